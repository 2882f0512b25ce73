"""The parameter estimation of Frank 2010 (algorithm 1): ICP, then a step down the error's numeric gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from estimators.palpation.bench import SHOWN, Bench, Palpation, beside_the_tool
from estimators.palpation.material_fit import POISSON, FitSettings, MaterialFit
from estimators.palpation.registration import placed, register
from estimators.palpation.skin import Match, Skin
from physics.fem import Equilibrium, NoEquilibrium

STEP = 1e-3
"""Of log E or ν, below which none is tried."""
ASIDE = 1e-4
"""By how much log E and ν are moved for the gradient. By a hundredth, half of it times the curvature by E outweighs the
gradient within half a percent of a valley's floor, and no step goes down there any more."""
TRIES = 10
"""Of an E that bears the forces, each four times the last, beside the one that is given."""


def descend(
    skin: Skin,
    held: np.ndarray,
    palpations: Sequence[Palpation],
    settings: FitSettings,
    most: int = 400,
    told: Callable[[str], None] = lambda line: None,
) -> MaterialFit:
    """Gradient descent on (log E, ν), its gradient by forward differences.

    The error is equation 3's, summed over points that show no tool: those are chosen once, and the very same are what
    ICP lays onto the simulated surface. ICP makes the error least over the pose, so that differences at the pose of the
    step's beginning are its gradient; points that come and go would roughen it, as would other points to align by. The
    paper's step length λ is not told: here it is halved until the error falls and doubled afterwards; E in logarithms,
    because in pascals no step suits both. It begins at the E that is given, and four times stiffer as often as the
    body can't bear the force there, or only turned inside out: the co-rotational law finds rest there, and the descent
    can stay there. The path's first place is where it began, with what softer starts took before. Later steps may pass
    where elements turn inside out: a slab's descent that could not stopped short. It ends where no step of STEP or more
    lowers the error, or at `most` simulations.

    Args: see `fit_material`.

    Raises:
        NoEquilibrium: the body bears the forces at no stiffness that was tried.
    """
    bench = Bench(skin, held, palpations, settings.law)
    poses = bench.poses
    values = np.array([np.log(settings.young), np.clip(settings.poisson, *POISSON)])
    starts: list[np.ndarray] = [np.zeros_like(skin.body.rest) for _ in palpations]
    clouds = []
    for each, pose in zip(palpations, poses, strict=True):
        match = Match.of(placed(pose, each.points), skin.vertices, skin.triangles)
        clouds.append(each.points[beside_the_tool(match.at(skin.triangles, skin.vertices), each)])

    def simulated(at: np.ndarray, aligned: bool = True) -> tuple[float, list[Equilibrium], list[np.ndarray]]:
        try:
            rests = bench.rest(float(np.exp(at[0])), float(at[1]), starts)
        except NoEquilibrium:
            return np.inf, [], []
        total, found = 0.0, []
        for rest, cloud, pose in zip(rests, clouds, poses, strict=True):
            vertices = skin.moved(rest.displacement)
            found.append(register(cloud, vertices, skin.triangles, pose, 1.0, SHOWN) if aligned else pose)
            apart = Match.of(placed(found[-1], cloud), vertices, skin.triangles).apart
            total += float(np.square(apart).mean())
        return total, rests, found

    for stiffer in 4.0 ** np.arange(TRIES + 1):
        values[0] = np.log(stiffer * settings.young)
        path = [bench.progress(np.exp(values[0]), values[1])]  # with what softer starts took
        error, rests, aligned = simulated(values)
        upright = bool(rests) and all(
            np.linalg.det(skin.body.deformation(each.displacement)).min() > 0 for each in rests
        )
        if upright or bench.solves >= most:
            break
    if not upright:
        raise NoEquilibrium("the body bears the forces at no stiffness that was tried; give a stiffer start.")
    length = 1.0
    while bench.solves < most:
        starts, poses = [rest.displacement for rest in rests], aligned
        sides = [np.array([ASIDE, 0.0]), np.array([0.0, ASIDE if values[1] + ASIDE < POISSON[1] else -ASIDE])]
        gradient = np.array([(simulated(values + side, aligned=False)[0] - error) / side.sum() for side in sides])
        gradient[~np.isfinite(gradient)] = 0.0  # where nothing rests there is nothing to learn
        if values[1] == POISSON[0 if gradient[1] > 0 else 1]:
            gradient[1] = 0.0  # ν would leave its range
        direction = -gradient / max(float(np.abs(gradient).max()), 1e-300)
        fell = False
        while bench.solves < most and length > STEP:
            aim = values + length * direction
            aim[1] = np.clip(aim[1], *POISSON)
            found = simulated(aim)
            if found[0] < error:
                fell = True
                break
            length /= 2
        if not fell:
            break
        (error, rests, aligned), values, length = found, aim, 2 * length
        path.append(bench.progress(np.exp(values[0]), values[1]))
        told(f"step {len(path) - 1}: E {path[-1].young:.4g} Pa, ν {values[1]:.3f}, {bench.solves} solves")
    path.append(bench.progress(np.exp(values[0]), values[1]))  # with what the last search took
    noise = float(np.sqrt(error / len(palpations)))
    nothing = np.full((2, 2), np.nan)
    return MaterialFit(path[-1].young, path[-1].poisson, nothing, list(aligned), list(rests), noise, path)
