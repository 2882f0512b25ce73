"""constraints.txt, which `make lock` compiles."""

import re
import tomllib
from itertools import chain
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]


def test_the_lock_pins_all_that_the_project_asks_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pins = dict(re.findall(r"^(\S+)==(\S+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    for asked in map(Requirement, chain(project["dependencies"], *project["optional-dependencies"].values())):
        assert asked.specifier.contains(pins[asked.name.lower()]), asked
