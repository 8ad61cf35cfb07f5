"""Calibration, validation and fixation, each against a signal whose answer is known."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from protocols.conditions import Gaze
from stimuli.errors import InputError
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.gaze.angles import ScreenGeometry
from studyapp.gaze.calibration import fit_map, gazepoint_commands, target_points
from studyapp.gaze.fixation import FixationWatch, drift_check
from studyapp.gaze.targets import TargetScreen, paint_target
from studyapp.gaze.validation import TargetGaze, evaluate, validate

SCREEN = ScreenGeometry(0.53, 0.30, 0.6, (1280, 720))


class ScriptedGaze:
    """A tracker that sees what it is told to, a new sample at every look."""

    name = "scripted"

    def __init__(self, offset: tuple[float, float] = (0.0, 0.0), valid: bool = True) -> None:
        self.at, self.offset, self.valid, self.stamp = (0.0, 0.0), offset, valid, 0

    def newest(self) -> tuple[float, float, int, bool] | None:
        self.stamp += 1
        return self.at[0] + self.offset[0], self.at[1] + self.offset[1], self.stamp, self.valid

    def alive(self) -> bool:
        return True


@pytest.mark.parametrize("count", [5, 9, 13])
def test_targets_are_distinct_symmetric_and_inside(count: int) -> None:
    points = target_points(count)  # type: ignore[arg-type]
    assert len({tuple(point) for point in points}) == count
    assert points.min() == pytest.approx(0.1)
    assert points.max() == pytest.approx(0.9)
    np.testing.assert_allclose(points.mean(axis=0), 0.5)


def test_other_numbers_of_targets_are_refused() -> None:
    with pytest.raises(InputError, match=r"5 \| 9 \| 13"):
        target_points(7)  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [5, 9, 13])
def test_the_map_recovers_a_distortion_that_it_can_express(count: int) -> None:
    points = target_points(count)  # type: ignore[arg-type]
    raw = points * [1.2, 0.8] + 0.1
    found = fit_map(raw, points)
    assert found.residual < 1e-12
    np.testing.assert_allclose(found(raw), points, atol=1e-12)


def test_the_map_refuses_too_few_targets_and_a_line() -> None:
    points = target_points(9)
    with pytest.raises(InputError, match="at least 5"):
        fit_map(np.where(np.arange(9)[:, None] < 4, points, np.nan), points)
    with pytest.raises(InputError, match="on a line"):
        fit_map(points * [1.0, 0.0], points)


def test_gazepoint_is_told_every_target() -> None:
    commands = gazepoint_commands(target_points(9))
    assert sum(b"ADDPOINT" in command for command in commands) == 9
    assert all(command.endswith(b"/>\r\n") for command in commands)


def test_accuracy_precision_and_loss_of_known_noise() -> None:
    rng = np.random.default_rng(0)
    n, sd = 20_000, 0.2
    samples = np.column_stack([rng.normal(3.3, sd, n), rng.normal(0.4, sd, n), rng.random(n) < 0.75])
    found = evaluate([TargetGaze(3.0, 0.0, samples)])
    assert found.accuracy_deg == pytest.approx(0.5, abs=0.01)
    assert found.loss == pytest.approx(0.25, abs=0.01)
    # Two dimensions: the spread is sd * sqrt(2), successive samples differ by twice that variance.
    assert found.precision_sd_deg == pytest.approx(sd * np.sqrt(2), rel=0.03)
    assert found.precision_rms_deg == pytest.approx(sd * 2, rel=0.03)


def test_validation_looks_at_every_target_and_finds_a_planted_offset() -> None:
    gaze = ScriptedGaze(offset=(0.6, -0.8))
    display = VirtualDisplay(SCREEN.size_px, Fraction(60))

    def look(x_dva: float, y_dva: float) -> None:
        gaze.at = (x_dva, y_dva)

    found = validate(TargetScreen(display, SCREEN), gaze, SCREEN, target_points(9), look)
    assert found.targets == 9
    assert found.accuracy_deg == pytest.approx(1.0, abs=0.05)
    assert found.precision_rms_deg == pytest.approx(0.0, abs=1e-6)
    assert found.failures(Gaze(accuracy_deg=1.5, precision_deg=0.1)) == []
    (line,) = found.failures(Gaze(accuracy_deg=0.5))
    assert "accuracy" in line


def test_blind_trackers_fail_every_limit_without_a_number() -> None:
    found = evaluate([TargetGaze(0.0, 0.0, np.zeros((0, 3)))])
    assert len(found.failures(Gaze())) == 3
    assert found.as_dict()["accuracy_deg"] is None


def test_fixation_and_drift_of_a_scripted_gaze() -> None:
    gaze = ScriptedGaze()
    watch = FixationWatch(gaze)
    for at in [(0.0, 0.0)] * 50 + [(5.0, 0.0)] * 50:
        gaze.at = at
        watch.newest()
    assert watch.first(50).size_deg == 0
    found = watch.result(3.0)
    assert (found.outside, found.worst_deg, found.loss) == (0.5, pytest.approx(5.0), 0.0)
    watch.begin()
    assert watch.result(3.0).n == 0
    assert not drift_check(np.zeros((0, 3))).within(2.0)
    assert drift_check(np.array([[1.0, 0.0, 1.0]])).within(2.0)


def test_the_target_is_a_disc_with_a_dot() -> None:
    picture = paint_target(SCREEN)
    n = len(picture)
    assert picture.shape == (n, n, 4)
    assert picture[n // 2, n // 2, :3].max() < 20
    assert picture[0, 0, 3] == 0
    px_per_deg = 1280 / 0.53 * 0.6 * np.tan(np.radians(1))
    assert (picture[..., 3] / 255).sum() == pytest.approx(np.pi * (0.3 * px_per_deg) ** 2, rel=0.03)
