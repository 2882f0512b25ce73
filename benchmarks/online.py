"""The online estimator on a pulled sheet whose stiffness is known: future gap, the field found, time a step.

    python -m benchmarks.online [--starts k1 k2 k3] [--match chamfer tracks both] [--history 0.1]
    python -m benchmarks.online --cost [--match chamfer tracks] [--optimizer adam]

A sheet of 600 particles, pinned along one side and gripped at the other, is stretched and swung. Its half at the pins
is three times as stiff as the other. The truth flows down its energy in continuous time, by Runge-Kutta steps whose
error is kept, where the estimator takes one implicit step a frame by sweeps. Seen are 9,000 points of its surface a
frame, 200 followed points, or both, with normal noise of 0.2 mm.

Future gap: norm of the residual mapping of states predicted 1 to 10 frames ahead (Liang 2024, equation 10), by both
kinds of observation for all, so that rows can be compared; "off" is the mean distance to the true particles. Tissue
moves where an edge's length changes by more than 1 %; the field's rank correlation is Spearman's there.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args, get_type_hints

import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import csr_array
from scipy.stats import spearmanr

from benchmarks import online_cost
from benchmarks.shared import command_line, machine, print_table
from estimators.online.matching import Chamfer, Match, Tracks
from estimators.online.objective import Objective, Weights
from estimators.online.session import Method, Session
from physics.pbd.body import Body, make_body
from physics.pbd.potential import Potential
from physics.pbd.stiffness import Stiffness, spread

ROWS, COLUMNS, SPACING = 25, 24, 0.005
SOFT, RATIO, BENDING = 1.0, 3.0, 0.01
STARTS = {"k1": (5.0, 0.015), "k2": (1.0, 0.01), "k3": (0.2, 0.005)}
"""Stiffness of distances and shapes to begin with: the paper's, shapes inside its own bound."""
NOISE, POINTS, FOLLOWED = 0.2e-3, 9000, 200
HORIZON, PAPER = 10, 0.9
MOVES = 0.01
MATCHES = ("chamfer", "tracks", "both")
METHODS, OPTIMIZERS = (get_args(get_type_hints(Method)[name]) for name in ("name", "optimizer"))
COLUMNS_SHOWN = (
    "start",
    "match",
    "method",
    "future gap [mm]",
    "less than PBD's",
    "off [mm]",
    "gap now [mm]",
    "gap + history + smoothness",
    "rank correlation",
    "median k, stiff / soft",
    "step [ms], median",
    f"{PAPER} s over it",
)


@dataclass(frozen=True, eq=False)
class Scene:
    """A pulled sheet: N particles, T frames."""

    body: Body
    gripped: np.ndarray
    distance: np.ndarray
    """True stiffness of distances, shape [N]."""
    truth: np.ndarray
    """Positions, shape [T, N, 3] [m]."""
    clouds: np.ndarray
    """Points of its surface, shape [T, 9000, 3] [m]."""
    places: csr_array
    """Of followed points among the particles, shape [P, N]."""
    tracks: np.ndarray
    """Where those are seen, shape [T, P, 3] [m]."""

    def matches(self, frame: int, kind: str) -> list[Match]:
        """What the estimator is given of a frame."""
        found: list[Match] = []
        if kind in ("chamfer", "both"):
            found.append(Chamfer(self.clouds[frame], self.body.surface))
        if kind in ("tracks", "both"):
            found.append(Tracks(self.places, self.tracks[frame]))
        return found

    def moving(self) -> np.ndarray:
        """Particles with an edge that changes its length by more than `MOVES` at some time, shape [N], bool."""
        first, second = self.body.edges.T
        lengths = np.linalg.norm(self.truth[:, first] - self.truth[:, second], axis=2)
        strained = (np.abs(lengths / self.body.layout.rest[self.body.kinds[0]] - 1) > MOVES).any(axis=0)
        return np.isin(np.arange(self.body.count), self.body.edges[strained]) & ~self.body.pinned


