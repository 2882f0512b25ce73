"""The command `palpate`."""

import importlib
import re
import sys

import pytest

import palpate
from palpate.__main__ import COMMANDS, main


def test_help_names_every_command_which_is_a_program_and_another_is_a_sentence(capsys) -> None:
    assert main([]) == main(["--help"]) == 0
    told = capsys.readouterr().out
    for name, module in COMMANDS.items():
        assert re.search(rf"^    {name} +[A-Z].+\.$", told, re.M)
        assert callable(importlib.import_module(module).main)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"palpate {palpate.__version__}\n"
    assert main(["nonsense"]) == 2
    assert "there is no command 'nonsense'; choose infer, live, train," in capsys.readouterr().err


def test_a_command_gets_the_arguments_behind_its_name(capsys, monkeypatch) -> None:
    monkeypatch.setattr(sys, "argv", ["palpate"])
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["infer", "--version"])
    assert capsys.readouterr().out.startswith("palpate ")
    with pytest.raises(SystemExit):
        main(["plan", "--help"])
    assert capsys.readouterr().out.startswith("usage: palpate plan")


def test_training_without_its_libraries_says_what_to_install(capsys, monkeypatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {name!r}", name="lightning")

    monkeypatch.setattr("palpate.__main__.load_program", missing)
    assert main(["export"]) == 2
    assert "export needs lightning; install 'palpate[train]'" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_prints_its_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A lone % in a help text ends argparse with a traceback."""
    with pytest.raises(SystemExit, match=r"^0$"):
        main([name, "--help"])
    assert "usage" in capsys.readouterr().out.lower()
