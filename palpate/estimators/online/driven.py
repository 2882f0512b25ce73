"""Tissue that an instrument drives, stepped on by what is followed of it in every frame."""

import dataclasses
from collections import deque
from contextlib import suppress

import numpy as np
from scipy.spatial import KDTree

from palpate.estimators.grip.lattice import GripFrame, NothingMoves
from palpate.estimators.grip.recorder import DRIVEN
from palpate.estimators.online.determined import BENDINGS, Determined, Fit, Fitting, uniform
from palpate.estimators.online.forecast import FIELD, SHEET, Lattice, prediction_skill, telling
from palpate.estimators.online.objective import Chamfer, Match, Objective, Tracks
from palpate.estimators.online.session import Frame, Session
from palpate.estimators.online.settings import MOST_FITTED, OnlineSettings, Start
from palpate.estimators.online.surface import Surface
from palpate.estimators.result import LEAST_SKILL

Cloud = tuple[np.ndarray, np.ndarray]
"""Points of the tissue, shape [m, 3] [scene units], and particles that no tool hides, shape [n]."""


class DrivenTissue:
    """A sheet or a volume under an instrument; P followed points, N particles.

    Args:
        surface: the tissue in the picture where following began.
        points: places of the followed points there, shape [P, 2] [px]. Of points that are known in space, shape [P, 3]:
            all displacements have a third axis then, away from the camera, in pixels that are as long as those across
            the line of sight at the point's depth at rest.
        distance: theirs from the tool there, shape [P] [px].
        settings: how.
        spacing: of the points' grid [px]; None = they lie on none, and no sheet of one number can be made of them.
        led: whether every step is given where the gripped particles are.
    """

    def __init__(
        self,
        surface: Surface,
        points: np.ndarray,
        distance: np.ndarray,
        settings: OnlineSettings,
        spacing: int | None = None,
        led: bool = False,
    ) -> None:
        self.surface = surface
        self._lattice = None if spacing is None else Lattice(points, spacing, distance)
        points, self._in_space = points[:, :2], points.shape[1] == 3
        body = surface.body
        self.fit: Fit | None = None
        """Parameters fitted to the first frames; None = nothing was fitted."""
        self._first: list[tuple[np.ndarray, Cloud | None, np.ndarray | None]] = []
        """Arguments of `step` in the first frames."""
        self._led = led
        inside, shares = surface.places(points)
        around = distance[inside] >= surface.reach
        if led:
            around = ~np.isin(shares.indices.reshape(-1, 3), surface.gripped).any(axis=1)
        self.around = inside[around]
        """Followed points that are compared, shape [Q]: on tissue that began out of the instrument's reach. Where that
        is led they lie in triangles without a gripped corner."""
        self._shares = shares[np.flatnonzero(around)]
        self._resting, self._depth = surface.project(self._shares @ body.rest), (self._shares @ body.rest)[:, 2]
        self._driving = np.flatnonzero(distance < surface.reach)
        self._points = np.asarray(points, np.float64)
        self._free = body.inverse_mass(surface.gripped) > 0
        self._fitting: Fitting | None = None
        self._begin(settings)
        if settings.fitted > 0:
            allowed = [bending for bending in BENDINGS if bending * settings.start.distance < settings.bounds.shape]
            allowed = allowed or [settings.start.shape / settings.start.distance]
            self._fitting = Fitting(self.session.objective, self.session.fields, allowed, self.shown)

    def _begin(self, settings: OnlineSettings) -> None:
        """Begin at rest."""
        body, rest = self.surface.body, self.surface.body.rest
        how = settings.stepping, settings.mapping, settings.elastic, settings.weights, settings.bounds
        objective = Objective(body, self.surface.gripped, *how)
        begun = uniform(body, settings.start.distance, settings.start.shape)
        self.settings = settings
        """Settings as given, or what was fitted."""
        self.session = Session(objective, begun, settings.method)
        self.alone = Determined(objective, begun, lambda values: self._shares @ values, self.shown)
        """Motion that the instrument alone explains."""
        self._learns = settings.method.name == "PBD-RM-ON" and len(self.around) > 0
        self._places = rest[self.surface.gripped]
        self._moving = np.zeros(len(rest), bool)
        self.past = deque[np.ndarray](maxlen=MOST_FITTED)
        """Places of the gripped particles in the last frames, shape [G, 3] [scene units]: how they moved before hardly
        matters to the motion to come."""
        self._seen = deque[np.ndarray](maxlen=MOST_FITTED)

    @property
    def stretched(self) -> np.ndarray:
        """Free particles at edges that have once changed their length by more than `strain`, shape [N], bool."""
        return self._moving & self._free

    def determined(self) -> tuple[np.ndarray, np.ndarray]:
        """Return standard deviations of log stiffness over its mean where tissue has stretched, and where that is
        determined.

        It is determined where tissue has stretched and the motion constrains it (`Determined.known`). The instrument
        alone must explain the motion as well as a sheet that is fitted to a grip.

        Returns:
            Shape [2, N] each: of distances, of shapes.
        """
        stretched = self.stretched
        among = stretched if stretched.any() else np.ones(len(stretched), bool)
        sd, known = self.alone.known(self.session.fields, among)
        return sd, known & stretched & (self.alone.skill >= LEAST_SKILL)

    def gripped_places(self, moved: np.ndarray) -> np.ndarray | None:
        """Return places of the gripped particles, shape [G, 3] [scene units]; None where too few points near them are
        visible.

        Args:
            moved: displacement of the followed points, shape [P, 2] [px]; not observed = NaN.
        """
        visible = self._driving[np.isfinite(moved[self._driving]).all(axis=1)]
        if len(visible) < 3:
            return None
        pixels = self.surface.pixels[self.surface.gripped]
        count = min(6, len(visible))
        away, near = KDTree(self._points[visible]).query(pixels, k=count)
        weight = 1 / (np.square(away.reshape(-1, count)) + 1)  # px: a point in the very place doesn't count for all
        motion = (weight[..., None] * moved[visible][near.reshape(-1, count)]).sum(axis=1) / weight.sum(axis=1)[:, None]
        surface, gripped = self.surface, self.surface.gripped
        return surface.lift(surface.pixels[gripped] + motion, surface.body.rest[gripped, 2])

    def step(self, moved: np.ndarray, cloud: Cloud | None = None, led: np.ndarray | None = None) -> Frame:
        """Take a frame in; where the instrument's tissue isn't seen it stays where it was, and nothing is learnt.

        With the last frame that is fitted to, the parameters are chosen, and all frames are taken in once more with
        them.

        Args:
            moved: displacement of the followed points since rest, shape [P, 2] [px]; not observed = NaN.
            cloud: of the frame, where there is one.
            led: where tissue is led, places of the gripped particles, shape [G, 3] [scene units].
        """
        found = self._taken(moved, cloud, led)
        if self._fitting is None:
            return found
        self._first.append((moved, cloud, led))
        if len(self._first) == self.settings.fitted:
            fit, self._fitting = self._fitting.best, None
            if fit is not None:
                self.fit = fit
                self._begin(self._fitted(fit))
                for frame in self._first:
                    found = self._taken(*frame)
            self._first.clear()
        return found

    def _fitted(self, fit: Fit) -> OnlineSettings:
        """Return the settings with the parameters that were fitted to the first frames."""
        settings, stiffness = self.settings, self.settings.start.distance
        most = min(settings.bounds.shape, fit.bending * settings.bounds.distance)
        bounds, start = dataclasses.replace(settings.bounds, shape=most), Start(stiffness, fit.bending * stiffness)
        stepping = fit.stepping(settings.stepping, stiffness)
        return dataclasses.replace(settings, start=start, bounds=bounds, stepping=stepping)

    def _taken(self, moved: np.ndarray, cloud: Cloud | None, places: np.ndarray | None) -> Frame:
        if not self._led:
            places = self.gripped_places(moved)
        matches: list[Match] = []
        if places is not None:
            self._places = places
            matches += self._tracks(moved, self.session.positions)
            if cloud is not None and all(map(len, cloud)):
                matches.append(Chamfer(*cloud))
        seen_around = moved[self.around] if places is not None else np.full_like(moved[self.around], np.nan)
        fields = self.session.fields
        self.alone.step(fields, self._places, seen_around)
        if self._fitting is not None:
            self._fitting.step(self._places, seen_around)
        found = self.session.step(self._places, matches)
        self.past.append(self._places)
        self._seen.append(moved)
        body = self.surface.body
        strained = np.abs(body.strains(found.positions)) > self.settings.strain
        learnt = self._learns and found.gap is not None
        if learnt:
            self.session.fields = self.alone.likeliest(fields)
        if learnt or found.terms is not None:
            self._moving[body.edges[strained]] = True
        return found

    def skills(self) -> dict[str, float]:
        """Return the skill of predicting later frames from earlier ones, by model (`estimators.online.forecast`).

        Simulations begin at rest and follow the instrument's way. A state that was mapped to an observation would fall
        back.
        """
        path, rest, gripped = np.stack(self.past), self.surface.body.rest, self.surface.gripped
        states = self.session.objective.stepped(self.session.fields, rest, path).positions[0, 1:]
        past = telling(len(path))
        frames, models = np.stack(self._seen)[past], {FIELD: self.shown(states[past])}
        lattice = self._lattice
        if lattice is not None:
            near = lattice.distance < DRIVEN
            moves = [GripFrame(each, near & np.isfinite(each).all(axis=1)) for each in frames]
            with suppress(NothingMoves):
                ratio = lattice.ratio(moves)
                models[SHEET] = np.stack([lattice.motion(each, ratio)[self.around] for each in moves])
        way = np.linalg.norm(path[past] - rest[gripped], axis=(1, 2))
        return {name: prediction_skill(model, frames[:, self.around], way) for name, model in models.items()}

    def shown(self, states: np.ndarray) -> np.ndarray:
        """Return the displacement of the points `around` in states [T, N, 3], shape [T, Q, 2], or [T, Q, 3] if in space
        [px]."""
        places = np.stack([self._shares @ state for state in states])
        away = (places[..., 2] - self._depth) * (self.surface.camera.fx / self._depth)
        moved = np.concatenate([self.surface.project(places) - self._resting, away[..., None]], axis=2)
        return moved[..., : 2 + self._in_space]

    def _tracks(self, moved: np.ndarray, positions: np.ndarray) -> list[Match]:
        """Return followed points at the depth of the sheet: they are known across the line of sight, not along it.

        Depth from one picture is off by far more than the motion; where that has three axes it counts.
        """
        places = self._resting + moved[self.around, :2]
        if not np.isfinite(places).all(axis=1).any():
            return []
        if self._in_space:
            depth = self._depth * (1 + moved[self.around, 2] / self.surface.camera.fx)
        else:
            depth = (self._shares @ positions)[:, 2]
        return [Tracks(self._shares, self.surface.lift(places, depth))]
