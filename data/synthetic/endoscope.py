"""Pictures of the same scenes by another law than estimators assume: what they are judged with, not made for.

The tissue is a smooth surface, not patches of vertices; it is rough (Oren and Nayar 1994), wet (Blinn 1977), and light
goes into it and comes out nearby. Lamps stand around the lens, so that an instrument throws shadows. The camera has
vignetting, an exposure that follows the picture's brightness, noise that grows with the light, and a response curve of
its own; thin smoke drifts before it.
"""

import itertools
import math

import cv2
import numpy as np

from palpate.data.synthetic.render import Renderer, labels_in, surface_normals
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.surface import SMALLEST_DRAWN, SheetView
from palpate.data.synthetic.tool import EXPOSURE_DISTANCE, Tool, draw_tool
from palpate.data.synthetic.truth import TrueMotion

SCATTERING = (0.9, 0.5, 0.35)
"""How far light spreads in tissue, a standard deviation: red, green and blue [grid px]."""
TARGET, FOLLOWED, STEP = 0.2, 0.15, 0.02
"""Mean light that the exposure is after, the share of what is missing that it takes up a frame, and the logarithm by
which it changes at least."""


class EndoscopeRenderer(Renderer):
    """Draws the frames of one scene, with a camera and lamps that are drawn with it."""

    def __init__(self, scene: Scene, motion: TrueMotion, generator: np.random.Generator) -> None:
        super().__init__(scene, motion, generator)
        camera, cell = scene.camera, scene.settings.cell
        angles = generator.uniform(0, 2 * np.pi) + np.arange(4) * np.pi / 2
        radius, self._roughness = generator.uniform(0.015, 0.03), generator.uniform(0.15, 0.4)
        self._lamps = (radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(4)], axis=1)).astype(np.float32)
        """Places [scene units]."""
        self._shares = (0.25 + generator.uniform(0, 0.2) * np.array([1, -1, 1, -1])).astype(np.float32)
        self._power, self._shoulder = generator.uniform(0.42, 0.52), generator.uniform(0, 0.3)
        distance = np.square(self.rays[..., :2]).sum(axis=-1)
        self._vignetting = 1 - generator.uniform(0.1, 0.4) * distance / distance.max()
        self._smoke, self._drift = generator.uniform(0, 0.08), generator.uniform(-1, 1, 2)
        sides = (camera.height, cell[1]), (camera.width, cell[0])
        # Wisps of smoke are 40 grid px wide.
        coarse = [round(side / of_cell / 40.0 * 2) + 2 for side, of_cell in sides]
        self._wisps = np.clip(0.5 + 0.3 * generator.standard_normal(coarse), 0, 1).astype(np.float32)
        self._gain: float | None = None
        """Logarithm of the exposure; None before the first frame, which finds its own."""
        self._lit = self._lamplight(self.rest, np.s_[:, :])
        """Of tissue at rest without shadows."""

    def frame(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw a frame, as `Renderer.frame` does; exposure goes on from the last one, too."""
        view = self._view(index)
        labels, depth = labels_in(view, self.rest_labels), view.depth.copy()
        tool = draw_tool(self.scene, self.motion, index, view) if self.scene.settings.tool_in_view else None
        light = self._lamplit(view, tool)
        if tool is not None:
            tool.paint(labels, light, depth)
        return self._camera(light, index), labels, depth

    def _view(self, index: int) -> SheetView:
        """The sheet, whose displacement is smooth between the vertices."""
        scene, camera = self.scene, self.scene.camera
        moved = np.zeros((*scene.mesh.grid_shape, 3), np.float32)
        moved[tuple(scene.mesh.pixels[self.motion.moving].T)] = self.motion.field[index]
        if not moved.any():
            return self.rest
        fine = cv2.resize(moved, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
        points = self.rays * self.rest.depth[..., None]
        after = points + fine
        if np.abs(fine).max() <= SMALLEST_DRAWN:
            return self.rest
        focal = np.array([camera.fx, camera.fy], np.float32)
        shift = focal * (after[..., :2] / after[..., 2:] - points[..., :2] / points[..., 2:])
        place_u, place_v = self.rest.rest_u, self.rest.rest_v
        for _ in range(4):  # where what is visible lay at rest, by iteration
            there = cv2.remap(shift, place_u, place_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            place_u, place_v = self.rest.rest_u - there[..., 0], self.rest.rest_v - there[..., 1]
        depth = cv2.remap(
            np.ascontiguousarray(after[..., 2]), place_u, place_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        changed = np.argwhere(np.abs(fine).max(axis=-1) > SMALLEST_DRAWN)
        reach = math.ceil(float(np.abs(shift).max())) + 4
        low, high = np.maximum(changed.min(axis=0) - reach, 0), changed.max(axis=0) + reach + 1
        return SheetView(depth, place_u, place_v, (slice(low[0], high[0]), slice(low[1], high[1])))

    def _lamplit(self, view: SheetView, tool: Tool | None) -> np.ndarray:
        """Linear light of the tissue, shape [H, W, 3]."""
        lit, region = self._lit, view.region
        if region[0].stop:
            lit = lit.copy()
            lit[:, :, *region] = self._lamplight(view, region)
        if tool is not None:
            lit = lit * np.stack([1 - self._shadow(tool, view.depth, lamp) for lamp in self._lamps])
        diffuse, gloss = lit.sum(axis=1)
        maps, cell = (view.rest_u, view.rest_v), self.scene.settings.cell[0]
        albedo = cv2.remap(self.albedo, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        inside = np.stack([cv2.GaussianBlur(diffuse, (0, 0), reach * cell) for reach in SCATTERING], axis=-1)
        return albedo * inside + 0.3 * self.scene.settings.highlights * gloss[..., None]

    def _lamplight(self, view: SheetView, region: tuple[slice, slice]) -> np.ndarray:
        """What tissue in a region sends back of every lamp's light, diffusely and as gloss, shape [2, 4, h, w]."""
        maps = view.rest_u[region], view.rest_v[region]
        points = (self.rays * view.depth[..., None])[region]
        normal = surface_normals(points).astype(np.float32)
        rough = normal.copy()
        rough[..., :2] += cv2.remap(self.bumps, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        rough /= np.linalg.norm(rough, axis=-1, keepdims=True)
        towards = -points / np.linalg.norm(points, axis=-1, keepdims=True)
        square = self._roughness**2
        level, slope = 1 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)  # Oren and Nayar's A and B
        out = np.clip(_dot(normal, towards), 0.02, 1)
        found = np.empty((2, len(self._lamps), *points.shape[:2]), np.float32)
        for index, (lamp, share) in enumerate(zip(self._lamps, self._shares, strict=True)):
            ray = lamp - points
            distance = np.linalg.norm(ray, axis=-1)
            ray /= distance[..., None]
            into = np.clip(_dot(normal, ray), 0, 1)
            # cos(φi - φr) · sin α · tan β, of the angles of light that comes and goes.
            same = np.maximum(_dot(ray, towards) - into * out, 0) / np.maximum(np.maximum(into, out), 0.02)
            half = ray + towards
            half /= np.linalg.norm(half, axis=-1, keepdims=True)
            reaches = share * np.square(EXPOSURE_DISTANCE / distance)
            found[0, index] = reaches * into * (level + slope * same)
            found[1, index] = reaches * np.power(np.clip(_dot(rough, half), 0, 1), 180.0)
        return found

    def _shadow(self, tool: Tool, depth: np.ndarray, lamp: np.ndarray) -> np.ndarray:
        """Share of a lamp's light that the tool keeps from the tissue, shape [H, W]."""
        camera, shadow = self.scene.camera, np.zeros(depth.shape, np.uint8)
        if not len(tool.rows):
            return shadow.astype(np.float32)
        behind = depth[tool.rows, tool.columns]
        shift = 1 / np.maximum(tool.depth, 1e-3) - 1 / behind
        # Depths in which the shadow is thrown.
        edges = np.quantile(shift, np.linspace(0, 1, 6))
        for low, high in itertools.pairwise(edges):
            some = (shift >= low) & (shift <= high)
            moved = -0.5 * (low + high) * lamp[:2] * [camera.fx, camera.fy]
            columns = np.rint(tool.columns[some] + moved[0]).astype(int)
            rows = np.rint(tool.rows[some] + moved[1]).astype(int)
            inside = (rows >= 0) & (rows < depth.shape[0]) & (columns >= 0) & (columns < depth.shape[1])
            shadow[rows[inside], columns[inside]] = 1
        # Lamps are areas, not points.
        return cv2.GaussianBlur(shadow.astype(np.float32), (0, 0), 0.5 * self.scene.settings.cell[0])

    def _camera(self, light: np.ndarray, index: int) -> np.ndarray:
        """A picture of the light: smoke, vignetting, exposure, lens, noise, response, 8 bits."""
        height, width = light.shape[:2]
        course = self._drift * index * self.scene.settings.cell
        around = np.array([[1, 0, course[0]], [0, 1, course[1]]], np.float32)
        wisps = cv2.resize(self._wisps, (width, height), interpolation=cv2.INTER_CUBIC)
        smoke = self._smoke * cv2.warpAffine(wisps, around, (width, height), borderMode=cv2.BORDER_REFLECT)
        light = (light * (1 - smoke[..., None]) + 0.5 * smoke[..., None]) * self._vignetting[..., None]
        gain = 0.0 if self._gain is None else self._gain
        wanted = math.log(TARGET / max(float(np.minimum(light * math.exp(gain), 1).mean()), 1e-6))
        gain += wanted if self._gain is None else STEP * round(FOLLOWED * wanted / STEP)
        self._gain = gain
        blur = 0.15 * self.scene.settings.cell[0] + 0.05
        exposed = cv2.GaussianBlur((light * math.exp(gain)).astype(np.float32), (0, 0), blur)
        noise = self.noise.standard_normal(exposed.shape, dtype=np.float32)
        exposed = exposed + self.scene.settings.image_noise * np.sqrt(0.1 + np.clip(exposed, 0, 1)) * noise
        curve = np.power(np.clip(exposed, 0, 1), self._power)
        shown = (1 - self._shoulder) * curve + self._shoulder * curve * curve * (3 - 2 * curve)
        return np.clip(shown * 255 + 0.5, 0, 255).astype(np.uint8)


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.einsum("ijk,ijk->ij", first, second)
