"""Instruments as shaded solids: shafts, collars, wrists, jaws, hooks, electrodes, seen by a lamp at the lens.

Every part is a cone along an axis in the picture. Its normal follows from the place across the axis, which gives the
solid's shading under the camera's light: bright in the middle, dark at the sides, with highlights along the axis.
"""

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Material:
    """Material of a part."""

    color: np.ndarray
    """Reflected colour under full light, shape [3]."""
    gloss: float
    """Brightness of the highlight along the axis."""
    mirror: float = 0.0
    """Share of streaks, like reflections in bare metal."""
    stripes: float = 0.0
    """Contrast of rings across the axis, like grooves, threads and print."""


def draw_material(kinds: tuple[str, ...], rng: np.random.Generator) -> Material:
    """Draw a material of one of some kinds: dark, steel, white, grey, colored or gold."""
    kind, grey = str(rng.choice(kinds)), rng.uniform(-0.02, 0.02, 3)
    if kind == "dark":
        return Material(rng.uniform(0.02, 0.2) + grey / 2, rng.choice([0.0, rng.uniform(0.1, 0.8)]))
    if kind == "grey":
        return Material(rng.uniform(0.2, 0.6) + grey, rng.uniform(0, 0.5), stripes=rng.choice([0, 0, 0.3]))
    if kind == "white":
        return Material(rng.uniform(0.7, 1.1) + grey, rng.uniform(0, 0.6))
    if kind == "steel":
        streaks, rings = rng.uniform(0.3, 1.0), rng.choice([0, 0, 0.4])
        return Material(rng.uniform(0.35, 0.9) + grey, rng.uniform(0.2, 1.0), streaks, rings)
    if kind == "gold":
        return Material(rng.uniform((0.5, 0.35, 0.05), (0.8, 0.55, 0.2)), rng.uniform(0.2, 0.8), 0.4)
    hue, saturation = rng.choice([rng.integers(35, 130), rng.integers(0, 180)]), rng.integers(60, 230)
    color = cv2.cvtColor(np.array([[[hue, saturation, 220]]], np.uint8), cv2.COLOR_HSV2RGB)[0, 0]
    return Material(color / 255 * rng.uniform(0.3, 1.0), rng.uniform(0, 0.6))


@dataclass
class Canvas:
    """A picture under an instrument's parts, which are drawn from back to front."""

    picture: np.ndarray
    """RGB, float32 [H, W, 3], 0 to 1 and more where it is overexposed."""
    tool: np.ndarray
    """Mask of the instrument, bool [H, W]."""
    rng: np.random.Generator
    light: float = 1.0
    """Brightness of the lamp on the instrument."""

    def part(self, begin: np.ndarray, end: np.ndarray, widths: tuple[float, float], material: Material) -> None:
        """Draw a cone from (x, y) to (x, y) [px], of widths at both ends [px]."""
        length = float(np.hypot(*(end - begin)))
        if length < 0.5:
            return
        axis, half = (end - begin) / length, np.array(widths) / 2
        across = np.array([-axis[1], axis[0]])
        sides = across * half[0], across * half[1]
        corners = np.array([begin + sides[0], end + sides[1], end - sides[1], begin - sides[0]])
        height, width = self.tool.shape
        left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
        right, bottom = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 2, (width, height))
        if left >= right or top >= bottom:
            return
        cover = np.zeros((bottom - top, right - left), np.uint8)
        fixed = np.round((corners - (left, top)) * 16).astype(np.int32)
        cv2.fillConvexPoly(cover, fixed, 255, cv2.LINE_AA, 4)  # 4 bits of a fraction
        v, u = np.mgrid[top:bottom, left:right].astype(np.float32)
        along = ((u - begin[0]) * axis[0] + (v - begin[1]) * axis[1]) / length
        radius = np.maximum(half[0] + (half[1] - half[0]) * np.clip(along, 0, 1), 0.5)
        aside = np.clip(((u - begin[0]) * across[0] + (v - begin[1]) * across[1]) / radius, -1, 1)
        where, alpha = np.s_[top:bottom, left:right], cover.astype(np.float32)[..., None] / 255
        self.picture[where] += alpha * (self._shade(along, aside, material) - self.picture[where])
        self.tool[where][cover > 127] = True

    def _shade(self, along: np.ndarray, aside: np.ndarray, material: Material) -> np.ndarray:
        """Colour [h, w, 3] at places along the axis, 0 to 1, and across it, -1 to 1."""
        rng = self.rng
        lit = 0.15 + 0.85 * np.sqrt(1 - aside * aside) ** rng.uniform(0.5, 1.6)
        value = np.asarray(material.color, np.float32) * lit[..., None]
        if material.mirror:
            knots = rng.uniform(0.1, 1.3, rng.integers(5, 14))
            streaks = np.interp(aside, np.linspace(-1, 1, len(knots)), knots)[..., None]
            # Bare metal reflects reddish tissue.
            reflected = streaks * (np.array([1.0, 0.76, 0.72]) * material.color)
            value = value + material.mirror * (reflected - value)
        if material.stripes:
            rings = np.sin(along * rng.uniform(8, 60) + rng.uniform(0, 6)) + rng.uniform(-0.5, 0.9) > 0
            value = value * (1 - material.stripes * rings)[..., None]
        if material.gloss:
            place, narrow = rng.uniform(-0.6, 0.6), rng.uniform(0.03, 0.25)
            value = value + (material.gloss * np.exp(-(((aside - place) / narrow) ** 2)))[..., None]
        fades = self.light * (1 + rng.uniform(-0.5, 0.5) * (along[..., None] - 0.5))
        return np.clip(value * fades, 0, 1.6).astype(np.float32)


