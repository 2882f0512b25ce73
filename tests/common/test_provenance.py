"""Results know every line they were made with: of sub-packages too, and from an installed package as well."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from palpate.common.provenance import MASKS, NOT_PREPARATION, PACKAGES, PREPARATION, code_digest
from tests.conftest import CHECKOUT

SETUP = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]


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


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("physics/msd/cone.py", ("all", "kernels")),
        ("data/contact/motion.py", ("all", "preparation")),
        ("data/depth/presets/photometric.yaml", ("all", "preparation")),
        ("common/robust.py", ("all", "preparation")),
        ("data/training/samples.py", ("all",)),
        ("estimators/network/fits.py", ("all",)),
        ("models/weights/contact.onnx", ()),
        (MASKS, ("all", "preparation")),
    ],
)
def test_a_changed_source_changes_the_digests_of_its_parts(tmp_path: Path, monkeypatch, name, parts) -> None:
    path = tmp_path / name
    path.parent.mkdir(parents=True)
    monkeypatch.setattr("palpate.common.provenance.ROOT", tmp_path)
    digests = []
    for content in ("LIMIT = 1", "LIMIT = 2"):
        path.write_text(content)
        digests.append({part: code_digest.__wrapped__(part) for part in ("all", "preparation", "kernels")})
    assert tuple(part for part, digest in digests[0].items() if digest != digests[1][part]) == parts


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
    assert rooms == {*PACKAGES, "cli"}
    # A folder without __init__.py would be left out of a wheel.
    folders = {path.parent.relative_to(CHECKOUT) for path in CHECKOUT.glob("palpate/**/*.py")}
    assert {
        folder for folder in folders if folder.parts[1:2] not in [(name,) for name in ("data", "models", "physics")]
    } <= found


def test_a_prepared_clip_depends_on_what_preparing_it_imports() -> None:
    prepares = "palpate.data.clip, palpate.data.masks.automatic"  # the second only where masks are automatic
    program = f"import sys, {prepares}; print(*(vars(each).get('__file__') for each in [*sys.modules.values()]))"
    command = [sys.executable, "-c", program]
    names = subprocess.run(command, capture_output=True, text=True, check=True, cwd=CHECKOUT).stdout.split()
    files = {Path(name).resolve().relative_to(CHECKOUT) for name in names if f"{CHECKOUT}/" in name}
    imported = {path.as_posix().removeprefix("palpate/") for path in files}
    ours = {name for name in imported if name.split("/")[0] in PACKAGES}
    assert "data/contact/motion.py" in ours
    assert not [name for name in ours if name.startswith(NOT_PREPARATION)]
    others = {name for name in ours if not name.startswith("data/")}
    # The helpers load modules, name sources, show names, read and list files, refuse settings and hand items on.
    helpers = [
        "__init__",
        "ahead",
        "lazy",
        "provenance",
        "doors",
        "settings",
        "files",
        "output",
        "registry",
        "heap",
        "stages",
    ]
    assert others - {f"common/{name}.py" for name in helpers} == {"physics/__init__.py", *PREPARATION} - {MASKS}
