"""Files of a synthetic clip: frames in CholecSeg8k's layout, its description, its truth, and its video."""

import contextlib
import dataclasses
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from palpate.common.files import as_json
from palpate.data.masks.class_table import CLASSES
from palpate.data.source.video import Video
from palpate.data.synthetic.errors import reported_camera
from palpate.data.synthetic.grip import SUBSTEPS, GrippedMotion
from palpate.data.synthetic.integration import ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import PressedMotion, damping_ratio, regime_of
from palpate.physics.mechanics import PARAMETERS


def write_frame(folder: Path, number: int, image: np.ndarray, labels: np.ndarray, stored_depth: np.ndarray) -> None:
    """Write one frame's four PNG files.

    Raises:
        OSError: a file can't be written.
    """
    stem = folder / f"frame_{number}_endo"
    colors = np.zeros((256, 3), np.uint8)
    colors[[entry.grey for entry in CLASSES.values()]] = [entry.color for entry in CLASSES.values()]
    _write_png(stem, "", image[..., ::-1])
    _write_png(stem, "_color_mask", colors[labels][..., ::-1])
    # The real watershed masks have three equal channels.
    _write_png(stem, "_watershed_mask", np.repeat(labels[..., None], 3, axis=2))
    _write_png(stem, "_depth", stored_depth)


def write_truth(folder: Path, scene: Scene, motion: PressedMotion | GrippedMotion, seed: int) -> None:
    """Write clip.json (known to users) and truth.json and truth.npz (for no training).

    Arrays of truth.npz:
        trajectory [F, 3]: displacement of the vertex that the tool touches.
        in_contact, times [F]: contact, and time stamps [s], of the frames.
        mesh_vertices [N, 3], mesh_springs [S, 2], mesh_rim [N], mesh_pixels [N, 2]: organ (grip: tissue) at rest.
        moving [M], field [F, M, 3] (float16): vertices that move, and their displacement.
        tip [F, 3]: point of the tool that touches, in a filled view.
        response [R, 3]: displacement of a press's contact vertex every 5 ms after the force's start (onset_s +
            force_delay_s).
        force [F]: signed force of a press just after each frame's time.
        touched [F]: mesh vertex that a press touches.
        log_stiffness [h, w]: log stiffness of gripped tissue at every grid pixel, relative to its mean.
        reaction [F, 2]: force of a grip over k_s along the picture's axes.
        course [F, 2]: offset of an island's gripping tool from the contact vertex, columns and rows [grid px].
    """
    settings, mesh = scene.settings, scene.mesh
    camera = dataclasses.asdict(reported_camera(scene.camera, settings))
    clip = {"fps": settings.fps, "camera": camera, "depth_scale": 1.0, "times": motion.times.tolist()}
    arrays: dict[str, Any] = {"trajectory": motion.contact, "in_contact": motion.in_contact, "times": motion.times}
    arrays |= {f"mesh_{name}": getattr(mesh, name) for name in ("vertices", "springs", "rim", "pixels")}
    arrays |= {"moving": motion.moving.astype(np.int32), "field": motion.field.astype(np.float16)}
    tool = {} if motion.passage is None else vars(motion.passage)
    arrays |= {name: value for name, value in tool.items() if name == "tip"}
    pressed = isinstance(motion, PressedMotion)
    own = ("response", "force", "touched") if pressed else ("log_stiffness", "reaction", "course")
    np.savez(folder / "truth.npz", **arrays, **{name: getattr(motion, name) for name in own})
    truth = {
        "seed": seed,
        "action": settings.action,
        "contact": motion.in_contact.tolist(),
        "onset_frame": motion.onset_frame,
        "release_frame": motion.release_frame,
        **_own_entries(scene, motion),
        "contact_vertex": scene.vertex,
        "contact_pixel": dict(zip(("row", "column"), mesh.pixels[scene.vertex].tolist(), strict=True)),
        "direction": scene.direction.tolist(),
        "tool": {name: np.asarray(value).tolist() for name, value in tool.items() if name != "tip"},
        "camera": dataclasses.asdict(scene.camera),
        "units": "scene units (stored depth over its type's largest value), s; stiffness, damping and force "
        "normalised, not N",
        "settings": dataclasses.asdict(settings),
    }
    for name, content in (("truth.json", truth), ("clip.json", clip)):
        (folder / name).write_text(as_json(content, indent=1) + "\n", encoding="utf-8")


def _own_entries(scene: Scene, motion: PressedMotion | GrippedMotion) -> dict[str, Any]:
    """Entries of truth.json that one kind of motion alone has."""
    if isinstance(motion, GrippedMotion):
        ratios = {"foundation_over_stiffness": motion.anchor, "damping_over_stiffness": motion.damping}
        return ratios | {"integrator": f"BDF2, {SUBSTEPS} steps a frame"}
    zeta = damping_ratio(motion.theta[0], motion.theta[1], scene.settings.mass)
    return {
        "theta": dict(zip(PARAMETERS, motion.theta.tolist(), strict=True)),
        "zeta": zeta,
        "regime": regime_of(zeta),
        "onset_s": float(motion.times[motion.onset_frame]),
        "release_s": float(motion.times[motion.release_frame]),
        "force_delay_s": motion.delay,
        "release_delay_s": motion.release_delay,
        "force_profile": scene.settings.profile,
        "force_shape": dataclasses.asdict(motion.shape),
        "peak_displacement": motion.peak,
        "integrator": f"DOP853 (scipy), relative tolerance {RELATIVE_TOLERANCE:g}, absolute {ABSOLUTE_TOLERANCE:g}",
    }


@contextlib.contextmanager
def open_video(path: Path, settings: SceneSettings) -> Generator[Callable[[np.ndarray], object]]:
    """Open an .mp4 of even size; yields a function that takes RGB frames [H, W, 3].

    Raises:
        OSError: the file can't be written.
    """
    width, height = settings.width // 2 * 2, settings.height // 2 * 2
    with contextlib.closing(Video(path, (width, height), settings.fps, settings.video_quality)) as opened:
        yield lambda image: opened.write(np.ascontiguousarray(image[:height, :width]))


def _write_png(stem: Path, suffix: str, pixels: np.ndarray) -> None:
    # imencode and write_bytes: OpenCV's own writer can't say why it failed. Its defaults take a third of the time of
    # the lowest compression level, with which it chooses other filters.
    done, encoded = cv2.imencode(".png", pixels)
    if not done:
        raise OSError(f"{stem}{suffix}.png can't be encoded as a PNG.")
    stem.with_name(f"{stem.name}{suffix}.png").write_bytes(encoded.tobytes())
