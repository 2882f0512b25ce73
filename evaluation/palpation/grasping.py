"""Objects that were grasped several times: stiffness by day, and whether it ranks as the objects' names say."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from palpate.estimators.palpation.grasp import GraspSlope

ORDER = ("softest", "softer", "soft", "medium", "hard", "harder", "hardest")
"""Words of a name that rank it, softest first."""


@dataclass(frozen=True)
class GraspName:
    """What a file's name tells, such as 2023-12-06__green_ball_softer_1.csv."""

    day: str
    """Before the double underscore; empty where there is none."""
    thing: str
    """The object, without the number of the grasp."""

    @classmethod
    def of(cls, stem: str) -> GraspName:
        """Of a file name without its ending."""
        day, split, thing = stem.rpartition("__")
        return cls(day if split else "", re.sub(r"[_-]?\d+$", "", thing))

    @property
    def rank(self) -> int | None:
        """Place in ORDER; None where no word says it."""
        words = [word for word in re.split(r"[_\W]+", self.thing.lower()) if word in ORDER]
        return ORDER.index(words[0]) if words else None

    @property
    def family(self) -> str:
        """The kind of thing: only balls are softer than balls. The last word that is none of ORDER."""
        words = [word for word in re.split(r"[_\W]+", self.thing.lower()) if word and word not in ORDER]
        return words[-1] if words else self.thing


def judge_grasps(slopes: Mapping[GraspName, list[GraspSlope]]) -> dict[str, dict[str, object]]:
    """Measures by object and day, and by kind and day whether its objects rank as named.

    Args:
        slopes: of all grasps of an object on a day.
    """
    found: dict[str, dict[str, object]] = {}
    medians: dict[GraspName, float] = {}
    for name, grasps in slopes.items():
        medians[name] = float(np.median([grasp.compliance for grasp in grasps]))
        label = f"{name.day} {name.thing}".strip()
        found[label] = {
            "grasps": len(grasps),
            "slope 2 to 8 N, median (N/mm)": 1 / medians[name] if medians[name] > 0 else float("inf"),
            "compliance, median (mm/N)": medians[name],
        }
    kinds = sorted({(name.day, name.family) for name in medians if name.rank is not None})
    for day, family in kinds:
        alike = [name for name in medians if (name.day, name.family) == (day, family) and name.rank is not None]
        named = sorted(alike, key=lambda name: (name.rank, name.thing))
        pairs = [(one, two) for i, one in enumerate(named) for two in named[i + 1 :] if one.rank != two.rank]
        if not pairs:
            continue
        right = sum(medians[one] > medians[two] for one, two in pairs)
        found[f"{day} {family}: order".strip()] = {
            "objects, softest first as found": " < ".join(
                name.thing for name in sorted(alike, key=lambda name: -medians[name])
            ),
            "pairs that rank as named": right,
            "pairs": len(pairs),
            "all rank as named": "yes" if right == len(pairs) else "no",
        }
    return found
