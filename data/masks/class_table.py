"""CholecSeg8k's classes, from `class_table.yaml`: how each is drawn in watershed masks and in colour masks."""

from typing import NamedTuple

from palpate.common.files import read_beside


class ClassEntry(NamedTuple):
    """How one class is drawn."""

    grey: int
    """Value in `*_endo_watershed_mask.png`."""
    color: tuple[int, int, int]
    """RGB in `*_endo_color_mask.png`."""


CLASSES = {name: ClassEntry(entry["grey"], tuple(entry["color"])) for name, entry in read_beside(__file__).items()}
"""By the classes' names."""
