"""Frozen kernels: no lanes, changing values, a changing Python number."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate
from renderers.frozen import aligned, frozen, opaque_float


def test_changing_values_do_not_record_anew_and_no_lanes_do_nothing() -> None:
    activate()
    kernel = frozen(lambda x, factor: x * factor)
    for k in range(50):
        got = kernel(5, opaque_float(np.arange(5.0)), opaque_float([k]))
        np.testing.assert_array_equal(got.numpy(), np.arange(5) * k)
    assert kernel.recordings == 1
    assert kernel(0, None, None) is None


def test_a_python_number_that_changes_is_found_out() -> None:
    activate()
    kernel = frozen(lambda x, factor: x * factor, max_recordings=3)
    for k in range(3):
        kernel(4, opaque_float([1, 2, 3, 4]), 1.5 + k)
    with pytest.raises(RuntimeError, match="a Python value changes"):
        kernel(4, opaque_float([1, 2, 3, 4]), 9.5)


def test_uploads_start_at_a_multiple_of_64_bytes() -> None:
    for size in (1, 3, 1000):
        values = aligned(np.arange(size), np.float32)
        assert values.ctypes.data % 64 == 0
        np.testing.assert_array_equal(values, np.arange(size))
