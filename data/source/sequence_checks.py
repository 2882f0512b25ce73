"""Whether a sequence's files fit together, told from the data: units, frames, clocks, and the sign of a wrench."""

import numpy as np
from scipy.spatial import KDTree

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.sequence import Sequence

LARGEST, SMALLEST = 2.0, 1e-3
"""Tissue that is wider or narrower has another unit [m]."""
LOOKED_AT, THINNED = 150, 3000
"""Frames, and points of each, by which clocks and frames are compared."""
NEAR = 0.01
"""A tip that never comes so near to the tissue, while it holds it, is in another frame [m]."""
LATE, LATEST, LAGS = 0.3, 3.0, 121
"""Clocks may differ by the first; up to the second a lag is looked for, at so many values [s]."""
ALIKE, BETTER = 0.6, 0.3
"""Correlation of two speeds at the lag that is told, and by how much it exceeds that without one."""
AROUND = 4
"""Points at the tip that tell when tissue moves."""
ALONG = 0.5
"""Mean cosine of a force with the tool's motion above which it isn't what the tissue does to the tool."""


def require_fit(sequence: Sequence) -> None:
    """See whether all that a sequence names fits together.

    Raises:
        InputError: it doesn't, a sentence that says what to mend; or a file can't be used.
    """
    count = len(sequence.times)
    frames = np.unique(np.linspace(0, count - 1, min(count, LOOKED_AT)).round().astype(int))
    clouds = {int(frame): _thinned(sequence.cloud(frame)) for frame in frames}
    begin = sequence.held[0]
    rest = clouds.get(begin, _thinned(sequence.cloud(begin)))
    _require_metres(sequence, rest)
    tips = sequence.tool.tips(sequence.times[frames])
    _require_frame(sequence, clouds, dict(zip(frames.tolist(), tips, strict=True)))
    _require_clock(sequence, clouds, rest)
    _require_sign(sequence)


def _thinned(points: np.ndarray) -> np.ndarray:
    return points[np.linspace(0, len(points) - 1, min(len(points), THINNED)).round().astype(int)]


def _require_metres(sequence: Sequence, cloud: np.ndarray) -> None:
    size = float(np.ptp(np.quantile(cloud, (0.05, 0.95), axis=0), axis=0).max())
    if SMALLEST <= size <= LARGEST:
        return
    where = printable(sequence.files[sequence.held[0]])
    likely, unit = ("millimetres", "mm") if size > LARGEST else ("metres", "m")
    give = f"unit: {unit}" if sequence.camera is None else "the length of a unit of depth in metres as depth_factor"
    raise InputError(f"{where} is {size:.3g} m wide, which looks like {likely}; give {give}.")


def _require_frame(sequence: Sequence, clouds: dict[int, np.ndarray], tips: dict[int, np.ndarray]) -> None:
    reach, trees = max(NEAR, 2 * sequence.grip_radius), {frame: KDTree(cloud) for frame, cloud in clouds.items()}
    apart, in_millimetres, in_metres = (
        min(tree.query(scale * tips[frame])[0] for frame, tree in trees.items() if frame in sequence.held)
        for scale in (1.0, 1e-3, 1e3)
    )
    if apart <= reach:
        return
    said = "clouds and poses seem to be in different frames; check hand_eye, camera_on and tip"
    if min(in_millimetres, in_metres) <= reach:
        said = "clouds and poses seem to be in different units; give both in one"
    raise InputError(f"{printable(sequence.path)}: the tip stays {apart:.3g} m from the tissue: {said}.")


def _require_clock(sequence: Sequence, clouds: dict[int, np.ndarray], rest: np.ndarray) -> None:
    """By the speed at which the tip leaves its place and at which tissue there does."""
    tool, frames = sequence.tool, [frame for frame in clouds if frame in sequence.held]
    times, origin = sequence.times[frames], tool.tips(sequence.times[sequence.held[0]])
    if sequence.points is not None:
        there = sequence.points[sequence.held[0]]
        near = np.argsort(np.linalg.norm(there - origin, axis=1))[:AROUND]  # what is not seen comes last
        motion = np.nanmean(np.linalg.norm(sequence.points[frames][:, near] - there[near], axis=2), axis=1)
    else:
        places = rest[np.argsort(np.linalg.norm(rest - origin, axis=1))[:AROUND]]
        motion = np.array([KDTree(clouds[frame]).query(places)[0].mean() for frame in frames])

    def alike(lag: float) -> float:
        inside = np.clip(times + lag, tool.times[0], tool.times[-1])
        ways = np.linalg.norm(tool.tips(inside) - origin, axis=1), motion
        speeds = [np.diff(way) / np.diff(times) for way in ways]
        known = np.isfinite(speeds[1])
        if known.sum() < 5 or min(speed[known].std() for speed in speeds) < 1e-9:
            return 0.0
        return float(np.corrcoef(speeds[0][known], speeds[1][known])[0, 1])

    lags = np.linspace(-LATEST, LATEST, LAGS)
    found = [alike(lag) for lag in lags]
    best = int(np.argmax(found))
    if abs(lags[best]) > LATE and found[best] > ALIKE and found[best] > alike(0.0) + BETTER:
        late = f"{abs(lags[best]):.1f} s {'later' if lags[best] > 0 else 'earlier'}"
        said = f"tells the tool's motion {late} than the clouds show it; put both on one clock"
        raise InputError(f"{printable(tool.path)} {said}.")


def _require_sign(sequence: Sequence) -> None:
    """Tissue pulls a tool back and pushes it out: its force is against the tool's way."""
    if sequence.forces is None:
        return
    tips = sequence.tool.tips(sequence.times)
    ways = (tips - tips[sequence.held[0]])[list(sequence.held)]
    forces = sequence.forces[list(sequence.held)]
    most = float((np.linalg.norm(forces, axis=1) * np.linalg.norm(ways, axis=1)).sum())
    if float((forces * ways).sum()) > ALONG * most:
        said = "acts along the tool's motion, so it is what the tool does to the tissue"
        raise InputError(f"{sequence.given.forces} in {printable(sequence.path)} {said}; reverse Fx, Fy and Fz.")
