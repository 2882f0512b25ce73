"""How places of a surface move under a press if a slab of finite elements lies beneath it, by all parameters of a fit.

Parameters are φ = (log E, log d, log |F|), d = αρ being the force per velocity and volume that Rayleigh's α gives at
the density ρ, or of a standard linear solid (log E, log γ, log |F|, log τ), E being the slow modulus; and the delays of
the press as of `estimators.direct.motion`. A picture shows no mass: ρ is fixed, and E, d and F count in its unit, as
those of a sheet count in the mass of a vertex.

Linear elements that can be followed in a second move far too early. So what quadratic ones change in small motions is
added (defect correction): these are linear in the load, and few modes tell them.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.motion import DelayedMotion, between_steps
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.fem import Inertia, Material, NoEquilibrium, Relaxation, simulate
from palpate.physics.fem.dynamics import Direction
from palpate.physics.fem.modes import Modes
from palpate.physics.fem.slab import Place, Slab
from palpate.physics.fem.solid import Solid
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Bounds, theta_of

LAW = "stable_neo_hookean"
"""It can be followed, too, where elements are pressed flat on the way to the best fit."""
POISSON = 0.45
"""ν: soft tissue hardly changes its volume, and a dent tells little of how little."""
DENSITY = 1500.0
"""ρ [mass/scene unit³]."""
PATCH = 8.0
"""Radius of the tissue that a blunt tip presses on, as 1 - (r/R)² [grid px]."""
SUBSTEPS = 2
"""Time steps a frame."""
TOLERANCE = 2e-5
"""Of the balance of forces in every time step: displacements are off by 5e-5 of the largest."""
SLAB_BOUNDS = Bounds((5.0, 5e3), (500.0, 3e6), (-10.0, -1e-3), (100.0, 5e4, -0.1))
"""Of E [force/scene unit²], d [force·s/scene unit⁴] and F."""
USUAL_YOUNG = 150.0
"""E for which modes of a body are best."""
SLIGHT = 0.01
"""Difference of a parameter, for derivatives of small motions."""
RINGS = 6.0, 8.0
"""Between rings around the contact [grid px]: the slab's own error is the same within one and a part of the time, and
independent elsewhere."""
EARLY = 2.5
"""Frames after the press begins, and after it ends, that are parts of their own."""
RELAXING_BOX = np.log([[5.0, 0.05, 1e-3, 0.01], [5e3, 20.0, 10.0, 2.0]])
"""Ends of φ of a standard linear solid."""

BLURRED = 0.15
"""Width of a firm region's margin over its radius."""


@dataclass(frozen=True, eq=False)
class FirmRegion:
    """A ball of firmer tissue with a blurred margin."""

    centre: np.ndarray
    """Shape [3] [scene units]."""
    radius: float
    """[scene units]."""
    firmer: float
    """Logarithm of its E over that around."""

    def stiffer(self, solid: Solid) -> np.ndarray:
        """Factor of E in a body's elements, shape [E]."""
        middles = solid.rest[solid.elements[:, :4]].mean(axis=1)
        apart = np.linalg.norm(middles - self.centre, axis=1) / self.radius
        return np.exp(self.firmer / (1 + np.exp((apart - 1) / BLURRED)))


def _stiffer(slab: Slab, region: FirmRegion | None) -> np.ndarray | float:
    return 1.0 if region is None else region.stiffer(slab.solid)


