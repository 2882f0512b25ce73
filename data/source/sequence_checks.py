"""Consistency checks of a sequence's files by their data: units and frames."""

import numpy as np
from scipy.spatial import KDTree

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.sequence import Sequence

NEAR = 0.01
"""Largest distance of the tip from tissue that it holds; beyond, it is in another frame [m]."""


def require_fit(sequence: Sequence) -> None:
    """Require that all that a sequence names fits together.

    Raises:
        InputError: it doesn't, or a file can't be used.
    """
    held, first = sequence.held, sequence.first[1]
    # Frames of coordinates are compared by 150 frames, and 3000 points of each.
    frames = np.unique(np.linspace(held[0], held[-1], min(len(held), 150)).round().astype(int))
    _require_metres(sequence, first)
    clouds = ((frame, first if frame == held[0] else sequence.cloud(frame)) for frame in frames)
    trees = {frame: KDTree(each[:: len(each) // 3000 + 1]) for frame, each in clouds if len(each)}
    _require_frame(sequence, [*trees.values()], sequence.tool.tips(sequence.times[[*trees]]))
    if sequence.points is not None:
        there = sequence.points[held[0]]
        known = there[np.isfinite(there).all(axis=1)]
        if len(known) and np.median(KDTree(first).query(known)[0]) > NEAR:
            raise InputError(f"{printable(sequence.path)}: points lie off the clouds; give both in one unit and frame.")


def _require_metres(sequence: Sequence, cloud: np.ndarray) -> None:
    size = float(np.ptp(np.quantile(cloud, (0.05, 0.95), axis=0), axis=0).max())
    if not 1e-3 <= size <= 2.0:  # tissue that is wider or narrower has another unit
        likely, unit = ("millimetres", "mm") if size > 2.0 else ("metres", "m")
        give = f"unit: {unit}" if sequence.camera is None else "the length of its unit in metres as depth_factor"
        problem = f"is {size:.3g} m wide, which looks like {likely}; give {give}"
        raise InputError(f"{printable(sequence.files[sequence.held[0]])} {problem}.")
    radius = sequence.grip_radius
    # A smaller grip has another unit [m].
    if not 5e-5 < radius < size:
        raise InputError(f"{printable(sequence.path)}: grip_radius can't be the tissue's; check `unit`.")


def _require_frame(sequence: Sequence, trees: list[KDTree], tips: np.ndarray) -> None:
    apart, *otherwise = (
        min(tree.query(scale * tip)[0] for tree, tip in zip(trees, tips, strict=True)) for scale in (1.0, 1e-3, 1e3)
    )
    reach = max(NEAR, 2 * sequence.grip_radius)
    if apart > reach:
        problem = "frames; check hand_eye, camera_on and tip" if min(otherwise) > reach else "units; give both in one"
        problem = f"the tip stays {apart:.3g} m from the tissue: clouds and poses seem to be in different {problem}"
        raise InputError(f"{printable(sequence.path)}: {problem}.")
