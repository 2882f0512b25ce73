"""Presses of a tool in a sequence beside a robot: the tissue at rest, and under each press's largest force.

The surface at rest is made of the points of the first frames. The body below it ends at a flat support, `thickness`
under the first contact.
"""

from pathlib import Path

import numpy as np
from scipy.ndimage import label
from scipy.spatial import KDTree

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.sequence import UNITS, moved, open_sequence
from palpate.data.source.sequence_checks import require_fit
from palpate.estimators.cloud_shape import CloudShape, view_across
from palpate.estimators.palpation.bench import Palpation
from palpate.estimators.palpation.material_fit import FitSettings
from palpate.estimators.palpation.registration import Triangles
from palpate.physics.mesh import Mesh

ONSET, QUIET = 0.3, 0.05
"""Of the largest force: a press is a run of frames above the first, and tissue is at rest below the second."""
HELD = 0.03
"""Share of a press's largest force below it, within which frames around show the same press."""
FRAMES = 20
"""Frames, the first ones, that show the tissue at rest."""
HIDDEN, UPRIGHT = 1.3, 0.7
"""Hole around a contact over the tool's radius, and least cosine of a force with the normal of the tissue's plane."""
REPEATED = {"base": (1e-6, 1e-5), "tool": (1e-4, 5e-4)}
"""Standard deviations of a camera's pose between two frames, by what carries it [m, rad]."""
FINE = 0.2
"""Over which distance heights of the surface at rest are averaged, by the tool's radius; its grid is twice as fine."""
BELOW = 1e-3
"""How far under the support the closed surface ends, so that the support is where the mesh is cut off [m]."""
RIM = 1.0
"""Width of the surface's rim, over that distance, that tells nothing: heights are known from one side only there."""
LAYERS, CELLS = 5.0, (6, 24)
"""Cells of the mesh in the thickness, and along the longest side."""


def read_presses(path: Path) -> tuple[Triangles, list[Palpation], FitSettings, np.ndarray, tuple[int, float], int]:
    """Find what a tool pressed.

    Returns:
        the body's closed surface and palpations of it, in the robot's frame; how they are fitted; pose of a frame whose
        z points out of the tissue, shape [4, 4]; axis and height of the support in it; cells along the longest side.

    Raises:
        InputError: the sequence can't be used, has no forces or no thickness, or shows no press or nothing at rest.
    """
    sequence, where = open_sequence(path), printable(path)
    require_fit(sequence)
    if sequence.forces is None or sequence.given.thickness is None:
        raise InputError(f"{where}: palpation needs forces, and the thickness of the tissue to its support; add both.")
    size = np.linalg.norm(sequence.forces, axis=1)
    runs, count = label(size > ONSET * size.max())
    still = np.flatnonzero(size[: int(np.argmax(runs > 0))] < QUIET * size.max())[:FRAMES]
    rest = np.concatenate([np.empty((0, 3)), *map(sequence.cloud, still)])
    if not len(rest):
        said = "shows no press after tissue at rest; begin before the tool touches it, and press beyond forces' noise"
        raise InputError(f"{where} {said}.")
    peaks = [int(np.argmax(np.where(runs == run, size, 0.0))) for run in range(1, count + 1)]
    tips = sequence.tool.tips(sequence.times[peaks])
    view = view_across(rest, sequence.eye(int(still[0]))[:3, 3], tips[0])
    radius, thickness = sequence.grip_radius, sequence.given.thickness * UNITS[sequence.given.unit]
    # As fine as the dent asks for: a rough surface's normals would take lateral motion for a sink.
    wide = FINE * radius
    shape, contacts = CloudShape(moved(rest, view), where, wide), moved(tips, view)
    mesh = shape.mesh(wide / 2)
    heights, covered = shape.heights(contacts[:, :2])
    if not covered.all():
        raise InputError(f"{where}: the tool presses where clouds at rest show no tissue; give clouds of all of it.")
    # How far the tip may be above the tissue where the force is largest, for what poses and clouds err [m].
    if (above := float((heights - contacts[:, 2]).max())) > 5e-3:
        said = f"is {above:.2g} m off the tissue while it presses; put forces and poses on one clock, or mend `tip`"
        raise InputError(f"{where}: the tip {said}.")
    contacts[:, 2] = heights
    support = contacts[0, 2] + thickness
    back = np.linalg.inv(view)
    upright = back @ np.diag([1.0, -1.0, -1.0, 1.0])  # the view looks down
    upright[:3, 3] += support * back[:3, 2]
    rim = KDTree(mesh.vertices[mesh.rim, :2])
    palpations, repeated = [], REPEATED[sequence.given.camera_on]
    for peak, contact in zip(peaks, moved(contacts, back), strict=True):
        same = np.flatnonzero((runs == runs[peak]) & (size > (1 - HELD) * size[peak]))
        points = np.concatenate([sequence.cloud(int(frame)) for frame in same])
        places = moved(points, view)[:, :2]
        points = points[shape.heights(places)[1] & (rim.query(places)[0] > RIM * wide)]
        if not len(points):
            raise InputError(f"{where}: no cloud shows the press at {sequence.times[peak]:g} s; give one that does.")
        eye, felt = sequence.eye(peak), sequence.forces[same].mean(axis=0)
        if felt @ view[2, :3] > -UPRIGHT * np.linalg.norm(felt):
            raise InputError(f"{where}: a force is over 45° off the tissue's normal; check its frame, and qx to qw.")
        seen = moved(points[:: len(points) // 5000 + 1], np.linalg.inv(eye))
        palpations.append(Palpation(-felt, contact, seen, eye, radius, HIDDEN * radius, *repeated))
    # Points of one patch share what noise has made of it at rest.
    widened = float(np.sqrt(1 + max(len(each.points) for each in palpations) / len(rest)))
    vertices, triangles = _closed(mesh, support + BELOW)
    cells = int(np.clip(LAYERS * np.ptp(vertices, axis=0).max() / thickness, *CELLS))
    return (moved(vertices, back), triangles), palpations, FitSettings(widened=widened), upright, (2, 0.0), cells


def _closed(mesh: Mesh, base: float) -> Triangles:
    """An open surface with walls along z down to a flat base at that height."""
    top, count = mesh.triangles.astype(np.int64), len(mesh.vertices)
    edges = top[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, where, shared = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    begin, end = edges[where[shared == 1]].T
    walls = np.stack([end, begin, begin + count, end, begin + count, end + count], axis=1).reshape(-1, 3)
    upper = mesh.vertices.astype(np.float64)
    lower = np.column_stack([upper[:, :2], np.full(count, base)])
    return np.concatenate([upper, lower]), np.concatenate([top, walls, top[:, ::-1] + count])
