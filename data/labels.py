"""Labels of pixels: label maps are uint8 (Bini 2026, section 3.1: only the binary tool/tissue partition is used)."""

from palpate.data.source.layout import InputError

OTHER, TISSUE, TOOL, UNSURE = 0, 1, 2, 3
"""Labels of other pixels, tissue, the tool, and pixels that may be an instrument."""


class MaskError(InputError):
    """The label map of one frame is missing or unusable; the clip's other frames go on."""
