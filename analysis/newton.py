"""Newton's step towards a maximum."""

from __future__ import annotations

import numpy as np


def uphill_step(information: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Newton's step; where the information is not positive definite, with a ridge that makes it so."""
    if not len(gradient):
        return gradient
    scale = np.sqrt(np.maximum(np.abs(np.diag(information)), 1e-300))
    scaled = information / np.outer(scale, scale)
    ridge = 0.0
    while True:
        try:
            factor = np.linalg.cholesky(scaled + ridge * np.eye(len(scale)))
        except np.linalg.LinAlgError:
            ridge = max(1e-3, 4 * ridge)
            continue
        half = np.linalg.solve(factor, gradient / scale)
        return np.asarray(np.linalg.solve(factor.T, half) / scale)
