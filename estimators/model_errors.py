"""What a fit's own model gets wrong, besides what residuals tell: standard deviations measured on drawn clips.

They are read from `model_errors.yaml`, which `python -m benchmarks.model_errors` writes. Every entry there has its
`meaning`, its `value`, its `source` (which clips, by what) and, as far as that command has measured it, what it found
(`measured`).
"""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import yaml

FILE = Path(__file__).with_suffix(".yaml")
_VALUES = {name: float(entry["value"]) for name, entry in yaml.safe_load(FILE.read_text(encoding="utf-8")).items()}
MODEL_ERRORS = SimpleNamespace(**_VALUES)
"""The values, by the entries' names."""


def read_entries(path: Path = FILE) -> dict[str, dict[str, Any]]:
    """Entries of a file, by name.

    Raises:
        ValueError: it has other entries than `model_errors.yaml`.
    """
    entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    if not isinstance(entries, dict) or list(entries) != list(_VALUES):
        names = ", ".join(_VALUES)
        raise ValueError(f"{path} holds other entries than {names}; write it with benchmarks.model_errors.")
    return entries
