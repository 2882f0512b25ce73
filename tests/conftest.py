"""Fixtures shared by all tests."""

import functools
import gc
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from palpate.common.workers import LIMITS

if "PYTEST_XDIST_WORKER" in os.environ:
    # One native thread for each of the test processes and what they start: where processes have together more threads
    # than the machine has cores, OpenMP's wait for each other in loops, and torch takes up to a hundred times as long.
    os.environ.update(dict.fromkeys(LIMITS, "1"))

CHECKOUT = Path(__file__).resolve().parents[1]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Leave the million objects of what tests import out of collections, each of which takes a third of a second."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Count acceptance tests as slow, and begin with files of slow tests: both processes end at the same time."""
    for item in items:
        if item.get_closest_marker("acceptance"):
            item.add_marker("slow")
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session", autouse=True)
def _one_table_of_operators() -> Iterator[None]:
    """Let torch's exporter, where tests import it, make its table of ONNX's operators once, and not for each file."""
    with pytest.MonkeyPatch.context() as patch:
        if "palpate.models.onnx_export" in sys.modules:
            from torch.onnx._internal.exporter._registration import ONNXRegistry

            patch.setattr(ONNXRegistry, "from_torchlib", staticmethod(functools.cache(ONNXRegistry.from_torchlib)))
        yield


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with the real clips, which are never part of the repository."""
    folder = Path(os.environ.get("TISSUE_REAL_DATA", CHECKOUT.parent / "shared" / "data"))
    if not (folder / "cholecseg8k").is_dir():
        pytest.skip(f"no real data at {folder}; set TISSUE_REAL_DATA")
    return folder


@pytest.fixture(autouse=True)
def _as_typed(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs whose `main` is called name themselves as if started in a checkout."""
    monkeypatch.setattr(sys, "argv", ["train.py" if "train" in request.path.stem else "infer.py"])


@pytest.fixture
def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures are drawn, which takes longer than all else about a short clip, where no test looks at them."""
    draw_nothing(monkeypatch)


@pytest.fixture(scope="module")
def blank_module() -> Iterator[None]:
    """Blank pictures for the results that a module's tests share."""
    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        yield


def draw_nothing(patch: pytest.MonkeyPatch) -> None:
    for draw in ("draw_fits",):
        patch.setattr(f"palpate.results.artefacts.fit.{draw}", lambda *_, **__: None)
    patch.setattr("palpate.results.artefacts.fit.write_figure", lambda path, _: path.write_bytes(b"a picture"))


@pytest.fixture
def nested() -> Iterator[Callable[[Path, str], None]]:
    """Makes 1100 folders within each other in a folder, all of one name."""
    home, tops = os.getcwd(), []

    def make(top: Path, name: str) -> None:
        tops.append((top, name))
        os.chdir(top)
        for _ in range(1100):
            os.mkdir(name)
            os.chdir(name)
        os.chdir(home)

    yield make
    for top, name in tops:  # pytest's own removal recurses
        os.chdir(top)
        for _ in range(1100):
            os.chdir(name)
        for _ in range(1100):
            os.chdir("..")
            os.rmdir(name)
    os.chdir(home)
