"""A look at results in three dimensions: tissue, how it moves, the force on it, and where it is stiffer.

    palpate view RESULTS                     on a page that this machine serves to its own browser
    palpate view RESULTS --output VIEW.html  as a file to send, which opens without a network

RESULTS is what was --output of palpate infer, a clip's folder in it, or a scene of --export. Presses that are
determined move after `palpate infer --export vtk`, pulls after `--estimator online`; of others the verdict is shown.
Not a medical device.
"""

import contextlib
import errno
import io
import textwrap
from collections.abc import Iterator, Mapping
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from viser import ViserServer

from palpate.common.command_line import described_parser, path_option, whole_number
from palpate.common.doors import plain
from palpate.common.output import write_own
from palpate.results import store
from palpate.results.field_overlay import MIDDLE, RANGE, colors
from palpate.results.forces import ENDS
from palpate.results.page.gather import clip_of
from palpate.results.page.render import UNREADABLE
from palpate.results.scene.files import read_scene
from palpate.results.scene.kinds import simulated
from palpate.results.scene.scene import KINDS
from palpate.results.verdicts import digits

FRAME_SECONDS, STILL_SECONDS = 0.04, 2.0
"""Time between two frames of a simulated press, about, and for which its end is shown, and what does not move [s]."""
SHADES, FAR, UNKNOWN, FORCE = np.linspace(0, 1, 13)[:, None], np.array([112, 26, 117]), [[150] * 3], (190, 24, 24)
"""Levels that have a colour; RGB of the largest displacement, of stiffness that is not determined, and of the force."""
NOTHING = "Nothing to see: palpate infer --export vtk keeps presses that are determined, --estimator online pulls."
MOVED = """Colour: displacement, simulated by the estimate, from 0 to {} {}.
Arrow: the force, thick up to the lower end of its 90 % interval, thin up to the upper; none where it isn't known."""
STIFFNESS = f"Colour: stiffness over median, 1/{RANGE:g} (blue) to {RANGE:g} (red). Grey, force: not determined."


def motions_in(path: Path) -> Iterator[tuple[str, dict[str, Any] | None]]:
    """What is said of every run of contact, and its motion where there is one.

    Args:
        path: a folder of results, a clip's folder, or a scene that `palpate infer --export` wrote.

    Raises:
        OSError: the scene can't be read.
        ValueError: it is none.
    """
    if path.is_file():
        yield path.name, _simulated(path, {}, {})
    for folder in filter(store.read_record, (path, *sorted(path.glob("[!.]*")))):
        try:
            yield from _of_clip(folder)
        except Exception as error:  # whatever a damaged folder holds, the other clips are shown
            yield f"{folder.name}: {UNREADABLE.format(type(error).__name__, error)}", None


def _of_clip(folder: Path) -> Iterator[tuple[str, dict[str, Any] | None]]:
    clip = clip_of(folder)
    newtons = {row["onset_frame"]: row for row in clip["calibrated"]}
    scenes = {name[6:].split(".")[0]: folder / name for name in filter(store.SCENE.fullmatch, store.own_files(folder))}
    for contact in clip["found"]:
        onset, detail, motion = contact["row"]["onset_frame"], contact["row"]["detail"], None
        if onset in scenes:
            motion = _simulated(scenes[onset], contact, newtons.get(onset, {}))
        elif clip["estimator"] == "online" and contact["name"] != "no_estimate":
            motion = _pulled(folder / store.FIELDS, int(onset), clip["curves"])
        title = f"{folder.name}: contact from frame {onset}, numbers in scene units"
        lines = title, f"Verdict: {contact['words']}. {contact['means']}", ", ".join(map(" ".join, contact["numbers"]))
        yield "\n".join(textwrap.fill(line, 90) for line in (*lines, detail, "" if motion else NOTHING) if line), motion


