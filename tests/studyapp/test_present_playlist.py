"""Which frame belongs to which refresh, and where panels stand."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stimuli.errors import InputError
from studyapp.present.layout import place_panels
from studyapp.present.playlist import check_rate, refresh_count, source_frames


@pytest.mark.parametrize(("rate", "held"), [(240, 1), (120, 2), (80, 3), (60, 4), (48, 5), (Fraction(240, 7), 7)])
def test_frame_stays_for_refresh_over_rate(rate: Fraction, held: int) -> None:
    rate = Fraction(rate)
    assert check_rate("clip", rate, Fraction(240)) == held
    frames = source_frames(np.arange(100), rate, Fraction(240), 1000)
    assert frames.tolist() == [k // held for k in range(100)]


@given(st.integers(1, 16), st.integers(0, 10**9), st.integers(1, 10**6))
def test_source_frame_is_the_exact_floor(divisor: int, k: int, count: int) -> None:
    rate = Fraction(60000, 1001) / divisor
    expected = min(k * rate // Fraction(60000, 1001), count - 1)
    assert source_frames(np.array([k]), rate, Fraction(60000, 1001), count)[0] == expected


def test_clip_holds_its_last_frame_or_loops() -> None:
    k = np.arange(7)
    assert source_frames(k, Fraction(240), Fraction(240), 3).tolist() == [0, 1, 2, 2, 2, 2, 2]
    assert source_frames(k, Fraction(240), Fraction(240), 3, looped=True).tolist() == [0, 1, 2, 0, 1, 2, 0]


@pytest.mark.parametrize("rate", [90, 241, 480, 0, -60, Fraction(60000, 1001)])
def test_rate_that_does_not_divide_is_refused(rate: Fraction) -> None:
    with pytest.raises(InputError, match="rate does not divide the refresh"):
        check_rate("clip", Fraction(rate), Fraction(240))


def test_refusal_names_the_modes_that_would_serve() -> None:
    modes = [Fraction(60), Fraction(144), Fraction(180), Fraction(360)]
    with pytest.raises(InputError, match="wanted a display mode of 180, 360 Hz"):
        check_rate("clip", Fraction(90), Fraction(240), modes)


def test_refresh_count_rounds() -> None:
    assert refresh_count(8.0, Fraction(240)) == 1920
    assert refresh_count(0.001, Fraction(240)) == 0


def slots(*names: str, size: tuple[int, int] = (100, 80)) -> dict[str, tuple[int, int]]:
    return dict.fromkeys(names, size)


def test_three_panels_stand_in_a_row_around_the_centre() -> None:
    left, centre, right = place_panels(slots("right", "left", "centre"), (400, 100), gap_px=10)
    assert [left.slot, centre.slot, right.slot] == ["left", "centre", "right"]
    assert (left.x_px, centre.x_px, right.x_px) == (40, 150, 260)
    assert {left.y_px, centre.y_px, right.y_px} == {10}


def test_mirrored_sides_and_mirrored_pictures() -> None:
    sides = place_panels(slots("left", "right"), (400, 100), mirror="sides")
    assert [rect.slot for rect in sides] == ["right", "left"]
    left, right = place_panels(slots("left", "right"), (400, 100), mirror="pictures")
    assert (left.flipped, right.flipped) == (True, False)
    four = place_panels(slots("a", "b", "c", "d"), (220, 200), mirror="sides")
    assert [rect.slot for rect in four] == ["b", "a", "d", "c"]
    assert not any(
        rect.flipped for rect in place_panels(slots("centre", size=(101, 80)), (400, 100), mirror="pictures")
    )


def test_intervals_share_the_centre() -> None:
    first, second = place_panels(slots("first", "second"), (400, 100))
    assert (first.x_px, first.y_px) == (second.x_px, second.y_px) == (150, 10)


def test_four_panels_that_do_not_fit_in_a_row_stand_in_two() -> None:
    rects = place_panels(slots("a", "b", "c", "d"), (220, 200), gap_px=4)
    assert [(r.x_px, r.y_px) for r in rects] == [(8, 18), (112, 18), (8, 102), (112, 102)]
    assert len({r.y_px for r in place_panels(slots("a", "b", "c", "d"), (450, 200))}) == 1


@pytest.mark.parametrize("names", [(), ("a", "b", "c", "d", "e")])
def test_no_panel_or_five_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="one to four"):
        place_panels(slots(*names), (1000, 1000))


def test_panels_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="do not fit"):
        place_panels(slots("left", "right"), (199, 80))
    place_panels(slots("left", "right"), (200, 80))
