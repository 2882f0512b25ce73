"""Picture of a clip's fits: observed and simulated motion of every run of contact along its force."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from data.samples import ContactCase
from estimators.delayed_problem import held_for
from estimators.estimate import ContactEstimate
from evaluation.drawing import INK, MUTED, Axes, Color, fit_text, text, text_width
from physics.mechanics import Mechanics
from physics.msd_kernel import simulate

if TYPE_CHECKING:
    from evaluation.contact_results import ContactResult

WIDTH = 1500
"""Width of the picture [px]."""
MOST_PANELS = 12
"""Runs of contact that are drawn, the first ones."""
_LEFT, _RIGHT, _TOP, _FOOT = 120, 50, 110, 90
_PANEL, _HEAD, _AXIS = 260, 106, 70
_OBSERVED: Color = (75, 85, 99)
_FITTED: Color = (124, 58, 237)
_RELEASE: Color = (234, 88, 12)


def draw_fits(results: Sequence[ContactResult], mechanics: Mechanics, title: str) -> np.ndarray:
    """Draw a clip's fits, one panel a run of contact that has an estimate.

    Args:
        results: the clip's runs of contact.
        mechanics: of the fits.
        title: name of the clip.

    Returns:
        RGB image, uint8, shape [H, WIDTH, 3].
    """
    fitted = [result for result in results if result.estimate is not None]
    drawn = fitted[:MOST_PANELS]
    pitch = _HEAD + _PANEL + _AXIS
    image = np.full((_TOP + pitch * len(drawn) + _FOOT, WIDTH, 3), 255, np.uint8)
    width = WIDTH - _LEFT - _RIGHT
    text(image, fit_text(title, width, 32, bold=True), (_LEFT, 48), 32, INK, bold=True)
    text(image, _subtitle(len(results), len(fitted), len(drawn)), (_LEFT, 80), 18, MUTED)
    for index, result in enumerate(drawn):
        _draw_panel(image, _TOP + index * pitch, result, mechanics)
    text(image, "palpate: research software, not a medical device.", (_LEFT, len(image) - 20), 16, MUTED)
    return image


def along_force(case: ContactCase, theta: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Displacements [M, 3] along the force, positive where they follow it, shape [M] [scene units]."""
    return displacement @ (np.sign(theta[2]) * case.direction.astype(np.float64))


def fitted_path(case: ContactCase, estimate: ContactEstimate, mechanics: Mechanics) -> np.ndarray:
    """Simulated displacement since the press began, shape [T, 3]; index i is the time (i+1)·Δt.

    It reaches to the last observation, before which it may have begun earlier than the first frame in contact.
    """
    delay, release = _delays(estimate)
    steps = int(case.steps.max()) + 1 + math.ceil(max(-delay, 0.0) / mechanics.time_step)
    used = dataclasses.replace(mechanics, steps=steps, load_steps=0)
    load = np.ones(steps)
    if case.load_steps < mechanics.steps:
        load = held_for(case.load_steps * mechanics.time_step + release - delay, used)
    return simulate(estimate.theta, case.mesh, case.vertex, case.direction, used, load=load)


def shown_path(case: ContactCase, estimate: ContactEstimate, mechanics: Mechanics) -> tuple[np.ndarray, np.ndarray]:
    """Times from the first frame in contact to the last observation, and the motion along the force then, [T] each."""
    path = along_force(case, estimate.theta, fitted_path(case, estimate, mechanics))
    began = _delays(estimate)[0] + mechanics.time_step * np.arange(len(path) + 1)
    times = np.linspace(0, (case.steps[-1] + 1) * mechanics.time_step, len(path) + 1)
    return times, np.interp(times, began, np.concatenate([[0.0], path]))


def _delays(estimate: ContactEstimate) -> tuple[float, float]:
    """Of the beginning and of the end of the press [s], 0 where they were not fitted."""
    return (*estimate.delays, 0.0, 0.0)[:2]


def _subtitle(runs: int, fitted: int, drawn: int) -> str:
    if runs == 0:
        return "no contact was found"
    told = f"{fitted} of {runs} runs of contact have an estimate"
    return told if drawn == fitted else f"{told}, the first {drawn} are drawn"


def _draw_panel(image: np.ndarray, top: int, result: ContactResult, mechanics: Mechanics) -> None:
    """One run of contact: its numbers, and its motion over time."""
    case, estimate = result.case, result.estimate
    times = (case.steps + 1) * mechanics.time_step
    observed = along_force(case, estimate.theta, case.displacement)
    path_times, path = shown_path(case, estimate, mechanics)
    _draw_head(image, top, result)
    shown = np.concatenate([observed - estimate.noise, observed + estimate.noise, path])
    margin = 0.08 * max(float(np.ptp(shown)), 1e-6)
    values = float(shown.min()) - margin, float(shown.max()) + margin
    width = WIDTH - _LEFT - _RIGHT
    axes = Axes(image, _LEFT, top + _HEAD, width, _PANEL, (0.0, float(times[-1])), values)
    axes.frame("Displacement along the force", "[scene units (normalised)]", x_label="time since the onset [s]")
    release = _delays(estimate)[1] + case.load_steps * mechanics.time_step
    if case.load_steps < mechanics.steps and release < times[-1]:
        _draw_release(axes, release)
    axes.band(times, observed - estimate.noise, observed + estimate.noise, _OBSERVED)
    axes.curve(path_times, path, _FITTED)
    for center in np.round(axes.pixels(times, observed)).astype(int).tolist():
        cv2.circle(image, center, 4, _OBSERVED, -1, cv2.LINE_AA)
    _draw_legend(image, top + _HEAD - 12)


def _draw_head(image: np.ndarray, top: int, result: ContactResult) -> None:
    """When the contact began, what was fitted, and what is known of it."""
    estimate, width = result.estimate, WIDTH - _LEFT - _RIGHT
    sd = np.abs(estimate.theta) * estimate.log_sd
    numbers = " · ".join(
        f"{name} {abs(value):.3g} ± {spread:.2g}"
        for name, value, spread in zip(("k_s", "k_d", "|F|"), estimate.theta, sd, strict=True)
    )
    heading = f"Contact from frame {result.onset_frame} ({result.onset_time_s:.3f} s): {numbers}"
    text(image, fit_text(heading, width, 22, bold=True), (_LEFT, top + 28), 22, INK, bold=True)
    told = f"{estimate.verdict}: {estimate.explanation}; misfit {estimate.misfit:.2f}. {result.detail}"
    text(image, fit_text(told, width, 17), (_LEFT, top + 56), 17, MUTED)


def _draw_release(axes: Axes, time: float) -> None:
    (u, top), (_, bottom) = np.round(axes.pixels([time, time], [axes.y_range[1], axes.y_range[0]])).astype(int).tolist()
    cv2.line(axes.image, (u, top), (u, bottom), _RELEASE, 1)
    text(axes.image, "release", (u + 6, top + 20), 16, _RELEASE)


def _draw_legend(image: np.ndarray, baseline: int) -> None:
    right = WIDTH - _RIGHT
    for label, color in (("fitted", _FITTED), ("observed ±σ", _OBSERVED)):
        text(image, label, (right, baseline), 17, INK, align="right")
        right -= text_width(label, 17) + 12
        cv2.line(image, (right - 26, baseline - 6), (right, baseline - 6), color, 3, cv2.LINE_AA)
        right -= 48
