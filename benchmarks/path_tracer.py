"""Presses rendered by a path tracer (Mitsuba 3), with truth, as `benchmarks.path_traced` reads them.

    pip install mitsuba
    python -m benchmarks.path_tracer --output runs/path_traced --clips 8
    python -m benchmarks.path_traced --data runs/path_traced --output runs/judged

Light bounces between tissue and instrument, lamps stand beside the lens, tissue is matt or glossy, and instruments come
in front of it along their axis; every fourth one hovers and never touches. Each clip is an MP4, a folder with pictures,
masks and depth, and NAME.truth.json. Motion is the simulator's of this project; its pictures share nothing with it.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import av
import cv2
import numpy as np
from rich.progress import track
from scipy.ndimage import gaussian_filter, map_coordinates

from palpate.common.doors import run_door
from palpate.common.files import as_json
from palpate.common.options import options
from palpate.data.masks.class_table import CLASSES
from palpate.data.source.camera import Camera, back_project
from palpate.data.source.layout import InputError
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import contact_normal, grid_mesh
from palpate.physics.msd.simulation import simulate

UNIT, DISTANCE = 120.0, 60.0
"""Millimetres of a scene unit, and from lens to tissue [mm]."""
CAMERA = Camera(fx=554.26, fy=554.26, cx=319.5, cy=179.5, width=640, height=360)
GRID = Camera(fx=554.26 / 3, fy=554.26 / 3, cx=106.0, cy=59.5, width=213, height=120)
FPS, FRAMES, STEP = 25, 36, 0.001
"""Frames a second, frames of a clip, and time step of the simulation [s]."""
TIPS = {
    "thin": [(0, 0.15), (4, 0.4), (8, 1.0), (14, 2.2)],
    "jaws": [(0, 0.5), (0.3, 0.9), (4, 1.5), (9, 2.0), (14, 2.4)],
    "round": [(0, 0.3), (0.8, 1.25), (1.5, 1.5), (9, 1.8), (14, 2.2)],
}
"""Places along instruments and radii there, from their ends [mm]."""
SHAFTS: dict[str, dict[str, Any]] = {
    "steel": {"type": "roughconductor", "material": "Cr", "alpha": 0.25},
    "polymer": {"type": "roughplastic", "diffuse_reflectance": {"type": "rgb", "value": 0.03}, "alpha": 0.2},
    "grey": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
}


@dataclass(frozen=True)
class PathTracer:
    """Options of the renderer."""

    output: Path
    """folder of the clips"""
    clips: Annotated[int, 1, 10_000] = 8
    """clips"""
    seed: int = 1
    """seed of everything drawn at random"""
    samples: Annotated[int, 1, 4096] = 24
    """samples of a pixel"""


def drawn(generator: np.random.Generator, hovers: bool) -> dict[str, Any]:
    """Return the parameters of a clip, drawn at random; `hovers` = its instrument never touches."""
    stiffness, ratio = float(np.exp(generator.uniform(math.log(0.3), 0))), float(generator.uniform(0.3, 1.2))
    names: dict[str, Any] = {key: str(generator.choice(list(of))) for key, of in (("tip", TIPS), ("shaft", SHAFTS))}
    return names | {
        "hovers": hovers,
        "stiffness": stiffness,
        "damping": 2 * ratio * math.sqrt(stiffness * Mechanics().mass),
        "depth": float(generator.uniform(0.025, 0.07)),
        "pixel": [int(generator.integers(90, 120)), int(generator.integers(52, 68))],
        "onset_s": float(generator.uniform(0.42, 0.46)),
        "release_s": float(generator.uniform(0.78, 0.84)),
        "azimuth": math.radians(generator.choice([0, 180]) + generator.uniform(-35, 35)),
        "tilt": generator.uniform(-0.25, 0.25, 2).tolist(),
        "roughness": None if generator.random() < 0.3 else float(generator.uniform(0.3, 0.5)),
        "lamps": [[0, 0, 0]] if generator.random() < 0.3 else [[3.5, -1.5, 0], [-3.5, -1.5, 0]],
        "crf": int(generator.choice([18, 20, 23])),
    }


def tissue_motion(case: dict[str, Any], points: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Return displacements [N, h, w, 3] [mm] of tissue at points [h, w, 3] [mm], F, and the normal at the contact [3].

    F makes the dent as deep as wanted; 0, and no displacement, where the instrument hovers.
    """
    mesh = grid_mesh(points / UNIT, np.ones(points.shape[:2], bool))
    column, row = case["pixel"]
    vertex = row * points.shape[1] + column
    normal = contact_normal(mesh, vertex).astype(np.float64)
    moved = np.zeros((FRAMES, *points.shape))
    if case["hovers"]:
        return moved, 0.0, normal
    lead, steps = case["onset_s"] / STEP, math.ceil((FRAMES / FPS - case["onset_s"]) / STEP)
    press = Press.at(vertex, normal, held(case["release_s"] / STEP - lead, steps))
    mechanics = Mechanics(time_step=STEP, steps=steps, scheme="dkd")

    def path(force: float, watch: np.ndarray | None = None) -> np.ndarray:
        return UNIT * simulate([case["stiffness"], case["damping"], force], mesh, press, mechanics, watch=watch)

    low, high = -2.0, -1e-4
    for _ in range(14):  # bisection of log |F|
        force = -math.sqrt(low * high)
        low, high = (force, high) if -(path(force) @ normal).min() > case["depth"] * DISTANCE else (low, force)
    rows, columns = np.arange(row - 22, row + 23), np.arange(column - 22, column + 23)
    found = path(force, (rows[:, None] * points.shape[1] + columns).ravel())
    at = np.arange(FRAMES) / FPS / STEP - lead
    known = at >= 1
    window = np.ix_(known, rows, columns)
    moved[window] = found[np.rint(at[known]).astype(int) - 1].reshape(-1, len(rows), len(columns), 3)
    return moved, force, normal


