"""What a fit's own model gets wrong, besides what residuals tell: standard deviations measured on drawn clips.

They are read from `model_errors.yaml`, which `python -m evaluation.model_errors` writes. Every entry there has its
`value`, its `source` (which clips, by what) and, as far as that command has measured it, what it found (`measured`).
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import yaml

FILE = Path(__file__).with_suffix(".yaml")


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations, of natural logarithms where nothing else is said, and the thresholds that go with them."""

    foundation_measured: float
    """Of the foundation by points that are measured again where a sheet says that they are."""
    foundation_followed: float
    """The same by points as they are followed."""
    foundation_uneven: float
    """Of the foundation where what is left of the motion goes together over many points: tissue is no such sheet."""
    force_uneven: float
    """Of the force over stiffness, there."""
    foundation_as_seen: float
    """Of the foundation where the grip's motion is taken from points next to the instrument, which err together."""
    force_as_seen: float
    """Of the force over stiffness, there."""
    force_common: float
    """No standard deviation, but the correlation between errors of the force in two frames: where it acts beneath the
    instrument is as unknown in one as in the other."""
    pull_force: float
    """Of force over E by a slab: mesh, law, the grip's shape, tissue that relaxes or is not homogeneous."""
    pull_course: float
    """Of the force over that of the last frame, by a slab, as a share of it."""
    slab_motion: float
    """Of a pressed slab's motion, as a share of it: mesh, law and tip are not the tissue's."""
    slab_young: float
    """Of E of a pressed slab, d/E and F/E known, by what law and tip get wrong."""
    slab_damping: float
    """Of its d/E."""
    slab_force: float
    """Of its F/E."""
    firm_young: float
    """Of its E where a firm region lies beneath, which is not one of those that are tried."""
    firm_damping: float
    """Of its d/E, there."""
    firm_force: float
    """Of its F/E, there."""
    brightness_damping: float
    """Of k_d/k_s by brightness: law, mesh, and what a video's coding leaves out, the same in all pixels."""
    brightness_force: float
    """Of its F/k_s."""
    brightness_scale: float
    """Common to k_s, k_d and F by it, which inertia alone tells."""
    brightness_damping_slope: float
    """No standard deviation, but by how much log k_d/k_s by brightness comes out too large for every unit of log ζ,
    where a press leaves `USUALLY_LEFT` of the light's change: by what coding leaves out slow tissue seems slower."""
    brightness_force_slope: float
    """The same of log F/k_s."""
    hidden_force: float
    """Of the force on the foundation of tissue that isn't visible, where the grip's motion is taken as it was seen; a
    share of it."""
    strained_motion: float
    """Of followed points' motion, where stiffness is looked for place by place, as a share of it: windows are strained
    with the tissue."""
    patch_aside: float
    """By how much what pixels of a dent show lies aside, by axis, where a pixel is the mean of several [grid px]."""
    patch_depth: float
    """Of the depth of a dent, there, as a share of it."""
    dent_wall: float
    """Of a pixel at a dent's wall, as a share of how much its neighbours differ from it: so much of a grid pixel may
    show another patch than it seems."""
    palpated_motion: float
    """Of a palpated body's simulated displacement, as a share of it: mesh and law are not the body's."""
    sheet_excess: float
    """The largest that points may err besides their noise, by axis, on tissue that is a homogeneous sheet [px]."""
    sheet_together: float
    """No standard deviation: over so many times as many points as following errs together what is left of the motion
    may go together, there."""
    followed_reach: float
    """No standard deviation, but the reach of the correlation between neighbouring points' errors, Matérn's of 3/2
    [px]."""
    measured_reach: float
    """The same of points that are measured again, in wide windows."""
    stiffness_roughness: float
    """Of the difference of log stiffness between neighbouring knots, before anything is observed."""
    stiffness_together: float
    """No standard deviation: so many followed points err together where stiffness is looked for place by place."""
    stiffness_unexplained: float
    """No standard deviation: so many times as many, where a sheet leaves more than `sheet_excess`."""
    contact_rest: float
    """Of a tracked contact's position at rest [σ]."""
    contact_tracking: float
    """Of the independent error that following it and taking off the camera's motion add to its depth's [σ]."""
    step_blur: float
    """Of what blurs the ends of a step to which its depth is rounded [σ]."""
    step_astray: float
    """No standard deviation, but the share of depths that lie outside of their step for other reasons."""
    step_wander: float
    """Of these depths [σ]."""
    step_reach: float
    """No standard deviation: depths farther apart are taken to correlate less than rounding in theory does [steps]."""
    step_independent: float
    """No standard deviation, but the share of the rounding errors' variance that is taken to be independent."""
    step_log_odds: float
    """No standard deviation, but the log odds of rounded to noisy depth before a motion is observed."""
    noise_freedom: float
    """No standard deviation, but the degrees of freedom with which σ is taken to be known."""
    firm_usual: float
    """No standard deviation, but E of a firm region over that around, by which places of it are compared."""
    firm_usual_sd: float
    """Of the logarithm of that over its mean."""
    field_misfit: float
    """The largest that the likeliest fields of stiffness may leave of the motion over what the fitted ones leave, root
    mean squares, on tissue as `online` simulates it."""


def read_entries(path: Path = FILE) -> dict[str, dict[str, Any]]:
    """Entries of the file, by name.

    Raises:
        ValueError: it doesn't have exactly those that `ModelErrors` names.
    """
    entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    names = [field.name for field in fields(ModelErrors)]
    if not isinstance(entries, dict) or list(entries) != names:
        raise ValueError(f"{path} holds other entries than {', '.join(names)}; write it with evaluation.model_errors.")
    return entries


MODEL_ERRORS = ModelErrors(**{name: float(entry["value"]) for name, entry in read_entries().items()})