class SlabMotion(DelayedMotion):
    """Displacements of V places at N instants for any parameters, D of them.

    Args:
        contact: its load.
        slab: the body beneath.
        pixels: rows and columns of the places at rest, shape [V, 2] [grid px].
        times: instants since the time stamp at which the press was observed to begin, rising, shape [N] [s].
        within: the press began, and ended, at most so long before or after the time stamps [s]; 0 = at them.
        relaxing: a standard linear solid instead of damping proportional to mass.
        fine: the same body, of elements whose small motions are exact enough; None = they are taken for so here.
        place: column and row of the tip's middle; None = the contact's vertex [grid px].
        region: that is firmer; None = tissue is homogeneous.
    """

    def __init__(
        self,
        contact: Interaction,
        slab: Slab,
        pixels: np.ndarray,
        times: np.ndarray,
        within: float = 0.0,
        relaxing: bool = False,
        fine: Slab | None = None,
        place: Place | None = None,
        region: FirmRegion | None = None,
    ) -> None:
        super().__init__(contact, times, within)
        self.slab, self.relaxing, self.tissue = slab, relaxing, 4 if relaxing else 3
        self.step = float(np.diff(times, prepend=0.0).min()) / SUBSTEPS
        """Of the simulation [s]."""
        self.longest = math.ceil((times[-1] + within) / self.step - 1e-6)
        """Steps of it."""
        self._shares = slab.patch(PATCH, place)
        self._pixels, self._shown = pixels, slab.between(pixels)
        self.fine, self.place, self.region = fine, place, region
        self._latest: tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None = None

    @property
    def box(self) -> np.ndarray:
        """Lower and upper ends of all parameters, shape [2, D]."""
        return self.with_delays(RELAXING_BOX if self.relaxing else SLAB_BOUNDS.log_box)

    def at(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements [N, V, 3] and their derivatives by all parameters [N, V, 3, D], those of the discrete motion.

        Not a number where the body can't be followed. The latest is remembered, as it takes seconds.
        """
        if self._latest is None or not np.array_equal(self._latest[0], logs):
            self._latest = np.array(logs), self._at(logs)
        return self._latest[1]

    def _at(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        try:
            path, slopes = self._followed(logs, LAW, True, self.region)
        except NoEquilibrium:
            shape = (len(self.times), self._shown.shape[0], 3)
            return np.full(shape, np.nan), np.full((*shape, len(logs)), np.nan)
        curves = path[..., None], slopes[..., : self.tissue], slopes[..., self.tissue :]
        found, slopes = self.seen(curves, self.step, logs)
        if self.fine is None:
            return found, slopes
        # What the body's elements get wrong in small motions is put right.
        steps = SLIGHT * np.eye(len(logs))
        change = [(self._wrong(logs + step) - self._wrong(logs - step)) / (2 * SLIGHT) for step in steps]
        return found + self._wrong(logs), slopes + np.stack(change, axis=-1)

    def _wrong(self, logs: np.ndarray) -> np.ndarray:
        """What is missing in small motions, shape [N, V, 3]."""
        return self.by_modes(logs) - self._by(self._coarse_modes, logs)

    def linear(self, logs: np.ndarray, region: FirmRegion | None = None) -> np.ndarray:
        """Displacements if nothing strained much, to which F is a factor, shape [N, V, 3].

        Args:
            logs: all parameters, shape [D].
            region: that is firmer; None = the motion's own.
        """
        firm = self.region if region is None else region
        return between_steps(self._followed(logs, "linear", False, firm)[0], self.step, self.since(logs))[0]

    def by_modes(self, logs: np.ndarray) -> np.ndarray:
        """The same of the fine elements where there are such, in milliseconds once modes are known."""
        return self._by(self._modes, logs)

    def _by(self, known: tuple[Modes, np.ndarray], logs: np.ndarray) -> np.ndarray:
        modes, shown = known
        young, force, damping, relaxation = self._constants(logs)
        course = force * held(self.loaded(logs) / self.step, self.longest)
        amplitudes = modes.follow(young, damping, course, self.step, relaxation)
        return np.einsum("vam,nm->nva", shown, between_steps(amplitudes, self.step, self.since(logs))[0], optimize=True)

    def _constants(self, logs: np.ndarray) -> tuple[float, float, float, Relaxation | None]:
        """E, F, Rayleigh's α and the standard linear solid, one of the latter two, of all parameters [D]."""
        young, second, force = theta_of(logs[:3])
        if self.relaxing:
            return young, force, 0.0, Relaxation(second, math.exp(logs[3]))
        return young, force, second / DENSITY, None

    @cached_property
    def _modes(self) -> tuple[Modes, np.ndarray]:
        return self._coarse_modes if self.fine is None else self._modes_of(self.fine)

    @cached_property
    def _coarse_modes(self) -> tuple[Modes, np.ndarray]:
        return self._modes_of(self.slab)

    def _modes_of(self, slab: Slab) -> tuple[Modes, np.ndarray]:
        """Of a body, and how the places move in each, shape [V, 3, M]."""
        pattern = slab.patch(PATCH, self.place)[:, None] * np.asarray(self.contact.direction, np.float64)
        shift = 4 / (self.step**2 * USUAL_YOUNG)
        tissue = Material("linear", _stiffer(slab, self.region), POISSON)
        modes = Modes(slab.solid, tissue, slab.held, DENSITY, pattern, shift)
        shown = slab.between(self._pixels) @ modes.shapes.reshape(len(pattern), -1)
        return modes, shown.reshape(len(self._pixels), 3, -1)

    def finer(self, logs: np.ndarray) -> np.ndarray:
        """The displacements of `at`: what finer steps change is less than what finer elements do, shape [N, V, 3]."""
        return self.at(logs)[0]

    def model_errors(self, sunk: np.ndarray, averages: bool) -> np.ndarray:
        """As of `SequenceMotion`: a share `slab_motion` (`estimators.model_errors`) of all; a column a ring and part of
        the time."""
        side, times = math.isqrt(sunk.shape[1]) // 2, self.times
        apart = np.hypot(*np.mgrid[-side : side + 1, -side : side + 1]).ravel()
        load = self.contact.load_seconds if self.contact.released else math.inf
        early = EARLY * float(np.diff(times, prepend=0.0).min())
        part = np.searchsorted([early, load, load + early], times) if load > early else np.searchsorted([early], times)
        ring = np.searchsorted(RINGS, apart)
        cells = ring[:, None] * (1 + part.max()) + part
        return MODEL_ERRORS.slab_motion * sunk.T[..., None] * (cells[..., None] == np.unique(cells))

    def _followed(
        self, logs: np.ndarray, law: str, slopes: bool, region: FirmRegion | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Motion after every step [T, V, 3], and its derivatives by φ and the load's duration, if that is unknown."""
        young, force, damping, relaxation = self._constants(logs)
        loaded = self.loaded(logs) / self.step
        factor = held(loaded, self.longest)
        direction = np.asarray(self.contact.direction, np.float64)
        nodes = np.flatnonzero(self._shares)
        pattern = force * self._shares[:, None] * direction
        along = [Direction(young=1.0), Direction(damping=damping), Direction(pattern=pattern, course=factor)]
        if relaxation is not None:
            along[1] = Direction(ratio=relaxation.ratio)
            along.append(Direction(time=relaxation.time))
        if self.within and self.contact.released:
            ending = (np.arange(self.longest) == math.floor(loaded)) / self.step
            along.append(Direction(pattern=pattern, course=ending))
        tissue = Material(law, young * _stiffer(self.slab, region), POISSON)
        what = self.slab.solid, tissue, self.slab.held, Press(nodes, self._shares[nodes], direction, factor), self.step
        inertia, ways = Inertia(DENSITY, damping), along if slopes else ()
        how = {"relaxation": relaxation, "directions": ways, "tolerance": TOLERANCE}
        found = simulate(*what, inertia=inertia, force=force, **how)
        return self._at_places(found.displacement[1:]), self._at_places(found.slopes[1:])

    def _at_places(self, values: np.ndarray) -> np.ndarray:
        """Of nodes [T, N, ...] at the places, shape [T, V, ...]."""
        flat = np.moveaxis(values, 1, 0).reshape(values.shape[1], -1)
        shape = (self._shown.shape[0], values.shape[0], *values.shape[2:])
        return np.moveaxis((self._shown @ flat).reshape(shape), 0, 1)
