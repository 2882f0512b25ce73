"""The numeric descent, which arrives where Gauss–Newton does by many more solves where it arrives."""

import dataclasses
import inspect
import re

import numpy as np
import pytest

from palpate.estimators.palpation import FitSettings, Palpation, Skin, fit_material
from palpate.estimators.palpation.bench import Bench
from palpate.estimators.palpation.descent import ASIDE, STEP, descend
from palpate.evaluation.palpation.synthetic import BODIES, observe, press
from palpate.physics.fem import NoEquilibrium
from tests.conftest import CHECKOUT

BODY = dataclasses.replace(BODIES["slab"], size=0.08)


def slab(force: float, place: float) -> tuple[Skin, np.ndarray, Palpation]:
    """A slab, what is held of it, and what is seen of a press on it."""
    truth = press(BODY, 1e4, 0.42, force, (place, 0.5), 3, law="corotational")
    return *BODY.skin(3, BODY.size / 12), observe(*truth, "stereo", 3, count=400)


@pytest.mark.slow
def test_the_descent_arrives_from_a_start_far_off() -> None:
    """Ten times too stiff; many times as many solves as by exact derivatives, which end at the same place."""
    skin, held, seen = slab(1.0, 0.1)
    exact, numeric = (fit(skin, held, [seen], FitSettings(young=1e5)) for fit in (fit_material, descend))
    assert abs(np.log(numeric.young / exact.young)) < 2 * exact.young_sd
    assert numeric.young == pytest.approx(1e4, rel=0.25)
    assert numeric.solves > 5 * exact.solves
    assert np.isnan(numeric.covariance).all()
    assert numeric.path[0].young == pytest.approx(1e5)
    assert (numeric.path[-1].young, numeric.path[-1].solves) == (numeric.young, numeric.solves)
    # It did not stop on a valley's floor: its error is no larger than where exact derivatives end, but for ICP's rest.
    at_exact = FitSettings(young=exact.young, poisson=exact.poisson)
    assert numeric.noise < (1 + 1e-5) * descend(skin, held, [seen], at_exact, most=1).noise


def test_a_start_at_which_the_body_turns_inside_out_is_none() -> None:
    """Thirty times too soft the slab goes through its floor; there the descent would end."""
    skin, held, seen = slab(0.5, 0.6)
    bench = Bench(skin, held, [seen], "corotational")
    (below,) = bench.rest(1e4 / 30, 0.3, [None])
    assert np.linalg.det(skin.body.deformation(below.displacement)).min() < 0
    found = descend(skin, held, [seen], FitSettings(young=1e4 / 30))
    begun = found.path[0]
    assert begun.young == pytest.approx(16e4 / 30)
    assert (begun.solves, begun.systems > below.iterations) == (2, True)  # what two softer starts took
    assert found.young == pytest.approx(1e4, rel=0.1)
    assert np.linalg.det(skin.body.deformation(found.rests[0].displacement)).min() > 0


def test_no_start_is_looked_for_without_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    skin, held, seen = slab(0.5, 0.6)
    tried = []

    def unborne(bench: Bench, young: float, poisson: float, starts: object) -> None:
        tried.append(young)
        raise NoEquilibrium("none")

    monkeypatch.setattr(Bench, "rest", unborne)
    with pytest.raises(NoEquilibrium, match="at no stiffness that was tried; give a stiffer start"):
        descend(skin, held, [seen], FitSettings(young=1.0))
    assert tried == pytest.approx(4.0 ** np.arange(11))


def test_the_page_lists_what_differs_from_the_paper_s_algorithm_1() -> None:
    page = (CHECKOUT / "docs" / "reports" / "palpation.md").read_text(encoding="utf-8")
    table = page[page.index("| what | algorithm 1 |") :].split("\n\n")[0]
    here = {row[0]: row[2] for row in re.findall(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", table, re.MULTILINE)}
    assert here.keys() >= {"parameters", "step", "end", "gradient", "error", "palpations", "start"}
    most = inspect.signature(descend).parameters["most"].default
    assert here["end"] == f"no step of {STEP:g} lowers the error, or {most} simulations"
    assert here["gradient"].startswith(f"forward differences of {ASIDE:g} in log E and ν")
    assert "is the paper's algorithm 1" not in page
