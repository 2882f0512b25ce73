"""The layout's floors, fences and faces, read from the source, and the promise that inference never loads torch."""

import ast
import graphlib
import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from palpate.data.synthetic.clip import write_clip as write_synthetic
from palpate.data.synthetic.settings import SceneSettings
from tests.inference_inputs import write_model

ROOT = Path(__file__).resolve().parents[1]
BELOW_RESULTS = {"estimators", "observations", "models", "data", "physics", "common"}
FLOORS = {
    "common": set(),
    "physics": {"common"},
    "data": {"physics", "common"},
    "models": {"physics", "common"},
    "observations": BELOW_RESULTS - {"estimators", "observations"},
    "estimators": BELOW_RESULTS - {"estimators"},
    "planning": BELOW_RESULTS,
    "results": BELOW_RESULTS,
    "palpate": BELOW_RESULTS | {"results", "planning"},
    "cli": BELOW_RESULTS | {"results", "planning", "palpate"},
    "benchmarks": BELOW_RESULTS | {"results", "planning", "palpate", "cli"},
}
"""What of the project each room may import: downwards only, and models and data not each other. `palpate` is the
public face alone, `cli` what a user types. `benchmarks` is not installed, and nothing else imports it."""
FENCES = {
    "lightning": (
        "palpate/cli/train.py",
        "palpate/cli/tracking.py",
        "models/module.py",
        "models/contact_module.py",
        "models/instruments/module.py",
        "data/training/contacts.py",
        "data/training/datamodule.py",
        "data/training/instruments/datamodule.py",
    ),
    "lightning.pytorch.loggers": ("palpate/cli/tracking.py",),
    "mlflow": ("palpate/cli/train.py", "palpate/cli/tracking.py"),
    "cv2": ("data/", "palpate/results/", "benchmarks/"),
    "matplotlib": (
        "palpate/planning/pictures.py",
        "palpate/results/artefacts/fit.py",
        "palpate/results/paper/",
        "benchmarks/",
    ),
    "jinja2": ("palpate/results/page/render.py",),
    "pandas": ("benchmarks/", "palpate/results/paper/"),
    "trimesh": (
        "palpate/planning/surface.py",
        "data/source/clouds.py",
        "palpate/estimators/palpation/",
        "physics/fem/surface.py",
        "benchmarks/",
    ),
    "scipy.stats": ("palpate/estimators/direct/", "palpate/results/paper/", "benchmarks/"),
}
"""Where a library may be imported, by whatever door."""
LIGHT_DOORS = {
    "palpate.cli.calibrate": "palpate.estimators.palpation.material_fit",
    "palpate.cli.infer": "palpate.estimators.direct.sampling",
    "palpate.cli.live": "palpate.estimators.direct.sampling",
    "palpate.cli.page": "palpate.results.page.render",
    "palpate.cli.plan": "palpate.planning.roadmap",
    "palpate.data.synthetic.__main__": "palpate.data.synthetic.truth",
}
"""Programs that run where no network is trained, and something that each of them reaches."""
HEAVY = ("torch", "lightning", "pytorch_lightning", "kornia", "mlflow", "jsonargparse", "torchmetrics", "onnx")
"""Libraries that are not installed, or too heavy, where only inference runs."""
MOST_NAMES = 15
"""Names that a package's face exports, at most."""


@cache
def modules() -> dict[str, Path]:
    """Files of the project by the names under which they are imported, tests left out."""
    found = {
        path.relative_to(ROOT): path for folder in ("palpate", "benchmarks") for path in (ROOT / folder).rglob("*.py")
    }
    linked = [path for folder in ("physics", "data", "models") for path in (ROOT / folder).rglob("*.py")]
    found |= {Path("palpate", path.relative_to(ROOT)): path for path in linked}
    names = {name.with_suffix("").as_posix().replace("/", "."): path for name, path in found.items()}
    return {name.removesuffix(".__init__"): names[name] for name in sorted(names)}


