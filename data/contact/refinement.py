"""Place of a young contact: the tissue near the detected place that has yielded most in the first frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.data.contact.geometry import TISSUE, TOOL, move_contact
from palpate.data.contact.outlines import near, uncover
from palpate.data.contact.tissue_points import grid_to_picture, picture_to_grid
from palpate.data.prepared import PreparedFrame
from palpate.data.tracks.tissue import TissueTemplate, TissueTracker

REFINE_FRAMES = 5
"""Number of frames after the onset that decide on the contact's place."""


@dataclass
class ContactRun:
    """A contact whose onset was observed, and the tissue point that is tracked from it."""

    onset: PreparedFrame
    """The first frame in contact."""
    pixel: np.ndarray
    """Tracked point in the latest frame, (u, v) [full-picture px]; NaN once it is lost."""
    template: TissueTemplate
    """Template of the tissue around it at the onset."""
    drift: np.ndarray
    """Rigid motion subtracted so far, shape [3] [scene units]."""
    young: list[tuple[PreparedFrame, np.ndarray, np.ndarray]] | None
    """Frames after the onset with the point's pixel and the drift in each; None once the contact's place is settled."""


def pressed_pixel(
    onset: PreparedFrame, later: Sequence[tuple[PreparedFrame, np.ndarray, float]], sigmas: float
) -> tuple[int, int] | None:
    """Grid pixel (u, v) whose depth changes most from its rest shape, on average over later frames.

    Tissue that is pressed away from the camera is sought all along the outline where the masks touch: frayed outlines
    put the closest pair of points anywhere on it. If none is pressed, tissue that comes nearer counts, but only close
    to the detected contact: a tool pixel that is taken for tissue looks the same.

    Args:
        onset: first frame in contact, its mesh at rest.
        later: following frames, each with the place of the contact's tissue, (u, v) [grid pixels], and the change of
            its depth by the camera [scene units].
        sigmas: threshold of the mean change over its standard deviation; one more away from the detected place, where
            many more pixels are compared.
    """
    mesh, (u, v), noise = onset.contact.mesh, onset.contact.pixel, onset.contact.noise
    reach = 3  # of the search, from the detected contact and from the outline where the masks touch [grid pixels]
    outline = near(onset.labels == TISSUE, reach) & near(onset.labels == TOOL, reach)
    close = (np.abs(mesh.pixels - (v, u)) <= reach).all(axis=1)
    chosen = np.flatnonzero((close | (outline[tuple(mesh.pixels.T)] & onset.contact.touching)) & ~mesh.rim)
    if len(chosen) == 0 or not later:
        return None
    changes, bare = (np.stack(parts) for parts in zip(*(_changes(onset, chosen, *item) for item in later), strict=True))
    share = (bare.sum(axis=0) + (onset.labels[tuple(mesh.pixels[chosen].T)] == TISSUE)) / (len(later) + 1)
    needed = (sigmas + ~close[chosen]) * noise
    # Depth five standard deviations nearer than the tissue at rest is the tool's.
    pressed = _largest(np.where(changes > -5.0 * noise, changes, np.nan), needed, share, noise)
    pulled = np.where(close[chosen], -changes, np.nan)
    found = pressed if pressed is not None else _largest(pulled, needed, share, noise)
    if found is None:
        return None
    row, column = mesh.pixels[chosen[found]]
    return int(column), int(row)


def _changes(
    onset: PreparedFrame, chosen: np.ndarray, prepared: PreparedFrame, place: np.ndarray, away: float
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of the chosen vertices' depth since rest [scene units], NaN if hidden, and mask of tissue, shapes [P]."""
    mesh, (u, v) = onset.contact.mesh, onset.contact.pixel
    rows, columns = (mesh.pixels[chosen] + np.rint(place[::-1] - (v, u)).astype(int)).T
    height, width = prepared.depth.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
    labels = uncover(prepared.depth, prepared.labels, onset.contact.noise)
    visible = inside & (labels[rows, columns] == TISSUE) & (prepared.depth[rows, columns] > 0)
    changes = np.where(visible, prepared.depth[rows, columns] - away - mesh.vertices[chosen, 2], np.nan)
    return changes, inside & (prepared.labels[rows, columns] == TISSUE)


def _largest(changes: np.ndarray, needed: np.ndarray, share: np.ndarray, noise: float) -> int | None:
    """The vertex of the largest mean change, or None where that isn't clear.

    Of vertices that change equally, up to the noise, it is the one that the masks show as tissue most often: the tip of
    the pressing tool goes as deep.

    Args:
        changes: shape [frames, P] [scene units]; NaN where a vertex wasn't visible.
        needed: limit of a single change, shape [P]; that of a mean of n changes is smaller by √n.
        share: share of frames in which the mask shows the vertex as tissue, shape [P].
        noise: standard deviation of a change.
    """
    count = np.isfinite(changes).sum(axis=0)
    root = np.sqrt(np.maximum(count, 1))
    mean = np.nansum(changes, axis=0) / np.maximum(count, 1)
    clear = (2 * count >= len(changes)) & (mean > needed / root)
    if not clear.any():
        return None
    # Dents grow: only frames that show both vertices compare them.
    behind = changes[:, np.argmax(np.where(clear, mean, -np.inf))][:, None] - changes
    common = np.isfinite(behind).sum(axis=0)
    # Mean changes whose difference is below this many of its standard deviations count as the same.
    # So do those that differ by less than this share: the tip of the tool that presses goes about as deep as the dent.
    least = 2.0 * noise * np.sqrt(2 * common) + 0.25 * common * np.nanmax(mean[clear])
    equal = clear & (np.nansum(behind, axis=0) <= least) & (common > 0)
    equal &= share == share[equal].max()
    return int(np.argmax(np.where(equal, mean, -np.inf)))


Lift = Callable[[np.ndarray, PreparedFrame], np.ndarray]
"""From pixels of the full picture [P, 2] to points [P, 3] in a frame."""


def settle_run(run: ContactRun, size: tuple[int, int], lift: Lift, tracker: TissueTracker) -> None:
    """Move a young contact to the nearby tissue that has yielded most, and track that; a settled one stays.

    Depth noise shifts the closest pair of points by a pixel or two, and a point load makes a dent hardly wider.

    Args:
        run: its young frames are forgotten.
        size: (width, height) of the full picture [px].
        lift: points [P, 3] of full-picture pixels [P, 2] in a frame.
        tracker: takes the template of the contact's new place.
    """
    young, run.young = run.young, None
    if young is None:
        return
    shape, contact = run.onset.depth.shape, picture_pixel(run.onset, size)
    places = [(prepared, picture_to_grid(pixel, shape, size), float(drift[2])) for prepared, pixel, drift in young]
    # A pixel's mean change must exceed this many standard deviations.
    yielded = pressed_pixel(run.onset, places, 3.5)
    if yielded is None or yielded == run.onset.contact.pixel:
        return
    run.onset.geometry = move_contact(run.onset.contact, yielded)
    moved = picture_pixel(run.onset, size)
    run.onset.track_position = lift(moved[None], run.onset)[0]
    for prepared, pixel, drift in young:
        prepared.track_position = lift((pixel + moved - contact)[None], prepared)[0] - drift
    run.pixel = run.pixel + moved - contact
    run.template = tracker.template(run.onset.shown, moved)


def picture_pixel(prepared: PreparedFrame, size: tuple[int, int]) -> np.ndarray:
    """The contact's place in the full picture of `size` (width, height), (u, v) [px]."""
    return grid_to_picture(np.array(prepared.contact.pixel), prepared.depth.shape, size)
