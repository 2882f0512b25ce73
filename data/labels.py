"""Labels of pixels: label maps are uint8 (Bini 2026, section 3.1: only the binary tool/tissue partition is used)."""

from palpate.data.source.layout import InputError

OTHER, TISSUE, TOOL, UNSURE = 0, 1, 2, 3
"""The last may be an instrument or not."""


class MaskError(InputError):
    """The label map of one frame is missing or unusable; the clip's other frames go on."""
