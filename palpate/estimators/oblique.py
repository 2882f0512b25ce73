"""Contacts pressed aslant to the line of sight: a dent may hide its own bottom, and its depth then looks too small.

A point load's dent is about one grid cell (0.0027 scene units) wide and 0.01 to 0.06 deep. Seen from the side, its near
wall covers its bottom. The tracked contact is then off by far more than the depth's noise. The motion alone doesn't
always reveal that: softer, less deeply pressed tissue may explain it as well. `python -m benchmarks.recovery --suite
oblique` shows the effect on estimates.
"""

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.estimate import PressResult
from palpate.physics.identifiability import box_information

LARGEST_ANGLE = 5.0
"""Angle to the line of sight beyond which a press is oblique [degrees]: there the bottom of a dent of 0.03 is a grid
cell off. A smaller one warns of contacts whose normal is only off by the rounding of 8-bit depth."""
HIDDEN_ERROR = 0.015
"""Root mean square error of contacts pressed at 4 to 28 degrees to the line of sight, by suite `oblique` of
`benchmarks.recovery` [scene units]."""
OBLIQUE = "Tissue is pressed at {:.0f}° to the line of sight, so its dent may hide its bottom; intervals are inflated."


def view_angle(contact: Interaction) -> float:
    """Return the angle between a contact's direction, either way, and the camera's ray through it [degrees]."""
    ray, direction = (np.asarray(v, np.float64) for v in (contact.mesh.vertices[contact.vertex], contact.direction))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(ray, direction)), np.abs(ray @ direction))))


def hides_bottom(rest: np.ndarray, moved: np.ndarray, direction: np.ndarray, angle: float) -> bool:
    """Return whether walls of a dent hide its bottom from a camera that looks aslant: they must be steep for that.

    Args:
        rest: vertices at rest, shape [V, 3] [scene units].
        moved: their displacements, shape [N, V, 3] [scene units].
        direction: along which they are pressed, shape [3].
        angle: between that and the line of sight [degrees].
    """
    sunk = np.abs(moved @ direction)
    frame, bottom = np.unravel_index(int(sunk.argmax()), sunk.shape)
    aside = rest - rest[bottom]
    aside = np.linalg.norm(aside - np.outer(aside @ direction, direction), axis=1)
    wall = sunk[frame, bottom] - sunk[frame]
    return bool((wall * np.tan(np.radians(angle)) > aside).any())


def is_oblique(estimate: PressResult) -> bool:
    """Return whether the contact is pressed so far from the line of sight that its dent may hide its own bottom."""
    angle = estimate.course.view_angle
    return angle is not None and angle > LARGEST_ANGLE


def effective_misfit(estimate: PressResult) -> float:
    """Return the estimate's misfit, or that of the expected hidden error of an oblique contact where it is larger."""
    return max(estimate.misfit, HIDDEN_ERROR / estimate.noise) if is_oblique(estimate) else estimate.misfit


def remark(estimate: PressResult) -> str:
    """Return a sentence on an oblique contact, empty for any other."""
    return OBLIQUE.format(estimate.course.view_angle) if is_oblique(estimate) else ""


def widened(estimate: PressResult, misfit: float, box: np.ndarray) -> PressResult:
    """Add the covariance of a noise `misfit` times as large, within the box, to the estimate and its verdict.

    Args:
        misfit: in units of the estimate's noise.
        box: lower and upper φ, shape [2, 3].
    """
    return estimate.widened(np.linalg.inv(estimate.information / misfit**2 + box_information(box)))  # ty: ignore[unsupported-operator]  a contact that was observed
