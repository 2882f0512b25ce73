"""Labels of pixels: label maps are uint8 (Bini 2026, section 3.1: only the binary tool/tissue partition is used)."""

OTHER, TISSUE, TOOL = 0, 1, 2
