"""How clips are divided: every frame and every sample exactly once, whatever the numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renderers.units import SAMPLE_BLOCK, Unit, average_blocks, block_sizes, plan_units, units_by_frames
from stimuli.errors import InputError
from tests.stimuli.test_clip import request


@settings(max_examples=60, deadline=None)
@given(
    frames=st.integers(1, 40), side=st.sampled_from([1, 64, 1000, 4000]), spp=st.none() | st.integers(1, 3000),
    stateless=st.booleans(),
)  # fmt: skip
def test_units_cover_every_frame_and_block_once(frames, side, spp, stateless):
    units = plan_units(request(frames, size_px=(side, side)), stateless, spp)
    if not stateless:
        assert units == (Unit(0, frames),)
        return
    seen = []
    for (first, stop), group in units_by_frames(units).items():
        blocks = [b for unit in group for b in range(*(unit.blocks or (0, len(block_sizes(spp or 1)))))]
        assert blocks == list(range(len(block_sizes(spp or 1))))
        seen += range(first, stop)
    assert seen == list(range(frames))
    assert all(Unit.from_name(unit.name) == unit for unit in units)


def test_long_frames_are_divided_by_samples():
    units = plan_units(request(2, size_px=(1920, 1080)), True, 256)
    assert len(units) == 8
    assert {unit.blocks for unit in units} == {(0, 1), (1, 2), (2, 3), (3, 4)}


@pytest.mark.parametrize("spp", [1, 63, 64, 65, 256, 1000])
def test_blocks_hold_all_samples(spp):
    sizes = block_sizes(spp)
    assert sum(sizes) == spp
    assert all(size == SAMPLE_BLOCK for size in sizes[:-1])


def test_average_is_weighted_and_one_block_is_itself():
    one = np.full((1, 1, 3), 0.1, np.float32)
    assert average_blocks([one], [7]) is one
    assert average_blocks([one, 4 * one], [64, 32])[0, 0, 0] == pytest.approx(0.2, rel=1e-6)


@pytest.mark.parametrize("name", ["", "frames-1-2", "frames-000000-000001.blocks-1-2", "../../etc"])
def test_other_names_are_no_units(name):
    with pytest.raises(InputError, match="unit"):
        Unit.from_name(name)


def test_clip_without_frames_is_refused():
    with pytest.raises(InputError, match="no frame"):
        plan_units(request(1, duration_s="1/1000"), True, None)
    with pytest.raises(InputError, match="spp"):
        block_sizes(0)
