"""Young's modulus and Poisson's ratio from forces and the deformed surfaces that they leave (Frank 2010, section VI).

The residual is the distance of a measured point from the simulated surface along its line of sight, with what the tool
hides masked. `fit_material` is Gauss–Newton with exact derivatives by (1/E, ν) and by the sensors' poses. Between two
simulations displacements are linear in (1/E, ν), and points are matched anew as often as it takes. It begins at the
linear law, by which displacements go with 1/E, so that any start will do. The paper's descent takes ten times as many
simulations (docs/reports/palpation.md).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.estimators.palpation.bench import Bench, Palpation
from palpate.estimators.palpation.gauss_newton import System, ends, iterated, states_of
from palpate.estimators.palpation.skin import Match, Skin
from palpate.physics.fem import Equilibrium, Material
from palpate.physics.identifiability import LIMIT

NOTHING = "nothing determined"
"""The verdict where not even E is."""


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit: its start, and the error of the model."""

    young: float = 1e4
    """Young's modulus E to begin at [Pa]."""
    model_error: float = 0.02
    """Relative error of the displacements by mesh and law, correlated within a quarter of the body, for the
    covariance."""


@dataclass(frozen=True, eq=False)
class MaterialFit:
    """Result of the palpations; O of them."""

    young: float
    """[Pa]."""
    poisson: float
    covariance: np.ndarray
    """Covariance of (log E, ν), shape [2, 2]."""
    poses: list[np.ndarray]
    """Poses of the sensors, aligned, each of shape [4, 4]."""
    rests: list[Equilibrium]
    """The body under each force, as it was simulated last."""
    noise: float
    """Root mean square distance that is left [m]."""
    solves: int
    """Equilibria that were computed."""

    @property
    def young_sd(self) -> float:
        """Standard deviation of log E: relative."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def poisson_sd(self) -> float:
        """Standard deviation of ν."""
        return float(np.sqrt(self.covariance[1, 1]))

    @property
    def verdict(self) -> str:
        """Verdict: `determined` if ν is, too; `young` if E alone is; `NOTHING` if E's interval spans a factor e or
        more."""
        if not self.young_sd < LIMIT:
            return NOTHING
        # A ν whose standard deviation is below this counts as determined: 95 % lie within 0.05.
        return "determined" if self.poisson_sd < 0.025 else "young"


def fit_material(
    skin: Skin,
    held: np.ndarray,
    palpations: Sequence[Palpation],
    settings: FitSettings = FitSettings(),
    report: Callable[[str], None] = lambda line: None,
) -> MaterialFit:
    """Fit E, ν and the poses.

    Args:
        skin: the surface at rest on its body.
        held: which components of the nodes are fixed, shape [N, 3], bool.
        palpations: one or several.
        settings: the start, and how wrong the model is.
        report: is given a line after every simulation.

    Raises:
        NoEquilibrium: the body can't bear the forces at any stiffness that was tried.
        ValueError: a contact off the surface, too few points next to the hole, or a reversed force.
    """
    normals = Match.of(np.array([each.contact for each in palpations]), skin.vertices, skin.triangles).normal
    for number, (each, normal) in enumerate(zip(palpations, normals, strict=True), start=1):
        if each.force @ normal > 0:
            problem = f"the force of palpation {number} points out of the body; give what the tool does to the body,"
            raise ValueError(f"{problem} the negative of what a sensor in its handle feels.")
    bench = Bench(skin, held, palpations)
    poisson = 0.3  # to begin at
    rests = bench.rests(Material("linear", settings.young, poisson), [None] * len(palpations))
    scale = _scale(bench, rests)
    begun = System(bench, states_of(bench, rests, scale), np.zeros(2), bench.poses, ends(poisson))
    young, poisson, rests, found = iterated(bench, (settings.young / scale, poisson, [], begun), report)
    # By the derivatives, from what was simulated last.
    young, poisson = float(young / (1 + found.change[0])), float(poisson + found.change[1])
    covariance = found.covariance(settings.model_error)
    return MaterialFit(young, poisson, covariance, found.poses, rests, found.noise, bench.solves)


def _scale(bench: Bench, rests: Sequence[Equilibrium]) -> float:
    """Return the factor by which E is too high for bodies by the linear law to move by 3 % of their size.

    With that displacement points are matched first.
    """
    farthest = max(float(np.abs(rest.displacement).max()) for rest in rests)
    return 0.03 * float(np.ptp(bench.skin.vertices, axis=0).max()) / max(farthest, 1e-300)