def draw_instrument(canvas: Canvas, entry: np.ndarray, tip: np.ndarray, width: float) -> None:
    """Draw an instrument from its entry to its tip, (x, y) [px] each; `width` is that of its shaft at the tip [px]."""
    rng = canvas.rng
    canvas.light = rng.uniform(0.5, 1.5)
    length = float(np.hypot(*(tip - entry)))
    axis, taper = (tip - entry) / max(length, 1e-6), rng.uniform(1.0, 1.9)
    neck = tip - axis * min(width * rng.uniform(1.5, 5.0), 0.8 * length)
    shaft = draw_material(("dark", "dark", "dark", "steel", "grey", "white", "colored", "gold"), rng)
    metal = draw_material(("steel", "steel", "steel", "grey", "dark", "gold"), rng)
    ends = ("jaws", "jaws", "jaws", "fenestrated", "scissors", "hook", "cone", "suction", "wrist", "wrist", "stump")
    end = str(rng.choice((*ends, "clip")))
    canvas.part(entry, neck, (width * taper, width), shaft)
    if rng.random() < 0.3:  # a band of another material
        place = rng.uniform(0.1, 0.9)
        places = np.array([place, min(place + rng.uniform(0.02, 0.25), 1)])
        wide = width * (taper + (1 - taper) * places) * rng.uniform(1.0, 1.15, 2)
        begin, over = entry + np.outer(places, neck - entry)
        canvas.part(begin, over, tuple(wide), draw_material(("white", "grey", "steel", "colored", "dark"), rng))
    draw = {"hook": _hook, "cone": _hook, "stump": _stump, "suction": _stump, "wrist": _wrist}.get(end, _jaws)
    draw(canvas, neck, tip, width, metal, end)


def _turned(axis: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]]) @ axis


