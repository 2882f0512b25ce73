"""Fits of palpations with known truth: what their table holds."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.palpation import __main__ as surfaces
from benchmarks.palpation.__main__ import SIX, STARTS
from benchmarks.palpation.synthetic import POISSON, YOUNG
from palpate.estimators.palpation.material_fit import FitSettings


def fitted(young: float) -> SimpleNamespace:
    return SimpleNamespace(
        young=young, poisson=0.4, young_sd=0.03, poisson_sd=0.02, verdict="determined", solves=6, poses=[np.eye(4)]
    )


@pytest.fixture(autouse=True)
def unpressed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, made in (("true_press", ()), ("fitted_mesh", (None, None)), ("observe", None)):
        monkeypatch.setattr(surfaces, name, lambda *_, made=made: made)


def test_fits_from_either_side_are_reported_by_their_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[float] = []

    def fit(skin: object, held: object, seen: list, settings: FitSettings) -> SimpleNamespace:
        begun.append(settings.young)
        assert len(seen) == 15
        return fitted(1.04 * YOUNG)

    monkeypatch.setattr(surfaces, "fit_material", fit)
    wanted = surfaces.Frank(tmp_path, body="slab").wanted
    assert not any("one palpation" in name for name in wanted)
    found = {name: work() for name, work in wanted.items() if "time of flight" in name}
    assert begun == pytest.approx([YOUNG * start for start in STARTS])
    for start in ("30", "0.0333"):
        measures = found[f"slab, time of flight, 3 presses, 15 pictures, start E × {start}"]
        assert measures["E / truth - 1"] == pytest.approx(0.04)
        assert measures["ν - truth"] == pytest.approx(0.4 - POISSON)
        assert measures["equilibria a press"] == 2


def test_six_forces_give_moduli_that_spread_by_a_known_share(monkeypatch: pytest.MonkeyPatch) -> None:
    shares = np.array([0.98, 1.02, 1.01, 0.99, 1.0, 1.03])
    youngs = iter(YOUNG * shares)
    monkeypatch.setattr(surfaces, "fit_material", lambda *arguments: fitted(float(next(youngs))))
    found = surfaces.fit_six("slab")
    spread = shares.std(ddof=1) / shares.mean()
    assert found["six forces: E, standard deviation / mean"] == pytest.approx(spread)
    assert found["six forces: E, mean / truth - 1"] == pytest.approx(0.005)
    assert len(SIX) == len(shares)
