"""Names that a package exports, imported only when they are asked for, and rooms of a checkout under both their names.

In a wheel everything lies under `palpate.`. In a checkout the rooms lie next to the package `palpate`, so that
`import physics` and `python -m evaluation.benchmark` work there, too. Both names must be the same modules, because a
class that is loaded twice is two classes.
"""

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.abc import InspectLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType
from typing import Any

PACKAGE = "palpate."


def exported(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """A package's `__getattr__`.

    Args:
        package: the package's `__name__`; a room imported by its bare name becomes the room of `palpate`.
        modules: names by the module that defines them.
    """
    if not package.startswith(PACKAGE) and package + "." != PACKAGE:
        _share(package)
    homes = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"there is no {name} here; choose {', '.join(sorted(homes))}.")
        return getattr(importlib.import_module(homes[name]), name)

    return find


def _share(room: str) -> None:
    """Let a room's bare name, and the bare names of all modules in it, stand for those in `palpate`."""
    if not any(isinstance(finder, _BareNames) for finder in sys.meta_path):
        sys.meta_path.insert(0, _BareNames())
    sys.modules[room] = importlib.import_module(PACKAGE + room)


class _BareNames(MetaPathFinder):
    """Finds `physics.mesh` as `palpate.physics.mesh`, in rooms that were imported by their bare name."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        room = sys.modules.get(fullname.partition(".")[0])
        if "." not in fullname or room is None or room.__name__ != PACKAGE + fullname.partition(".")[0]:
            return None
        real = importlib.util.find_spec(PACKAGE + fullname)
        if real is None:
            return None
        is_package = real.submodule_search_locations is not None
        return ModuleSpec(fullname, _SameModule(real), origin=real.origin, is_package=is_package)


class _SameModule(InspectLoader):
    """Loads nothing of its own: the module is the one in `palpate`."""

    def __init__(self, real: ModuleSpec) -> None:
        self._real = real

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return importlib.import_module(self._real.name)

    def exec_module(self, module: ModuleType) -> None:
        """Nothing but its own name back: the module has been executed under it."""
        module.__spec__ = self._real

    def get_code(self, fullname: str) -> CodeType | None:
        """Code of the module, for `python -m`."""
        return self._real.loader.get_code(self._real.name)  # ty: ignore

    def get_source(self, fullname: str) -> str | None:
        """Source of the module, for tracebacks."""
        return self._real.loader.get_source(self._real.name)  # ty: ignore