def _jaws(canvas: Canvas, neck: np.ndarray, tip: np.ndarray, width: float, metal: Material, end: str) -> None:
    """Two jaws on a joint, open or closed; fenestrated ones have slots, through which the background shows."""
    rng, head = canvas.rng, float(np.hypot(*(tip - neck)))
    axis = (tip - neck) / max(head, 1e-6)
    joint = neck + axis * head * rng.uniform(0.15, 0.5)
    canvas.part(neck, joint, (width * rng.uniform(0.75, 1.0), width * rng.uniform(0.7, 1.0)), metal)
    long = float(np.hypot(*(tip - joint)))
    opening = rng.choice([rng.uniform(0, 0.08), rng.uniform(0.08, 0.9)])
    one_moves, bend = rng.random() < 0.2, rng.uniform(-0.4, 0.4) * (rng.random() < 0.4)
    wide = width * {"scissors": 0.3, "clip": 0.45}.get(end, rng.uniform(0.25, 0.55))
    for side in (-1, 1):
        way = _turned(axis, (side > 0) * opening if one_moves else side * opening / 2)
        start = joint + _turned(axis, np.pi / 2) * side * width * 0.18
        middle = start + way * long * 0.55
        last = middle + _turned(way, bend - side * rng.uniform(0, 0.15)) * long * 0.45
        before = canvas.picture.copy() if end == "fenestrated" else None
        canvas.part(start, middle, (wide * 1.2, wide), metal)
        canvas.part(middle, last, (wide, wide * rng.uniform(0.3, 0.9)), metal)
        radius = max(wide * 0.35, 1)
        canvas.part(last - way * radius, last + way * radius, (radius * 1.6, radius * 0.8), metal)
        if before is not None:
            slot = np.zeros(canvas.tool.shape, np.uint8)
            ends = [(start + (last - start) * share).astype(int) for share in (0.25, 0.8)]
            cv2.line(slot, *ends, 1, max(int(wide * 0.4), 1), cv2.LINE_AA)
            canvas.picture[slot > 0] = before[slot > 0] * 0.8


def _wrist(canvas: Canvas, neck: np.ndarray, tip: np.ndarray, width: float, metal: Material, end: str) -> None:
    """Links of an articulated wrist, bent, with jaws at their end."""
    rng, head = canvas.rng, float(np.hypot(*(tip - neck)))
    way, bend = (tip - neck) / max(head, 1e-6), rng.uniform(-0.7, 0.7)
    for _ in range(2):
        way = _turned(way, bend / 2)
        after = neck + way * head * 0.28
        widths = width * rng.uniform(0.7, 1.05), width * rng.uniform(0.7, 1.0)
        canvas.part(neck, after, widths, draw_material(("steel", "dark", "steel"), rng))
        neck = after
    _jaws(canvas, neck, neck + way * head * rng.uniform(0.5, 0.9), width * 0.8, metal, "jaws")


def _hook(canvas: Canvas, neck: np.ndarray, tip: np.ndarray, width: float, metal: Material, end: str) -> None:
    """Insulating cone with a thin electrode: a hook, a needle or a spatula."""
    rng = canvas.rng
    cone, thin = neck + (tip - neck) * rng.uniform(0.3, 0.8), max(width * rng.uniform(0.12, 0.3), 1.5)
    insulation = draw_material(("white", "white", "grey", "dark", "steel"), rng)
    canvas.part(neck, cone, (width, max(width * rng.uniform(0.25, 0.6), thin)), insulation)
    canvas.part(cone, tip, (thin, thin), metal)
    if end == "hook":
        axis = (tip - neck) / max(float(np.hypot(*(tip - neck))), 1e-6)
        side = _turned(axis, rng.choice([-1, 1]) * rng.uniform(1.0, 1.8))
        canvas.part(tip, tip + side * width * rng.uniform(0.3, 0.8), (thin, thin), metal)


def _stump(canvas: Canvas, neck: np.ndarray, tip: np.ndarray, width: float, metal: Material, end: str) -> None:
    """Blunt end, as in a suction tube with its holes, a trocar or a stapler."""
    rng = canvas.rng
    canvas.part(neck, tip, (width, width * rng.uniform(0.7, 1.05)), metal)
    axis = (tip - neck) / max(float(np.hypot(*(tip - neck))), 1e-6)
    rim = tip + axis * max(width * rng.uniform(0.02, 0.2), 1)
    canvas.part(tip, rim, (width * rng.uniform(0.5, 1.0), width * rng.uniform(0.3, 0.8)), metal)
    for _ in range(rng.integers(0, 4) if end == "suction" else 0):
        hole = (neck + (tip - neck) * rng.uniform(0.3, 0.95)).astype(int)
        cv2.circle(canvas.picture, hole, max(int(width * 0.12), 1), (0.02, 0.01, 0.01), -1, cv2.LINE_AA)
