"""Pictures of a synthetic scene: tissue and tool lit by a light at the camera.

Radiance = albedo · cos(angle of incidence) / distance², plus highlights, then the sRGB curve: the model that
`data.depth.photometric` inverts. Albedo and fine relief are fixed to the tissue and move with it, so that optical flow
can follow it.
"""

import math
from functools import cached_property

import cv2
import numpy as np

from palpate.data.masks.class_table import CLASSES
from palpate.data.source.camera import back_project
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.surface import SheetView, deformed_view, rest_view
from palpate.data.synthetic.tool import EXPOSURE_DISTANCE, draw_tool, paint
from palpate.data.synthetic.truth import TrueMotion
from palpate.physics.shading import exchanged

GREY = {name: entry.grey for name, entry in CLASSES.items()}
"""Grey code of every class."""
ALBEDO = {"gallbladder": (0.80, 0.49, 0.34), "liver": (0.36, 0.12, 0.10), "abdominal wall": (0.62, 0.30, 0.24)}
"""Linear RGB of the tissues."""


class Renderer:
    """Draws the frames of one scene."""

    def __init__(self, scene: Scene, motion: TrueMotion, generator: np.random.Generator) -> None:
        self.scene, self.motion = scene, motion
        self.noise = generator.spawn(1)[0]
        self.rest = rest_view(scene)
        self.rest_labels = rest_labels(scene, generator)
        self.albedo = reflectance(scene, self.rest_labels, generator)
        self.bumps = bumps(scene, generator)
        self.fat_course = generator.uniform(size=(2, 2))
        settings = scene.settings
        angle, offset = generator.uniform(0, 2 * np.pi), np.float32(settings.lamp_offset)
        # Two lamps at any side of the lens, 134 degrees apart.
        angles = np.array([angle, angle + 2.34][: 1 + (offset > 0)], np.float32)
        self.lamps = offset * np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=-1)
        if settings.masked == "all":
            self.rest_labels[:] = GREY["gallbladder"]
        camera = scene.camera
        self.rays = back_project(np.ones((camera.height, camera.width)), camera)
        corner = np.square(self.rays[..., :2] / self.rays[0, 0, :2]).mean(axis=-1, keepdims=True)
        self.gain = 1 - settings.vignetting * corner

    @cached_property
    def rest_lights(self) -> list[np.ndarray]:
        """Linear light of the tissue at rest from each lamp alone, shape [H, W, 3]."""
        whole = np.s_[0 : self.scene.settings.height, 0 : self.scene.settings.width]
        return [self._tissue_light(self.rest, whole, lamp) for lamp in self.lamps]

    def frame(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw a frame. Frames are drawn in order: the noise goes on from the last one.

        Returns:
            RGB picture, shape [H, W, 3], uint8; grey class codes of `data.masks.class_table`, shape [H, W], uint8; true
            z, shape [H, W], float32 [scene units].
        """
        view = deformed_view(self.scene, self.motion, index, self.rest)
        how = cv2.INTER_NEAREST, None, cv2.BORDER_REPLICATE
        labels = cv2.remap(self.rest_labels, view.rest_u, view.rest_v, *how)
        light, depth = self._lit_tissue(index, view), view.depth.copy()
        if self.scene.settings.occlusion > 0:
            self._add_fat(index, labels, light, depth)
        if self.scene.settings.tool_in_view:
            paint(draw_tool(self.scene, self.motion, index, view, self.rays), labels, light, depth)
        sigma = 0.15 * self.scene.settings.cell[0] + 0.05
        blurred = cv2.GaussianBlur((light * self.gain).astype(np.float32), (0, 0), sigma)
        picture = encode_srgb(np.clip(blurred, 0, 1))
        if self.scene.settings.image_noise > 0:
            noise = self.noise.standard_normal(picture.shape, dtype=np.float32)
            picture = picture + self.scene.settings.image_noise * noise
        return np.clip(picture * 255 + 0.5, 0, 255).astype(np.uint8), labels, depth

    def _lit_tissue(self, index: int, view: SheetView) -> np.ndarray:
        """Linear light of the tissue in a frame, the tool's shadow on it, shape [H, W, 3]."""
        total, passage = 0.0, self.motion.passage
        for lamp, rest in zip(self.lamps, self.rest_lights, strict=True):
            light = rest.copy()
            if view.region[0].stop > 0:
                light[view.region] = self._tissue_light(view, view.region, lamp)
            if passage is not None and self.scene.settings.tool_in_view:
                light *= passage.lit(index, lamp, self.rays * view.depth[..., None])[..., None]
            total = total + light / len(self.lamps)
        return self._exchanged(view, np.asarray(total))

    def _exchanged(self, view: SheetView, light: np.ndarray) -> np.ndarray:
        """Add the light [H, W, 3] that the walls of a dent send each other, reflected up to twice in every colour."""
        settings = self.scene.settings
        size = settings.grid_width, settings.grid_height
        small, rest = (cv2.resize(each.depth, size, interpolation=cv2.INTER_AREA) for each in (view, self.rest))
        row, column = divmod(int(np.argmax(np.abs(small - rest))), size[0])
        if small[row, column] == rest[row, column]:
            return light
        side = 21  # as far as light between the walls of a dent reaches [grid cells]
        starts = (min(max(at - side // 2, 0), end - side) for at, end in zip((row, column), size[::-1], strict=True))
        window = tuple(slice(start, start + side) for start in starts)
        rays = cv2.resize(self.rays, size, interpolation=cv2.INTER_AREA)[window]
        points = np.ascontiguousarray(rays * small[window][..., None], np.float64)
        inside = tuple(
            slice(round(part.start * cell), round(part.stop * cell))
            for part, cell in zip(window, settings.cell[::-1], strict=True)
        )
        maps = view.rest_u[inside], view.rest_v[inside]
        albedo = cv2.remap(self.albedo, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        cells = points.shape[1::-1]
        reflects, sent = (cv2.resize(part, cells, interpolation=cv2.INTER_AREA) for part in (albedo, light[inside]))
        received = np.zeros_like(sent)
        for _ in range(2):
            sends = np.ascontiguousarray(np.moveaxis(sent + reflects * received, -1, 0), np.float64)
            received = np.moveaxis(exchanged(np.broadcast_to(points, (3, *points.shape)), sends), 0, -1)
        found = light.copy()
        found[inside] += albedo * cv2.resize(received, albedo.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        return found

    def _tissue_light(self, view: SheetView, region: tuple[slice, slice], lamp: np.ndarray) -> np.ndarray:
        """Linear light of the tissue over a region if a lamp at a place [3] gives all light, shape [h, w, 3]."""
        # Smoothing and gradients need neighbours: the border of the computed picture is not used.
        margin = math.ceil(4 * self.scene.settings.cell[0])
        starts = [max(part.start - margin, 0) for part in region]
        inner = tuple(slice(p.start - start, p.stop - start) for p, start in zip(region, starts, strict=True))
        outer = tuple(slice(start, part.stop + margin) for part, start in zip(region, starts, strict=True))
        maps = view.rest_u[outer], view.rest_v[outer]
        # Tissue that enters the picture shows a mirror image of the texture inside it, so that it can be followed.
        albedo = cv2.remap(self.albedo, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        bumps = cv2.remap(self.bumps, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        depth, sigma = view.depth[outer], 0.6 * self.scene.settings.cell[0]
        if sigma >= 1:  # round off the ramps between the vertices' plates
            depth = cv2.GaussianBlur(depth, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        points = self.rays[outer] * depth[..., None]
        normals = surface_normals(points)
        distance_square = np.einsum("ijk,ijk->ij", lamp - points, lamp - points)
        towards = (lamp - points) / np.sqrt(distance_square)[..., None]
        facing = np.clip(np.einsum("ijk,ijk->ij", normals, towards), 0.02, 1)
        rough = normals.copy()
        rough[..., :2] += bumps
        rough /= np.linalg.norm(rough, axis=-1, keepdims=True)
        if lamp.any():  # a mirror facing half-way between lamp and lens shows the lamp
            towards -= points / np.linalg.norm(points, axis=-1, keepdims=True)
            towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        glance = np.clip(np.einsum("ijk,ijk->ij", rough, towards), 0, 1)
        falloff = EXPOSURE_DISTANCE**2 / distance_square
        highlight = self.scene.settings.highlights * np.power(glance, self.scene.settings.gloss)
        return ((albedo * facing[..., None] + highlight[..., None]) * falloff[..., None])[inner]

    def _add_fat(self, index: int, labels: np.ndarray, light: np.ndarray, depth: np.ndarray) -> None:
        """Draw a drifting ellipse of fat that hides the wanted share of the tissue."""
        settings, outline = self.scene.settings, self.scene.outline
        course = index / max(settings.frames - 1, 1)
        drift = (self.fat_course[0] * (1 - course) + self.fat_course[1] * course) * 2 - 1
        center = (outline.center + 0.5 * drift * outline.axes + 0.5) * settings.cell - 0.5
        # The ellipse has the organ's shape: its half-axes scale with the root of its share of the area.
        axes = outline.axes * settings.cell * math.sqrt(settings.occlusion)
        columns = (np.arange(settings.width) - center[0]) / axes[0]
        rows = (np.arange(settings.height) - center[1]) / axes[1]
        radius = np.square(columns) + np.square(rows)[:, None]
        fat = radius < 1
        labels[fat] = GREY["fat"]
        depth[fat] -= 0.01 + 0.04 * np.sqrt(1 - radius[fat])  # the fat lies before the tissue [scene units]
        shade = np.sqrt(1 - 0.7 * radius[fat]) * np.square(EXPOSURE_DISTANCE / depth[fat])
        speckle = self.albedo[..., 0][fat] / self.albedo[..., 0][fat].mean()
        light[fat] = np.array((0.78, 0.62, 0.25)) * (shade * (0.5 + 0.5 * speckle))[:, None]


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear light in [0, 1] to sRGB values in [0, 1] (IEC 61966-2-1)."""
    table_size = 4096
    steps = np.linspace(0, 1, table_size, dtype=np.float32) ** 2
    encoded = np.where(steps <= 0.0031308, 12.92 * steps, 1.055 * np.power(steps, 1 / 2.4) - 0.055)
    # The table is even in the root of the light, where the curve is nearly straight.
    position = np.sqrt(linear) * (table_size - 1)
    return encoded.astype(np.float32)[np.rint(position).astype(np.int32)]


def surface_normals(points: np.ndarray) -> np.ndarray:
    """Unit normals towards the camera of a grid of points, both of shape [h, w, 3]."""
    down, across = np.gradient(points, axis=(0, 1))
    normals = np.cross(down, across)
    normals *= np.where(np.einsum("ijk,ijk->ij", normals, points) > 0, -1, 1)[..., None]
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-20)


def rest_labels(scene: Scene, generator: np.random.Generator) -> np.ndarray:
    """Class codes of the sheet at rest: the organ, liver around it, abdominal wall in one corner."""
    settings = scene.settings
    sides = zip((settings.width, settings.height), settings.cell, strict=True)
    columns, rows = np.meshgrid(*((np.arange(side) + 0.5) / cell - 0.5 for side, cell in sides))
    labels = np.full(columns.shape, GREY["liver"], np.uint8)
    angle = generator.uniform(0, 2 * np.pi)
    x, y = columns / settings.grid_width - 0.5, rows / settings.grid_height - 0.5
    wave = 0.03 * np.sin(9 * x + angle) + 0.02 * np.cos(7 * y)
    beyond = 0.36
    if settings.view == "filled":
        beyond, wave = generator.uniform(0, 0.4), 0.06 * _noise(labels.shape, 0.3 * settings.width, generator)
    labels[x * math.cos(angle) + y * math.sin(angle) + wave > beyond] = GREY["abdominal wall"]
    labels[scene.outline.level(columns, rows) > 0] = GREY["gallbladder"]
    return labels


def reflectance(scene: Scene, labels: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Linear RGB reflectance of the sheet at rest, shape [H, W, 3], float32: mottled tissue with vessels."""
    shape = labels.shape
    albedo = np.empty((*shape, 3), np.float32)
    colors = np.array(list(ALBEDO.values()))
    if scene.settings.view == "filled":  # any organ may be the target
        colors = generator.permutation(colors) * np.exp(0.12 * generator.standard_normal(colors.shape))
    for name, color in zip(ALBEDO, colors, strict=True):
        albedo[labels == GREY[name]] = color
    cell = scene.settings.cell[0]
    # A soft, dark border between the organs, without moving the labels.
    albedo = cv2.GaussianBlur(albedo, (0, 0), 0.5 * cell + 0.3)
    border = cv2.morphologyEx(labels, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    crease = cv2.GaussianBlur(border.astype(np.float32), (0, 0), 1.5 * cell)
    albedo *= 1 - 0.5 * (crease / crease.max())[..., None]
    spots = ((1.0, 0.08), (2.5, 0.11), (8.0, 0.08), (30.0, 0.08))
    mottle = sum(weight * _noise(shape, size * cell, generator) for size, weight in spots)
    hue = _noise(shape, 25 * cell, generator)
    albedo *= np.exp(mottle)[..., None] * np.exp(hue[..., None] * np.array([0.02, -0.06, -0.08], np.float32))
    vessels = _vessels(shape, cell, generator)
    return albedo * (1 - vessels[..., None] * np.array([0.25, 0.6, 0.55], np.float32))


def _noise(shape: tuple[int, int], size: float, generator: np.random.Generator) -> np.ndarray:
    """Smooth noise of about unit variance with spots of a size [px]."""
    coarse = (max(round(shape[0] / size), 2), max(round(shape[1] / size), 2))
    values = generator.standard_normal(coarse).astype(np.float32)
    return cv2.resize(values, shape[::-1], interpolation=cv2.INTER_CUBIC)


def _vessels(shape: tuple[int, int], cell: float, generator: np.random.Generator) -> np.ndarray:
    """Branching dark lines, shape [H, W] in [0, 1]."""
    canvas = np.zeros(shape, np.uint8)
    for _ in range(14):
        position = generator.uniform(0, 1, 2) * [shape[1], shape[0]]
        heading = generator.uniform(0, 2 * np.pi)
        width = generator.uniform(0.3, 0.9) * cell
        turns = generator.normal(0, 0.25, 60)
        steps = np.array((np.cos(heading + np.cumsum(turns)), np.sin(heading + np.cumsum(turns)))).cumsum(axis=1).T
        course = np.round((position + steps * 1.6 * cell) * 8).astype(np.int32)
        strength = int(generator.integers(90, 220))
        for start in range(0, 60, 20):
            thickness = max(1, round(width * (1 - start / 80)))
            cv2.polylines(canvas, [course[start : start + 21]], False, strength, thickness, cv2.LINE_AA, shift=3)
    return cv2.GaussianBlur(canvas, (0, 0), 0.2 * cell + 0.2).astype(np.float32) / 255


def bumps(scene: Scene, generator: np.random.Generator) -> np.ndarray:
    """Fine relief that breaks up highlights: offsets of the normal's x and y, shape [H, W, 2], float32."""
    shape, cell = (scene.settings.height, scene.settings.width), scene.settings.cell[0]
    spots = ((2.0, 0.05), (6.0, 0.08), (18.0, 0.08))
    layers = [sum(weight * _noise(shape, size * cell, generator) for size, weight in spots) for _ in range(2)]
    return np.stack(layers, axis=-1).astype(np.float32)
