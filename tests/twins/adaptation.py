"""The arm that is learned, as a textbook has it: Bayesian regression on [load, viscous [n], Coulomb [n]]."""

import numpy as np


class Twin:
    """Dense information matrix and vector; rows of all joints together."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.matrix, self.vector = np.zeros((1 + 2 * n, 1 + 2 * n)), np.zeros(1 + 2 * n)

    def rows(self, load: np.ndarray, viscous: np.ndarray, coulomb: np.ndarray) -> np.ndarray:
        """Y [n, 1 + 2 n] N m."""
        return np.column_stack([load, np.diag(viscous), np.diag(coulomb)])

    def take_in(self, y: np.ndarray, z: np.ndarray, weight: np.ndarray, kept: float) -> None:
        """Rows y with the torques z [n] that they should give."""
        self.matrix = kept * self.matrix + (weight[:, None] * y).T @ y
        self.vector = kept * self.vector + y.T @ (weight * z)

    def mean(self) -> np.ndarray:
        """Posterior mean under the prior N(0, 1)."""
        return np.linalg.solve(np.eye(1 + 2 * self.n) + self.matrix, self.vector)

    def variance(self, y: np.ndarray) -> np.ndarray:
        """Posterior variance of the rows y, [n]."""
        return np.einsum("ij,jk,ik->i", y, np.linalg.inv(np.eye(1 + 2 * self.n) + self.matrix), y)
