"""Fits, descents and bounds of palpations with known truth: what their tables hold, and the paper's pictures."""

from __future__ import annotations

import base64
import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimators.palpation import FitSettings
from palpate.estimators.palpation.bench import Progress, surface_error
from palpate.evaluation.palpation import __main__ as door
from palpate.evaluation.palpation import surfaces
from palpate.evaluation.palpation.surfaces import FIGURES, MAX_SOLVES, POISSON, SIX, STARTS, YOUNG, arrival
from palpate.evaluation.palpation.synthetic import BODIES, SENSORS, observe, press
from palpate.physics.fem import Material, NoEquilibrium

BODY = dataclasses.replace(BODIES["slab"], size=0.08)


def fitted(young: float) -> SimpleNamespace:
    return SimpleNamespace(
        young=young, poisson=0.4, young_sd=0.03, poisson_sd=0.02, verdict="determined", solves=6, poses=[np.eye(4)]
    )


def test_fits_from_either_side_are_reported_by_their_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[float] = []

    def fit(skin: object, held: object, seen: list, settings: FitSettings) -> SimpleNamespace:
        begun.append(settings.young)
        assert len(seen) == 15
        return fitted(1.04 * YOUNG)

    monkeypatch.setattr(surfaces, "fit_material", fit)
    monkeypatch.setattr(surfaces, "true_press", lambda *arguments: ())
    monkeypatch.setattr(surfaces, "fitted_mesh", lambda *arguments: (None, None))
    monkeypatch.setattr(surfaces, "observe", lambda *arguments: None)
    wanted = surfaces.Frank(tmp_path, body="slab").wanted
    assert not any("one palpation" in name for name in wanted)
    found = {name: work() for name, work in wanted.items() if "time of flight" in name}
    assert begun == pytest.approx([YOUNG * start for start in STARTS])
    for start in ("30", "0.0333"):
        measures = found[f"slab, time of flight, 3 presses, 15 pictures, start E × {start}"]
        assert measures["E / truth - 1"] == pytest.approx(0.04)
        assert measures["ν - truth"] == pytest.approx(0.4 - POISSON)
        assert measures["equilibria a press"] == 2


@pytest.mark.slow
def test_the_error_surface_is_lowest_at_the_truth() -> None:
    truth = press(BODY, YOUNG, POISSON, 1.0, (0.1, 0.5), 4, law="corotational")
    skin, held = BODY.skin(4, BODY.size / 20)
    seen = observe(*truth, "stereo", 3, count=1500)
    fit = surfaces.fit_material(skin, held, [seen], FitSettings(young=2e4))
    pose = fit.poses[0]
    found = surfaces.error_surface(skin, held, seen, pose, YOUNG * np.array([0.4, 1.0, 2.5]), np.array([0.1, POISSON]))
    assert np.unravel_index(found.argmin(), found.shape) == (1, 1)
    own = np.nanmean(surface_error(skin, fit.rests[0], seen, pose))
    assert found[1, 1] == pytest.approx(1000 * np.sqrt(own), rel=0.15)
    assert fit.noise == pytest.approx(SENSORS["stereo"], rel=0.15)  # along the sight, not to the closest place


def test_the_error_surface_ends_where_the_body_bears_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def rest(body: object, material: Material, held: object, **options: object) -> SimpleNamespace:
        if material.young < 1.5:
            raise NoEquilibrium("none")
        return SimpleNamespace(displacement=np.zeros((1, 3)))

    monkeypatch.setattr(surfaces, "find_equilibrium", rest)
    monkeypatch.setattr(surfaces, "surface_error", lambda *arguments: np.array([4e-6, np.nan]))
    skin = SimpleNamespace(body=None, pressed=lambda *arguments: None)
    seen = SimpleNamespace(contact=None, tool_radius=None, force=None)
    found = surfaces.error_surface(skin, None, seen, np.eye(4), np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.4]))
    np.testing.assert_allclose(found, [[np.nan, 2, 2], [np.nan, 2, 2]])


