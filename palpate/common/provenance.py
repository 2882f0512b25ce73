"""Code that a result was made with: version and digest of the sources, the same from a checkout and installed."""

import functools
import hashlib
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

ROOT = Path(__file__).resolve().parents[1]
"""Folder `palpate`."""
PACKAGES = ("common", "data", "estimators", "models", "observations", "physics", "planning", "results")
NOT_PREPARATION = ("data/synthetic/", "data/training/")
"""Folders that no prepared clip depends on."""
MASKS = "models/weights/instruments.onnx"
"""The network that outlines instruments."""
PREPARATION = ("common/onnx_devices.py", "common/robust.py", "physics/jit.py", "physics/mesh.py", MASKS)
"""Files outside data/ on which it depends."""
Part = Literal["all", "preparation", "kernels"]


def _version() -> str:
    """Return the version of the installed package; in a plain checkout, that of pyproject.toml."""
    try:
        return version("palpate")
    except PackageNotFoundError:
        path = ROOT.parent / "pyproject.toml"
        return tomllib.loads(path.read_text("utf-8"))["project"]["version"] if path.is_file() else "unknown"


__version__ = _version()


@functools.cache
def code_digest(part: Part = "all") -> str:
    """Return the digest of every module, preset and built-in model that can change a result, sub-packages included, or
    of a part.

    Args:
        part: preparation: what decides what a prepared clip holds. kernels: what is compiled.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        root = ROOT / package if (ROOT / package).is_dir() else ROOT.parent / package  # a checkout without links
        for path in sorted(path for path in root.rglob("*") if path.suffix in (".py", ".yaml", ".onnx")):
            name = f"{package}/{path.relative_to(root).as_posix()}"
            if _belongs(name, part):
                digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _belongs(name: str, part: Part) -> bool:
    """Return whether a source, by its path below ROOT, counts for a part."""
    if part == "kernels":
        return name.startswith("physics/")
    if part == "preparation":
        return name in PREPARATION or (name.startswith("data/") and not name.startswith(NOT_PREPARATION))
    # An estimator's network is known by the hash of its own file.
    return name == MASKS or not name.startswith("models/weights/")
