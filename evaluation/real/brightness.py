"""Light of gripped tissue, predicted from the first half of its frames, and what it adds to predicted motion.

Compared is the change of light since rest as sessions see it (`data.brightness`): its logarithm on the lattice of a
picture, gain and slow changes taken off, where both that picture and the one at rest show tissue. Far tissue's affine
motion is taken off, as for the skill of motion. Of the later frames only the motion at the instrument is known. What
goes on place by place is found in the first half as a share of that motion, by ridge regression (`by_place`).
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from palpate.common.robust import affine_motion
from palpate.data.brightness.light import log_light
from palpate.data.brightness.sequence import FEWEST_FAR, change_of_light
from palpate.data.labels import TOOL
from palpate.data.tracks.background import without_background
from palpate.data.tracks.following import PointFollower
from palpate.data.tracks.linking import sampled
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.lattice import BEYOND, LEAST_FRAMES, GripFrame, continued, fit_sheet
from palpate.estimators.grip.recorder import DRIVEN
from palpate.estimators.records import InteractionEstimate
from palpate.evaluation.harness import Row
from palpate.evaluation.real.predicted import skill
from palpate.evaluation.real.pulled import PulledClip, opened

PENALTIES = np.geomspace(1e-2, 1e3, 11)
"""Of squared shares, over the mean square of what they are shares of; the first half chooses one."""
SCALES = {"light": 0.0, "light over 32 px": 32.0}
"""Standard deviations of the weights with which light is averaged before it is compared [px]: texture that was carried
to a wrong place hardly shows over wide ones, light and shadow do."""
ROUNDS = 8
"""In which it is found what tissue a place shows."""
OBSERVED = "observed"
STILL, SHEET, CORRECTED, FOLLOWED = "nothing moves", "sheet", "sheet, places", "followed motion"
"""Motions by which the picture at rest is carried along. With places, what the sheet leaves at each of them in the
first half goes on in the later one; the last motion is no prediction."""
SHOWN, EDGE = 0.5, 10
"""Largest change of light that the colours of a figure tell apart, and what it shows around what is compared [px]."""


@dataclass(frozen=True, eq=False)
class LitPull:
    """Gripped tissue and its light; N points, T frames, a lattice of h × w places."""

    points: np.ndarray
    """Places at rest, on a grid, shape [N, 2] (column, row) [px]."""
    spacing: int
    """Of that grid [px]."""
    size: np.ndarray
    """Width and height of their picture, shape [2] [px]."""
    numbers: list[int]
    """Of the frames, T of them."""
    frames: list[GripFrame]
    """Their motion, far tissue's taken off."""
    rest: np.ndarray
    """Logarithm of the light at rest, shape [h, w]; not a number where no tissue is visible."""
    light: np.ndarray
    """The same in every frame, gain and far tissue's motion taken off, shape [T, h, w]."""

    @cached_property
    def places(self) -> np.ndarray:
        """Of the lattice, shape [h, w, 2] (column, row) [px]."""
        return lattice_places(self.rest.shape, self.size)

    @cached_property
    def nodes(self) -> np.ndarray:
        """Of a sheet, the points first, shape [M, 2] [px]; they fill a rectangle."""
        return continued(self.points, self.spacing, BEYOND)

    def moved(self, motion: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Displacement of places [rows, columns, 2] by that of the nodes [M, 2] [px]."""
        low = self.nodes.min(axis=0)
        column, row = np.rint((self.nodes - low) / self.spacing).astype(int).T
        whole = np.empty((row.max() + 1, column.max() + 1, 2), np.float32)
        whole[row, column] = motion
        return sampled(whole, ((places - low) / self.spacing).astype(np.float32))

    def origin(self, motion: np.ndarray) -> np.ndarray:
        """Where the tissue was at rest that the lattice shows if the nodes have moved so, shape [h, w, 2] [px]."""
        found = self.places
        for _ in range(ROUNDS):
            found = self.places - self.moved(motion, found)
        return found

    def change_at(self, places: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Change of the light of tissue at places [rows, columns, 2] if it has moved so [T, rows, columns, 2] [px].

        Without every frame's median: the gain.
        """
        rest = light_at(self.rest, places, self.size)
        lit = [light_at(*pair, self.size) for pair in zip(self.light, places + motions, strict=True)]
        change = np.array(lit) - rest
        return change - np.nanmedian(change, axis=(1, 2), keepdims=True)


def lattice_places(shape: tuple[int, ...], size: np.ndarray) -> np.ndarray:
    """Places of a lattice [h, w] over a picture of that width and height, shape [h, w, 2] (column, row) [px]."""
    return (np.indices(shape)[::-1].transpose(1, 2, 0) + 0.5) * size / shape[::-1] - 0.5


def light_at(light: np.ndarray, places: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Light [h, w] at places [rows, columns, 2] [px], by its neighbours there that are known.

    Not a number where these count less than half.
    """
    columns, rows = cv2.split(((places + 0.5) * light.shape[::-1] / size - 0.5).astype(np.float32))
    known = np.isfinite(light)
    parts = known.astype(np.float32), np.where(known, light, 0).astype(np.float32)
    share, found = (cv2.remap(part, columns, rows, cv2.INTER_LINEAR) for part in parts)
    return np.where(share > 0.5, found / np.maximum(share, 0.5), np.nan)


def read_light(clip: PulledClip, run: InteractionEstimate) -> LitPull:
    """The frames that tell of a run's grip, with their light.

    Raises:
        InputError: the clip can't be read.
        NoEstimate: there is no grip, or enough light of tissue is visible in too few frames.
    """
    times = np.empty(0) if run.grip is None else run.onset_time_s + run.grip.times
    follower, rest, size = None, np.empty((0, 0)), np.empty(2)
    numbers, frames, lights = list[int](), list[GripFrame](), list[np.ndarray]()
    _, stream = opened(clip)
    for frame in map(stream.prepared, stream.source):
        if not frame.visible or frame.frame.index < run.onset:
            continue
        picture, labels = frame.view
        light = log_light(picture, labels, frame.depth.shape)
        if follower is None:
            follower, rest = PointFollower(picture, labels == TOOL), light
            size = np.array(follower.shown.gray.shape[::-1])
            continue
        follower.step(picture, labels == TOOL)
        if not np.isclose(times, frame.frame.time_s).any():
            continue
        points, moved = follower.points, follower.moved
        against = without_background(points, moved, follower.distance)
        known, places = follower.followed, lattice_places(rest.shape, size)
        carried = affine_motion(points, moved - against, known, places.reshape(-1, 2)).reshape(places.shape)
        change = change_of_light(light_at(light, places + carried, size), rest)
        if change is not None:
            numbers.append(frame.frame.number)
            frames.append(GripFrame(against, known & (follower.distance < DRIVEN)))
            lights.append(rest + change)
    if follower is None or len(frames) < 2 * LEAST_FRAMES:
        raise NoEstimate(f"In {len(frames)} frames enough light of tissue is visible; {2 * LEAST_FRAMES} are needed.")
    points = follower.points.astype(np.float64)
    return LitPull(points, follower.spacing, size, numbers, frames, rest, np.stack(lights))


def by_place(drivers: np.ndarray, values: np.ndarray, half: int) -> np.ndarray:
    """What values [T, P, C] are expected to be by their drivers [T, P, K], place by place; 0 where nothing is known.

    Their shares are those of the first half of the frames. Of PENALTIES that one counts with which its first two thirds
    predict its last third best; where all do that worse than no shares at all, nothing is expected.
    """
    drivers = np.nan_to_num(drivers / (float(np.sqrt(np.nanmean(np.square(drivers[:half])))) or 1.0))
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    given, values = np.where(known, drivers, 0.0), np.where(known, values, 0.0)
    inner = half - max(half // 3, 1)

    def expected(count: int, penalty: float, at: np.ndarray) -> np.ndarray:
        squares = np.einsum("tpk,tpl->pkl", given[:count], given[:count]) + penalty * np.eye(given.shape[-1])
        shares = np.linalg.solve(squares, np.einsum("tpk,tpc->pkc", given[:count], values[:count]))
        return np.einsum("tpk,pkc->tpc", at, shares)

    def left(penalty: float) -> float:
        return float(np.square(values[inner:half] - expected(inner, penalty, given[inner:half])).sum())

    best = min(PENALTIES, key=left)
    if left(best) >= np.square(values[inner:half]).sum():
        return np.zeros_like(values)
    return expected(half, best, drivers)


def light_skill(expected: np.ndarray, observed: np.ndarray) -> float:
    """1 - error / change of the light of pixels [K], root mean squares, both without their medians: the gain."""
    expected, observed = (values - np.median(values) for values in (expected, observed))
    return 1 - float(np.sqrt(np.square(expected - observed).mean() / np.square(observed).mean()))


def evaluate_light(pull: LitPull) -> tuple[Row, Figure]:
    """Skills of predicted light and of predicted motion, with and without brightness, by name, and a picture of them.

    Means over the frames of the later half.

    Raises:
        NothingMoves: no sheet can be fitted to the first half.
        NoEstimate: a frame shows too little light of what is predicted.
    """
    frames, half, count = pull.frames, len(pull.frames) // 2, len(pull.points)
    fit = fit_sheet(pull.points, pull.spacing, frames[:half])
    nodes = np.array([fit.held(frame).found.displacement for frame in frames])
    sheet, hidden = nodes[:, :count], nodes[:, count:]
    followed, around = (np.array([getattr(frame, name) for frame in frames]) for name in ("moved", "around"))
    grip = np.array([frame.moved[frame.gripped].mean(axis=0) for frame in frames])[:, None]
    left = np.where(around[..., None], followed - sheet, np.nan)

    def brightness(moved: np.ndarray) -> np.ndarray:
        """Change of the light where the points are expected, shape [T, N, 1]."""
        return pull.change_at(pull.points[:, None], moved[:, :, None])

    others = np.random.default_rng(0).permutation(count)
    corrected = sheet + by_place(np.broadcast_to(grip, left.shape), left, half)
    expected = {
        SHEET: sheet,
        f"{SHEET}, brightness": sheet + by_place(brightness(sheet), left, half),
        f"{SHEET}, brightness of other places": sheet + by_place(brightness(sheet)[:, others], left, half),
        CORRECTED: corrected,
        f"{CORRECTED}, brightness": corrected + by_place(brightness(corrected), left + sheet - corrected, half),
    }
    courses: dict[str, list[float]] = {}
    for name, moved in expected.items():
        compared = zip(moved, followed, around, strict=True)
        courses[f"skill of motion: {name}"] = [skill(one[shown], other[shown]) for one, other, shown in compared]
    carriers = {STILL: 0 * nodes, SHEET: nodes, CORRECTED: np.concatenate([corrected, hidden], axis=1)}
    carriers[FOLLOWED] = np.concatenate([np.where(np.isfinite(followed), followed, sheet), hidden], axis=1)
    images, of_light = _images(pull, carriers, grip)
    courses |= of_light
    return {name: float(np.mean(course[half:])) for name, course in courses.items()}, _draw(pull, images, courses)


def averaged(image: np.ndarray, width: np.ndarray) -> np.ndarray:
    """A weighted mean around every place of an image [h, w]; where that is not a number it doesn't count.

    Args:
        image: values.
        width: standard deviation of the weights along rows and along columns, shape [2] [places]; 0 = no mean.
    """
    if not width.any():
        return image
    known = np.isfinite(image)
    parts = known.astype(np.float32), np.where(known, image, 0).astype(np.float32)
    share, found = (cv2.GaussianBlur(part, (0, 0), sigmaX=width[0], sigmaY=width[1]) for part in parts)
    return np.where(known, found / np.where(known, share, 1), np.nan)


def _images(
    pull: LitPull, carriers: dict[str, np.ndarray], grip: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, list[float]]]:
    """The last frame's changes of light [h, w], observed and predicted; and of all frames their sizes, and skills.

    Args:
        pull: what is predicted.
        carriers: displacements of the nodes by what predicts them, shape [T, M, 2] each [px].
        grip: mean displacement of the grip, shape [T, 1, 2] [px].
    """
    predicted: dict[str, np.ndarray] = {}
    for name, nodes in carriers.items():
        change = pull.change_at(pull.places, np.array([pull.moved(each, pull.places) for each in nodes]))
        pixels = change.reshape(len(change), -1, 1)
        own = by_place(np.broadcast_to(grip, (*pixels.shape[:2], 2)), pixels, len(change) // 2).reshape(change.shape)
        origins = [pull.origin(each) for each in nodes]
        predicted[name] = np.array([light_at(pull.rest, origin, pull.size) for origin in origins]) - pull.rest
        added = np.array([light_at(*pair, pull.size) for pair in zip(own, origins, strict=True)])
        predicted[f"{name}, brightness"] = predicted[name] + added
    observed = pull.light - pull.rest
    known = np.logical_and.reduce([np.isfinite(values) for values in (observed, *predicted.values())])
    if known.sum(axis=(1, 2)).min() < FEWEST_FAR:
        raise NoEstimate(f"A frame shows the light of fewer than {FEWEST_FAR} places of tissue that is predicted.")
    images = {name: np.where(known, values, np.nan) for name, values in {OBSERVED: observed, **predicted}.items()}
    courses = dict[str, list[float]]()
    for kind, width in SCALES.items():
        places = width * np.array(known.shape[:0:-1]) / pull.size
        wide = {name: [averaged(image, places) for image in values] for name, values in images.items()}
        courses[f"change of {kind}"] = [float(np.nanstd(image)) for image in wide[OBSERVED]]
        for name in predicted:
            each = zip(wide[name], wide[OBSERVED], known, strict=True)
            courses[f"skill of {kind}: {name}"] = [light_skill(image[k], seen[k]) for image, seen, k in each]
    return {name: values[-1] for name, values in images.items()}, courses


def _draw(pull: LitPull, images: dict[str, np.ndarray], courses: dict[str, list[float]]) -> Figure:
    """Changes of light in the last frame, observed and predicted, and skill over the frames."""
    figure, shown = Figure(figsize=(13, 10), layout="constrained"), (OBSERVED, CORRECTED, f"{CORRECTED}, brightness")
    rows = [np.repeat(shown, 2).tolist(), np.repeat([*SCALES], 3).tolist()]
    axes = figure.subplot_mosaic(rows, height_ratios=(1.1, 1))
    numbers, half = pull.numbers, len(pull.numbers) // 2
    visible = pull.places[np.isfinite(images[OBSERVED])]
    (left, top), (right, bottom) = visible.min(axis=0) - EDGE, visible.max(axis=0) + EDGE
    width, height = pull.size - 0.5
    for name in shown:
        image = images[name] - np.nanmedian(images[name])
        extent = -0.5, width, height, -0.5
        drawn = axes[name].imshow(image, cmap="RdBu_r", vmin=-SHOWN, vmax=SHOWN, extent=extent)
        title = name if name == OBSERVED else f"predicted by\n{name}"
        axes[name].set(title=f"frame {numbers[-1]}, {title}", xlim=(left, right), ylim=(bottom, top))
        axes[name].set(facecolor="0.8", xlabel="column [px]", ylabel="row [px]")
    figure.colorbar(drawn, ax=axes[shown[-1]], label="change of log light since rest [1]")
    for kind in SCALES:
        below = axes[kind]
        for color, name in enumerate((STILL, SHEET, CORRECTED, FOLLOWED)):
            for style, each in (("--", name), ("-", f"{name}, brightness")):
                course = courses[f"skill of {kind}: {each}"]
                below.plot(numbers, course, style, color=f"C{color}", marker=".", label=each)
        below.axvspan(numbers[0] - 0.5, sum(numbers[half - 1 : half + 1]) / 2, color="0.93", zorder=0)
        below.text(numbers[0] - 0.4, 1.0, "frames that are fitted", va="top")
        below.set(xlabel="frame", ylabel=f"skill of {kind} [1]", ylim=(-1, 1.05), xlim=(numbers[0] - 0.5, None))
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(*below.get_legend_handles_labels(), title="predicted by", loc="outside lower center", ncols=4)
    return figure
