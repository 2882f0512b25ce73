"""Symmetric linear systems of a body: factorised where small, iterated where large."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, SuperLU, cg, splu

DIRECT = 10_000
"""Unknowns up to which the matrix is factorised at once: filling-in grows with their square, iterations don't."""
_ITERATIONS = 3000


class LinearSystem:
    """A symmetric matrix to be solved with, shape [U, U]."""

    def __init__(self, matrix: csr_array) -> None:
        self.matrix = matrix

    def solve(self, right: np.ndarray, tolerance: float = 1e-11) -> np.ndarray:
        """Solutions for right-hand sides [U] or [U, K].

        Args:
            right: any of them may be zero.
            tolerance: of the residual's norm, over that of the right-hand side; a factorisation does better.

        Raises:
            RuntimeError: the matrix is singular: nothing holds the body.
        """
        if len(right) > DIRECT and "factors" not in self.__dict__:
            columns = [self._iterate(column, tolerance) for column in right.reshape(len(right), -1).T]
            found = [column for column in columns if column is not None]
            if len(found) == len(columns):
                return np.stack(found, axis=1).reshape(right.shape)
        return self.factors.solve(right)

    @cached_property
    def factors(self) -> SuperLU:
        """Of the matrix, without pivoting: its order is chosen for a symmetric pattern."""
        return splu(self.matrix.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    @cached_property
    def _preconditioner(self) -> LinearOperator | None:
        diagonal = self.matrix.diagonal()
        if not (diagonal > 0).all():
            return None
        scale = 1 / diagonal
        return LinearOperator(self.matrix.shape, lambda values: scale * values.ravel())

    def _iterate(self, right: np.ndarray, tolerance: float) -> np.ndarray | None:
        """Conjugate gradients, or None where they don't converge, as with an indefinite matrix."""
        if self._preconditioner is None:
            return None
        found, failed = cg(self.matrix, right, rtol=tolerance, maxiter=_ITERATIONS, M=self._preconditioner)
        return None if failed else found