def texture(generator: np.random.Generator) -> np.ndarray:
    """Return the reflectance of tissue, mottled, with vessels and fat, linear RGB [900, 1600, 3], float32."""
    shape = 900, 1600
    spots = sum(
        weight * scale * gaussian_filter(generator.standard_normal((225, 400)), scale)
        for scale, weight in ((2, 0.25), (6, 0.6), (18, 1.0), (40, 1.2))
    )
    spots = cv2.resize(spots / spots.std(), shape[::-1], interpolation=cv2.INTER_CUBIC).clip(-2.5, 2.5)[..., None]
    found = np.array([0.5, 0.17, 0.14]) * np.exp(spots * [0.1, 0.22, 0.2])
    vessels = np.zeros(shape, np.float32)
    for _ in range(14):
        turns = np.cumsum(generator.normal(0, 0.12, 150)) + generator.uniform(0, 2 * np.pi)
        course = np.cumsum(4 * np.exp(1j * turns)) + complex(*generator.uniform(0, shape[::-1]))
        course = np.column_stack([course.real, course.imag])
        cv2.polylines(vessels, [course.astype(np.int32)], False, 0.6, int(generator.integers(1, 6)), cv2.LINE_AA)
    fat = gaussian_filter(generator.standard_normal(shape), 34)
    for cover, colour in (
        (gaussian_filter(vessels, 1.2), [0.28, 0.04, 0.05]),
        (fat / fat.std() * 3 - 6, [0.62, 0.42, 0.12]),
    ):
        share = np.clip(cover, 0, 1)[..., None]
        found = found * (1 - share) + share * np.array(colour)
    return found.clip(0.01, 0.9).astype(np.float32)


