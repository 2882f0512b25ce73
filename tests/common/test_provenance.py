"""Results know every line they were made with: of sub-packages too, and from an installed package as well."""

import ast
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from palpate.common.provenance import NOT_PREPARATION, PACKAGES, PREPARATION, code_digest
from tests.conftest import CHECKOUT

DECIDING = ("common", "data", "estimators", "models", "physics", "results")
"""Packages on which a user's results depend."""
SETUP = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
FINGERPRINTS = """
import functools, sys
from pathlib import Path
from palpate.data.settings import PrepareSettings
from palpate.common.files import digest_of
from palpate.common.provenance import ROOT, code_digest
from palpate.estimators.open import EstimatorOptions, open_estimator
from palpate.results.record import depends_on

Path.rglob = functools.cache(lambda folder, pattern, find=Path.rglob: list(find(folder, pattern)))  # files stay
estimator = open_estimator(EstimatorOptions("direct"))

def found():
    code_digest.cache_clear()
    causes = depends_on(Path("clip.mp4"), PrepareSettings(), estimator)
    return digest_of(causes), *map(code_digest, ("preparation", "kernels"))

print(ROOT, *found())
for name in sys.stdin.read().splitlines():
    path, changed = Path(name), Path(name + ".changed")
    kept = path.read_bytes()
    path.write_bytes(changed.read_bytes())
    print(name, *found())
    path.write_bytes(kept)
print(ROOT, *found())
"""
"""Prints fingerprint and digests of the program as it is, with every file that is named replaced in turn, and again."""


def run(program: str, **options: Any) -> str:
    """What a program of its own prints."""
    command = [sys.executable, "-c", program]
    return subprocess.run(command, capture_output=True, text=True, check=True, **options).stdout


def folder_of(package: str) -> Path:
    """Where a package's files stand in the checkout."""
    room, _, rest = package.removeprefix("palpate.").partition(".")
    found = SETUP["package-dir"].get(f"palpate.{room}")
    return CHECKOUT / package.replace(".", "/") if found is None else CHECKOUT / found / rest.replace(".", "/")


def installed(site: Path) -> Path:
    """What a wheel of the project unpacks to: the packages that are listed, and their data; the folder of the rooms."""
    for package in SETUP["packages"]:
        target, folder = site / package.replace(".", "/"), folder_of(package)
        target.mkdir()
        for pattern in ("*.py", *SETUP["package-data"].get(package, ())):
            for path in folder.glob(pattern):
                copy = target / path.relative_to(folder)
                copy.parent.mkdir(exist_ok=True)
                shutil.copyfile(path, copy)
    (site / "palpate-1.dist-info").mkdir()
    (site / "palpate-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: palpate\nVersion: 1\n")
    return site / "palpate"


def checked_out(folder: Path) -> Path:
    """A copy of the checkout's packages."""
    shutil.copytree(CHECKOUT / "palpate", folder / "palpate", symlinks=True)
    for package in PACKAGES:
        shutil.copytree(CHECKOUT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copyfile(CHECKOUT / "pyproject.toml", folder / "pyproject.toml")
    return folder


def changed(source: bytes) -> bytes:
    """A module with one number in it raised by 1; one without any says something else of itself."""
    tree = ast.parse(source)
    numbers = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and type(node.value) in (int, float))
    node, added = next(numbers, None), b"+1"
    if node is None:
        node, added = tree.body[0].value, b'" "'
    lines = source.splitlines(keepends=True)
    line, column = node.end_lineno - 1, node.end_col_offset
    lines[line] = lines[line][:column] + added + lines[line][column:]
    compile(b"".join(lines), "changed", "exec")
    return b"".join(lines)


