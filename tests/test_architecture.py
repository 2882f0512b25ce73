"""The layout's floors and fences, read from the source, and the promise that inference never loads torch."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.inference_inputs import write_clip, write_model

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("physics", "data", "models", "estimators", "evaluation", "benchmarks")
FLOORS = {
    "physics": {"physics"},
    "data": {"data", "physics"},
    "models": {"models", "physics"},
    "estimators": {"estimators", "models", "data", "physics"},
    "evaluation": {"evaluation", "estimators", "models", "data", "physics"},
}
"""Packages of the project that each package may import: downwards only, and models and data not each other."""
FENCES = {
    "lightning": ("train.py", "models/module.py", "data/datamodule.py"),
    "mlflow": ("train.py",),
    "cv2": ("data/", "evaluation/"),
}
"""Where a library may be imported."""
NOT_AT_INFERENCE = (
    "torch",
    "lightning",
    "pytorch_lightning",
    "kornia",
    "mlflow",
    "matplotlib",
    "scipy.stats",
    "jsonargparse",
    "torchmetrics",
    "onnx",
)
"""Libraries that are not installed, or too heavy, where only inference runs."""


def sources() -> list[Path]:
    """All modules of the project, tests left out."""
    return sorted(ROOT.glob("*.py")) + [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imported(path: Path) -> set[str]:
    """Dotted names that a module imports anywhere, also inside functions; blocks for type checkers don't count."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            node.body = []
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name_of(path)} has a relative import; write the whole name"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def is_inside(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def test_the_layout_is_found() -> None:
    names = {name_of(path) for path in sources()}
    assert {"infer.py", "train.py", "physics/msd.py", "data/clip.py", "models/module.py"} <= names


@pytest.mark.parametrize("package", FLOORS)
def test_imports_go_downwards(package: str) -> None:
    upward = [
        f"{name_of(path)} imports {module}"
        for path in sources()
        if name_of(path).startswith(f"{package}/")
        for module in sorted(imported(path))
        if module.split(".")[0] in {*PACKAGES, "train", "infer"} - FLOORS[package]
    ]
    assert upward == []


@pytest.mark.parametrize("library", FENCES)
def test_libraries_stay_behind_their_fence(library: str) -> None:
    outside = [
        name_of(path)
        for path in sources()
        if not name_of(path).startswith(FENCES[library])
        and any(is_inside(module, library) for module in imported(path))
    ]
    assert outside == []


def test_package_files_are_empty_and_nothing_is_called_utils() -> None:
    assert [name_of(path) for path in sources() if path.name == "__init__.py" and path.read_text().strip()] == []
    assert [name_of(path) for path in sources() if path.stem in ("utils", "helpers", "common", "misc")] == []


def test_nothing_that_infer_can_reach_imports_training_libraries() -> None:
    """Follows every import from infer.py, also those inside functions, which a single run may not execute."""
    modules = {name_of(path).removesuffix(".py").replace("/", "."): path for path in sources()}
    reached, waiting = set(), ["infer"]
    while waiting:
        module = waiting.pop()
        if module in reached or module not in modules:
            continue
        reached.add(module)
        waiting += imported(modules[module])
    assert {"estimators.amortized", "physics.msd_kernel", "data.automatic_masks"} <= reached
    heavy = [
        f"{module} imports {name}"
        for module in sorted(reached)
        for name in sorted(imported(modules[module]))
        if any(is_inside(name, library) for library in NOT_AT_INFERENCE)
    ]
    assert heavy == []


def test_inference_runs_where_torch_cannot_be_imported(tmp_path: Path) -> None:
    """A whole run, with every training library made impossible to import, in a process of its own."""
    write_clip(tmp_path / "clip", 4, 2)
    write_model(tmp_path / "parameters.onnx")
    program = f"""
import sys
banned = {NOT_AT_INFERENCE!r}
class Ban:
    def find_spec(self, name, path=None, target=None):
        if any(name == entry or name.startswith(entry + ".") for entry in banned):
            raise ImportError(name + " is banned here")
sys.meta_path.insert(0, Ban())
import infer
status = infer.main([{str(tmp_path / "clip")!r}, "--output", {str(tmp_path / "out")!r},
                     "--model", {str(tmp_path / "parameters.onnx")!r}, "--masks", "automatic"])
loaded = [name for name in sys.modules if any(name == entry or name.startswith(entry + ".") for entry in banned)]
assert not loaded, loaded
sys.exit(status)
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "clip" / "parameters.csv").is_file()