def instrument(tip: str) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [V, 3] [mm], along +x from the tip, and triangles [F, 3] of an instrument."""
    profile = np.array([*TIPS[tip], (15, 2.3), (15.01, 2.75), (17, 2.75), (17.01, 2.5), (110, 2.5)])
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rings = np.stack([np.stack([np.full(40, x), r * np.cos(angles), r * np.sin(angles)], -1) for x, r in profile])
    index = np.arange(rings.shape[0] * 40).reshape(-1, 40)
    here, ahead, turned, both = index[:-1], index[1:], np.roll(index[:-1], -1, 1), np.roll(index[1:], -1, 1)
    triangles = np.concatenate([np.stack([here, ahead, turned], -1), np.stack([turned, ahead, both], -1)])
    return rings.reshape(-1, 3), triangles.reshape(-1, 3)


class Studio:
    """Mitsuba's scene of a clip.

    Args:
        case: parameters, as `drawn` gives them.
        generator: of the tissue's texture and of the noise.
        samples: of a pixel.
    """

    def __init__(self, case: dict[str, Any], generator: np.random.Generator, samples: int) -> None:
        import mitsuba  # ty: ignore[import-not-found]

        self.mi, self.case, self.samples, self.generator = mitsuba, case, samples, generator
        reflectance = {
            "type": "bitmap",
            "bitmap": mitsuba.Bitmap(texture(generator)),
            "raw": True,
            "wrap_mode": "mirror",
        }
        matt = {"type": "diffuse", "reflectance": reflectance}
        glossy = {
            "type": "roughplastic",
            "diffuse_reflectance": reflectance,
            "alpha": case["roughness"],
            "int_ior": 1.4,
        }
        self.tissue, self.shaft = (
            mitsuba.load_dict({"type": "twosided", "inner": each})
            for each in (matt if case["roughness"] is None else glossy, SHAFTS[case["shaft"]])
        )
        film = {"type": "hdrfilm", "width": CAMERA.width, "height": CAMERA.height, "pixel_format": "rgb"}
        to_world = mitsuba.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0])
        lens = {"type": "perspective", "fov": 60, "fov_axis": "x", "near_clip": 0.5, "to_world": to_world, "film": film}
        lamp = np.array([1.0, 0.93, 0.85]) * DISTANCE**2 * np.pi / len(case["lamps"])
        self.rest: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 5}, "sensor": lens}
        for number, place in enumerate(case["lamps"]):
            light = {"type": "rgb", "value": lamp.tolist()}
            self.rest[f"lamp{number}"] = {"type": "point", "position": place, "intensity": light}

    def mesh(self, name: str, vertices: np.ndarray, triangles: np.ndarray, bsdf: Any, places: np.ndarray | None) -> Any:
        """Return a smooth mesh; `places` are those on the texture [V, 2]."""
        mi, properties = self.mi, self.mi.Properties()
        properties["bsdf"] = bsdf
        size = len(vertices), len(triangles)
        made = mi.Mesh(name, *size, has_vertex_normals=True, has_vertex_texcoords=places is not None, props=properties)
        values = mi.traverse(made)
        values["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
        values["faces"] = mi.UInt32(triangles.astype(np.uint32).ravel())
        if places is not None:
            values["vertex_texcoords"] = mi.Float(places.astype(np.float32).ravel())
        corners, normals = vertices[triangles], np.zeros_like(vertices)
        for axis, part in enumerate(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).T):
            for corner in triangles.T:
                np.add.at(normals[:, axis], corner, part)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
        values["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
        values.update()
        return made

    def shoot(self, number: int, tissue: tuple, tool: tuple) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return picture [H, W, 3] uint8, the instrument's mask [H, W] and z [H, W] [mm] of a frame.

        Args:
            tissue: vertices, triangles and places on the texture.
            tool: vertices and triangles.
        """
        mi = self.mi
        meshes = {"tissue": self.mesh("tissue", *tissue[:2], self.tissue, tissue[2])}
        meshes["tool"] = self.mesh("tool", *tool, self.shaft, None)
        scene = mi.load_dict(self.rest | meshes)
        linear = np.clip(np.array(mi.render(scene, seed=number, spp=self.samples)), 0, None)
        linear = linear + self.generator.standard_normal(linear.shape) * np.sqrt(7e-5 * linear + 0.0016**2)
        linear = linear.clip(0, 1)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        depth = []
        for shown in (meshes, {"tissue": meshes["tissue"]}):
            rays = back_project(np.ones((CAMERA.height, CAMERA.width)), CAMERA).reshape(-1, 3).T.astype(np.float32)
            ray = mi.Ray3f(mi.Point3f(0), mi.Vector3f(*(mi.Float(part) for part in rays)))
            hit = mi.load_dict({"type": "scene", **shown}).ray_intersect(ray)
            depth.append(
                np.where(np.array(hit.is_valid()), np.array(hit.p.z), 0.0).reshape(CAMERA.height, CAMERA.width)
            )
        return np.rint(255 * encoded).astype(np.uint8), depth[0] < depth[1] - 1e-3, depth[0]


