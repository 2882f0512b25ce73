"""Brightness sequences of simulated presses from geometry alone: what the network by light is trained on.

A sheet is pressed by the simulator and lit by the law of light (`estimators.direct.brightness`), with all that a video
gets wrong drawn at random: tilt and distance, roughness, gloss, lobe, spreading, response and ambient share, the dent's
place and the instants of the press, every place's albedo and gloss, errors that persist, noise, gain, what an
instrument and highlights hide, and a coder that leaves small changes of its blocks out. No picture is rendered, and
nothing is read but what the simulator was given.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Self

import numpy as np
from scipy.fft import dct
from scipy.ndimage import gaussian_filter

from palpate.data.brightness.light import level_of_light
from palpate.data.brightness.sequence import PLACES, SIDE, BrightnessSequence
from palpate.data.contact.features import FRAME_RATE, SLOTS, slot_times
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.light_features import LightSlots, light_amounts, light_slots
from palpate.data.synthetic.tool import TIP_START, jaw_width
from palpate.estimators.direct.brightness import LARGEST, LAW, OTHERS, PRIOR_MEAN, PRIOR_SD, BrightnessProblem
from palpate.estimators.direct.brightness_fit import WITHIN
from palpate.estimators.direct.motion import FITTED
from palpate.estimators.network.fits import SCENES
from palpate.physics.load import Press, held
from palpate.physics.mechanics import RECOMMENDED
from palpate.physics.mesh import Mesh, grid_mesh
from palpate.physics.observation import Observation

MOTIONS, LIGHTS, CODINGS = 6, 2, 3
"""Presses of a sheet, how each is lit, and how each of these is coded and hidden."""
ATTEMPTS = 20
"""Draws of a press until one's force lies in the admissible box."""
GRID = 120, 214
"""Rows and columns of the grid."""
FIELDS_OF_VIEW = 50.0, 70.0
"""Of the cameras [degrees]."""
DISTANCES = 0.22, 0.65
"""Of the tissue from the camera [scene units]."""
DEEPEST = 0.015, 0.16
"""Largest displacements, in shares of that distance."""
BORDER, RADIUS = 22, 40
"""Contacts keep so far from the picture's border, and sheets end so far from contacts [grid pixels]."""
PRESSED = 0.16, 0.56
"""Times under load [s]."""
ANY_TISSUE = 0.3
"""Share of presses whose tissue is drawn from the whole admissible box, not from the scenes' ranges."""
NONE = 1 / 3
"""Share of sequences without gloss, of those without roughness, and of those without light from everywhere; half as
many have none of the three."""
STEEPEST = 0.6
"""Tangent of the largest tilt."""
ASIDE = 1.2
"""Standard deviation of the dent's place by axis [grid pixels]."""
AT_TIP = 0.4
"""The same of an instrument's tip, around that."""
DELAY = 0.5
"""Standard deviation of the instants of a press, in units of the longest delays."""
LEVELS = -2.2, -0.3
"""Logarithms of the tissue's light at rest, in shares of white."""
STEPS = 3.0, 24.0
"""Quantisation steps of a coder [levels of 8 bits], those of quantisation parameters 14 to 32."""
DEAD = 0.15, 0.4
"""What a coder adds to a coefficient over its step before it cuts the fraction off: less than half leaves more out."""
UNCODED = 0.15
"""Share of sequences that are not coded."""
BLOCK = 4
"""Places of the lattice along a coder's block: of 8 pixels where a place is the mean of 2 × 2."""
_DCT = dct(np.eye(BLOCK), axis=0, norm="ortho")


