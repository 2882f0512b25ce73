"""The tables of a clip: their columns, each with what it is (columns.yaml), and their rows."""

from collections.abc import Iterable, Mapping
from typing import Any

from palpate.common.files import read_beside
from palpate.common.tables import to_cell
from palpate.estimators.estimate import LEAST_SKILL, REPORTED, SYMBOLS
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.online.particle_field import FieldEstimate
from palpate.estimators.records import InteractionEstimate
from palpate.physics.mechanics import PARAMETERS

TEXTS: dict[str, dict[str, str]] = read_beside(__file__)
"""What every column is, in groups."""
UNITS = TEXTS["units"]
"""Units of the results; nothing that estimates knows of others."""


def named(group: str, names: Iterable[str], **words: Mapping[str, object]) -> dict[str, str]:
    """The columns of a group for each of some quantities.

    Args:
        group: one of TEXTS.
        names: of the quantities.
        words: what stands for their braces, by quantity.
    """
    return {
        column.format(name=name): text.format(name=name, **{word: of[name] for word, of in words.items()})
        for name in names
        for column, text in TEXTS[group].items()
    }


ESTIMATED = named("estimated", REPORTED, symbol=SYMBOLS) | named("bounds", PARAMETERS, symbol=SYMBOLS)
"""Columns of an estimate."""
_AGAINST = {"distance_stiffness": "stretch", "shape_stiffness": "bending"}
FIELD = named("stiffness", _AGAINST, what=_AGAINST, unit=UNITS) | {
    column: text.format(least_skill=LEAST_SKILL) for column, text in TEXTS["field"].items()
}
"""Columns of a frame's field of stiffness; empty from estimators without one."""
FRAMES = TEXTS["frame"] | ESTIMATED | TEXTS["frame_contact"] | FIELD | TEXTS["frame_status"]
FRAMES |= TEXTS["verdict"] | TEXTS["frame_force"] | TEXTS["frame_detail"]
"""Columns of `parameters.csv`, in order."""
ALARM = TEXTS["alarm"]
"""What `parameters.csv` has in addition with --force-limit."""
INTERACTIONS = TEXTS["run"] | TEXTS["run_press"] | ESTIMATED | TEXTS["grip"] | TEXTS["verdict"] | TEXTS["run_fit"]
"""Columns of `interactions.csv`, in order."""
CALIBRATED = TEXTS["run"] | named("calibrated", PARAMETERS, symbol=SYMBOLS) | TEXTS["calibrated_detail"]
"""Columns of `calibrated.csv`, in order; written with --force-scale."""


def row(columns: Mapping[str, str], values: Mapping[str, Any]) -> list[str]:
    """The cells of one frame or one run of contact.

    Args:
        columns: FRAMES or INTERACTIONS.
        values: what is known, by column.
    """
    return [cell(values.get(name), ".6f" if name.endswith("time_s") else ".7g") for name in columns]


def known(columns: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of one frame or one contact by column; missing ones are left out."""
    found = {name: values.get(name) for name in columns}
    return {name: value for name, value in found.items() if value is not None and value == value and value != ""}


def interaction_values(run: InteractionEstimate) -> dict[str, Any]:
    """What is known of a run of contact, by column."""
    estimate, contact, output = run.estimate, run.interaction, run.main_estimate
    found = vars(run) | {"frames": 0 if contact is None else len(contact.observation), "status": "no_estimate"}
    found |= {"skill": run.skill}
    if estimate is not None:
        stuck = [name for name, at_end in zip(PARAMETERS, estimate.at_bound, strict=True) if at_end]
        delays = dict(zip(("delay_s", "release_delay_s"), estimate.delays, strict=False))
        found |= vars(estimate) | estimate.numbers() | delays
        found |= {"explanation": estimate.explanation if output is estimate else "", "at_bound": " ".join(stuck)}
    if isinstance(output, GripEstimate):
        found |= {"frames": len(output.times)}
    if isinstance(output, FieldEstimate):
        found |= {"explanation": output.explanation, "frames": len(output.times)}
    if output is not None:
        found |= {"status": "ok", "verdict": output.verdict, "determined": ";".join(output.determined)}
    return found


def cell(value: float | int | bool | str | None, form: str = ".7g") -> str:
    """A value as text on one line, as `to_cell` gives it; true is 1. Seven digits are those that float32 has."""
    return " ".join(to_cell(int(value) if isinstance(value, bool) else value, form).split())