def _simulated(path: Path, contact: Mapping[str, Any], newtons: Mapping[str, str]) -> dict[str, Any]:
    """Tissue as its estimate moves it, and the force of a press.

    Args:
        path: its scene.
        contact: of its clip, as `results.page.gather` has it; empty = all of the scene's force counts as known.
        newtons: its row of calibrated.csv, where there is one.
    """
    scene = read_scene(path)
    rest, faces, motion = scene.parts["points"].astype(np.float64), scene.parts["triangles"], simulated(scene)
    is_press, step = "load_factor" in scene.parts, scene.parts.get("time_step", np.ones(1)).item()
    stride = max(1, round(FRAME_SECONDS / step)) if is_press else 1
    moved = np.concatenate([np.zeros_like(motion[:1]), motion[stride - 1 :: stride]])
    times = np.append(0, scene.parts["times"]) if "times" in scene.parts else step * stride * np.arange(len(moved))
    lengths = np.linalg.norm(moved, axis=2)
    shown = {"positions": rest + moved, "faces": faces, "ramp": MIDDLE + SHADES * (FAR - MIDDLE), "times": times}
    shown |= {"levels": lengths[:, faces].mean(axis=2) / lengths.max()}
    unit = KINDS[scene.kind]["parts"]["points"][3].partition(":")[0].replace("units", "units, not metric")
    shown |= {"legend": MOVED.format(digits(lengths.max(), 2), unit)}
    if not is_press:
        return shown | {"arrows": np.full((len(moved), 2, 2, 3), np.nan), "said": [""] * len(moved)}
    press, force = scene.press, np.abs(scene.parts["force"].ravel())
    force[1:].sort()
    unit, factor = "scene units, not N", np.append(press.factor[::stride], press.factor[-1])[: len(moved)]
    if "force" in newtons.get("determined", "").split(";"):
        force, unit = np.array([float(newtons[f"force{end}"]) for end in ENDS]), newtons["force_unit"]
    known = factor > 0
    if contact:
        told, delay = contact["forces"], float(contact["row"]["delay_s"] or 0)
        last = max(np.array(told["time_s"])[[each is not None for each in told["force"]]], default=-np.inf)
        known &= times + delay <= last - told["onset_time_s"] + FRAME_SECONDS / 2
    amount = "{} ({} to {})".format(*(digits(each, 2) for each in force))
    words = "released", "force not known: it was not observed any more", f"force {{:.0%}} of {amount} {unit}"
    said = [words[(part > 0) + int(sure)].format(part) for part, sure in zip(factor, known, strict=True)]
    long = 0.3 * np.ptp(rest, axis=0).max() * np.outer(np.where(known, factor, np.nan), force[1:] / force[2])
    tips = np.repeat((rest + moved)[:, press.vertices[:1]], 2, axis=1)
    arrows = np.stack([tips - np.sign(scene.number("force")) * long[..., None] * press.direction, tips], axis=2)
    return shown | {"arrows": arrows, "said": said}


def _pulled(path: Path, onset: int, curves: Mapping[str, Any]) -> dict[str, Any]:
    """Tissue that an instrument drives, as the file of fields at `path` has the run that begins in frame `onset`.

    Args:
        curves: of its clip, as `results.page.gather` has them.
    """
    with np.load(path, allow_pickle=False) as file:
        frames = [number for number in map(int, curves["frame"]) if file.get(f"frame_{number}/run") == onset]
        names = "positions", "distance", "known"
        positions, values, known = (np.stack([file[f"frame_{each}/{name}"] for each in frames]) for name in names)
        shown: dict[str, Any] = {"positions": positions, "faces": file[f"run_{onset}/faces"]}
    times = np.array([time for frame, time in zip(curves["frame"], curves["time_s"], strict=True) if frame in frames])
    logs = np.log(np.where(known, values, np.nan))
    # Of a frame of which nothing is known there is no median.
    logs -= [[np.median(row[sure]) if sure.any() else np.nan] for row, sure in zip(logs, known, strict=True)]
    shown["levels"] = np.clip(logs[:, shown["faces"]].mean(axis=2) / np.log(RANGE), -1, 1) / 2 + 0.5
    said = [f"stiffness determined at {row.mean():.0%} of the points" for row in known]
    shown |= {"times": times - times[0], "arrows": np.full((len(times), 2, 2, 3), np.nan)}
    return shown | {"ramp": np.concatenate([colors(2 * SHADES[:, 0] - 1), UNKNOWN]), "legend": STIFFNESS, "said": said}


def page_of(path: Path) -> str:
    """A page that plays all runs of contact of some results, one after the other.

    Raises:
        OSError, ValueError: there is nothing to show, and why.
    """
    with contextlib.redirect_stdout(io.StringIO()), contextlib.ExitStack() as ending:  # it tells that it serves
        server, shown = ViserServer("127.0.0.1", 0, verbose=False), []
        ending.callback(server.stop)
        server.initial_camera.position, server.initial_camera.look_at = (0, -0.7, 0.5), (0, 0, 0)
        file = server.get_scene_serializer()
        for said, motion in motions_in(path):
            _play(server, file, f"/{len(shown)}", said, motion)
            shown.append(motion is not None)
        if not any(shown):
            raise ValueError(f"{path}: {NOTHING if path.exists() else 'There is no such file or folder; check it.'}")
        return file.as_html()


