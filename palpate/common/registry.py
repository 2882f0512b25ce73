"""Components by name: those that come along, and those that installed packages register as entry points."""

import functools
import importlib.metadata
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint
from typing import Any


@functools.cache
def _registered(find: Callable[..., Any], group: str) -> list[EntryPoint]:
    """Return entry points of a group; finding them takes as long as reading the names of all installed packages."""
    return list(find(group=group))


class Registry:
    """Components of one kind; each is imported only when it is asked for.

    Args:
        noun: name of the kind in sentences.
        group: group of entry points under which other packages register theirs, in their pyproject.toml.
        built_in: `package.module:name` of the components that come along; an entry point can't replace them.
    """

    def __init__(self, noun: str, group: str, built_in: Mapping[str, str]) -> None:
        self.noun, self.group = noun, group
        self._built_in = {name: EntryPoint(name, value, group) for name, value in built_in.items()}

    @property
    def entries(self) -> dict[str, EntryPoint]:
        """All components by name, built-in ones first."""
        found = {entry.name: entry for entry in _registered(importlib.metadata.entry_points, self.group)}
        return self._built_in | found | self._built_in

    def __getitem__(self, name: str) -> Any:
        """Import a component.

        Raises:
            ValueError: there is none of this name, or it can't be imported.
        """
        entries = self.entries
        if name not in entries:
            raise ValueError(f"there is no {self.noun} {name}; choose {', '.join(entries)}.")
        try:
            return entries[name].load()
        except (ImportError, AttributeError) as error:
            raise ValueError(f"{self.noun} {name} can't be imported ({error}); install its package anew.") from error
