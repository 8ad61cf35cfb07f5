"""Latin squares whose rows are balanced for carry-over (Williams, Aust. J. Sci. Res. A 2, 1949)."""

from __future__ import annotations


def balanced_rows(n: int) -> tuple[tuple[int, ...], ...]:
    """Orders of 0..n-1 in which every item stands equally often at every place and equally often just before every
    other: n rows where n is even, 2n (each row and its mirror image) where it is odd. n = 1: one row; n < 1: none."""
    if n < 1:
        return ()
    # 0, 1, n-1, 2, n-2, ...: the differences of neighbours are all different.
    first = [0] + [(k + 1) // 2 if k % 2 else n - k // 2 for k in range(1, n)]
    rows = [tuple((item + shift) % n for item in first) for shift in range(n)]
    if n % 2 and n > 1:
        rows += [row[::-1] for row in rows]
    return tuple(rows)