def _play(server: Any, file: Any, run: str, said: str, motion: dict[str, Any] | None) -> None:
    """Record a run of contact under nodes of the name `run`, the tissue as wide as 1 and turned so that z points up.

    Args:
        server, file: of viser: what shows it, and what it is recorded in.
        said: of it, in lines.
        motion: of N vertices and F triangles in T frames: `times` since the first [T] [s]; `positions`, x right, y
            down, z away [T, N, 3] [scene units]; `faces` [F, 3]; `levels` of their colours, from 0 to 1, not a number
            where it is not determined [T, F]; `ramp`, RGB of SHADES, then of what is not determined; `arrows`, tails
            and tips of the force as large as the lower and the upper end of its 90 % interval, not a number where
            there is none or it isn't known [T, 2, 2, 3] [scene units]; what is `said` of each frame; `legend`.
    """
    scene, first = server.scene, np.zeros((1, 3)) if motion is None else motion["positions"][0]
    size = float(np.ptp(first, axis=0).max()) or 1.0
    (left, top, _), (_, bottom, _) = low, high = np.array([first.min(axis=0), first.max(axis=0)]) / size
    (x, y, z), upright = (low + high) / 2, (0.5**0.5, -(0.5**0.5), 0, 0)
    stand = scene.add_frame(run, show_axes=False, wxyz=upright, position=(-x, -z, y))
    scene.add_label(f"{run}/said", said, position=(left, top - 0.06, z), anchor="bottom-left")
    if motion is not None:
        ramp, under = motion["ramp"].astype(np.uint8), bottom + 0.2
        row, wide = np.linspace((left, under, z), (x, under, z), len(ramp), retstep=True)
        scene.add_point_cloud(f"{run}/legend", row, ramp, point_size=wide[0], precision="float32", point_shading="flat")
        tones = np.nan_to_num(np.rint((len(SHADES) - 1) * motion["levels"]), nan=len(SHADES))
        for frame, seconds in enumerate(np.diff(motion["times"], append=motion["times"][-1])):
            # A mesh of viser has one colour: every tone is a mesh with the vertices that it needs.
            for tone, color in enumerate(ramp.tolist()):
                used, faces = np.unique(motion["faces"][tones[frame] == tone], return_inverse=True)
                how = {"color": color, "side": "double", "scale": 1 / size}
                scene.add_mesh_simple(f"{run}/{tone}", motion["positions"][frame][used], faces, **how)
            text = f"{motion['times'][frame]:.2f} s: {motion['said'][frame]}\n{motion['legend']}"
            scene.add_label(f"{run}/now", text, position=(left, under + 0.05, z))
            low, high = np.nan_to_num(motion["arrows"][frame])[:, None] / size
            sure = bool(np.isfinite(motion["arrows"][frame]).all())
            scene.add_arrows(f"{run}/force", low, FORCE, shaft_radius=0.008, head_length=0.04, visible=sure)
            scene.add_line_segments(f"{run}/upper", high, FORCE, thickness=3, thickness_units="screen", visible=sure)
            file.insert_sleep(float(seconds))
    file.insert_sleep(STILL_SECONDS)
    stand.visible = False


def main(arguments: list[str] | None = None) -> int:
    """Show what the command line names; returns the exit status."""
    parser = described_parser("palpate view", __doc__, "0 written; 1 it could not be; 2 wrong usage; 130 interrupted")
    parser.add_argument("results", type=path_option, metavar="RESULTS", help="of palpate infer, a clip's, or a scene")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--output", type=path_option, metavar="VIEW.html", help="write a page to send, and serve none")
    where.add_argument("--port", type=whole_number(1, 65535), default=8080, metavar="N", help="(default 8080)")
    options: Any = parser.parse_args(arguments)
    try:
        page = page_of(options.results)
        with TemporaryDirectory() as folder:
            output = options.output or Path(folder, "index.html")
            with store.writing(output.parent):
                write_own(output, page)
            if options.output is None:
                handler = partial(SimpleHTTPRequestHandler, directory=folder)
                with ThreadingHTTPServer(("127.0.0.1", options.port), handler) as server:
                    print("Look at http://{}:{} until Ctrl-C".format(*server.server_address), flush=True)
                    server.serve_forever()
    except (OSError, ValueError) as error:
        port = f"--port {options.port}: " if getattr(error, "errno", None) == errno.EADDRINUSE else ""
        parser.exit(1, f"{port}{plain(str(error))}\n")
    return 0
