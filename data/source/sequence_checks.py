"""Whether a sequence's files fit together, told from the data: units, frames and clocks."""

import numpy as np
from scipy.spatial import KDTree

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.sequence import Sequence, Tool

LARGEST, SMALLEST = 2.0, 1e-3
"""Tissue that is wider or narrower has another unit [m]."""
THINNEST = 5e-5
"""A smaller grip has another unit [m]."""
LOOKED_AT, THINNED = 150, 3000
"""Frames, and points of each, by which clocks and frames are compared."""
NEAR = 0.01
"""A tip that never comes so near to the tissue, while it holds it, is in another frame [m]."""
LATE, LATEST, LAGS = 0.3, 3.0, 121
"""Clocks may differ by the first; up to the second a lag is looked for, at so many values [s]."""
ALIKE, BETTER = 0.6, 0.3
"""Correlation of two speeds at the lag that is told, and by how much it exceeds that without one."""
AROUND, SCATTERED = 4, 30
"""Followed points at the tip that tell when tissue moves, and points of a cloud, which has others in every frame."""


def require_fit(sequence: Sequence) -> None:
    """See whether all that a sequence names fits together.

    Raises:
        InputError: it doesn't, a sentence that says what to mend; or a file can't be used.
    """
    held, first = sequence.held, sequence.first[1]
    origin = sequence.tool.tips(sequence.times[held[:1]])[0]
    frames = np.unique(np.linspace(held[0], held[-1], min(len(held), LOOKED_AT)).round().astype(int))
    _require_metres(sequence, first)
    clouds = ((frame, first if frame == held[0] else sequence.cloud(frame)) for frame in frames)
    trees = {frame: KDTree(each[:: len(each) // THINNED + 1]) for frame, each in clouds if len(each)}
    _require_frame(sequence, [*trees.values()], sequence.tool.tips(sequence.times[[*trees]]))
    if sequence.points is None:
        frames = np.array([*trees])
        places = first[np.argsort(np.linalg.norm(first - origin, axis=1))[:SCATTERED]]
        motion = np.array([tree.query(places)[0].mean() for tree in trees.values()])
    else:
        there = sequence.points[held[0]]
        known = there[np.isfinite(there).all(axis=1)]
        if len(known) and np.median(KDTree(first).query(known)[0]) > NEAR:
            raise InputError(f"{printable(sequence.path)}: points lie off the clouds; give both in one unit and frame.")
        near = np.argsort(np.linalg.norm(there - origin, axis=1))[:AROUND]  # what is not seen comes last
        motion = np.linalg.norm(sequence.points[frames][:, near] - there[near], axis=2).mean(axis=1)
    if len(frames) > 1:
        _require_clock(sequence.tool, sequence.times[frames], motion, origin)


def _require_metres(sequence: Sequence, cloud: np.ndarray) -> None:
    size = float(np.ptp(np.quantile(cloud, (0.05, 0.95), axis=0), axis=0).max())
    if not SMALLEST <= size <= LARGEST:
        likely, unit = ("millimetres", "mm") if size > LARGEST else ("metres", "m")
        give = f"unit: {unit}" if sequence.camera is None else "the length of its unit in metres as depth_factor"
        said = f"is {size:.3g} m wide, which looks like {likely}; give {give}"
        raise InputError(f"{printable(sequence.files[sequence.held[0]])} {said}.")
    radius = sequence.grip_radius
    if not THINNEST < radius < size:
        raise InputError(f"{printable(sequence.path)}: grip_radius can't be the tissue's; check `unit`.")


def _require_frame(sequence: Sequence, trees: list[KDTree], tips: np.ndarray) -> None:
    apart, *otherwise = (
        min(tree.query(scale * tip)[0] for tree, tip in zip(trees, tips, strict=True)) for scale in (1.0, 1e-3, 1e3)
    )
    reach = max(NEAR, 2 * sequence.grip_radius)
    if apart > reach:
        said = "frames; check hand_eye, camera_on and tip" if min(otherwise) > reach else "units; give both in one"
        said = f"the tip stays {apart:.3g} m from the tissue: clouds and poses seem to be in different {said}"
        raise InputError(f"{printable(sequence.path)}: {said}.")


def _require_clock(tool: Tool, times: np.ndarray, motion: np.ndarray, origin: np.ndarray) -> None:
    """By the speed at which the tip leaves its place, shape [3] [m], and at which tissue there does, shape [T] [m]."""
    step = max(1, round(LATE / float(np.median(np.diff(times)))))

    def alike(lag: float) -> float:
        way = np.linalg.norm(tool.tips(times + lag) - origin, axis=1)
        speeds = np.stack([each[step:] - each[:-step] for each in (way, motion)])
        speeds = speeds[:, np.isfinite(speeds).all(axis=0)]
        return float(np.corrcoef(speeds)[0, 1]) if speeds.shape[1] > 5 and speeds.std(axis=1).all() else 0.0

    lags = np.linspace(-LATEST, LATEST, LAGS)
    found = [alike(lag) for lag in lags]
    lag, most = float(lags[np.argmax(found)]), max(found)
    if abs(lag) > LATE and most > ALIKE and most > alike(0.0) + BETTER:
        late = f"{abs(lag):.1f} s {'later' if lag > 0 else 'earlier'}"
        said = f"tells the tool's motion {late} than the clouds show it; put both on one clock"
        raise InputError(f"{printable(tool.path)} {said}.")
