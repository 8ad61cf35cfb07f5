"""A recording is found by all Python values in their places, not by the set of them (a trap of Dr.Jit 1.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from renderers.backend import activate, dr, mi
from renderers.frozen import frozen

activate()


@dataclass(frozen=True)
class Setting:
    wide: bool


def test_repeated_python_values_make_their_own_recordings() -> None:
    def kernel(x, a, b, c):
        return x + 100.0 * a + 10.0 * b + c

    frozen_kernel = frozen(kernel)
    x = dr.opaque(mi.Float, 0)
    assert np.array(frozen_kernel(1, x, 1, 2, 1))[0] == 121
    assert np.array(frozen_kernel(1, x, 1, 2, 2))[0] == 122
    assert np.array(frozen_kernel(1, x, 1, 2, 1))[0] == 121
    assert frozen_kernel.recordings == 2


def test_a_flag_inside_a_setting_does_not_hide_a_flag_beside_it() -> None:
    def kernel(x, setting, flag):
        return x + (10.0 if setting.wide else 20.0) + (1.0 if flag else 2.0)

    frozen_kernel = frozen(kernel)
    x = dr.opaque(mi.Float, 0)
    assert np.array(frozen_kernel(1, x, Setting(True), True))[0] == 11
    assert np.array(frozen_kernel(1, x, Setting(True), False))[0] == 12
    assert np.array(frozen_kernel(1, x, Setting(False), False))[0] == 22
