"""Functions for scripts; `palpate infer`, `calibrate` and `plan` do the same for files and folders."""

from pathlib import Path
from typing import Any

from palpate.data.clip import ClipStream
from palpate.data.source.frames import open_source
from palpate.estimators.contract import ClipInfo, Estimator, Preparation
from palpate.estimators.open import open_estimator, preparation
from palpate.estimators.palpation.material_fit import MaterialFit, fit_material
from palpate.estimators.palpation.scene import read_scene
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.session import estimates_of
from palpate.planning.cost_table import open_tables
from palpate.planning.roadmap import EdgeCosts, Plan, find_plan
from palpate.planning.scene import SpaceScene, read_plan_scene
from palpate.planning.space_map import open_costs, plan_in_space


def open_clip(path: str | Path, estimator: Estimator | None = None, **choices: Any) -> ClipStream:
    """Open a video file or a folder of frames: iterate over it for prepared frames.

    Args:
        path: the clip.
        estimator: that the frames are for; None = the network that comes along.
        choices: fields of `palpate.estimators.contract.Preparation`: masks, depth, layout, camera, …

    Raises:
        ValueError: the clip or a choice can't be used; a sentence that names it.
    """
    settings = preparation(estimator or open_estimator(), Preparation(**choices))
    return ClipStream(open_source(Path(path), settings.layout), settings)


def estimate(
    clip: str | Path | ClipStream, estimator: str | Estimator | None = None, **choices: Any
) -> list[InteractionEstimate]:
    """Estimate every run of contact in a clip.

    Args:
        clip: a video file, a folder of frames, or a clip opened for this estimator.
        estimator: its name, or opened; None = the network that comes along.
        choices: as in `open_clip`, where the clip is a path.

    Returns:
        One a run, in order: `interaction` holds what was observed, `estimate` or `grip` what follows from it, `verdict`
        what that determines, and `detail` why nothing more does.

    Raises:
        ValueError: the clip, the estimator or a choice can't be used; a sentence that names it.
    """
    opened = open_estimator(estimator) if estimator is None or isinstance(estimator, str) else estimator
    if isinstance(clip, ClipStream):
        if choices:
            raise TypeError(f"the clip is open already; give {', '.join(choices)} to open_clip.")
    else:
        clip = open_clip(clip, opened, **choices)
    outputs = estimates_of(opened.start(ClipInfo.of(clip)), clip)
    return [item for item in outputs if isinstance(item, InteractionEstimate)]


def calibrate(scene: str | Path) -> MaterialFit:
    """Fit Young's modulus [Pa] and Poisson's ratio to surfaces under known forces (Frank 2010, section IV).

    Args:
        scene: YAML file as in `palpate calibrate palpation`.

    Raises:
        InputError: the scene can't be used.
        NoEquilibrium: the body can't bear the forces.
    """
    read = read_scene(Path(scene))
    return fit_material(read.skin, read.held, read.palpations)


def plan(scene: str | Path, cache: str | Path, alpha: float | None = None) -> Plan:
    """Find the cheapest path of an instrument's tip past tissue that gives way (Frank 2010, section VII).

    Args:
        scene: YAML file as in `palpate plan`.
        cache: folder of simulated presses and road maps, which is filled where it lacks any.
        alpha: 0 = the shortest path, 1 = the gentlest; None = as the scene has it.

    Raises:
        InputError: the scene can't be used.
        Blocked: there is no path.
    """
    read = read_plan_scene(Path(scene), alpha)
    if isinstance(read, SpaceScene):
        return plan_in_space(open_costs(read, Path(cache))[0])
    return find_plan(EdgeCosts(read, open_tables(read, Path(cache))))