class LightDraws(NamedTuple):
    """Brightness sequences with the parameters of their presses."""

    slots: LightSlots
    logs: np.ndarray
    """log k_s, log k_d and log |F|, shape [B, 3]."""

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Several, at least one, as one."""
        return cls(LightSlots.joined([part.slots for part in parts]), np.concatenate([part.logs for part in parts]))

    def chosen(self, some: np.ndarray | slice) -> Self:
        """Some of them."""
        return type(self)(self.slots.chosen(some), self.logs[some])


def draw_light(seed: int) -> LightDraws | None:
    """Presses of one sheet, lit and coded; None where no press could be drawn."""
    generator = np.random.default_rng([seed, 5])
    mesh, vertex, distance = _sheet(generator)
    angle = generator.uniform(0, 2 * math.pi)
    steepness = abs(generator.normal(0, 0.2)) if generator.random() < 0.7 else generator.uniform(0, 0.55)
    tilt = min(steepness, STEEPEST) * np.array([math.cos(angle), math.sin(angle)])
    parts = []
    for _ in range(MOTIONS):
        contact = _contact(mesh, vertex, generator)
        problem = BrightnessProblem(contact, FITTED, WITHIN / FRAME_RATE, tilt)
        press = _press(problem, distance, generator)
        if press is None:
            continue
        delayed = problem.within * press[problem.motion.delays]
        moved = problem.motion.quick(press)
        for _ in range(LIGHTS):
            logs = _lit(press, tilt, generator)
            lit, law = (part.reshape(SLOTS, SIDE, SIDE) for part in problem.predicted(logs, moved))
            for _ in range(CODINGS):
                shown = _shown(contact.load_seconds + delayed[1], logs[-OTHERS : 2 - OTHERS], generator)
                observed, step = _observed(contact, lit, law, shown, generator)
                slots = dataclasses.replace(light_slots(observed)[0], step=np.array([step]))
                parts.append(LightDraws(slots, press[None, :3]))
    return LightDraws.joined(parts) if parts else None


def _sheet(generator: np.random.Generator) -> tuple[Mesh, int, float]:
    """A plane that faces the camera, its contact and its distance; its outline and its camera count."""
    rows, columns = np.indices(GRID).astype(np.float64)
    focal = 0.5 * GRID[1] / math.tan(math.radians(generator.uniform(*FIELDS_OF_VIEW)) / 2)
    distance = _between(generator, DISTANCES)
    pixel = np.array([int(generator.integers(BORDER, size - BORDER)) for size in GRID])
    down, across = rows - pixel[0], columns - pixel[1]
    valid = (np.abs(down) <= RADIUS) & (np.abs(across) <= RADIUS)
    if generator.random() < 0.5:
        angle = generator.uniform(0, 2 * math.pi)
        valid &= down * math.sin(angle) + across * math.cos(angle) < generator.uniform(10, RADIUS)
    rays = np.stack([(columns - GRID[1] / 2) / focal, (rows - GRID[0] / 2) / focal, np.ones(GRID)], axis=-1)
    mesh = grid_mesh(distance * rays, valid)
    return mesh, int(np.flatnonzero((mesh.pixels == pixel).all(axis=1))[0]), distance


def _between(generator: np.random.Generator, ends: tuple[float, float]) -> float:
    return math.exp(generator.uniform(*np.log(ends)))


def _contact(mesh: Mesh, vertex: int, generator: np.random.Generator) -> Interaction:
    """A press of some length whose light is not known yet."""
    step, times = FITTED.time_step, slot_times()
    stamped = round(generator.uniform(*PRESSED) * FRAME_RATE) / FRAME_RATE
    load = Press.at(vertex, np.array([0, 0, -1], np.float32), held(round(stamped / step), round(1 / step)))
    light = BrightnessSequence(times, np.zeros((SLOTS, SIDE, SIDE), np.float32), np.zeros((SIDE, SIDE)), 0.0)
    observed = Observation.of_point(vertex, times, np.zeros((SLOTS, 3)), np.nan)
    return Interaction(mesh, load, observed, step, brightness=light)


def _press(problem: BrightnessProblem, distance: float, generator: np.random.Generator) -> np.ndarray | None:
    """Parameters of a press that moves the tissue as far as drawn, or None where its force would not be admissible."""
    box, usual = RECOMMENDED.log_box, np.log(np.transpose([SCENES.stiffness, SCENES.damping, (1.0, 1.0)]))
    for _ in range(ATTEMPTS):
        delays = np.clip(generator.normal(0, DELAY, 2), -1, 1)
        press = np.concatenate([generator.uniform(*(box if generator.random() < ANY_TISSUE else usual)), delays])
        deepest = float(np.linalg.norm(problem.motion.coarse(press), axis=-1).max())
        press[2] += math.log(_between(generator, DEEPEST) * distance / max(deepest, 1e-12))
        if box[0, 2] < press[2] < box[1, 2]:
            return press
    return None


def _lit(press: np.ndarray, tilt: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """All parameters of a brightness problem from those of a press and the tilt: a law of light, without any coding."""
    others = PRIOR_MEAN + PRIOR_SD * generator.standard_normal(OTHERS)
    others[:2], others[2:4] = generator.normal(0, ASIDE, 2), tilt
    others = np.clip(others, PRIOR_MEAN - LARGEST, PRIOR_MEAN + LARGEST)
    positive = [-LAW - 1, -LAW, -2]
    some = generator.random(len(positive)) >= (1.0 if generator.random() < NONE / 2 else NONE)
    others[positive], others[-1] = some * np.abs(others[positive]), 0.0
    return np.concatenate([press, others])


def _observed(
    contact: Interaction, lit: np.ndarray, law: np.ndarray, shown: np.ndarray, generator: np.random.Generator
) -> tuple[Interaction, float]:
    """A contact as a video shows it, and the coder's step, as of `BrightnessSequence.coder_step`.

    Args:
        contact: without light.
        lit: how its light changes without errors, shape [SLOTS, L, L].
        law: the law's part of that.
        shown: where tissue is visible, bool [SLOTS, L, L].
    """
    strength = gaussian_filter(generator.standard_normal((SIDE, SIDE)), generator.uniform(0.5, 2))
    strength *= generator.uniform(0.05, 0.35) / strength.std()
    light = lit + law * strength
    light += np.abs(law) * persistent(generator, generator.uniform(0, 0.15), 1.5, 0.9)
    light += persistent(generator, _between(generator, (0.002, 0.02)), 0.0, 0.0)
    light += persistent(
        generator, _between(generator, (0.002, 0.03)), generator.uniform(1, 4), generator.choice([0.6, 0.9, 0.97])
    )
    level, step = generator.uniform(*LEVELS), 0.0
    if generator.random() >= UNCODED:
        unit, step = float(level_of_light(np.array(level))), _between(generator, STEPS)
        noise = generator.normal(0, generator.uniform(0.2, 1.0), light.shape)
        light = unit * as_coded(light / unit + noise, step, generator.uniform(*DEAD), generator)
        step *= unit / 8
    light += generator.normal(0, 0.015) + generator.normal(0, 0.01, (SLOTS, 1, 1))
    light[~shown] = np.nan
    assert contact.brightness is not None
    sequence = dataclasses.replace(contact.brightness, light=light.astype(np.float32))
    return dataclasses.replace(contact, brightness=sequence), step


def persistent(generator: np.random.Generator, sd: float, spread: float, kept: float) -> np.ndarray:
    """Errors [SLOTS, L, L] that neighbours share, and successive frames to such a share.

    Args:
        sd: their standard deviation.
        spread: places over which they are smoothed.
        kept: correlation of one frame and the next.
    """
    fresh = generator.standard_normal((SLOTS, SIDE, SIDE))
    if spread:
        fresh = gaussian_filter(fresh, (0, spread, spread))
    fresh *= sd / fresh.std()
    for index in range(1, SLOTS):
        fresh[index] = kept * fresh[index - 1] + math.sqrt(1 - kept**2) * fresh[index]
    return fresh


def as_coded(levels: np.ndarray, step: float, dead: float, generator: np.random.Generator) -> np.ndarray:
    """Pictures [N, L, L] after a coder that adds quantised changes of blocks to what was coded before, first to 0.

    Args:
        levels: means over 2 × 2 pixels, less those at rest.
        step: of the coefficients of blocks of 8 × 8 pixels.
        dead: added to a coefficient over its step before the fraction is cut off.
        generator: draws where blocks begin.
    """
    height = BLOCK * (levels.shape[1] // BLOCK + 2)
    top, left = generator.integers(0, BLOCK, 2)
    inside = np.s_[top : top + levels.shape[1], left : left + levels.shape[2]]
    before, found = np.zeros((height, height)), np.empty_like(levels)
    for index, now in enumerate(levels):
        wanted = np.zeros_like(before)
        wanted[inside] = now
        blocks = (wanted - before).reshape(height // BLOCK, BLOCK, -1, BLOCK)
        # A coefficient of 8 × 8 pixels is twice that of their means over 2 × 2.
        coefficients = np.einsum("ij,ajbk,lk->aibl", _DCT, blocks, _DCT) / (step / 2)
        kept = np.sign(coefficients) * np.floor(np.abs(coefficients) + dead) * (step / 2)
        before = before + np.einsum("ji,ajbk,kl->aibl", _DCT, kept, _DCT).reshape(height, height)
        found[index] = before[inside]
    return found


def _shown(released: float, dent: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Where tissue is visible, bool [SLOTS, L, L]: not under the instrument, which leaves, and not in highlights.

    Args:
        released: when the instrument leaves [s].
        dent: where the dent's middle lies, at the instrument's tip: rows, columns from the contact [grid pixels].
        generator: draws the instrument and the highlights.
    """
    tip, angle = dent + generator.normal(0, AT_TIP, 2), generator.uniform(0, 2 * math.pi)
    rows, columns = np.meshgrid(PLACES - tip[0], PLACES - tip[1], indexing="ij")
    ahead = columns * math.cos(angle) + rows * math.sin(angle)
    across = np.abs(rows * math.cos(angle) - columns * math.sin(angle))
    wider, edge, speed = generator.uniform(0.8, 1.5), generator.uniform(0.5, 1.6), generator.uniform(1.5, 8)
    holes = gaussian_filter(generator.standard_normal((SIDE, SIDE)), 2.0)
    shown = np.repeat((holes <= np.quantile(holes, 1 - generator.uniform(0, 0.25)))[None], SLOTS, axis=0)
    for index, time in enumerate(slot_times()):
        back = speed * max(time - released, 0.0) * FRAME_RATE
        half = wider * jaw_width(np.maximum(ahead - back, TIP_START)) + edge
        shown[index] &= ~((ahead - back >= TIP_START - edge) & (across <= half))
    return shown


def noise_factors(count: int = 100) -> Iterator[np.ndarray]:
    """Factors L of the covariances L·Lᵀ of a frame's amounts under errors of standard deviation 1, of four spreads."""
    generator = np.random.default_rng(3)
    for spread in (0.0, 1.0, 2.0, 4.0):
        errors = np.concatenate([persistent(generator, 1.0, spread, 0.0) for _ in range(count)])
        amounts = light_amounts(errors).amounts
        yield np.linalg.cholesky(np.cov(amounts.T) + 1e-9 * np.eye(amounts.shape[1]))
