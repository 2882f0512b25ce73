"""A new file is one class behind an entry point, a new column one field of a dataclass."""

import importlib.metadata
import json
import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from palpate.cli import infer
from palpate.estimators.estimate import PressNumbers
from palpate.estimators.records import FrameEstimate
from palpate.estimators.result import NINETY, Quantity, Table, column
from palpate.results.artefacts import base
from tests.inference_inputs import write_clip, write_model

pytestmark = pytest.mark.usefixtures("blank_pictures")


class TouchedFrames(base.Artefact):
    """touched.txt: numbers of the frames in contact, then that contact's first one."""

    name = "touched.txt"

    def open(self) -> None:
        self.said: list[str] = []

    def frame(self, estimate, image, labels) -> None:
        self.said += [str(estimate.frame)] if estimate.contact else []

    def contact(self, run) -> None:
        self.said.append(f"from {run.onset_frame}")

    def finish(self) -> None:
        self.path.write_text(" ".join(self.said))


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = SimpleNamespace(name="touched", load=lambda: TouchedFrames)
    found, ours = importlib.metadata.entry_points, {"group": "palpate.artefacts"}
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **of: [entry] if of == ours else found(**of))


@pytest.mark.usefixtures("registered")
def test_a_class_behind_an_entry_point_is_written_recorded_and_kept_up_to_date(tmp_path: Path, capsys) -> None:
    clip, model = write_clip(tmp_path / "clip", 6, 3), write_model(tmp_path / "model.onnx")
    given = [str(clip), "--output", str(tmp_path / "out"), "--model", str(model), "--no-overlay"]
    assert infer.main(given) == 0
    written = tmp_path / "out" / "clip" / "touched.txt"
    assert written.read_text() == "13 14 15 from 13"
    assert "touched.txt" in json.loads((tmp_path / "out" / "clip" / "run.json").read_text())["files"]
    assert "touched.txt" in (tmp_path / "out" / "clip" / "page.html").read_text()
    assert infer.main(given) == 0
    assert "up to date" in capsys.readouterr().err
    written.unlink()
    assert infer.main(given) == 0
    assert written.exists()


@dataclass(frozen=True)
class Energetic(PressNumbers):
    work: Quantity | None = column("W", None)


@dataclass(frozen=True, eq=False)
class Warm(FrameEstimate):
    warmth: float = column(kw_only=True)
    """of the tissue, K"""


def test_a_field_is_a_column_of_the_table_and_a_quantity_has_its_interval() -> None:
    table = Table((Warm, Energetic))
    cells = dict(
        zip(table.columns, table.row(Warm(3, 0.1, "ok", warmth=310.0), Energetic(work=Quantity(2.0, 0.1))), strict=True)
    )
    assert (table.columns["warmth"], cells["warmth"], cells["frame"]) == ("of the tissue, K", "310", "3")
    assert list(table.columns)[-4:] == ["work", "work_sd", "work_low", "work_high"]
    assert float(cells["work_high"]) == pytest.approx(2 * math.exp(0.1 * NINETY), rel=1e-6)
    assert table.columns["work_low"] == "lower end of the 90 % interval of W"
