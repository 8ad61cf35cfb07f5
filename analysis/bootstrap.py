"""Resampling of participants: seeded, in blocks that several threads share, with the same numbers on any machine."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

BLOCK = 250
"""Resamples in a block. Blocks are the same whatever the number of threads, and so are the sums within them."""


def resample_weights(n: int, n_boot: int, seed: int) -> np.ndarray:
    """(n_boot, n) how often each of ``n`` participants is drawn in each resample; rows sum to n."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    return rng.multinomial(n, np.full(n, 1 / n), size=n_boot).astype(float)


def in_blocks(fit: Callable[[np.ndarray], np.ndarray], weights: np.ndarray, workers: int | None = None) -> np.ndarray:
    """``fit`` of the weights, block by block, in order: (resamples, parameters).

    ``workers``: threads (None: one a core; numpy's linear algebra runs outside the interpreter's lock). The result
    does not depend on it.
    """
    blocks = [weights[start : start + BLOCK] for start in range(0, len(weights), BLOCK)] or [weights]
    threads = min(workers or os.cpu_count() or 1, len(blocks))
    if threads == 1:
        return np.concatenate([fit(block) for block in blocks])
    with ThreadPoolExecutor(threads) as pool:
        return np.concatenate(list(pool.map(fit, blocks)))