@pytest.mark.slow
def test_the_papers_figures_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six forces give moduli that spread by a known share."""
    youngs = iter(YOUNG * np.array([0.98, 1.02]))
    monkeypatch.setattr(surfaces, "fit_material", lambda *arguments: fitted(float(next(youngs))))
    found = surfaces.paper_figures("slab", True)
    assert tuple(found["figures"]) == FIGURES
    assert all(base64.b64decode(content).startswith(b"\x89PNG") for content in found["figures"].values())
    spread = np.std([0.98, 1.02], ddof=1)
    assert found["six forces: E, standard deviation / mean"] == pytest.approx(spread)
    assert found["six forces: E, mean / truth - 1"] == pytest.approx(0, abs=1e-12)
    assert len(SIX) == 6


def test_a_user_s_picture_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "six_forces.png").write_text("mine")
    assert door.main(["frank", "--quick", "--output", str(tmp_path)]) == 2
    assert "six_forces.png is not as this program wrote it" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "figures" / "six_forces.png").read_text() == "mine"


def test_e_has_arrived_once_it_stays_near() -> None:
    """Passing by on the way to elsewhere is no arrival."""
    path = [Progress(young, 0.4, solves, 3 * solves) for young, solves in ((30, 1), (1.02, 4), (0.8, 7), (1.04, 9))]
    assert arrival(path) is path[3]
    assert arrival([*path, Progress(1.0, 0.4, 12, 36)]) is path[3]
    assert arrival(path[:1]) is path[0]


def walked(young: float, solves: int, noise: float = 1.0, begun: tuple[float, int] = (2 * YOUNG, 0)) -> SimpleNamespace:
    path = [Progress(begun[0], 0.4, begun[1], 5 * begun[1]), Progress(young, 0.4, solves, 5 * solves)]
    return SimpleNamespace(young=young, poisson=0.4, path=path, noise=noise)


def test_the_solves_of_both_methods_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first start the descent stops short; from the second it arrives, apart from Gauss–Newton.

    There a softer start was tried before, which does not count.
    """
    monkeypatch.setitem(surfaces.BODIES, "slab", BODY)
    monkeypatch.setattr(surfaces, "true_press", lambda *arguments: press(BODY, YOUNG, 0.42, 0.5, (0.6, 0.5), 3))
    monkeypatch.setattr(surfaces, "PLAIN_CELLS", 3)
    there = walked(YOUNG, 1)
    short = walked(2 * YOUNG, MAX_SOLVES, 1.01, (30 * YOUNG, 0))
    ends = iter([short, there, walked(1.06 * YOUNG, 61, 0.99, (4 / 30 * YOUNG, 1)), there])
    asked = []

    def fit(skin: object, held: object, seen: object, settings: SimpleNamespace, most: int = 0) -> SimpleNamespace:
        if most != 1:
            asked.append(settings.young)
        return next(ends) if most else walked(YOUNG, 6)

    monkeypatch.setattr(surfaces, "fit_material", fit)
    monkeypatch.setattr(surfaces, "descend", fit)
    wanted = surfaces.Descents(tmp_path, body="slab").wanted
    assert list(wanted) == ["slab, start E × 30", "slab, start E × 0.0333"]
    stiff, soft = (work() for work in wanted.values())
    assert asked == pytest.approx([30 * YOUNG, 30 * YOUNG, YOUNG / 30, YOUNG / 30])
    assert stiff["descent: E that it could begin at / truth"] == 30
    assert soft["descent: E that it could begin at / truth"] == pytest.approx(4 / 30)
    assert stiff["descent: equilibria until E within 5%"] == f"never, after {MAX_SOLVES}"
    assert stiff["Gauss–Newton: linear systems until E within 5%"] == 30
    assert "equilibria until E within 5%, descent / Gauss–Newton" not in stiff
    assert stiff["descent: equilibria until the end"] == f"never, after {MAX_SOLVES}"
    assert soft["descent: linear systems until E within 5%"] == 300
    assert soft["linear systems until E within 5%, descent / Gauss–Newton"] == 10
    assert soft["equilibria until the end, descent / Gauss–Newton"] == 10
    assert soft["descent: E / truth - 1"] == pytest.approx(0.06)


@pytest.mark.slow
def test_a_press_off_the_middle_tells_more_of_a_slab_and_noise_takes_it_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surfaces, "DESIGN_CELLS", 4)
    monkeypatch.setattr(surfaces, "FORCES", (0.5,))
    monkeypatch.setitem(surfaces.BODIES, "slab", BODY)

    def sds(along: float, sensor: str) -> np.ndarray:
        return np.array(list(surfaces.bound("slab", along, sensor).values())[:2])

    middle, outer = (sds(along, "stereo") for along in (0.1, 0.6))
    assert outer[0] < 0.8 * middle[0]
    # As many times wider as there is more noise, and by what is left out next to edges, which grows with it.
    ratio = sds(0.6, "time of flight") / outer * SENSORS["stereo"] / SENSORS["time of flight"]
    assert np.all((ratio > 1) & (ratio < 1.4))
