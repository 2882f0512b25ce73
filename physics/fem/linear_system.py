"""Symmetric linear systems of a body: factorised where small, iterated where large."""

from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, SuperLU, aslinearoperator, cg, splu

DIRECT = 10_000
"""Largest number of unknowns of a matrix that is factorised at once: fill-in grows with their square."""


def factorised(matrix: csc_array) -> SuperLU:
    """Factors of a symmetric matrix, without pivoting: its order is chosen for a symmetric pattern."""
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class LinearSystem:
    """A symmetric matrix to be solved with, shape [U, U].

    Args:
        matrix: matrix of the system.
        near: a system much like it, as in the Newton step or the frame before: factors that it has, or was given,
            precondition this one.
    """

    def __init__(self, matrix: csr_array, near: "LinearSystem | None" = None) -> None:
        self.matrix = matrix
        self.borrowed = None if near is None or near.matrix.shape != matrix.shape else near.known
        """Factors of another matrix close by."""

    @property
    def known(self) -> SuperLU | None:
        """Factors where they were needed, else those that were borrowed."""
        return self.factors if "factors" in self.__dict__ else self.borrowed

    def solve(self, right: np.ndarray, tolerance: float = 1e-11) -> np.ndarray:
        """Solutions for right-hand sides [U] or [U, K].

        Args:
            right: any of them may be zero.
            tolerance: largest norm of the residual over that of the right-hand side; a factorisation does better.

        Raises:
            RuntimeError: the matrix is singular: nothing holds the body.
        """
        columns = np.atleast_2d(right.T)
        if "factors" not in self.__dict__:
            found = None
            if self.borrowed is not None and len(columns) <= 3:
                borrowed = LinearOperator(self.matrix.shape, self.borrowed.solve)
                # More iterations take longer than factors of its own: those of 37,500 to 62,000 unknowns take as long
                # as 90 to 250.
                found = self._iterated(columns, tolerance, borrowed, max(12, len(right) // 800))
            # Where factors of such a matrix were to be had, its own are too.
            if found is None and self.borrowed is None and len(right) > DIRECT and self._diagonal is not None:
                found = self._iterated(columns, tolerance, self._diagonal, 3000)
            if found is not None:
                return found.reshape(right.shape)
        return self.factors.solve(right)

    @cached_property
    def factors(self) -> SuperLU:
        """Factors of the matrix."""
        return factorised(self.matrix.T)

    @cached_property
    def _diagonal(self) -> LinearOperator | None:
        diagonal = self.matrix.diagonal()
        return aslinearoperator(diags_array(1 / diagonal)) if (diagonal > 0).all() else None

    def _iterated(self, columns: np.ndarray, tolerance: float, inverse: LinearOperator, most: int) -> np.ndarray | None:
        """Conjugate gradients for right-hand sides [K, U], solutions [U, K]; None where they don't converge, as with an
        indefinite matrix.
        """
        solved = []
        for column in columns:
            found, failed = cg(self.matrix, column, rtol=tolerance, maxiter=most, M=inverse)
            if failed:
                return None
            solved.append(found)
        return np.stack(solved, axis=1)
