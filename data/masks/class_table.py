"""CholecSeg8k's classes: the grey value of `*_endo_watershed_mask.png` and the RGB colour of `*_endo_color_mask.png`.

The first seven were measured on the real masks of video01_00080; the others are the data set's published table.
"""

from typing import NamedTuple


class ClassEntry(NamedTuple):
    """How one class is drawn."""

    grey: int
    """Value in the watershed mask."""
    color: tuple[int, int, int]
    """RGB in the colour mask."""


CLASSES: dict[str, ClassEntry] = {
    "background": ClassEntry(50, (127, 127, 127)),
    "abdominal wall": ClassEntry(11, (210, 140, 140)),
    "liver": ClassEntry(21, (255, 114, 114)),
    "gastrointestinal tract": ClassEntry(13, (231, 70, 156)),
    "fat": ClassEntry(12, (186, 183, 75)),
    "grasper": ClassEntry(31, (170, 255, 0)),
    "gallbladder": ClassEntry(22, (255, 160, 165)),
    "connective tissue": ClassEntry(23, (255, 85, 0)),
    "blood": ClassEntry(24, (255, 0, 0)),
    "cystic duct": ClassEntry(25, (255, 255, 0)),
    "l-hook electrocautery": ClassEntry(32, (169, 255, 184)),
    "hepatic vein": ClassEntry(33, (0, 50, 128)),
    "liver ligament": ClassEntry(5, (111, 74, 0)),
}
