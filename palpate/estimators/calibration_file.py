"""The force scale of `palpate infer --force-scale`: what is known in newtons.

A YAML file (fields of `CalibrationFile`), a table of forces (columns time_s, force_N) for every clip, or the topic of
forces in every bag.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.common.settings import Checked, NotNegative, Positive
from palpate.data.source.bags import read_wrenches
from palpate.data.source.images import printable
from palpate.data.source.layout import from_mapping, read_mapping
from palpate.estimators import force_scale
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.known_force import LEAST_KNOWN, KnownForce, read_forces
from palpate.estimators.palpated import palpated_young


@dataclass(frozen=True)
class CalibrationFile(Checked):
    """Fields of the file.

    Raises:
        ValueError: fields that don't belong together, or numbers that can't be.
    """

    force_N: Positive | None = None
    """A known force, its magnitude [N]."""
    force_sd_N: NotNegative = 0.0
    """Standard deviation of the force [N]."""
    force_time_s: float | None = None
    """Time at which the force acted, in the run of contact under way then [s, clip time]."""
    stiffness: Positive | None = None
    """Stiffness k_s of the tissue's sheet of springs, at all contacts [N/m]."""
    stiffness_sd: NotNegative = 0.0
    """Standard deviation of the stiffness [N/m]."""
    palpation: str | None = None
    """calibration.json of `palpate calibrate`, next to this file: E, of which k_s is three quarters, times
    `thickness_m`."""
    thickness_m: Positive | None = None
    """Thickness of the sheet that the tissue's surface is [m]."""
    thickness_sd_m: NotNegative = 0.0
    """Standard deviation of the thickness [m]."""

    def __post_init__(self) -> None:
        known = ("force_N", "stiffness", "palpation")
        given = [name for name in known if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} each tell newtons; give one.")
        if not given:
            raise ValueError(f"nothing is known; give one of {', '.join(known)}.")
        if (self.force_N is None) != (self.force_time_s is None):
            raise ValueError("force_N and force_time_s belong together; give both.")
        if (self.palpation is None) != (self.thickness_m is None):
            raise ValueError("palpation and thickness_m belong together; give both.")
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class Calibration:
    """Force or stiffness that is known in newtons, as read from its file."""

    fields: CalibrationFile | None
    """Fields of the file; None = forces were measured in every clip."""
    path: Path
    files: tuple[Path, ...]
    """The calibration's file, and files that it names."""
    measured: KnownForce | None = None
    """Measured forces; None before `of_clip` where bags hold them."""
    young: tuple[float, float] | None = None
    """Young's modulus of the palpations [Pa], and the standard deviation of its logarithm."""

    @property
    def of_one_clip(self) -> bool:
        """True if the scale follows from a force that acted in one clip."""
        return self.fields is not None and self.fields.force_N is not None

    def of_clip(self, clip: Path, pictures: str | None) -> "Calibration":
        """Return the calibration with the forces that the clip, a bag, holds; unchanged without a topic.

        Args:
            clip: path of the clip.
            pictures: topic of the clip's pictures; None = the only one.

        Raises:
            InputError: the clip is no bag with that topic, or its forces can't be read.
        """
        if self.fields is not None or self.measured is not None:
            return self
        return replace(self, measured=KnownForce(*read_wrenches(clip, str(self.path), pictures)))

    def scale(self, runs: Sequence[force_scale.PressedRun], length: force_scale.ClipLength) -> force_scale.ForceScale:
        """Return the scale of a clip from its own runs, or from the tissue's stiffness.

        Raises:
            NoEstimate: why there is none.
        """
        if self.measured is not None:
            forces = force_scale.measured_presses(runs, self.measured)
            if not forces:
                raise NoEstimate(f"No results in newtons: no estimated run of contact has {LEAST_KNOWN} known forces.")
            frames = ", ".join(str(frame) for frame, *_ in forces)
            return force_scale.scale_by_force(runs, forces, f"forces measured at frame {frames}")
        given = self.fields
        assert given is not None
        if given.force_N is not None and given.force_time_s is not None:
            at = np.array([given.force_time_s])
            here = [run for run in runs if run.pressing(at)[0]]
            if not here:
                problem = f"no press was estimated at {given.force_time_s:g} s, when the force is known"
                raise NoEstimate(f"No results in newtons: {problem}.")
            frame, log_sd = here[0].onset_frame, given.force_sd_N / given.force_N
            source = f"known force of {given.force_N:g} N at frame {frame}"
            return force_scale.scale_by_force(runs, [(frame, given.force_N, log_sd)], source)
        if given.stiffness is not None:
            source = f"known stiffness of {given.stiffness:g} N/m"
            log_sd = given.stiffness_sd / given.stiffness
            return force_scale.scale_by_stiffness(given.stiffness, log_sd, length, source)
        assert self.young is not None
        assert given.thickness_m is not None
        young, young_sd = self.young
        log_sd = float(np.hypot(young_sd, given.thickness_sd_m / given.thickness_m))
        source = f"palpation, E = {young:.4g} Pa, in a sheet of {1000 * given.thickness_m:g} mm"
        stiffness = force_scale.SHEET_FACTOR * young * given.thickness_m
        return force_scale.scale_by_stiffness(stiffness, log_sd, length, source)


def read_calibration(path: Path) -> Calibration:
    """Read what is known in newtons.

    Args:
        path: a YAML or JSON file, a table of forces (.csv), or the topic of forces in bags.

    Raises:
        InputError: a file can't be read, or its values contradict each other.
    """
    is_topic = path.is_absolute() and not path.suffix and not path.exists()  # no topic has a point in its name
    if is_topic or path.suffix.lower() == ".csv":
        return Calibration(None, path, ()) if is_topic else Calibration(None, path, (path,), read_forces(path))
    given = from_mapping(CalibrationFile, read_mapping(path, "a calibration"), printable(path))
    if given.palpation is None:
        return Calibration(given, path, (path,))
    palpation = path.parent / given.palpation
    return Calibration(given, path, (path, palpation), young=palpated_young(palpation))
