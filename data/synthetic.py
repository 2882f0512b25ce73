"""Synthetic clips with known truth, in memory or in CholecSeg8k's folder layout.

`python -m data.synthetic --output DIR --clips N` writes DIR/videoNN/videoNN_00000/ with each frame's picture, masks and
depth, with clip.json (frame rate, camera, times), truth.json and truth.npz, and beside that folder a video of the clip.
Every clip is a video of its own, so that a split by video works. No training reads the truth.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import functools
import inspect
import itertools
import json
import os
import shutil
import sys
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from data.camera import Camera
from data.synthetic_errors import observe_depth, observe_labels, reported_camera, stored_to_depth
from data.synthetic_files import open_video, write_frame, write_truth
from data.synthetic_render import Renderer
from data.synthetic_scene import Scene, draw_scene
from data.synthetic_settings import SceneSettings
from data.synthetic_truth import Motion, draw_motion

SIZES = {"full": (854, 480), "medium": (428, 240), "small": (214, 120)}
"""Named picture sizes [px]: CholecSeg8k's, half of it, the network's input."""


@dataclass(frozen=True)
class SyntheticFrame:
    """One frame as a user's files would show it."""

    image: np.ndarray
    """RGB, shape [H, W, 3], uint8."""
    labels: np.ndarray
    """Grey class codes of `data.class_table`, shape [H, W], uint8."""
    stored_depth: np.ndarray
    """z times its type's largest value, shape [H, W], uint8 or uint16, 0 = invalid."""


@dataclass(frozen=True)
class SyntheticClip:
    """A clip in memory."""

    scene: Scene
    """True geometry: sheet, mesh, contact vertex, direction, true cameras."""
    motion: Motion
    """Truth: θ, force in time, trajectories."""
    camera: Camera
    """Camera that the clip claims, with its focal-length error."""
    seed: int
    images: np.ndarray
    """RGB, shape [F, H, W, 3], uint8."""
    labels: np.ndarray
    """Grey class codes of `data.class_table`, shape [F, H, W], uint8."""
    depth: np.ndarray
    """Observed z, shape [F, H, W], float32 [scene units], 0 = invalid."""


def draw_truth(settings: SceneSettings, seed: int) -> tuple[Scene, Motion]:
    """Scene and true motion of a clip, without its pictures.

    Geometry, motion, looks and errors of observation have a random stream each, so that changing the errors leaves the
    truth as it is.

    Raises:
        SceneError: the settings leave nothing to draw.
    """
    scene = draw_scene(settings, np.random.default_rng([seed, 0]))
    return scene, draw_motion(scene, np.random.default_rng([seed, 1]))


def observe(scene: Scene, motion: Motion, seed: int) -> Iterator[SyntheticFrame]:
    """Frames of a clip in order, with their errors of observation."""
    settings = scene.settings
    renderer = Renderer(scene, motion, np.random.default_rng([seed, 2]))
    depth_errors, mask_errors = np.random.default_rng([seed, 3]), np.random.default_rng([seed, 4])
    for index in range(settings.frames):
        frame = renderer.frame(index)
        labels = observe_labels(frame.labels, settings, mask_errors)
        yield SyntheticFrame(frame.image, labels, observe_depth(frame.depth, settings, depth_errors))


def make_clip(settings: SceneSettings, seed: int) -> SyntheticClip:
    """Make a clip in memory; the same settings and seed give the same arrays.

    Raises:
        SceneError: the settings leave nothing to draw.
    """
    return synthetic_clip(*draw_truth(settings, seed), seed)