def room_of(module: str) -> str:
    """Which of the FLOORS a module stands on."""
    if is_inside(module, "benchmarks"):
        return "benchmarks"
    room = module.split(".")[1] if "." in module else "palpate"
    return room if room in FLOORS else "palpate"


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(node: ast.AST, *, within_functions: bool = True) -> Iterator[ast.Import | ast.ImportFrom]:
    """Imports in a piece of source; blocks for type checkers don't count."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif within_functions or not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from imports(child, within_functions=within_functions)


@cache
def imported(path: Path, *, within_functions: bool = True) -> frozenset[str]:
    """Dotted names that a file imports, as modules and as names in modules, and modules of components that it names."""
    found: set[str] = set()
    for node in imports(tree_of(path), within_functions=within_functions):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        else:
            found |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
    texts = (node.value for node in ast.walk(tree_of(path)) if isinstance(node, ast.Constant))
    components = (re.fullmatch(r"(palpate(?:\.\w+)+):[\w.]+", str(text)) for text in texts if within_functions)
    found |= {component[1] for component in components if component and modules().get(component[1]) != path}
    return frozenset(found)


def is_face(call: ast.Call) -> bool:
    return isinstance(call.func, ast.Name) and call.func.id == "exported"


@cache
def faces() -> dict[str, dict[str, str]]:
    """What every package exports: the module that defines a name, by the name."""
    found = {}
    for package, path in modules().items():
        if path.name == "__init__.py":
            calls = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)]
            homes = next((ast.literal_eval(call.args[0]) for call in calls if is_face(call)), {})
            found[package] = {name: home for home, names in homes.items() for name in names}
    return found


@cache
def reached_at_once(module: str) -> set[str]:
    """Files of the project that a file imports, through the faces to the homes of the names that it takes from them."""
    homes = {f"{package}.{name}": home for package, names in faces().items() for name, home in names.items()}
    return {homes.get(name, name) for name in imported(modules()[module])} & set(modules())


def is_inside(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def test_the_layout_is_found() -> None:
    wanted = ("palpate", "palpate.cli.train", "palpate.physics.msd", "palpate.data.clip", "palpate.models.module")
    assert set(wanted) <= set(modules())
    assert "palpate.data.training.samples" in reached_at_once("palpate.estimators.network.training") | set(modules())
    assert not [name for name in modules() if name.rpartition(".")[2] in ("utils", "helpers", "misc")]


def test_imports_name_files_in_full() -> None:
    """So that they can be followed: no relative ones, and no package whose names are looked up later."""
    vague = [
        f"{name_of(path)}, line {node.lineno}"
        for path in modules().values()
        for node in imports(tree_of(path))
        if (isinstance(node, ast.ImportFrom) and node.level)
        or (isinstance(node, ast.Import) and {alias.name for alias in node.names} & set(faces()))
    ]
    assert vague == []


@pytest.mark.parametrize("room", FLOORS)
def test_imports_go_downwards(room: str) -> None:
    upward = [
        f"{module} imports {name}"
        for module, path in modules().items()
        if room_of(module) == room
        for name in sorted(imported(path))
        if name.split(".")[0] in ("infer", "train", "tests", *FLOORS)
        and (room_of(name) not in FLOORS[room] | {room} or not name.startswith(("palpate", "benchmarks")))
    ]
    assert upward == []


def test_no_two_files_need_each_other() -> None:
    """In whatever function, and by however many others."""
    order = graphlib.TopologicalSorter({module: reached_at_once(module) for module in modules()}).static_order()
    assert set(order) >= set(modules())  # a circle is an error that names it


@pytest.mark.parametrize("library", FENCES)
def test_libraries_stay_behind_their_fence(library: str) -> None:
    outside = [
        name_of(path)
        for path in modules().values()
        if not name_of(path).startswith(FENCES[library])
        and any(is_inside(module, library) for module in imported(path))
    ]
    assert outside == []


@pytest.mark.parametrize(
    ("library", "user"),
    [
        ("matplotlib", "palpate.results.artefacts.fit"),
        ("scipy.stats", "palpate.estimators.direct.sampling"),
        ("jinja2", "palpate.results.page.render"),
    ],
)
def test_what_loads_slowly_is_loaded_only_where_it_is_used(library: str, user: str) -> None:
    assert any(is_inside(name, library) for name in imported(modules()[user]))
    at_once = [
        name_of(path)
        for module, path in modules().items()
        if room_of(module) != "benchmarks"
        and not is_inside(module, "palpate.results.paper")
        and any(is_inside(name, library) for name in imported(path, within_functions=False))
    ]
    assert at_once == []


@pytest.mark.parametrize("door", LIGHT_DOORS)
def test_nothing_that_a_light_door_can_reach_imports_training_libraries(door: str) -> None:
    """Follows every import, also those inside functions, which a single run may not execute."""
    reached, waiting = set(), {door}
    while waiting:
        module = waiting.pop()
        reached.add(module)
        waiting |= reached_at_once(module) - reached
    assert LIGHT_DOORS[door] in reached
    heavy = [
        f"{module} imports {name}"
        for module in sorted(reached)
        for name in sorted(imported(modules()[module]))
        if any(is_inside(name, library) for library in HEAVY)
    ]
    assert heavy == []


@pytest.mark.slow
def test_inference_runs_where_torch_cannot_be_imported(tmp_path: Path) -> None:
    """Whole runs, fit included, with every training library made impossible to import, in a process of its own."""
    scene = SceneSettings(
        width=214, height=120, frames=12, onset_fraction=(0.25, 0.25), press_seconds=(0.16, 0.16), depth_noise=0.0005
    )
    clip = write_synthetic(tmp_path / "clips", 1, scene, 3)
    write_model(tmp_path / "parameters.onnx")
    program = f"""