def sheet() -> Body:
    """Flat, in the plane z = 0, pinned at y = 0."""
    at = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    one, two, three, four = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    across = (one // COLUMNS + one) % 2 == 0  # diagonals alternate, so that no direction is stiffer
    faces = np.where(
        across[:, None, None],
        np.stack([[one, two, three], [two, four, three]]).transpose(2, 0, 1),
        np.stack([[one, two, four], [one, four, three]]).transpose(2, 0, 1),
    )
    rest = np.stack([at % COLUMNS, at // COLUMNS, 0 * at], axis=-1).reshape(-1, 3) * SPACING
    return make_body(rest, faces.reshape(-1, 3), pinned=np.arange(at.size) < COLUMNS)


def pull(frames: int) -> np.ndarray:
    """Displacement of the grip: away and up, swinging to both sides, shape [frames, 3] [m]."""
    share = np.arange(1, frames + 1) / frames
    return np.stack([0.02 * np.sin(2 * np.pi * share), 0.05 * share, 0.015 * np.sin(np.pi * share)], axis=1)


def simulated(body: Body, gripped: np.ndarray, fields: Stiffness, path: np.ndarray) -> np.ndarray:
    """The flow dx/dt = -∇U, by Runge-Kutta: what steps of position-based dynamics without velocities go towards.

    A frame lasts 1, the mass is 1. Returns positions, shape [T, N, 3] [m].
    """
    energy = Potential(body, spread(body, fields)[0])
    free = ~body.pinned
    free[gripped] = False
    found, now, before = [], body.rest.copy(), np.zeros(3)
    for after in path:

        def placed(time: float, moving: np.ndarray, before=before, after=after) -> np.ndarray:
            points = body.rest.copy()
            points[free] = moving.reshape(-1, 3)
            points[gripped] += before + time * (after - before)
            return points

        def flow(time: float, moving: np.ndarray, placed=placed) -> np.ndarray:
            return -energy.slope(placed(time, moving))[1][free].ravel()

        solution = solve_ivp(flow, (0.0, 1.0), now[free].ravel(), rtol=1e-5, atol=1e-7)
        now, before = placed(1.0, solution.y[:, -1]), after
        found.append(now)
    return np.stack(found)


def sampled(body: Body, count: int, random: np.random.Generator) -> csr_array:
    """Random places on the surface as shares of the particles, shape [count, N]."""
    corners = body.faces[random.integers(len(body.faces), size=count)]  # of one area
    shares = random.dirichlet(np.ones(3), size=count)
    return csr_array((shares.ravel(), corners.ravel(), 3 * np.arange(count + 1)), shape=(count, body.count))


def make_scene(frames: int) -> Scene:
    """Simulate and observe; always the same."""
    body, random = sheet(), np.random.default_rng(0)
    gripped = (ROWS - 1) * COLUMNS + COLUMNS // 2 + np.arange(-2, 2)
    distance = np.where(body.rest[:, 1] < 0.5 * body.rest[:, 1].max(), RATIO * SOFT, SOFT)
    truth = simulated(body, gripped, Stiffness(distance, np.full(body.count, BENDING)), pull(frames))
    clouds = np.stack([sampled(body, POINTS, random) @ state for state in truth])
    places = sampled(body, FOLLOWED, random)
    tracks = np.stack([places @ state for state in truth])
    clouds, tracks = (values + random.normal(0, NOISE, values.shape) for values in (clouds, tracks))
    return Scene(body, gripped, distance, truth, clouds, places, tracks)


@dataclass(frozen=True)
class Judgement:
    """What one method did on one scene; None = that it doesn't do."""

    future: float
    """Mean future gap [m]."""
    off: float
    """Mean distance of predicted particles to the true ones [m]."""
    seconds: float
    """Median time of a step [s]."""
    now: float | None
    """Mean gap of the frames themselves [m]."""
    terms: np.ndarray | None
    """Of the objective, their mean over frames, shape [3]."""
    rank: float | None
    """Spearman's correlation of the field with truth."""
    ratio: float | None
    """Median stiffness of the stiff half over that of the soft one."""


def judged(
    scene: Scene, start: tuple[float, float], kind: str, method: Method, every: int, weights: Weights
) -> Judgement:
    """Follow the sheet, and predict from every so many frames."""
    body = scene.body
    fields = Stiffness(*(np.full(body.count, value) for value in start))
    session = Session(Objective(body, scene.gripped, weights=weights), fields, method)
    future, off, spent, now, terms = [], [], [], [], []
    for frame in range(len(scene.truth) - HORIZON):
        begun = time.perf_counter()
        told = session.step(scene.truth[frame, scene.gripped], scene.matches(frame, kind))
        spent.append(time.perf_counter() - begun)
        now += [] if told.gap is None else [told.gap]
        terms += [] if told.terms is None else [told.terms]
        if frame % every == every - 1:
            later = range(frame + 1, frame + 1 + HORIZON)
            ahead = session.ahead(scene.truth[later][:, scene.gripped])
            for state, at in zip(ahead, later, strict=True):
                residual = session.objective.mapped(state, scene.matches(at, "both"))
                future.append(np.linalg.norm(residual.deformation))
                off.append(np.linalg.norm(state - scene.truth[at], axis=1).mean())
    rank, ratio = None, None
    if terms:
        moving, stiff, found = scene.moving(), scene.distance > SOFT, session.fields.distance
        rank = float(spearmanr(found[moving], scene.distance[moving]).statistic)
        ratio = float(np.median(found[moving & stiff]) / np.median(found[moving & ~stiff]))
    return Judgement(
        float(np.mean(future)),
        float(np.mean(off)),
        float(np.median(spent)),
        float(np.mean(now)) if now else None,
        np.mean(terms, axis=0) if terms else None,
        rank,
        ratio,
    )


def floor(scene: Scene, every: int) -> float:
    """Mean gap of the true states [m], which k⁰ pulls back to rest, and sampled clouds and noise draw aside."""
    objective = Objective(scene.body, scene.gripped)
    frames = range(every - 1, len(scene.truth), every)
    gaps = [objective.mapped(scene.truth[frame], scene.matches(frame, "both")).deformation for frame in frames]
    return float(np.mean([np.linalg.norm(gap) for gap in gaps]))


def rows(
    scene: Scene,
    starts: Sequence[str],
    kinds: Sequence[str],
    every: int,
    weights: Weights,
    optimizer: Literal["adam", "gauss-newton"] = "adam",
) -> Iterator[list[str]]:
    """What is measured, a row for every start, kind of observation and method."""
    for name in starts:
        plain = None
        for kind in kinds:
            for method in METHODS:
                if method == "PBD" and plain is not None:
                    continue  # it sees nothing
                found = judged(scene, STARTS[name], kind, Method(method, optimizer), every, weights)
                plain = found.future if plain is None else plain
                yield [
                    name,
                    "" if method == "PBD" else kind,
                    method,
                    f"{1e3 * found.future:.1f}",
                    f"{1 - found.future / plain:.0%}",
                    f"{1e3 * found.off:.2f}",
                    "" if found.now is None else f"{1e3 * found.now:.1f}",
                    "" if found.terms is None else " + ".join(f"{term:.2f}" for term in found.terms),
                    "" if found.rank is None else f"{found.rank:.2f}",
                    "" if found.ratio is None else f"{found.ratio:.2f}",
                    f"{1e3 * found.seconds:.0f}",
                    f"{PAPER / found.seconds:.1f}",
                ]


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = command_line(__doc__)
    parser.add_argument("--cost", action="store_true", help="what a step costs, by particles, in place of the pull")
    parser.add_argument("--starts", nargs="+", choices=STARTS, default=list(STARTS), help="stiffness to begin with")
    parser.add_argument("--match", nargs="+", choices=MATCHES, default=list(MATCHES), help="what is seen")
    parser.add_argument("--frames", type=int, default=60, help="of the pull")
    parser.add_argument("--every", type=int, default=10, help="frames from one prediction to the next")
    parser.add_argument("--optimizer", choices=OPTIMIZERS, default=OPTIMIZERS[0], help="what changes the stiffness")
    usual = Weights()
    parser.add_argument("--gap", type=float, default=usual.gap, help="weight of the gap")
    parser.add_argument("--history", type=float, default=usual.history, help="weight of the history")
    parser.add_argument("--smoothness", type=float, default=usual.smoothness, help="weight of the smoothness")
    options = parser.parse_args(arguments)
    if options.cost:
        print(f"{machine()}; {online_cost.POINTS} points\n")
        print_table(online_cost.COLUMNS, online_cost.rows(options.match, optimizer=options.optimizer))
        return 0
    if options.frames < HORIZON + options.every or options.every < 1:
        parser.error(f"--frames is {options.frames}; give --every and the horizon's {HORIZON} together at least.")
    weights = Weights(options.gap, options.history, options.smoothness)
    scene = make_scene(options.frames)
    print(f"{scene.body.count} particles, {scene.moving().sum()} of them move; {machine()}; {weights}")
    own = floor(scene, options.every)
    print(f"Gap of the truth itself, by k⁰, the cloud's sampling and noise: {1e3 * own:.1f} mm\n")
    print_table(COLUMNS_SHOWN, rows(scene, options.starts, options.match, options.every, weights, options.optimizer))
    return 0


if __name__ == "__main__":
    run_door(main)
