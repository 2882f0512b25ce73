"""Base of results: quantities with intervals, and dataclasses whose fields are columns of tables.

A column is declared once, where its value is. `skill: float = column("1 - error / motion")` stands in every table of
that class, with this text in run.json.
"""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Protocol, Self, get_type_hints

import numpy as np

from palpate.common.options import field_texts
from palpate.common.tables import to_cell
from palpate.physics.identifiability import NINETY

ENDS = {"": 0, "_low": -1, "_high": 1}
"""Endings of the columns of a value and its 90 % interval, with the side of the interval."""
UNITS = {
    "stiffness": "scene units (normalised), not N/m",
    "damping": "scene units (normalised), not N·s/m",
    "force": "scene units (normalised), not N",
    "displacement": "scene units: depth divided by the clip's one fixed scale",
    "time": "s",
    "distance_stiffness": "relative: a particle's mass over the square of a frame's time, not N/m; compares places "
    "within a run of contact, not clips",
    "shape_stiffness": "relative, not comparable with distance_stiffness",
    "gap": "scene units",
}
"""Units of the results."""
LEAST_SKILL = 0.35
"""Least skill of a fit that explains how tissue moves with an instrument. Instruments that pass over tissue reach 0.1
to 0.3, pulls 0.4 and more."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """Positive number, or array of such, whose logarithm has a normal error."""

    value: Any
    log_sd: Any = None
    """Standard deviation of the logarithm; None = the estimator gives none."""

    @property
    def sd(self) -> Any:
        """Standard deviation of the log-normal distribution."""
        return self.value * np.exp(self.log_sd**2 / 2) * np.sqrt(np.expm1(self.log_sd**2))

    def end(self, side: int) -> Any:
        """Return the lower (-1) or upper (1) end of the 90 % interval, or the value (0)."""
        return self.value * np.exp(side * NINETY * self.log_sd)

    @property
    def parts(self) -> dict[str, Any]:
        """Cells by the ending of their column."""
        if self.log_sd is None:
            return {"": self.value}
        ends = {end: float(self.end(side)) for end, side in ENDS.items() if side}
        return {"": self.value, "_sd": float(self.sd), **ends}


class Result(Protocol):
    """Result of a contact; a dataclass whose columns join the tables."""

    @property
    def verdict(self) -> str:
        """Verdict in a word."""

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the quantities that are determined."""

    @property
    def explanation(self) -> str:
        """Explanation beside verdict and numbers, a sentence."""


def column(text: str = "", default: Any = MISSING, **options: Any) -> Any:
    """Declare a field that is a column of its dataclass's tables; it may hold a `Quantity`, which has a column for each
    part.

    Args:
        text: unit and meaning, as run.json has them; by default the documentation of the field.
        default: of the field; without one it must be given.
        options: of `dataclasses.field`.
    """
    return field(default=default, metadata={"column": text}, **options)


def group(kind: type[Any], default: Any = None, **options: Any) -> Any:
    """Declare a field that holds a dataclass of this kind, or an object whose `numbers` is one: its columns stand
    here."""
    return field(default=default, metadata={"group": kind}, **options)


def columns_of(kind: type[Any]) -> dict[str, str]:
    """Return columns of a dataclass, in order, each with what it is."""
    found, texts, kinds = dict[str, str](), field_texts(kind), get_type_hints(kind)
    for item in fields(kind):
        if "group" in item.metadata:
            found |= columns_of(item.metadata["group"])
        elif "column" in item.metadata:
            text = found[item.name] = item.metadata["column"] or texts[item.name]
            if kinds[item.name] == Quantity | None:
                symbol = text.partition(" ")[0]
                found[f"{item.name}_sd"] = f"standard deviation of {symbol}; empty: the estimator gives none"
                for end, name in (("low", "lower"), ("high", "upper")):
                    found[f"{item.name}_{end}"] = f"{name} end of the 90 % interval of {symbol}"
    return found


def values_of(row: Any) -> dict[str, Any]:
    """Return values of a dataclass by column; what isn't known is left out."""
    found: dict[str, Any] = {}
    for item in fields(row):
        value = getattr(row, item.name)
        if value is None:
            continue
        if "group" in item.metadata:
            found |= values_of(getattr(value, "numbers", value))
        elif "column" in item.metadata:
            parts = value.parts if isinstance(value, Quantity) else {"": value}
            found |= {f"{item.name}{end}": part for end, part in parts.items()}
    return found


@dataclass(frozen=True)
class Table:
    """Table whose rows are an object of each of some dataclasses."""

    kinds: tuple[type[Any], ...]
    left_out: tuple[str, ...] = ()
    """Columns that it does not have."""

    @cached_property
    def columns(self) -> dict[str, str]:
        """Columns in order, each with its unit and what it is."""
        found = {name: text for kind in self.kinds for name, text in columns_of(kind).items()}
        return {name: text for name, text in found.items() if name not in self.left_out}

    def without(self, *names: str) -> Self:
        """Return the table without some columns."""
        return replace(self, left_out=names)

    def known(self, *rows: Any) -> dict[str, Any]:
        """Return values of a row, dataclasses or mappings, by column, without those that are missing."""
        values: dict[str, Any] = {}
        for row in rows:
            values |= row if isinstance(row, Mapping) else values_of(row)
        found = ((name, values.get(name)) for name in self.columns)
        return {name: value for name, value in found if value is not None and value == value and value != ""}

    def row(self, *rows: Any) -> list[str]:
        """Return cells of a row: texts on one line, numbers with the seven digits that float32 has, true as 1."""
        known, found = self.known(*rows), []
        for name in self.columns:
            value, form = known.get(name), ".6f" if name.endswith("time_s") else ".7g"
            found.append(" ".join(to_cell(int(value) if isinstance(value, bool) else value, form).split()))
        return found