import sys
banned = {HEAVY!r}
class Ban:
    def find_spec(self, name, path=None, target=None):
        if any(name == entry or name.startswith(entry + ".") for entry in banned):
            raise ImportError(name + " is banned here")
sys.meta_path.insert(0, Ban())
from palpate.cli import infer
raw, model = ["--masks", "automatic", "--depth", "photometric"], ["--model", {str(tmp_path / "parameters.onnx")!r}]
quick = ["--onset", "stamp", "--no-overlay"]
for name, options in (("network", quick), ("gan", [*model, *raw]), ("direct", quick)):
    output = {str(tmp_path)!r} + "/" + name
    assert infer.main([{str(clip)!r}, "--output", output, "--estimator", name, *options]) == 0, name
loaded = [name for name in sys.modules if any(name == entry or name.startswith(entry + ".") for entry in banned)]
assert not loaded, loaded
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    for name in ("network", "gan", "direct"):
        assert (tmp_path / name / clip.name / "interactions.csv").is_file()


@pytest.mark.parametrize("package", faces())
def test_a_face_maps_every_room_of_its_package(package: str) -> None:
    path = modules()[package]
    rooms = {name.removeprefix(f"{package}.") for name in modules() if name.startswith(f"{package}.")}
    words = set(re.findall(r"\w+", ast.get_docstring(tree_of(path)) or ""))
    assert {room for room in rooms if "." not in room and room != "__main__"} - words == set()


@pytest.mark.parametrize("package", faces())
def test_a_face_exports_few_names_that_exist(package: str) -> None:
    names = faces()[package]
    assert len(names) <= MOST_NAMES
    assert not [name for name in names if f"{package}.{name}" in modules()]
    face = importlib.import_module(package)
    for name, home in names.items():
        assert is_inside(home, package)
        assert getattr(face, name) is vars(importlib.import_module(home))[name]


def test_faces_load_nothing() -> None:
    program = f"""
import importlib, sys
packages = {sorted(faces())!r}
for package in packages:
    importlib.import_module(package)
print(*sorted({{name for name in sys.modules if name.split(".")[0] not in sys.stdlib_module_names}} - set(packages)))
"""
    done = subprocess.run([sys.executable, "-S", "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert set(done.stdout.split()) - {"__main__"} == {"palpate.common.lazy"}, done.stderr


def test_json_is_written_by_one_function() -> None:
    """`palpate.common.files.as_json`, which leaves no number in it that JSON doesn't know."""
    writers = [
        f"{name_of(path)}, line {node.lineno}"
        for module, path in modules().items()
        if module != "palpate.common.files"
        for node in ast.walk(tree_of(path))
        if (isinstance(node, ast.Attribute) and ast.unparse(node) in ("json.dump", "json.dumps", "json.JSONEncoder"))
        or (isinstance(node, ast.Attribute) and node.attr == "to_json")
        or (isinstance(node, ast.ImportFrom) and node.module == "json")
    ]
    assert writers == []


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Strings that document something, attributes too, with their lines."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value.strip()


def test_docstrings_begin_with_what_they_describe() -> None:
    """Each makes sense alone, as a tooltip."""
    opening = re.compile(r"(?:Of|Likewise|That|The same|As|Whoever)\b|(?s:.*)\b[Aa]s of\b")
    vague = [
        f"{name_of(path)}, line {line}: {text[:60]}"
        for path in (*modules().values(), *(ROOT / "tests").rglob("*.py"))
        for line, text in docstrings(path)
        if opening.match(text)
    ]
    assert vague == []


def test_hardly_a_name_is_a_participle_of_telling() -> None:
    """`told`, `said`, `led`, `seen` and `gone` don't say what they hold; public names of old may keep them."""
    found = []
    for path in modules().values():
        for node in ast.walk(tree_of(path)):
            stored = isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store)
            names = ("id", "attr") if stored else ("arg", "name") if not isinstance(node, ast.keyword) else ()
            if {getattr(node, name, None) for name in names} & {"told", "said", "led", "seen", "gone"}:
                found.append(f"{name_of(path)}, line {getattr(node, 'lineno', 0)}")
    assert len(found) < 20, found


def test_pages_name_no_commits() -> None:
    commit = re.compile(r"\b(?=[a-f]*\d)(?=\d*[a-f])[0-9a-f]{7,40}\b")
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "models").rglob("*.md")]
    assert [f"{name_of(page)}: {found}" for page in pages for found in commit.findall(page.read_text("utf-8"))] == []
