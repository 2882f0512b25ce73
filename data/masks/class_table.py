"""CholecSeg8k's classes, from `class_table.yaml`: how each is drawn in watershed masks and in colour masks."""

from pathlib import Path
from typing import NamedTuple

import yaml


class ClassEntry(NamedTuple):
    """How one class is drawn."""

    grey: int
    """Value in `*_endo_watershed_mask.png`."""
    color: tuple[int, int, int]
    """RGB in `*_endo_color_mask.png`."""


_TABLE = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
CLASSES = {name: ClassEntry(entry["grey"], tuple(entry["color"])) for name, entry in _TABLE.items()}
"""By the classes' names."""