def render(case: dict[str, Any], seed: int, samples: int, folder: Path, name: str) -> None:
    """Render a clip: its MP4, its folder in CholecSeg8k's layout, and its truth."""
    generator = np.random.default_rng(seed)
    studio = Studio(case, generator, samples)
    rays = back_project(np.ones((GRID.height, GRID.width)), GRID).astype(np.float64)
    points = rays * (DISTANCE / (1 - rays[..., :2] @ case["tilt"]))[..., None]
    moved, force, normal = tissue_motion(case, points)
    pad = ((10, 10), (10, 10), (0, 0))
    wide = np.pad(points, pad, mode="reflect", reflect_type="odd")
    finer = np.meshgrid(*(np.arange((side - 1) * 3 + 1) / 3 for side in wide.shape[:2]), indexing="ij")

    def fine(values: np.ndarray) -> np.ndarray:
        return np.stack(
            [map_coordinates(part, finer, order=3, mode="nearest") for part in np.moveaxis(values, -1, 0)], -1
        )

    rest, index = fine(wide), np.arange(finer[0].size).reshape(finer[0].shape)
    corners = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    triangles = np.concatenate(
        [np.stack([corners[i] for i in face], -1).reshape(-1, 3) for face in ((0, 2, 1), (1, 2, 3))]
    )
    relief = sum(gaussian_filter(generator.standard_normal(rest.shape[:2]), scale) * scale**2 for scale in (1, 2, 4))
    rest[..., 2] -= 0.01 * relief / relief.std()
    places = np.stack([(finer[1] - 10) / (GRID.width - 1), 1 - (finer[0] - 10) / (GRID.height - 1)], -1).reshape(-1, 2)
    vertices, faces = instrument(case["tip"])
    elevation, column, row = math.radians(48), *case["pixel"]
    flat = math.cos(elevation)
    axis = np.array([flat * math.cos(case["azimuth"]), flat * math.sin(case["azimuth"]), -math.sin(elevation)])
    side = np.cross(axis, [0, 0, 1.0]) / np.linalg.norm(np.cross(axis, [0, 0, 1.0]))
    turned = vertices @ np.stack([axis, side, np.cross(axis, side)])
    contact = points[row, column]
    (folder / name).mkdir(parents=True, exist_ok=True)
    times, pictures = np.arange(FRAMES) / FPS, []
    for frame, time in enumerate(track(times, description=name)):
        surface = rest + fine(np.pad(moved[frame], (*pad[:2], (0, 0))))
        if case["hovers"]:
            tip = contact + 3.0 * normal + np.array([12.0 * (frame / FRAMES - 0.5), 4.0, 0.0])
        else:
            away = 60.0 * max(case["onset_s"] - time, time - case["release_s"], 0.0)
            tip = contact + (away + 0.6) * axis
        picture, mask, depth = studio.shoot(frame, (surface.reshape(-1, 3), triangles, places), (turned + tip, faces))
        pictures.append(picture)
        codes = np.where(mask[..., None], CLASSES["grasper"].color, CLASSES["gallbladder"].color).astype(np.uint8)
        for ending, image in (("", picture[..., ::-1]), ("_color_mask", codes[..., ::-1])):
            cv2.imwrite(f"{folder / name}/frame_{frame}_endo{ending}.png", image)
        stored = np.rint(depth / UNIT * 65535).clip(0, 65535).astype(np.uint16)
        cv2.imwrite(f"{folder / name}/frame_{frame}_endo_depth.png", stored)
    (folder / name / "clip.json").write_text(
        as_json({"fps": FPS, "camera": vars(CAMERA) | {"distortion": []}, "depth_scale": 1.0, "times": times})
    )
    with av.open(folder / f"{name}.mp4", "w") as file:
        stream = file.add_stream("libx264", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = CAMERA.width, CAMERA.height, "yuv420p"
        stream.options = {"crf": str(case["crf"])}
        for picture in pictures:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        file.mux(stream.encode(None))
    pressed = (
        [] if case["hovers"] else np.flatnonzero((times >= case["onset_s"]) & (times <= case["release_s"])).tolist()
    )
    theta = {"stiffness": case["stiffness"], "damping": case["damping"], "force": force}
    truth = {
        "theta": theta,
        "contact_frames": pressed,
        "distance_mm": contact[2],
        "mm_per_scene_unit": UNIT,
        "case": case,
    }
    (folder / f"{name}.truth.json").write_text(as_json(truth))


def main(arguments: list[str] | None = None) -> int:
    """Render the clips that are not there yet; return the exit status."""
    asked: PathTracer = options(PathTracer, arguments, "benchmarks.path_tracer", __doc__)
    try:
        import mitsuba  # ty: ignore[import-not-found]

        mitsuba.set_variant("llvm_ad_rgb")
    except ImportError as error:
        raise InputError(
            "benchmarks.path_tracer needs Mitsuba 3 (pip install mitsuba) and an LLVM of 16 or newer, whose libLLVM.so "
            "DRJIT_LIBLLVM_PATH names."
        ) from error
    for number in range(asked.clips):
        name, seed = f"clip{number:02}", asked.seed * 1000 + number
        if not (asked.output / f"{name}.truth.json").exists():
            case = drawn(np.random.default_rng(seed), hovers=number % 4 == 3)
            render(case, seed, asked.samples, asked.output, name)
    return 0


if __name__ == "__main__":
    run_door(main)
