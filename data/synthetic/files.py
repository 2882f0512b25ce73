"""Files of a synthetic clip: frames in CholecSeg8k's layout, its description, its truth, and its video."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Generator
from pathlib import Path

import cv2
import numpy as np

from palpate.common.files import as_json
from palpate.data.masks.class_table import CLASSES
from palpate.data.source import video
from palpate.data.synthetic.errors import reported_camera
from palpate.data.synthetic.grip import SUBSTEPS, GrippedMotion
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.slab import LAW, PressedSlab, SlabMotion
from palpate.data.synthetic.slab import SUBSTEPS as SLAB_SUBSTEPS
from palpate.data.synthetic.truth import (
    ABSOLUTE_TOLERANCE,
    RELATIVE_TOLERANCE,
    PressedMotion,
    TrueMotion,
    damping_ratio,
    regime_of,
)
from palpate.physics.mechanics import PARAMETERS

UNITS = {
    "length": "scene units (stored depth divided by its type's largest value)",
    "time": "s",
    "stiffness": "normalised, per scene unit; not N/m",
    "damping": "normalised",
    "force": "normalised, signed; negative presses into the tissue",
}
ARRAYS = {
    "trajectory": "displacement of the contact vertex at the frames' times [F, 3]",
    "in_contact": "whether tool and tissue touch in each frame [F]",
    "times": "time stamps [F]",
    "mesh_*": "organ at rest, of a grip all tissue: vertices [N, 3], springs [S, 2], rim [N], pixels [N, 2]",
    "moving, field": "vertices that move [M] and their displacement at the frames' times [F, M, 3], float16",
}
PRESS_ARRAYS = {
    "response": "the same every 5 ms from the force's start (onset_s + force_delay_s), the first 5 ms after it [R, 3]",
    "force": "signed force just after each frame's time [F]",
}
GRIP_ARRAYS = {
    "log_stiffness": "relative to the mean at every grid pixel [h, w]",
    "reaction": "what holds the tissue over k_s at the frames' times, along the picture's axes [F, 2] [scene units]",
    "course": "the tool's tip from the contact vertex in the picture, columns and rows [F, 2] [grid px]",
}
SLAB_FORCE = {"force": "signed force at each frame's time, just after it [F]"}
SLAB_REACTION = {
    "reaction": "what holds the tissue at the frames' times, along the picture's axes [F, 2]",
    "course": GRIP_ARRAYS["course"],
}
INTEGRATOR = f"DOP853 (scipy), relative tolerance {RELATIVE_TOLERANCE:g}, absolute {ABSOLUTE_TOLERANCE:g}"
GRIP_INTEGRATOR = f"BDF2, {SUBSTEPS} steps a frame"
SLAB_INTEGRATOR = f"finite elements ({LAW}), trapezoidal rule, {SLAB_SUBSTEPS} steps a frame"
FASTEST_COMPRESSION = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def write_frame(folder: Path, number: int, image: np.ndarray, labels: np.ndarray, stored_depth: np.ndarray) -> None:
    """Write one frame's four PNG files.

    Raises:
        OSError: a file can't be written.
    """
    stem = folder / f"frame_{number}_endo"
    _write_png(stem, "", image[..., ::-1])
    _write_png(stem, "_color_mask", _color_table()[labels][..., ::-1])
    # The real watershed masks have three equal channels.
    _write_png(stem, "_watershed_mask", np.repeat(labels[..., None], 3, axis=2))
    _write_png(stem, "_depth", stored_depth)


def write_truth(folder: Path, scene: Scene, motion: PressedMotion | GrippedMotion | SlabMotion, seed: int) -> None:
    """Write clip.json (what a user may know) and truth.json and truth.npz (what no training may read)."""
    settings, mesh = scene.settings, scene.mesh
    clip = {
        "fps": settings.fps,
        "camera": dataclasses.asdict(reported_camera(scene.camera, settings)),
        "depth_scale": 1.0,
        "times": motion.times.tolist(),
    }
    own, names = _own_entries(scene, motion)
    np.savez(
        folder / "truth.npz",
        trajectory=motion.contact,
        in_contact=motion.in_contact,
        times=motion.times,
        mesh_vertices=mesh.vertices,
        mesh_springs=mesh.springs,
        mesh_rim=mesh.rim,
        mesh_pixels=mesh.pixels,
        moving=motion.moving.astype(np.int32),
        field=motion.field.astype(np.float16),
        **{name: getattr(motion, name) for name in names},
    )
    truth = _truth_entries(scene, motion, seed, own, names)
    for name, content in (("truth.json", truth), ("clip.json", clip)):
        (folder / name).write_text(as_json(content, indent=1) + "\n", encoding="utf-8")


def _own_entries(scene: Scene, motion: PressedMotion | GrippedMotion | SlabMotion) -> tuple[dict, dict[str, str]]:
    """Entries of truth.json that one kind of motion alone has, and descriptions of its own arrays."""
    if isinstance(motion, PressedMotion):
        return _press_entries(scene, motion), PRESS_ARRAYS
    if isinstance(motion, GrippedMotion):
        return _grip_entries(motion), GRIP_ARRAYS
    known = {"slab": dataclasses.asdict(motion.tissue), "peak_displacement": motion.peak, "integrator": SLAB_INTEGRATOR}
    return known, SLAB_FORCE if isinstance(motion, PressedSlab) else SLAB_REACTION


def _truth_entries(scene: Scene, motion: TrueMotion, seed: int, own: dict, arrays: dict[str, str]) -> dict:
    """Content of truth.json."""
    return {
        "seed": seed,
        "action": scene.settings.action,
        "contact": motion.in_contact.tolist(),
        "onset_frame": motion.onset_frame,
        "release_frame": motion.release_frame,
        **own,
        "contact_vertex": scene.vertex,
        "contact_pixel": dict(zip(("row", "column"), scene.mesh.pixels[scene.vertex].tolist(), strict=True)),
        "direction": scene.direction.tolist(),
        "camera": dataclasses.asdict(scene.camera),
        "units": UNITS,
        "arrays": ARRAYS | arrays,
        "settings": dataclasses.asdict(scene.settings),
    }


def _press_entries(scene: Scene, motion: PressedMotion) -> dict:
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
        "integrator": INTEGRATOR,
    }


def _grip_entries(motion: GrippedMotion) -> dict:
    return {
        "foundation_over_stiffness": motion.anchor,
        "damping_over_stiffness": motion.damping,
        "integrator": GRIP_INTEGRATOR,
    }


@contextlib.contextmanager
def open_video(path: Path, settings: SceneSettings) -> Generator[Callable[[np.ndarray], object]]:
    """Open an .mp4 of even size; yields a function that takes RGB frames [H, W, 3].

    Raises:
        OSError: the file can't be written.
    """
    width, height = settings.width // 2 * 2, settings.height // 2 * 2
    with contextlib.closing(video.open_video(path, (width, height), settings.fps, settings.video_quality)) as opened:
        yield lambda image: opened.write(np.ascontiguousarray(image[:height, :width]))


def _write_png(stem: Path, suffix: str, pixels: np.ndarray) -> None:
    # imencode and write_bytes: OpenCV's own writer can't say why it failed.
    done, encoded = cv2.imencode(".png", pixels, FASTEST_COMPRESSION)
    if not done:
        raise OSError(f"{stem}{suffix}.png can't be encoded as a PNG.")
    stem.with_name(f"{stem.name}{suffix}.png").write_bytes(encoded.tobytes())


def _color_table() -> np.ndarray:
    table = np.zeros((256, 3), np.uint8)
    for entry in CLASSES.values():
        table[entry.grey] = entry.color
    return table
