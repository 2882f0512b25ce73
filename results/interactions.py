"""How a clip's runs of contact are drawn and counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from estimators.estimate import InteractionEstimate
from results.columns import interaction_values
from results.plots import ContactPanel, Motion, draw_fits
from results.store import INTERACTIONS
from results.verdicts import numbers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_PANELS = 12
"""Contacts that are drawn: those with an estimate first."""
NO_ESTIMATE = "no_estimate"


def state(run: InteractionEstimate) -> str:
    """What a run is counted as: its verdict, or that it has no estimate."""
    return NO_ESTIMATE if run.estimate is None else run.estimate.verdict


def draw_contacts(panels: Sequence[ContactPanel], counts: Counter[str], title: str) -> Figure:
    """Picture of a clip's runs of contact.

    Args:
        panels: those that are drawn.
        counts: of all by `state`.
        title: name of the clip.
    """
    total, without = counts.total(), counts[NO_ESTIMATE]
    told = f"Runs of contact: {total}, with an estimate: {total - without}."
    if len(panels) < total:
        told += f" {len(panels)} are drawn, {INTERACTIONS} has all."
    nothing = ContactPanel(NO_ESTIMATE, "no contact was found", "", None)
    return draw_fits(panels or [nothing], title=title, subtitle=told)


def contact_panel(run: InteractionEstimate) -> ContactPanel:
    """What is drawn of a run of contact: its verdict first, and no number surer than that."""
    place, estimate = f"contact from frame {run.onset_frame} ({run.onset_time_s:.3f} s)", run.estimate
    if estimate is None:
        return ContactPanel(NO_ESTIMATE, f"no estimate: {place}", run.detail, None)
    doubtful = estimate.verdict == "determined" and run.detail != ""
    told = "doubtful" if doubtful else estimate.verdict
    values = ", ".join(" ".join(pair) for pair in numbers(told, interaction_values(run)))
    heading = f"{estimate.verdict}{', but doubtful' if doubtful else ''}: {place}, {values}"
    sentences = [run.detail]
    if np.isfinite(estimate.misfit):
        sentences.append(f"Misfit {estimate.misfit:.2g} (1: it fits); {estimate.explanation}.")
    if estimate.covariance is not None and told != "determined":
        sentences.append("Ranges are 90 % intervals.")
    return ContactPanel(told, heading, " ".join(filter(None, sentences)), _motion(run))


def _motion(run: InteractionEstimate) -> Motion | None:
    """Observed and simulated motion along the force, positive where it follows it."""
    contact, estimate, simulated = run.interaction, run.estimate, run.simulated
    if contact is None or estimate is None or simulated is None:
        return None
    sign, (times, path) = np.sign(estimate.theta[2]), simulated
    release = contact.load_seconds + (*estimate.delays, 0.0, 0.0)[1] if contact.released else None
    return Motion(contact.observation.times, sign * contact.along, estimate.noise, times, sign * path, release)
