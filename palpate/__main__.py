"""One command for every program of the project.

    palpate COMMAND [options]

`palpate COMMAND --help` lists a command's options. Research software, not a medical device.
"""

from palpate.common.doors import enter_door, load_program, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import ast
import importlib.util
import sys
from pathlib import Path

from palpate.common.provenance import __version__

OWN = ("infer", "live", "train", "calibrate", "plan", "page", "outline")
"""Commands that are modules of `palpate.cli`."""
COMMANDS = {name: f"palpate.cli.{name}" for name in OWN} | {
    "export": "palpate.cli.train",
    "synthetic": "palpate.data.synthetic.__main__",
}
"""Modules whose `main` takes a command's arguments."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command that the first argument names, with the others; returns the exit status."""
    name, *rest = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in ("--help", "-h"):
        print(__doc__ + "".join(f"\n    {name:10} {summary(name)}" for name in COMMANDS))
        return 0
    if name == "--version":
        print(f"palpate {__version__}")
        return 0
    if name not in COMMANDS:
        print(f"palpate: there is no command {name!r}; choose {', '.join(COMMANDS)}.", file=sys.stderr)
        return 2
    try:
        command = load_program(COMMANDS[name])
    except ModuleNotFoundError as error:
        if name not in ("train", "export"):
            raise
        print(f"palpate: {name} needs {error.name}; install 'palpate[train]'.", file=sys.stderr)
        return 2
    sys.argv[:] = [f"palpate {name}"]  # what the command calls itself in its messages
    return command.main(["export", *rest] if name == "export" else rest)


def summary(name: str) -> str:
    """Return the first line of a command's description, read without importing the command."""
    if name == "export":
        return "A trained network as one ONNX file for `palpate infer --model`."
    spec = importlib.util.find_spec(COMMANDS[name])
    assert spec is not None
    text = Path(str(spec.origin)).read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


def command() -> None:
    """Run the installed command `palpate`."""
    enter_door()
    run_door(main)


if __name__ == "__main__":
    run_door(main)