@pytest.mark.parametrize(("lay_out", "every"), [(checked_out, 1), (installed, 12)])
def test_a_constant_changed_in_any_module_changes_the_fingerprint(lay_out, every: int, tmp_path: Path) -> None:
    """Of an installed package, whose digest is that of the checkout (below), in every twelfth module."""
    (tmp_path / "tree").mkdir()
    tree = lay_out(tmp_path / "tree")
    modules = [path for package in DECIDING for path in sorted((tree / package).rglob("*.py")) if path.stat().st_size]
    names = {path.relative_to(tree).as_posix() for path in modules}
    assert {"data/contact/motion.py", "estimators/network/fits.py", "models/losses.py", "physics/msd/cone.py"} <= names
    modules = modules[::every]
    for path in modules:
        path.with_name(f"{path.name}.changed").write_bytes(changed(path.read_bytes()))
    models = [tree / "data/depth/photometric.onnx", tree / "data/depth/presets/photometric.yaml"]
    for path in models:
        path.with_name(f"{path.name}.changed").write_bytes(path.read_bytes() + b"\n")
    (tmp_path / "clip.mp4").touch()
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "tree"), "PYTHONDONTWRITEBYTECODE": "1"}
    named = "\n".join(map(str, [*modules, *models]))
    said = run(FINGERPRINTS, cwd=tmp_path, input=named, env=environment)
    first, *edited, last = (line.rsplit(" ", 3) for line in said.splitlines())
    assert first == last
    assert Path(first[0]) == tree
    assert len(edited) == len(modules) + len(models) > 180 / every
    assert len({fingerprint for _, fingerprint, *_ in [first, *edited]}) == len(edited) + 1
    for name, _, preparation, kernels in edited:
        path = Path(name).relative_to(tree).as_posix()
        prepares = path.startswith("data/") and not path.startswith(NOT_PREPARATION)
        assert (preparation != first[2]) == (prepares or path in PREPARATION), path
        assert (kernels != first[3]) == path.startswith("physics/"), path


@pytest.mark.parametrize("part", ["all", "preparation", "kernels"])
def test_installed_the_digest_is_the_checkout_s(tmp_path: Path, monkeypatch, part) -> None:
    expected = code_digest(part)
    monkeypatch.setattr("palpate.common.provenance.ROOT", installed(tmp_path))
    assert code_digest.__wrapped__(part) == expected


def test_every_package_of_the_tree_is_installed() -> None:
    found = {path.parent.relative_to(CHECKOUT) for path in CHECKOUT.glob("[!.]*/**/__init__.py")}
    names = {".".join(path.parts) for path in found if path.parts[0] not in ("tests", "benchmarks")}
    assert {name if name.startswith("palpate") else f"palpate.{name}" for name in names} == set(SETUP["packages"])
    rooms = {package.split(".")[1] for package in SETUP["packages"] if "." in package}
    assert rooms == {*PACKAGES, "command"}
    # A folder without __init__.py would be left out of a wheel.
    modules = [path for package in PACKAGES for path in CHECKOUT.glob(f"{package}/**/*.py")]
    assert {path.parent.relative_to(CHECKOUT) for path in modules} <= found


def test_a_prepared_clip_depends_on_what_preparing_it_imports() -> None:
    prepares = "palpate.data.clip, palpate.data.masks.automatic"  # the second only where masks are automatic
    program = f"import sys, {prepares}; print(*(vars(each).get('__file__') for each in [*sys.modules.values()]))"
    names = run(program, cwd=CHECKOUT).split()
    imported = {Path(name).resolve().relative_to(CHECKOUT).as_posix() for name in names if f"{CHECKOUT}/" in name}
    ours = {name for name in imported if name.split("/")[0] in PACKAGES}
    assert "data/contact/motion.py" in ours
    assert not [name for name in ours if name.startswith(NOT_PREPARATION)]
    others = {name for name in ours if not name.startswith("data/")}
    # The helpers load modules, name sources, show names, read and list files, refuse settings and hand items on.
    helpers = ("__init__", "ahead", "lazy", "provenance", "doors", "settings", "files", "output")
    assert others - {f"common/{name}.py" for name in helpers} == {"physics/__init__.py", *PREPARATION}
