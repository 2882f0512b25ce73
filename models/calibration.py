"""Calibration of a contact posterior's standard deviations, as found on validation clips."""

from dataclasses import dataclass

Triple = tuple[float, float, float]
"""One number for each of (log k_s, log k_d, log |F|)."""
LOG_DAMPING: Triple = (-0.5, 1.0, 0.0)
"""Shares of these in the logarithm of the damping ratio ζ = k_d/(2√(k_s·m)), less its constant."""


@dataclass(frozen=True)
class Widths:
    """Calibrated standard deviations of log θ: scale · sd^power · σ^noise · (k_d/√k_s)^damping · exp(bend · distance²).

    The default changes nothing. A network's own error hardly shrinks with the posterior's width, so a power below 1
    widens narrow intervals more than wide ones. The distance is that of log σ from the middle of a range: rounded depth
    lies between clean and noisy depth and is worse than both.
    """

    scale: Triple = (1.0, 1.0, 1.0)
    power: Triple = (1.0, 1.0, 1.0)
    noise: Triple = (0.0, 0.0, 0.0)
    """Exponents of the observation's σ, in the unit in which the contact's features hold it."""
    damping: Triple = (0.0, 0.0, 0.0)
    """Exponents of the estimated damping ratio without its constant factor, as posteriors of creeping tissue are not
    normal."""
    bend: Triple = (0.0, 0.0, 0.0)
    """Coefficients of the squared distance of log σ from the middle of `middle_range`."""
    middle_range: tuple[float, float] = (0.0, 0.0)
    """Range of log σ of the fitted clips less their lowest and highest twentieth; the distance is constant beyond."""


@dataclass(frozen=True)
class Calibration:
    """Widths by the observed part of a contact, and the features that tell it."""

    whole: Widths = Widths()
    """Widths of contacts observed through their release."""
    pressed: Widths = Widths()
    """Widths of contacts whose release has not been observed; used if `known_features` are given."""
    between: Widths = Widths()
    """Widths of presses of unknown instants, where they are wider; used if `within_features` are given."""
    noise_features: tuple[int, ...] = ()
    """Features whose sum is log σ."""
    known_features: tuple[int, ...] = ()
    """Features that are 1 for instants that were observed."""
    loaded_features: tuple[int, ...] = ()
    """Features that are 1 for instants that were observed under load."""
    within_features: tuple[int, ...] = ()
    """Features that are above 0 where the instants of a press are not known."""
