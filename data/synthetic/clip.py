"""Synthetic clips with known truth: drawn, observed with their errors, and written in CholecSeg8k's folder layout."""

import json
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from palpate.common.files import as_json, read_file
from palpate.common.output import list_folder, require_own_folder
from palpate.data.source.camera import Camera
from palpate.data.synthetic.errors import depth_bias, observe_depth, observe_labels, reported_camera, stored_to_depth
from palpate.data.synthetic.files import open_video, write_frame, write_truth
from palpate.data.synthetic.grip import GrippedMotion, draw_grip
from palpate.data.synthetic.passage import draw_passage
from palpate.data.synthetic.render import Renderer
from palpate.data.synthetic.scene import Scene, draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import PressedMotion, TrueMotion, draw_motion
from palpate.data.synthetic.turning import CameraTurning


@dataclass(frozen=True)
class SyntheticClip:
    """A clip in memory."""

    scene: Scene
    """True geometry: sheet, mesh, contact vertex, direction, true cameras."""
    motion: TrueMotion
    """True parameters of the tissue, what the tool does, and trajectories."""
    camera: Camera
    """Camera that the clip claims, with its focal-length error."""
    seed: int
    """Seed from which the clip was drawn."""
    images: np.ndarray
    """RGB, shape [F, H, W, 3], uint8."""
    labels: np.ndarray
    """Grey class codes of `data.masks.class_table`, shape [F, H, W], uint8."""
    depth: np.ndarray
    """Observed z, shape [F, H, W], float32 [scene units], 0 = invalid."""


Truth = PressedMotion | GrippedMotion
"""True motion of a clip."""


def draw_truth(settings: SceneSettings, seed: int) -> tuple[Scene, Truth]:
    """Scene and true motion of a clip, without its pictures.

    Geometry, motion, looks and errors of observation have a random stream each, so that changing the errors leaves the
    truth as it is.

    Raises:
        SceneError: the settings leave nothing to draw.
    """
    scene, generator = draw_scene(settings, np.random.default_rng([seed, 0])), np.random.default_rng([seed, 1])
    draw = draw_motion if settings.action in ("press", "slide") else draw_grip
    motion = draw(scene, generator)
    if settings.view == "filled":
        motion = replace(motion, passage=draw_passage(scene, motion, np.random.default_rng([seed, 7])))
    return scene, motion


def observe(scene: Scene, motion: TrueMotion, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Frames of a clip in order as a user's files would show them, with their errors of observation.

    Yields:
        RGB picture, shape [H, W, 3], uint8; grey class codes of `data.masks.class_table`, shape [H, W], uint8; z times
        its type's largest value, uint8 or uint16, 0 = invalid.
    """
    settings = scene.settings
    renderer = Renderer(scene, motion, np.random.default_rng([seed, 2]))
    turning = CameraTurning(scene, np.random.default_rng([seed, 6])) if settings.turning_deg else None
    depth_errors, mask_errors = np.random.default_rng([seed, 3]), np.random.default_rng([seed, 4])
    bias = depth_bias(settings, np.random.default_rng([seed, 5]))
    for index in range(settings.frames):
        image, labels, depth = renderer.frame(index)
        if turning is not None:
            image, labels, depth = turning.turned(index, image, labels, depth)
        depth = depth * bias
        yield image, observe_labels(labels, settings, mask_errors), observe_depth(depth, settings, depth_errors)


def synthetic_clip(scene: Scene, motion: TrueMotion, seed: int) -> SyntheticClip:
    """A clip in memory of a truth that was drawn already, observed as the scene's settings state."""
    images, labels, stored = map(np.stack, zip(*observe(scene, motion, seed), strict=True))
    camera = reported_camera(scene.camera, scene.settings)
    return SyntheticClip(scene, motion, camera, seed, images, labels, stored_to_depth(stored))


def clip_seed(seed: int, index: int) -> int:
    """Seed of one clip of a set, so that clips of one seed share nothing and clip i doesn't depend on their number."""
    return int(np.random.SeedSequence((seed, index)).generate_state(1)[0])


def write_clip(
    output: Path,
    number: int,
    settings: SceneSettings,
    seed: int,
    *,
    overwrite: bool = False,
    advance: Callable[[int], None] = lambda frames: None,
) -> Path:
    """Write a clip as output/videoNN and return its frame folder.

    The folder appears when it is complete. A clip that is there already with the same settings and seed is kept.

    Args:
        advance: is called with the number of frames that were written since the last call.

    Raises:
        FileExistsError: the folder is there and holds a file that this program did not write, or it was made otherwise
            and `overwrite` is off.
        OSError: the folder can't be written.
        SceneError: the settings leave nothing to draw.
    """
    name = f"video{number:02d}"
    target, folder = output / name, f"{name}_00000"
    if not overwrite and _same_clip(target / folder / "truth.json", settings, seed):
        advance(settings.frames)
        return target / folder
    require_own_folder(target)
    if target.exists() and not overwrite:
        raise FileExistsError(f"{target} was made with other settings; give another --output or --overwrite.")
    scene, motion = draw_truth(settings, seed)
    output.mkdir(parents=True, exist_ok=True)
    # The leading dot keeps readers away.
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=output, ignore_cleanup_errors=True) as temporary:
        partial = Path(temporary, name)
        (partial / folder).mkdir(parents=True)
        with open_video(partial / f"{folder}.mp4", settings) as add_to_video:
            for index, frame in enumerate(observe(scene, motion, seed)):
                write_frame(partial / folder, index, *frame)
                add_to_video(frame[0])
                advance(1)
        write_truth(partial / folder, scene, motion, seed)
        list_folder(partial)
        require_own_folder(target)  # drawing takes long
        if target.exists():
            os.replace(target, Path(temporary, "earlier"))
        os.replace(partial, target)
    return target / folder


def _same_clip(truth: Path, settings: SceneSettings, seed: int) -> bool:
    """Return whether a truth file records these settings and this seed."""
    try:
        recorded = json.loads(read_file(truth))
    except (OSError, ValueError, RecursionError):
        return False
    wanted = json.loads(as_json(asdict(settings)))
    return isinstance(recorded, dict) and recorded.get("seed") == seed and recorded.get("settings") == wanted