def synthetic_clip(scene: Scene, motion: Motion, seed: int) -> SyntheticClip:
    """A clip in memory of a truth that was drawn already, observed as the scene's settings say."""
    frames = list(observe(scene, motion, seed))
    return SyntheticClip(
        scene,
        motion,
        reported_camera(scene.camera, scene.settings),
        seed,
        np.stack([frame.image for frame in frames]),
        np.stack([frame.labels for frame in frames]),
        np.stack([stored_to_depth(frame.stored_depth) for frame in frames]),
    )


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
        advance: called with the number of frames done since the last call.

    Raises:
        FileExistsError: the folder is there but was made otherwise and `overwrite` is off.
        OSError: the folder can't be written.
        SceneError: the settings leave nothing to draw.
    """
    name = f"video{number:02d}"
    target, folder_name = output / name, f"{name}_00000"
    if target.exists() and not overwrite:
        if not _same_clip(target / folder_name / "truth.json", settings, seed):
            raise FileExistsError(
                f"{target} exists and was made with other settings; give another --output or --overwrite."
            )
        advance(settings.frames)
        return target / folder_name
    scene, motion = draw_truth(settings, seed)
    # The process id keeps several writers apart; the leading dot keeps readers away.
    partial = output / f".{name}.{os.getpid()}.partial"
    try:
        (partial / folder_name).mkdir(parents=True)
        with open_video(partial / f"{folder_name}.mp4", settings) as add_to_video:
            for index, frame in enumerate(observe(scene, motion, seed)):
                write_frame(partial / folder_name, index, frame.image, frame.labels, frame.stored_depth)
                add_to_video(frame.image)
                advance(1)
        write_truth(partial / folder_name, scene, motion, seed)
        if target.exists():
            shutil.rmtree(target)
        os.replace(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return target / folder_name


def _same_clip(truth: Path, settings: SceneSettings, seed: int) -> bool:
    try:
        recorded = json.loads(truth.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    wanted = json.loads(json.dumps(dataclasses.asdict(settings)))
    return recorded.get("seed") == seed and recorded.get("settings") == wanted


class FrameRateColumn(ProgressColumn):
    """Frames a second, averaged over the last seconds."""

    def render(self, task: Task) -> Text:
        """Text of the column."""
        return Text(f"{task.speed:.1f} frames/s" if task.speed else "", style="progress.data.speed")


def field_help(settings: type) -> dict[str, str]:
    """Documentation string of every field of a dataclass, from its source."""
    body = ast.parse(inspect.getsource(settings)).body[0].body
    pairs = itertools.pairwise(body)
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairs
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr)
    }


def build_parser() -> argparse.ArgumentParser:
    """Command line: the set, and an option for every field of SceneSettings."""
    parser = argparse.ArgumentParser(prog="python -m data.synthetic", description=__doc__.split("\n")[0])
    parser.add_argument("--output", type=Path, required=True, help="folder that gets videoNN/videoNN_00000/")
    parser.add_argument("--clips", type=int, default=1, help="number of clips (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="another seed gives other clips (default %(default)s)")
    parser.add_argument("--first", type=int, default=1, help="number of the first video (default %(default)s)")
    sizes = ", ".join(f"{name} ({width}x{height})" for name, (width, height) in SIZES.items())
    parser.add_argument("--size", default="full", help=f"picture: {sizes} or WIDTHxHEIGHT (default %(default)s)")
    parser.add_argument("--overwrite", action="store_true", help="replace clips that were made with other settings")
    knobs = parser.add_argument_group("scene")
    texts, types = field_help(SceneSettings), typing.get_type_hints(SceneSettings)
    for field in dataclasses.fields(SceneSettings):
        if field.name in ("width", "height"):
            continue
        option = {"default": field.default, "help": f"{texts[field.name]} (default {field.default})".replace("%", "%%")}
        kind = types[field.name]
        if kind is bool:
            option["action"] = argparse.BooleanOptionalAction
        elif typing.get_origin(kind) is typing.Literal:
            option |= {"choices": typing.get_args(kind), "type": type(field.default)}
        elif typing.get_origin(kind) is tuple:
            option |= {"nargs": 2, "type": float, "metavar": ("LOW", "HIGH")}
        else:
            option |= {"type": kind, "metavar": kind.__name__.upper()}
        knobs.add_argument(f"--{field.name.replace('_', '-')}", **option)
    return parser


def picture_size(text: str) -> tuple[int, int]:
    """Width and height [px] of a named size or WIDTHxHEIGHT.

    Raises:
        ValueError: neither.
    """
    if text in SIZES:
        return SIZES[text]
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"--size is '{text}'; give {', '.join(SIZES)} or WIDTHxHEIGHT such as 854x480.")
    return int(width), int(height)


def main(arguments: list[str] | None = None) -> int:
    """Write the clips that the command line asks for; returns the exit status: 0 done, 1 failed, 2 wrong usage."""
    console = Console(stderr=True)
    options = vars(build_parser().parse_args(arguments))
    output, clips, seed, first, size, overwrite = (
        options.pop(name) for name in ("output", "clips", "seed", "first", "size", "overwrite")
    )
    try:
        if clips < 1 or seed < 0 or first < 0:
            raise ValueError("--clips takes 1 or more, --seed and --first 0 or more.")
        width, height = picture_size(size)
        ranges = {name: tuple(value) if isinstance(value, list) else value for name, value in options.items()}
        settings = SceneSettings(width=width, height=height, **ranges)
    except ValueError as error:
        console.print(str(error), style="red", markup=False)
        return 2
    columns = (BarColumn(), MofNCompleteColumn(), FrameRateColumn(), TimeRemainingColumn())
    try:
        output.mkdir(parents=True, exist_ok=True)
        with Progress(TextColumn("{task.description}"), *columns, console=console) as progress:
            task = progress.add_task("clips", total=clips * settings.frames)
            for index in range(clips):
                progress.update(task, description=f"clip {index + 1} of {clips}")
                write_clip(
                    output,
                    first + index,
                    settings,
                    clip_seed(seed, index),
                    overwrite=overwrite,
                    advance=functools.partial(progress.advance, task),
                )
    except KeyboardInterrupt:
        console.print("Interrupted; finished clips are kept, and the same command continues.", style="yellow")
        return 1
    except (ValueError, OSError) as error:
        console.print(_sentence(error), style="red", markup=False)
        return 1
    console.print(f"{clips} clips with truth in {output}", markup=False)
    return 0


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        where = error.filename or "The output"
        return f"{where} can't be written ({error.strerror}); check --output, its rights and its free space."
    return str(error)


if __name__ == "__main__":
    sys.exit(main())
