"""Backgrounds without instruments: procedural tissue, real pictures, gauze, drapes, rims and lettering."""

import cv2
import numpy as np

PALETTE = np.array(
    [
        [120, 40, 35], [85, 25, 25], [150, 60, 50], [190, 90, 80], [205, 130, 120], [225, 170, 150], [215, 160, 80],
        [200, 150, 60], [170, 120, 70], [160, 140, 110], [120, 90, 60],
        [180, 80, 70], [90, 60, 70], [140, 110, 120], [200, 180, 170],
        [205, 195, 195], [165, 170, 185], [225, 215, 200], [150, 145, 155],
    ],
    np.float32,
) / 255  # fmt: skip
"""Colours of liver, bowel, fat, gall bladder, bloody tissue, and of pale and grey membranes under white light."""


def smooth_noise(rng: np.random.Generator, size: tuple[int, int], cells: float) -> np.ndarray:
    """Smooth noise of unit scale, float32 [H, W], with `cells` cells along the longer side."""
    height, width = size
    long = max(height, width)
    cells_of = tuple(max(int(cells * side / long), 1) + 3 for side in size)
    grid = rng.standard_normal(cells_of).astype(np.float32)
    return cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)


def tissue(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """Tissue of a few organs under a lamp at the lens, RGB float32 [H, W, 3]."""
    height, width = size
    picture = np.empty((height, width, 3), np.float32)
    picture[:] = PALETTE[rng.integers(len(PALETTE))]
    relief = smooth_noise(rng, size, rng.uniform(1, 4)) * rng.uniform(0.5, 1.5)
    for _ in range(rng.integers(1, 5)):
        shape = smooth_noise(rng, size, rng.uniform(1, 5)) - rng.uniform(-0.2, 1.0)
        edge = np.clip(shape * rng.uniform(5, 60) + 0.5, 0, 1)[..., None]
        grain = smooth_noise(rng, size, rng.uniform(8, 60))[..., None] * rng.uniform(0, 0.12)
        picture += edge * (PALETTE[rng.integers(len(PALETTE))] * rng.uniform(0.6, 1.25) * (1 + grain) - picture)
        relief += np.minimum(np.maximum(shape, 0), rng.uniform(0.1, 1)) * rng.uniform(0, 3)
    if rng.random() < 0.5:  # lobes of fat, folds
        cells = rng.uniform(5, 25)
        relief += np.abs(smooth_noise(rng, size, cells)) * rng.uniform(2, 8) / cells
    if rng.random() < 0.6:
        fine = rng.uniform(20, 90)
        relief += smooth_noise(rng, size, fine) * rng.uniform(0.1, 0.8) / fine
    for _ in range(rng.integers(0, 6)):  # vessels
        points = np.cumsum(rng.normal(0, width / 14, (12, 2)), axis=0) + rng.uniform(0, 1, 2) * (width, height)
        layer = np.zeros(size, np.float32)
        cv2.polylines(layer, [points.astype(np.int32)], False, 1.0, int(rng.integers(1, 4)), cv2.LINE_AA)
        layer = cv2.GaussianBlur(layer, (0, 0), rng.uniform(0.5, 1.5))[..., None] * rng.uniform(0.2, 0.8)
        picture += layer * (
            np.array(rng.choice([[0.4, 0.05, 0.08], [0.35, 0.1, 0.2], [0.9, 0.8, 0.7]]), np.float32) - picture
        )
    slope = width * rng.uniform(0.04, 0.14)
    gy, gx = np.gradient(relief)
    facing = 1 / np.sqrt(1 + (gx * gx + gy * gy) * slope * slope)
    picture *= (0.25 + 0.75 * facing ** rng.uniform(0.8, 2))[..., None]
    if rng.random() < 0.8:  # wet
        tilt = (gx * slope + rng.normal(0, 0.15)) ** 2 + (gy * slope + rng.normal(0, 0.15)) ** 2
        wet = np.exp(-tilt / rng.uniform(0.002, 0.03)) * (
            smooth_noise(rng, size, rng.uniform(3, 40)) > rng.uniform(0, 1.6)
        )
        picture += cv2.GaussianBlur(wet.astype(np.float32), (0, 0), rng.uniform(0.4, 1.2))[..., None] * rng.uniform(
            0.2, 1.2
        )
    return picture * lamp(rng, size, relief)


def lamp(rng: np.random.Generator, size: tuple[int, int], relief: np.ndarray | None = None) -> np.ndarray:
    """Fall-off of the lamp's light with the distance from the middle and with depth, float32 [H, W, 1]."""
    height, width = size
    v, u = np.mgrid[:height, :width].astype(np.float32)
    away = ((u / width - rng.uniform(0.1, 0.9)) ** 2 + (v / height - rng.uniform(0.1, 0.9)) ** 2) * rng.uniform(0, 5)
    if relief is not None:
        away = away + np.maximum(-smooth_noise(rng, size, rng.uniform(1, 3)) - rng.uniform(-0.3, 1), 0) * rng.uniform(
            0, 4
        )
    return (rng.uniform(0.6, 1.4) / (1 + away))[..., None]


def sparkle(rng: np.random.Generator, picture: np.ndarray) -> None:
    """Scatter highlights over wet tissue: specks and streaks in clusters."""
    height, width = picture.shape[:2]
    light = np.zeros((height, width), np.float32)
    for _ in range(rng.integers(1, 5)):
        middle, spread = rng.uniform(0, 1, 2) * (width, height), width * rng.uniform(0.01, 0.09, 2)
        for place in rng.normal(middle, spread, (rng.integers(5, 70), 2)):
            axes = tuple(rng.integers(0, 4, 2).tolist())
            cv2.ellipse(light, place.astype(int), axes, rng.uniform(0, 180), 0, 360, 1.0, -1, cv2.LINE_AA)
    light = cv2.GaussianBlur(light, (0, 0), rng.uniform(0.4, 1.0))[..., None] * rng.uniform(0.4, 1.2)
    picture += light * (np.array([1.05, 1.0, 1.0]) - 0.5 * picture)


def cloth(rng: np.random.Generator, picture: np.ndarray) -> None:
    """Lay gauze, a membrane, a drape or a clip-like crumb over a part of a picture; none of these is an instrument."""
    size = picture.shape[:2]
    shape = smooth_noise(rng, size, rng.uniform(1, 4)) - rng.uniform(0.2, 1.3)
    edge = np.clip(shape * rng.uniform(15, 80), 0, 1)
    if rng.random() < 0.3:  # vessels shine through a membrane
        veins = np.exp(-np.square(smooth_noise(rng, size, rng.uniform(6, 20)) / rng.uniform(0.05, 0.2)))
        edge = edge * (1 - rng.uniform(0.2, 0.8) * veins)
    # Colours of gauze, membranes and drapes.
    colors = np.array([[90, 90, 85], [60, 60, 60], [75, 70, 65], [15, 30, 40], [20, 40, 70], [40, 40, 45]], np.float32)
    color = colors[rng.integers(len(colors))] / 100
    weave = 1.0
    if rng.random() < 0.5:
        v, u = np.mgrid[: size[0], : size[1]].astype(np.float32)
        pitch, turn = rng.uniform(2, 6), rng.uniform(0, np.pi)
        weave = 1 + rng.uniform(0.05, 0.3) * np.sin((u * np.cos(turn) + v * np.sin(turn)) * 2 * np.pi / pitch) * np.sin(
            (v * np.cos(turn) - u * np.sin(turn)) * 2 * np.pi / pitch
        )
    folds = smooth_noise(rng, size, rng.uniform(3, 12))
    value = color * (np.clip(0.75 + 0.25 * folds, 0.1, 1.3) * weave)[..., None] * rng.uniform(0.4, 1.2)
    picture += (edge * rng.uniform(0.25, 1.0))[..., None] * (value - picture)


def thread(rng: np.random.Generator, picture: np.ndarray) -> None:
    """Draw a suture or a drain, which is no instrument here."""
    size = picture.shape[:2]
    points = np.cumsum(rng.normal(0, size[1] / 10, (8, 2)), axis=0) + rng.uniform(0, 1, 2) * size[::-1]
    color = rng.choice([[0.1, 0.1, 0.5], [0.8, 0.8, 0.9], [0.05, 0.05, 0.05], [0.3, 0.1, 0.5]])
    cv2.polylines(picture, [points.astype(np.int32)], False, color, int(rng.choice([1, 1, 2, 5])), cv2.LINE_AA)


def rim(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """View through the endoscope, float32 [H, W, 1] in [0, 1]: round, octagonal or rectangular."""
    height, width = size
    kind = rng.choice(["none", "round", "round", "octagon", "box"], p=[0.45, 0.2, 0.15, 0.1, 0.1])
    view = np.zeros(size, np.float32)
    centre = (width * rng.uniform(0.44, 0.56), height * rng.uniform(0.44, 0.56))
    if kind == "none":
        return np.ones((height, width, 1), np.float32)
    if kind == "round":
        cv2.circle(view, tuple(int(v) for v in centre), int(width * rng.uniform(0.3, 0.56)), 1.0, -1, cv2.LINE_AA)
    else:
        w, h = width * rng.uniform(0.3, 0.5), height * rng.uniform(0.4, 0.52)
        cut = min(w, h) * (rng.uniform(0.15, 0.5) if kind == "octagon" else 0.0)
        x, y = np.array([-w, -w + cut, w - cut, w]), np.array([-h, -h + cut, h - cut, h])
        corners = np.column_stack([x[[0, 1, 2, 3, 3, 2, 1, 0]], y[[1, 0, 0, 1, 2, 3, 3, 2]]])
        cv2.fillConvexPoly(view, (corners + centre).astype(np.int32), 1.0, cv2.LINE_AA)
    return cv2.GaussianBlur(view, (0, 0), rng.uniform(0.4, 2.0))[..., None]


def lettering(rng: np.random.Generator, picture: np.ndarray) -> None:
    """Write console text, boxes and bars over a picture."""
    height, width = picture.shape[:2]
    for _ in range(rng.integers(1, 5)):
        across, down = rng.uniform(0, 0.9), rng.choice([rng.uniform(0, 0.12), rng.uniform(0.88, 1), rng.uniform(0, 1)])
        corner = int(across * width), int(down * height)
        grey = float(rng.choice([0.9, 0.1, 0.5]))
        color = (grey, grey, float(rng.choice([grey, 0.9])))
        if rng.random() < 0.4:
            long = int(rng.uniform(0.03, 0.4) * width), int(rng.uniform(0.02, 0.09) * height)
            cv2.rectangle(picture, corner, (corner[0] + long[0], corner[1] + long[1]), color, -1)
        text = "".join(chr(c) for c in rng.integers(40, 91, rng.integers(2, 14)))
        ink = np.zeros((height, width), np.uint8)
        cv2.putText(ink, text, corner, int(rng.integers(0, 3)), rng.uniform(0.25, 0.6), 255, 1, cv2.LINE_AA)
        letters = 1 - np.array(color, np.float32) if rng.random() < 0.5 else np.array(color, np.float32)
        picture += (ink[..., None] / np.float32(255)) * (letters - picture)
