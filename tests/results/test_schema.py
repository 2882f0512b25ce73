"""results.schema.json: made from the dataclasses of results, followed by what a run writes, and equal to its tables.

After a change of columns `python -m tests.results.test_schema` writes it anew.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from palpate.estimators.records import CONTACTS, FRAMES, FrameEstimate
from palpate.estimators.result import Table
from palpate.results.artefacts.results import VERSION
from palpate.results.calibrated import CALIBRATED
from tests.conftest import CHECKOUT
from tests.estimators.estimates import ESTIMATE, GOOD, NONE, frame_in_contact
from tests.results.fields import opened
from tests.results.test_writer import FRAME
from tests.tables import read_rows

pytestmark = pytest.mark.usefixtures("blank_pictures")
SCHEMA = CHECKOUT / "palpate" / "results" / "results.schema.json"
TYPES = {bool: "boolean", int: "integer", str: "string"}
ALWAYS = ("frame", "time_s", "status", "onset_frame", "onset_time_s")
"""Columns that every row has."""
PYTHON = {"boolean": bool, "integer": int, "number": (int, float), "string": str, "null": type(None)}
PYTHON |= {"array": list, "object": dict}


def kinds_of(kind: type[Any]) -> dict[str, Any]:
    """Annotations of a dataclass's columns."""
    hints, found = get_type_hints(kind), dict[str, Any]()
    for item in dataclasses.fields(kind):
        if "group" in item.metadata:
            found |= kinds_of(item.metadata["group"])
        elif "column" in item.metadata:
            found[item.name] = hints[item.name]
    return found


def row_of(table: Table, **more: dict[str, Any]) -> dict[str, Any]:
    """Schema of a table's rows."""
    kinds = {name: kind for each in table.kinds for name, kind in kinds_of(each).items()}
    found = dict[str, dict[str, Any]]()
    for name, text in table.columns.items():
        given = (kinds.get(name, float), *get_args(kinds.get(name, float)))
        kind = next((TYPES[each] for each in given if each in TYPES), "number")
        found[name] = {"type": kind if name in ALWAYS else [kind, "null"], "description": text}
    texts = {"type": "array", "items": {"type": "string"}}
    found["determined"] = texts | {"description": "parameters and ratios that are determined"}
    return {"type": "object", "properties": found | more, "required": [*found, *more]}


def schema() -> dict[str, Any]:
    """The schema as the dataclasses have it."""
    three: dict[str, Any] = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
    matrix = three | {"type": ["array", "null"], "items": three}
    matrix["description"] = "covariance of (log k_s, log k_d, log |F|); null: the estimator gives none"
    newtons = row_of(CALIBRATED) | {"type": ["object", "null"], "description": "in physical units, by --force-scale"}
    rows = {
        "frames": {"type": "array", "items": row_of(FRAMES, covariance=matrix)},
        "contacts": {"type": "array", "items": row_of(CONTACTS, covariance=matrix, newtons=newtons)},
    }
    texts = {"type": "object", "additionalProperties": {"type": "string"}}
    head = {"version": {"const": VERSION, "type": "integer"}, "notice": {"type": "string"}, "clip": {"type": "string"}}
    head |= {"fps": {"type": "number"}, "units": texts}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:palpate:results:{VERSION}",
        "title": "Results of a clip",
        "description": "results.json of `palpate infer`: numbers have the digits of the CSV files; null is not known",
        "type": "object",
        "properties": head | rows,
        "required": [*head, *rows],
    }


def check(value: Any, given: dict[str, Any], at: str = "results") -> None:
    """Require what a schema of these few keywords says."""
    kinds = given["type"] if isinstance(given["type"], list) else [given["type"]]
    assert any(isinstance(value, PYTHON[kind]) for kind in kinds), (at, value)
    assert not isinstance(value, bool) or "boolean" in kinds, at
    assert value == given.get("const", value), at
    if isinstance(value, list):
        assert given.get("minItems", 0) <= len(value) <= given.get("maxItems", len(value)), at
        for index, each in enumerate(value):
            check(each, given["items"], f"{at}[{index}]")
    if isinstance(value, dict) and "properties" in given:
        assert sorted(value) == sorted(given["required"]), at
        for name, inner in given["properties"].items():
            check(value[name], inner, f"{at}.{name}")


def test_the_schema_is_that_of_the_dataclasses() -> None:
    assert json.loads(SCHEMA.read_text("utf-8")) == schema(), "run python -m tests.results.test_schema"
    assert (CHECKOUT / "docs" / SCHEMA.name).samefile(SCHEMA)


def test_results_follow_the_schema_and_have_the_tables_numbers(tmp_path: Path) -> None:
    pressed = frame_in_contact("determined", (0.5, 0.06, -0.1), (1.2, 1.2, 1.2), number=7, time_s=0.28, contact=True)
    with opened(tmp_path / "clip") as results:
        results.write(FRAME, pressed)
        results.write(FRAME, FrameEstimate(8, 0.32, "no_contact", "Because.", contact=False))
        results.add(GOOD)
        results.add(NONE)
        results.finish({})
    found = json.loads((tmp_path / "clip" / "results.json").read_text("utf-8"))
    check(found, json.loads(SCHEMA.read_text("utf-8")))
    for name, file in (("frames", "parameters.csv"), ("contacts", "interactions.csv")):
        for value, row in zip(found[name], read_rows(tmp_path / "clip" / file), strict=True):
            for column, cell in row.items():
                said = ";".join(value[column]) if column == "determined" else value[column]
                assert (said in (None, "")) == (cell == ""), column
                assert not cell or said == (cell if isinstance(said, str) else float(cell)), column
    np.testing.assert_allclose(found["contacts"][0]["covariance"], ESTIMATE.covariance)
    assert found["contacts"][1]["covariance"] is found["contacts"][0]["newtons"] is None
    assert found["frames"][0]["contact"] is True


if __name__ == "__main__":
    SCHEMA.write_text(json.dumps(schema(), indent=1, ensure_ascii=False) + "\n", "utf-8")
