"""Whether a palpated body stiffens, or its mesh or law only makes it look so.

Coarse elements, and a law that is not the body's, err more the deeper the dents, which looks like stiffening: what is
asked for on a fit's own mesh is fitted again on a finer one, and by RIVAL.
"""

from collections.abc import Callable

import numpy as np

from palpate.estimators.palpation.bench import Bench
from palpate.estimators.palpation.gauss_newton import Fit, System, ends, iterated, states_of
from palpate.estimators.palpation.stiffening import ASKED
from palpate.physics.fem import NoEquilibrium

ALIKE = 1.25
"""Ratio of the largest force to the smallest, below which nothing tells whether the body stiffens."""
STIFFENS, STRAIGHT, UNKNOWN = "stiffening", "linear", "stiffening, not determined"
"""Verdicts on it."""
RIVAL = "neo_hookean"
"""The law whose own stiffness grows most with strain: a body stiffens only if that doesn't explain it."""


def check_stiffening(bench: Bench, plain: Fit, model_error: float, report: Callable[[str], None]) -> tuple[str, Fit]:
    """Whether the evidence asks for a growing stiffness, and the fit.

    E is the fit's with a growth also where that isn't determined, or no finer mesh is to be had: without, E takes on
    what grows with the dents.

    Args:
        bench: the body; where growth is asked for it goes on with a finer mesh, and with RIVAL.
        plain: the fit without a growth.
        model_error: as of `System.covariance`.
        report: is given a line after every simulation.
    """
    young, at, rests, found = plain
    sizes = [float(np.linalg.norm(each.force)) for each in bench.palpations]
    if max(sizes) <= ALIKE * min(sizes):
        return UNKNOWN, plain
    bench.watch_stiffening(rests)
    at = np.append(at, 0.0)
    asking = System(bench, states_of(bench, rests, 1.0), np.append(found.change, 0.0), found.poses, ends(at))
    odds = asking.odds(model_error, 0.0)
    if odds <= ASKED:
        return STRAIGHT if odds < 1 / ASKED else UNKNOWN, plain
    fit = plain
    try:
        fit = iterated(bench, (young, at, rests, asking), report)
        shares = bench.refine()
        fit = _again(bench, fit, [shares @ rest.displacement for rest in fit[2]], report)
        if fit[3].odds(model_error, fit[1][1]) > ASKED:
            bench.law = RIVAL
            rival = _again(bench, fit, [rest.displacement for rest in fit[2]], report)
            if rival[3].odds(model_error, rival[1][1]) > ASKED:
                return STIFFENS, fit
    except (NoEquilibrium, ValueError) as error:
        report(f"it looks like stiffening, which can't be checked: {error}")
    return UNKNOWN, fit


def _again(bench: Bench, fit: Fit, starts: list[np.ndarray], report: Callable[[str], None]) -> Fit:
    """A fit of a growing stiffness on another mesh or by another law, from where one ended."""
    young, at, _, found = fit
    rests = bench.rest(young, *at, starts=starts)
    begun = System(bench, states_of(bench, rests, 1.0), np.zeros(3), found.poses, ends(at))
    return iterated(bench, (young, at, rests, begun), report)
