"""Hyperelastic laws: energy density, stress and tangent of isotropic materials at deformation gradients.

Every law is linear in the Lamé constants (μ, λ), up to a constant energy, so that its derivative by either is the law
itself at (1, 0) or (0, 1). At rest all have the same tangent, Hooke's.

linear              Hooke at small strain; a rotation strains it
corotational        Hooke in the frame that the polar decomposition F = R S turns back (Müller & Gross 2004, what Frank
                    2010 simulates), as the energy μ|S - I|² + λ/2 tr²(S - I), whose tangent is exact
neo_hookean         μ/2 (tr FᵀF - 3) - μ log J + λ/2 log² J (Bonet & Wood 1997, equation 5.28); breaks where J ≤ 0
stable_neo_hookean  Smith, de Goes & Kim 2018, equation 14, reparametrised as there (section 3.4) so that (μ, λ) are
                    Lamé's; also defined where an element is turned inside out

F is of shape [..., 3, 3], F_ij = ∂x_i/∂X_j; nine-vectors are row by row.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palpate.physics.fem.polar import rotations, spins

_IDENTITY = np.eye(9)


class Response(NamedTuple):
    """Answer of a law."""

    energy: np.ndarray
    """Energy per volume at rest, shape [...], infinite where the law isn't defined."""
    stress: np.ndarray
    """First Piola–Kirchhoff, ∂energy/∂F, shape [..., 3, 3]."""
    tangent: np.ndarray | None
    """∂stress/∂F, shape [..., 9, 9], symmetric; None where it was not asked for."""


def _linear(gradient: np.ndarray, mu: np.ndarray, lam: np.ndarray, tangent: bool) -> Response:
    strain = (gradient + np.swapaxes(gradient, -1, -2)) / 2 - np.eye(3)
    trace = np.trace(strain, axis1=-2, axis2=-1)
    energy = mu * np.square(strain).sum((-2, -1)) + lam / 2 * trace**2
    stress = _of(2 * mu) * strain + _of(lam * trace) * np.eye(3)
    transposed = _IDENTITY[np.arange(9).reshape(3, 3).T.ravel()]
    slope = _of(mu) * (_IDENTITY + transposed) + _of(lam) * np.outer(np.eye(3), np.eye(3)) if tangent else None
    return Response(energy, stress, slope)


def _corotational(gradient: np.ndarray, mu: np.ndarray, lam: np.ndarray, tangent: bool) -> Response:
    rotation = rotations(gradient)
    strain = np.einsum("...ki,...kj->...ij", rotation, gradient) - np.eye(3)
    trace = np.trace(strain, axis1=-2, axis2=-1)
    energy = mu * np.square(strain).sum((-2, -1)) + lam / 2 * trace**2
    stress = _of(2 * mu) * (gradient - rotation) + _of(lam * trace) * rotation
    slope = None
    if tangent:
        turn = rotation.reshape(*rotation.shape[:-2], 9)
        slope = _of(lam * trace - 2 * mu) * spins(gradient, rotation)
        slope += _of(2 * mu) * _IDENTITY + _of(lam) * _outer(turn, turn)
    return Response(energy, stress, slope)


def _neo_hookean(gradient: np.ndarray, mu: np.ndarray, lam: np.ndarray, tangent: bool) -> Response:
    cofactor = _cofactor(gradient)
    volume = (gradient[..., 0, :] * cofactor[..., 0, :]).sum(-1)
    valid = volume > 0
    safe = np.where(valid, volume, 1.0)
    log, inverse = np.log(safe), cofactor / _of(safe)  # F⁻ᵀ
    energy = mu / 2 * (np.square(gradient).sum((-2, -1)) - 3) - mu * log + lam / 2 * log**2
    pressure = lam * log - mu
    stress = _of(mu) * gradient + _of(pressure) * inverse
    slope = None
    if tangent:
        flat = inverse.reshape(*inverse.shape[:-2], 9)
        crossed = np.einsum("...il,...kj->...ijkl", inverse, inverse).reshape(*inverse.shape[:-2], 9, 9)
        slope = _of(mu) * _IDENTITY + _of(lam) * _outer(flat, flat) - _of(pressure) * crossed
    return Response(np.where(valid, energy, np.inf), stress, slope)


