"""CholecSeg8k's classes, from `class_table.yaml`: codes of watershed masks and of colour masks."""

from typing import NamedTuple

from palpate.common.files import read_beside


class ClassEntry(NamedTuple):
    """Codes of one class."""

    grey: int
    """Value in `*_endo_watershed_mask.png`."""
    color: tuple[int, int, int]
    """RGB in `*_endo_color_mask.png`."""


CLASSES = {name: ClassEntry(entry["grey"], tuple(entry["color"])) for name, entry in read_beside(__file__).items()}
"""Codes of the classes by their names."""
