"""Package faces, and programs of a checkout's rooms under their bare names."""

import subprocess
import sys

import pytest

from palpate.common.lazy import exported
from tests.conftest import CHECKOUT


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], cwd=CHECKOUT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_name_is_imported_when_it_is_asked_for_and_others_are_listed() -> None:
    find, listed, public = exported({"math": ("pi",), "json": ("dumps",)})
    assert listed() == public == ["dumps", "pi"]
    assert find("pi") == pytest.approx(3.14159265)
    with pytest.raises(AttributeError, match="there is no tau here; choose dumps, pi"):
        find("tau")


def test_a_program_of_a_room_runs_under_its_bare_name() -> None:
    assert run("-m", "data.synthetic", "--help").startswith("usage: python -m data.synthetic")