def _stable_neo_hookean(gradient: np.ndarray, mu: np.ndarray, lam: np.ndarray, tangent: bool) -> Response:
    mu, lam = 4 / 3 * mu, lam + 5 / 6 * mu
    flat = gradient.reshape(*gradient.shape[:-2], 9)
    levi_civita = np.cross(np.eye(3)[:, None], np.eye(3))
    # ∂(cof F)_ij/∂F_kl = ε_ikm ε_jln F_mn.
    cofactor_slope = np.einsum("ikm,jln->ijklmn", levi_civita, levi_civita).reshape(81, 9)
    bending = np.matmul(cofactor_slope, flat[..., None]).reshape(*gradient.shape[:-2], 9, 9)
    cofactor = np.matmul(bending, flat[..., None])[..., 0] / 2  # quadratic in F
    growth = np.einsum("...i,...i->...", cofactor, flat) / 3 - 1
    squares = np.square(flat).sum(-1)
    energy = mu / 2 * (squares - 3 - np.log((squares + 1) / 4)) + lam / 2 * growth**2 - 3 / 4 * mu * growth
    share, pressure = mu * (1 - 1 / (squares + 1)), lam * growth - 3 / 4 * mu
    stress = share[..., None] * flat + pressure[..., None] * cofactor
    slope = None
    if tangent:
        slope = _of(share) * _IDENTITY + _of(2 * mu / (squares + 1) ** 2) * _outer(flat, flat)
        slope += _of(lam) * _outer(cofactor, cofactor) + _of(pressure) * bending
    return Response(energy, stress.reshape(gradient.shape), slope)


_LAWS = {law.__name__[1:]: law for law in (_linear, _corotational, _neo_hookean, _stable_neo_hookean)}
LAWS = tuple(_LAWS)
"""Names of the laws."""


def respond(law: str, gradient: np.ndarray, mu: np.ndarray, lam: np.ndarray, *, tangent: bool = False) -> Response:
    """Energy, stress and, where asked for, tangent of a law.

    Args:
        law: one of `LAWS`.
        gradient: F, shape [..., 3, 3].
        mu: shear modulus, of a shape that broadcasts to [...] [unit of stress].
        lam: Lamé's first constant, of such a shape [unit of stress].
        tangent: True = with the tangent.
    """
    one = np.ones(gradient.shape[:-2])
    return _LAWS[law](gradient, mu * one, lam * one, tangent)


@dataclass(frozen=True, eq=False)
class Material:
    """A law and its constants.

    Raises:
        ValueError: an unknown law; E that is not positive; ν outside (-1, 0.5).
    """

    law: str
    """One of `LAWS`."""
    young: float | np.ndarray
    """Young's modulus E, one number or one an element, shape [E] [Pa]."""
    poisson: float
    """Poisson's ratio ν."""

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise ValueError(f"there is no law {self.law!r}; choose one of {', '.join(LAWS)}.")
        if not (np.isfinite(self.young).all() and np.all(np.asarray(self.young) > 0)):
            raise ValueError("Young's modulus is not a positive number everywhere; give one in pascals.")
        if not -1 < self.poisson < 0.5:
            raise ValueError(f"Poisson's ratio is {self.poisson:g}; give one above -1 and below 0.5.")

    @property
    def lame(self) -> tuple[np.ndarray, np.ndarray]:
        """(μ, λ), each of E's shape [Pa]."""
        young, ratio = np.asarray(self.young, np.float64), self.poisson
        return young / (2 * (1 + ratio)), young * ratio / ((1 + ratio) * (1 - 2 * ratio))

    @property
    def lame_by_poisson(self) -> tuple[np.ndarray, np.ndarray]:
        """∂(μ, λ)/∂ν, each of E's shape [Pa]."""
        young, ratio = np.asarray(self.young, np.float64), self.poisson
        product = (1 + ratio) * (1 - 2 * ratio)
        return -young / (2 * (1 + ratio) ** 2), young * (1 + 2 * ratio**2) / product**2


def _cofactor(gradient: np.ndarray) -> np.ndarray:
    """det(F) F⁻ᵀ, shape [..., 3, 3]; written out, as NumPy's inverse of many small matrices is several times slower."""
    found = np.empty(gradient.shape)
    for row in range(3):
        one, two = gradient[..., (row + 1) % 3, :], gradient[..., (row + 2) % 3, :]
        for column in range(3):
            left, right = (column + 1) % 3, (column + 2) % 3
            found[..., row, column] = one[..., left] * two[..., right] - one[..., right] * two[..., left]
    return found


def _of(scalars: np.ndarray) -> np.ndarray:
    return scalars[..., None, None]


def _outer(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return one[..., :, None] * two[..., None, :]
