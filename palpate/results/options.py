"""Options of `palpate infer` besides those of preparation and of the estimator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

from palpate.common.options import flag_of, option
from palpate.common.settings import Positive
from palpate.data.depth.normalise import MOST_THREADS
from palpate.estimators.contract import Estimator, Preparation
from palpate.estimators.open import ESTIMATORS

FRAME_FORCE = ("force_seconds", "the force of every frame")
"""Needs of options about the force of frames."""


@dataclass(frozen=True)
class Inference:
    """Clips and results."""

    inputs: tuple[Path, ...] = option(positional=True, metavar="INPUT")
    """video files, bags of ROS 1 or 2, frame folders, or folders of those; with --estimator online a robot's
    sequence.yaml too"""
    output: Path = option(metavar="DIR")
    """folder of the results, one folder a clip"""
    estimator: str | None = option(None, choices=lambda: [*ESTIMATORS.entries])
    """estimator (default: what --model is for, else network)"""
    jobs: Annotated[int, 1, MOST_THREADS] = option(1, metavar="N")
    """clips at once, each in a process of its own with its share of the threads"""
    overwrite: bool = False
    """compute all clips again and replace earlier results"""
    overlay: bool = True
    """write the overlay video"""
    export: bool = option(False, needs=("tells_intervals", "intervals"))
    """write how the tissue of every determined contact deforms, as .vtu files with a .pvd index for ParaView, and its
    mesh as .ply (docs/results.md)"""


@dataclass(frozen=True)
class Forces:
    """Physical units."""

    force_scale: Path | None = option(None, metavar="FILE|TOPIC", needs=("tells_theta", "a force"))
    """source of newtons: a table of forces (.csv, columns time_s, force_N), the topic of forces in bags
    (geometry_msgs/WrenchStamped), or a YAML file (docs/forces.md). Gives k_s, k_d and F in physical units
    (calibrated.csv), and the force of contacts over time (forces.json)"""
    shaft_diameter: Annotated[float, 1, 30] | None = option(None, metavar="MM")
    """diameter of an instrument's shaft in view, such as 5 or 8: gives a scene unit's length where depth has no metres.
    forces.json then has F/k_s in mm, and with --force-scale calibrated.csv has N/m; all else stays in scene units
    (docs/metric.md)"""
    force_limit: Positive | None = option(None, metavar="X", needs=FRAME_FORCE)
    """limit of the force in the unit of the column force, in newtons with --force-scale. Every frame states whether the
    force is above it, by its interval (docs/forces.md). Research software, not a medical device"""
    alarm_at: Annotated[float, 0.5, 0.999] | None = option(None, metavar="P", needs=FRAME_FORCE)
    """probability that the force is above --force-limit from which on there is an alarm, which ends below 0.5 (default:
    0.9); a lower one misses less and warns more often for nothing (docs/forces.md)"""


@dataclass(frozen=True)
class Extras:
    """Several machines, bags, and errors."""

    scheduler: str | None = option(None, metavar="ADDRESS")
    """clips by the workers of a Dask scheduler, such as tcp://host:8786, each of one thread and with the same files at
    the same paths (palpate[distributed])"""
    bag: Literal["ros1", "ros2"] | None = option(None, needs=("tells_theta", "a force"))
    """write forces with their 90 % intervals and verdicts as a bag of ROS: ros1 (forces.bag) or ros2 (forces.mcap;
    docs/results.md; palpate[robot])"""
    debug: bool = False
    """stop at the first failure with its traceback"""


KINDS = (Inference, Preparation, Forces, Extras)
"""Groups of options, in the order of the help."""


def in_options(text: str) -> str:
    """Return a sentence of another module that calls settings by the options that they are here."""
    for name, field in Preparation.__dataclass_fields__.items():
        if "setting" in field.metadata:
            text = text.replace(field.metadata["setting"], flag_of(name))
    return text


def require_able(estimator: Estimator, values: Mapping[str, Any], kinds: Sequence[type[Any]] = KINDS) -> None:
    """Raise a ValueError where an option is given that needs what an estimator can't do, or a package.

    Args:
        estimator: opened.
        values: of options, by name.
        kinds: dataclasses of these options.
    """
    if values.get("alarm_at") is not None and values.get("force_limit") is None:
        raise ValueError("--alarm-at has no effect without --force-limit; give a limit, too.")
    for kind in kinds:
        for name, field in kind.__dataclass_fields__.items():
            needs, given = field.metadata.get("needs"), values.get(name) not in (None, False)
            if given and needs and not getattr(estimator, needs[0]):
                lacks = f"which --estimator {estimator.name} does not give"
                raise ValueError(f"{flag_of(name)} needs {needs[1]}, {lacks}; choose another, or leave it out.")
    if values.get("bag") is not None and find_spec("rosbags") is None:
        raise ValueError("--bag needs rosbags; install 'palpate[robot]', or leave it out.")
