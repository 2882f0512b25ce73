"""The paper's experiments: what their tables hold, the error surface's least place, and their pictures."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from palpate.estimators.palpation import FitSettings
from palpate.estimators.palpation.bench import surface_error
from palpate.evaluation.file_table import FileTable
from palpate.evaluation.palpation import frank
from palpate.evaluation.palpation.frank import FIGURES, POISSON, SIX, STARTS, YOUNG
from palpate.evaluation.palpation.synthetic import BODIES, SENSORS, observe, press
from palpate.physics.fem import Material, NoEquilibrium

BODY = dataclasses.replace(BODIES["slab"], size=0.08)


def measures(table: FileTable) -> dict[tuple[object, object], object]:
    return {(row["file"], row["measure"]): row["value"] for row in table.rows}


def fitted(young: float) -> SimpleNamespace:
    return SimpleNamespace(
        young=young, poisson=0.4, young_sd=0.03, poisson_sd=0.02, verdict="determined", solves=6, poses=[np.eye(4)]
    )


def test_fits_from_either_side_are_told_by_their_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[float] = []

    def fit(skin: object, held: object, seen: object, settings: FitSettings) -> SimpleNamespace:
        begun.append(settings.young)
        return fitted(1.04 * YOUNG)

    monkeypatch.setattr(frank, "fit_material", fit)
    table = FileTable(tmp_path, Console(stderr=True))
    frank._starts("ball, stereo", None, None, [None, None], 2, table)
    assert begun == pytest.approx([YOUNG * start for start in STARTS])
    found = measures(table)
    for start in ("30", "0.0333"):
        label = f"ball, stereo, 2 presses, 2 pictures, start E × {start}"
        assert found[label, "E / truth - 1"] == pytest.approx(0.04)
        assert found[label, "ν - truth"] == pytest.approx(0.4 - POISSON)
        assert found[label, "equilibria a press"] == 3


@pytest.mark.slow
def test_the_error_surface_is_lowest_at_the_truth() -> None:
    truth = press(BODY, YOUNG, POISSON, 1.0, (0.1, 0.5), 4, law="corotational")
    skin, held = BODY.skin(4, BODY.size / 20)
    seen = observe(*truth, "stereo", 3, count=1500)
    fit = frank.fit_material(skin, held, [seen], FitSettings(young=2e4))
    pose = fit.poses[0]
    found = frank._error_surface(skin, held, seen, pose, YOUNG * np.array([0.4, 1.0, 2.5]), np.array([0.1, POISSON]))
    assert np.unravel_index(found.argmin(), found.shape) == (1, 1)
    own = np.nanmean(surface_error(skin, fit.rests[0], seen, pose))
    assert found[1, 1] == pytest.approx(1000 * np.sqrt(own), rel=0.15)
    assert fit.noise == pytest.approx(SENSORS["stereo"], rel=0.15)  # along the sight, not to the closest place


def test_the_error_surface_ends_where_the_body_bears_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def rest(body: object, material: Material, held: object, **options: object) -> SimpleNamespace:
        if material.young < 1.5:
            raise NoEquilibrium("none")
        return SimpleNamespace(displacement=np.zeros((1, 3)))

    monkeypatch.setattr(frank, "find_equilibrium", rest)
    monkeypatch.setattr(frank, "surface_error", lambda *arguments: np.array([4e-6, np.nan]))
    skin = SimpleNamespace(body=None, pressed=lambda *arguments: None)
    seen = SimpleNamespace(contact=None, tool_radius=None, force=None)
    found = frank._error_surface(skin, None, seen, np.eye(4), np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.4]))
    np.testing.assert_allclose(found, [[np.nan, 2, 2], [np.nan, 2, 2]])


@pytest.mark.slow
def test_the_papers_figures_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six forces give moduli that spread by a known share."""
    youngs = iter(YOUNG * np.array([0.98, 1.02]))
    monkeypatch.setattr(frank, "fit_material", lambda *arguments: fitted(float(next(youngs))))
    table = FileTable(tmp_path, Console(stderr=True))
    pictures = frank._paper("slab", True, table)
    assert tuple(pictures) == FIGURES
    assert all(content.startswith(b"\x89PNG") for content in pictures.values())
    found = {name: value for (_, name), value in measures(table).items()}
    spread = np.std([0.98, 1.02], ddof=1)
    assert found["six forces: E, standard deviation / mean"] == pytest.approx(spread)
    assert found["six forces: E, mean / truth - 1"] == pytest.approx(0, abs=1e-12)
    assert len(SIX) == 6


def test_a_user_s_picture_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "six_forces.png").write_text("mine")
    assert frank.main(["--quick", "--output", str(tmp_path)]) == 1
    assert "six_forces.png is not as this program wrote it" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "six_forces.png").read_text() == "mine"
