"""Package faces, and rooms of a checkout under both their names."""

import subprocess
import sys
from pathlib import Path

import pytest

from palpate.common.lazy import exported
from tests.conftest import CHECKOUT


def run(*arguments: str, folder: Path = CHECKOUT) -> str:
    done = subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_name_is_imported_when_it_is_asked_for_and_others_are_listed() -> None:
    find = exported("palpate.anything", {"math": ("pi",), "json": ("dumps",)})
    assert find("pi") == pytest.approx(3.14159265)
    with pytest.raises(AttributeError, match="there is no tau here; choose dumps, pi"):
        find("tau")


@pytest.mark.parametrize("first", ["physics.mesh", "palpate.physics.mesh"])
def test_both_names_of_a_module_are_the_same_module_whichever_comes_first(first: str) -> None:
    program = f"""
import importlib, sys
importlib.import_module({first!r})
import physics.mesh, palpate.physics.mesh
from physics.load import Press
import palpate.physics.load
assert physics.mesh is palpate.physics.mesh and Press is palpate.physics.load.Press
print(physics.mesh.__name__, physics.mesh.__spec__.name, Press.__module__)
"""
    assert run("-c", program) == "palpate.physics.mesh palpate.physics.mesh palpate.physics.load"


def test_a_module_that_is_not_there_is_missing_under_its_bare_name() -> None:
    program = """
try:
    import physics.nothing
except ModuleNotFoundError as error:
    print(error)
"""
    assert "physics.nothing" in run("-c", program)


def test_a_users_own_package_of_the_same_name_stays_theirs(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "__init__.py").write_text("OWN = 1\n")
    (tmp_path / "data" / "clip.py").write_text("CLIP = 2\n")
    program = f"""
import sys
sys.path.append({str(CHECKOUT)!r})
import physics.mesh  # the bare names of one room are no claim on another
import data.clip
import palpate.data.clip
print(data.OWN, data.clip.CLIP, palpate.data.clip.ClipStream.__name__)
"""
    assert run("-c", program, folder=tmp_path) == "1 2 ClipStream"


def test_a_program_of_a_room_runs_under_its_bare_name() -> None:
    assert run("-m", "data.synthetic", "--help").startswith("usage: python -m data.synthetic")
