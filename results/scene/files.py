"""Scenes written for USD, SOFA, VTK and PLY as formats.yaml has them, and read again.

Every file but PLY's, which shows tissue alone, says all that `simulated` needs. A SOFA scene is made of SOFA's own
components besides, and runs there.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from palpate.common.files import read_file
from palpate.physics.fem.solid import EIGHTHS
from palpate.physics.msd.reference import integrator
from palpate.results.scene.kinds import pressed
from palpate.results.scene.scene import FORMATS, KINDS, Scene, make_scene

_OF_ENDING = {f".{kind['ending']}": kind for kind in FORMATS.values()}
_CELLS = {"elements": 24, "tetrahedra": 10, "triangles": 5}
"""Parts that are VTK's cells, the first of them that a scene has, and its numbers of their types."""
_ENDS = {"load": ("_x", "_y", "_z"), "pixels": ("_row", "_column"), "known": ("", "_bending")}
"""What tells numbers of a row apart that are no value with both ends of its interval."""


def scene_text(scene: Scene, format_: str) -> str:
    """What a file says of a scene in one of FORMATS; its ending is to be the format's."""
    form, kind, parts = FORMATS[format_], KINDS[scene.kind], scene.parts
    shape = next(name for name in _CELLS if len(parts.get(name, ())))
    cells, bodies, lists = parts[shape], form.get("bodies", {}), form.get("lists", {})
    values: dict[str, Any] = {"time_step": 1.0, **parts, "cells": cells, "types": np.full(len(cells), _CELLS[shape])}
    values |= {"ends": cells.shape[1] * np.arange(1, len(cells) + 1), "threes": np.full(len(parts["triangles"]), 3)}
    values["solid"] = cells[:, EIGHTHS].reshape(-1, 4) if shape == "elements" else cells
    values |= _components(scene) if scene.kind in bodies else {}

    def text(numbers: object) -> str:
        return form["comma"].join(np.asarray(numbers).ravel().astype(str))

    ways: dict[str, Any] = {"": text, "count": len, "first": lambda rows: text(rows.flat[:1])}
    ways["tuples"] = lambda rows: ", ".join(f"({', '.join(row)})" for row in rows.astype(str))
    texts: dict[str, Any] = {name: kind.get(name, "") for name in ("about", "where", "length")}
    texts |= dict.fromkeys(("shape", "vertex", "everywhere", "whole", "columns"), "")
    columns = [parts["points"].astype(str)]
    for name, (group, width, dtype, unit) in kind["parts"].items():
        words = {"name": name, "unit": unit, "width": width, "type": form["types"][dtype], "rows": len(parts[name])}
        if name not in form["names"]:
            texts[group] += form[group].format(values=text(parts[name]), **words) + "\n"
        if group in ("vertex", "everywhere") and "rows" in lists:
            columns.append(np.broadcast_to(parts[name].astype(str), (len(columns[0]), width)))
            ends = _ENDS.get(name, ("", "_low", "_high"))[:width]
            texts["columns"] += "".join(f"property {words['type']} {name}{end}\n" for end in ends)
    values |= {"rows": np.column_stack(columns)[:, None], "faces": parts["triangles"][:, None]}
    for name, line in lists.items():
        texts[name] = "\n".join(line.format(*map(text, row)) for row in values.get(name, ()))
    body = bodies.get(scene.kind, bodies.get(shape, ""))
    for want in {*re.findall(r"{(\w+)}", body + form["file"])} - {*texts, "body"}:
        name, _, way = want.partition("__")
        texts[want] = ways[way](np.atleast_1d(values[name]))
    return re.sub(r"\n\s*\n", "\n", form["file"].format(body=body.format(**texts), **texts))


def _components(scene: Scene) -> dict[str, Any]:
    """Numbers that SOFA's own components need besides parts, by name.

    Of vertices that are `pressed` or `gripped` there is a row each: its number, times, and vectors then.

    Explicit damping of a mass Δt/kick, `kick` being that of `physics.msd.reference.Integrator`, is the implicit (or
    exact) damping of the mass m.
    """
    parts = scene.parts
    # What the file says, so that nothing pulls at rest.
    points = parts["points"].astype(str).astype(np.float64)
    # Of no vertex at all SOFA would hold the first.
    fixed = [[np.flatnonzero(parts["held"])]] * int(parts["held"].any())
    found: dict[str, Any] = {"all": np.arange(len(points)), "fixed": fixed}
    if "springs" in parts:
        ends = parts["springs"]
        apart = np.diff(points[ends], axis=1)[:, 0]
        lengths = np.linalg.norm(apart, axis=1)
        stiffness = np.broadcast_to(parts["stiffness"][:, 0], len(points))[ends].mean(axis=1)
        rows = zip(*ends.T.tolist(), stiffness.tolist(), lengths.tolist(), strict=True)
        elastic = " ".join(f"{first} {second} {value} 0 {length}" for first, second, value, length in rows)
        found["elastic"] = elastic
    if "grip_path" in parts:
        vertices, times = scene.grip.vertices, np.append(0.0, parts["times"])
        way = np.pad(scene.grip.displacement, ((1, 0), (0, 0), (0, 0)))
        found["gripped"] = [(vertex, times, way[:, at]) for at, vertex in enumerate(vertices)]
    if "load_factor" in parts:
        # Between keys SOFA goes straight; a step takes the force of its beginning.
        keys = np.flatnonzero(np.diff(parts["load_factor"][:, 0], 2, prepend=np.nan, append=np.nan) != 0)
        times, factor = scene.number("time_step") * keys, parts["load_factor"][keys]
        found["pressed"] = [(at, times, factor * parts["load"][at]) for at in scene.press.vertices]
    if scene.kind == "press":
        mechanics = pressed(scene)[3]
        found["damped_mass"] = mechanics.time_step / integrator(scene.number("damping"), mechanics).kick
    return found


def read_scene(path: Path) -> Scene:
    """A scene of which a file says what `scene_text` has.

    Raises:
        OSError: the file can't be read.
        ValueError: another program wrote it, or it shows tissue alone.
    """
    try:
        form = _OF_ENDING[path.suffix]
        found = re.findall(form["found"], read_file(path).decode())
        numbers = {name: re.sub("[(),]", " ", text).split() for name, text in reversed(found)}
        kind, names = list(KINDS)[int(numbers["model"][0])], form["names"]
        return make_scene(kind, **{name: numbers[names.get(name, name)] for name in KINDS[kind]["parts"]})
    except (KeyError, IndexError, ValueError) as error:
        said = f"is no scene to simulate on that palpate wrote ({error}); give one of --export usd, sofa or vtk"
        raise ValueError(f"{path}: {said}.") from error
