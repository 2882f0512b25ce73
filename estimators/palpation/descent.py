"""A descent after the parameter estimation of Frank 2010 (algorithm 1): ICP, then a step down the error's gradient.

`docs/reports/palpation.md` lists what differs from the paper's.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from palpate.estimators.palpation.bench import SHOWN, Bench, Palpation, beside_the_tool
from palpate.estimators.palpation.material_fit import POISSON, FitSettings, MaterialFit, fit_material, require_along
from palpate.estimators.palpation.registration import placed, register
from palpate.estimators.palpation.skin import Match, Skin
from palpate.physics.fem import Equilibrium, NoEquilibrium

STEP = 1e-3
"""Of log E or ν, below which none is tried."""
ASIDE = 1e-4
"""By how much log E and ν are moved for the gradient. By a hundredth, half of it times the curvature by E outweighs the
gradient within half a percent of a valley's floor, and no step goes down there any more."""
TRIES = 10
"""Of an E that bears the forces, each four times the last, besides the one that is given."""


def descend(
    skin: Skin,
    held: np.ndarray,
    palpations: Sequence[Palpation],
    settings: FitSettings,
    most: int = 400,
    report: Callable[[str], None] = lambda line: None,
) -> MaterialFit:
    """Gradient descent on (log E, ν), its gradient by forward differences.

    The error is equation 3's, summed over points that show no tool: those are chosen once, and the very same are what
    ICP lays onto the simulated surface. ICP makes the error least over the pose, so that differences at the pose of the
    step's beginning are its gradient; points that come and go would roughen it, as would other points to align by. The
    paper's step length λ is not given: here it is halved until the error falls and doubled afterwards; E in logarithms,
    because in pascals no step suits both. It begins at the E that is given, and four times stiffer as often as the
    body can't bear the force there, or only turned inside out: the co-rotational law finds rest there, and the descent
    can stay there. The path's first place is where it began, with what softer starts took before. Later steps may pass
    where elements turn inside out: a slab's descent that could not stopped short. It ends where no step of STEP or more
    lowers the error, or at `most` simulations.

    Args: see `fit_material`.

    Raises:
        NoEquilibrium: the body bears the forces at no stiffness that was tried.
        ValueError: a reversed force.
    """
    values = np.array([np.log(settings.young), np.clip(settings.poisson, *POISSON)])
    judge = Bench(skin, held, palpations, settings.law)  # of its own, since a bench counts equilibria
    require_along(judge, settings.young, judge.linear(settings.young, values[1]))
    error = _Error(Bench(skin, held, palpations, settings.law))
    bench = error.bench
    for stiffer in 4.0 ** np.arange(TRIES + 1):
        values[0] = np.log(stiffer * settings.young)
        path = [bench.progress(np.exp(values[0]), values[1])]  # with what softer starts took
        here = error.at(values)
        if here.upright(skin) or bench.solves >= most:
            break
    if not here.upright(skin):
        raise NoEquilibrium("the body bears the forces at no stiffness that was tried; give a stiffer start.")
    length = 1.0
    while bench.solves < most:
        error.begin(here)
        sides = [np.array([ASIDE, 0.0]), np.array([0.0, ASIDE if values[1] + ASIDE < POISSON[1] else -ASIDE])]
        nearby = [error.at(values + side, aligned=False).total for side in sides]
        gradient = np.array([(total - here.total) / side.sum() for total, side in zip(nearby, sides, strict=True)])
        gradient[~np.isfinite(gradient)] = 0.0  # where nothing rests there is nothing to learn
        if values[1] == POISSON[0 if gradient[1] > 0 else 1]:
            gradient[1] = 0.0  # ν would leave its range
        direction = -gradient / max(float(np.abs(gradient).max()), 1e-300)
        fell = False
        while bench.solves < most and length > STEP:
            aim = values + length * direction
            aim[1] = np.clip(aim[1], *POISSON)
            found = error.at(aim)
            if found.total < here.total:
                fell = True
                break
            length /= 2
        if not fell:
            break
        here, values, length = found, aim, 2 * length
        path.append(bench.progress(np.exp(values[0]), values[1]))
        report(f"step {len(path) - 1}: E {path[-1].young:.4g} Pa, ν {values[1]:.3f}, {bench.solves} solves")
    path.append(bench.progress(np.exp(values[0]), values[1]))  # with what the last search took
    noise = float(np.sqrt(here.total / len(palpations)))
    return MaterialFit(path[-1].young, path[-1].poisson, np.full((2, 2), np.nan), here.poses, here.rests, noise, path)


class _Found(NamedTuple):
    """The bodies at some (log E, ν), none of them where they find no rest."""

    total: float
    """The error [m²]."""
    rests: list[Equilibrium]
    poses: list[np.ndarray]
    """Of the sensors, aligned."""

    def upright(self, skin: Skin) -> bool:
        """Whether the bodies rest, without an element inside out."""
        volumes = (np.linalg.det(skin.body.deformation(rest.displacement)) for rest in self.rests)
        return bool(self.rests) and all(volume.min() > 0 for volume in volumes)


class _Error:
    """What is made least: points that show no tool, chosen once, against the simulated surfaces."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self._poses = bench, bench.poses
        skin = bench.skin
        self._starts: list[np.ndarray] = [np.zeros_like(skin.body.rest) for _ in bench.palpations]
        self._clouds = []
        for each, pose in zip(bench.palpations, bench.poses, strict=True):
            match = Match.of(placed(pose, each.points), skin.vertices, skin.triangles)
            self._clouds.append(each.points[beside_the_tool(match.at(skin.triangles, skin.vertices), each)])

    def begin(self, here: _Found) -> None:
        """Simulate and align from there on."""
        self._starts, self._poses = [rest.displacement for rest in here.rests], here.poses

    def at(self, values: np.ndarray, aligned: bool = True) -> _Found:
        """Of (log E, ν), infinite where nothing rests; the poses left as they are, if so wanted."""
        skin = self.bench.skin
        try:
            rests = self.bench.rest(float(np.exp(values[0])), float(values[1]), self._starts)
        except NoEquilibrium:
            return _Found(np.inf, [], [])
        total, poses = 0.0, []
        for rest, cloud, pose in zip(rests, self._clouds, self._poses, strict=True):
            vertices = skin.moved(rest.displacement)
            poses.append(register(cloud, (vertices, skin.triangles), pose, 1.0, SHOWN) if aligned else pose)
            apart = Match.of(placed(poses[-1], cloud), vertices, skin.triangles).apart
            total += float(np.square(apart).mean())
        return _Found(total, list(rests), poses)


OPTIMIZERS: Mapping[str, Callable[..., MaterialFit]] = {"gauss-newton": fit_material, "gradient": descend}
"""Fits of Young's modulus and Poisson's ratio by name: by exact derivatives, or the paper's numeric descent."""
