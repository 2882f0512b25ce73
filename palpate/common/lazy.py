"""Names that a package exports, imported only when they are asked for."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def exported(modules: Mapping[str, Sequence[str]]) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return a package's `__getattr__`, `__dir__` and `__all__`.

    Args:
        modules: names by the module that defines them.
    """
    homes = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"there is no {name} here; choose {', '.join(sorted(homes))}.")
        return getattr(importlib.import_module(homes[name]), name)

    names = sorted(homes)
    return find, lambda: names, names
