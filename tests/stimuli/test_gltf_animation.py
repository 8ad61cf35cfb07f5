"""Key tracks and node chains against oracles: scipy's Slerp and Hermite spline, plain matrix products."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from stimuli.gltf_animation import (
    Channel,
    Rig,
    RigNode,
    compose,
    sample_keys,
    slerp,
    unit,
)

AT = np.linspace(-0.5, 3.5, 41)
TIMES = np.array([0.0, 0.3, 1.0, 2.5, 3.0])


def random_turns(seed: int, count: int) -> np.ndarray:
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_quat()


def same_rotation(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.allclose(np.abs(np.sum(a * b, axis=-1)), 1.0, atol=1e-12))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_linear_rotations_are_scipys_slerp_and_hold_outside_the_keys(seed: int) -> None:
    keys = random_turns(seed, 5)
    ours = sample_keys(TIMES, keys[None], "LINEAR", AT, rotation=True)[0]
    theirs = Slerp(TIMES, Rotation.from_quat(keys))(np.clip(AT, 0.0, 3.0)).as_quat()
    assert same_rotation(ours, theirs)


def test_slerp_takes_the_short_way_and_survives_equal_and_opposite_quaternions() -> None:
    a = np.array([0.0, 0.0, 0.0, 1.0])
    b = -Rotation.from_rotvec([0.0, 0.2, 0.0]).as_quat()
    middle = slerp(a, b, np.array(0.5))
    assert same_rotation(middle, Rotation.from_rotvec([0.0, 0.1, 0.0]).as_quat())
    for other in (a, -a):
        assert same_rotation(slerp(a, other, np.array(0.3)), a)
    tiny = Rotation.from_rotvec([0.0, 1e-9, 0.0]).as_quat()
    assert slerp(a, tiny, np.array(0.5))[1] == pytest.approx(0.25e-9, rel=1e-6)


def test_cubic_splines_are_scipys_hermite_splines() -> None:
    rng = np.random.default_rng(3)
    tangent, value = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    keys = np.stack([tangent, value, tangent], axis=1)[None]
    ours = sample_keys(TIMES, keys, "CUBICSPLINE", AT, rotation=False)[0]
    theirs = CubicHermiteSpline(TIMES, value, tangent)(np.clip(AT, 0.0, 3.0))
    assert np.allclose(ours, theirs, atol=1e-12)


def test_cubic_tangents_in_and_out_are_not_confused() -> None:
    # One key leaves with slope 2, the next is entered with slope 0: p(0.5) = h10 * 2 * 1 + h01 * 1.
    keys = np.zeros((1, 2, 3, 1))
    keys[0, 0, 2], keys[0, 1, 1] = 2.0, 1.0
    keys[0, 0, 0], keys[0, 1, 2] = 77.0, 99.0
    got = sample_keys(np.array([0.0, 1.0]), keys, "CUBICSPLINE", np.array([0.5]), rotation=False)
    assert got[0, 0, 0] == pytest.approx(0.125 * 2.0 + 0.5)


def test_step_holds_until_the_next_key() -> None:
    values = np.array([[1.0], [2.0], [3.0], [4.0], [5.0]])[None]
    at = np.array([-1.0, 0.0, 0.2999, 0.3, 0.99, 2.999, 3.0, 9.0])
    got = sample_keys(TIMES, values, "STEP", at, rotation=False)[0, :, 0]
    assert got.tolist() == [1.0, 1.0, 1.0, 2.0, 2.0, 4.0, 5.0, 5.0]


@pytest.mark.parametrize("kind", ["LINEAR", "STEP"])
def test_one_key_and_doubled_keys_give_numbers(kind: str) -> None:
    one = sample_keys(np.array([1.0]), np.array([[[7.0]]]), kind, AT, rotation=False)  # type: ignore[arg-type]
    assert (one == 7.0).all()
    twice = np.array([0.0, 1.0, 1.0, 2.0])
    got = sample_keys(twice, np.array([[[0.0], [1.0], [5.0], [6.0]]]), kind, np.array([1.0, 2.0]), rotation=False)  # type: ignore[arg-type]
    assert got[0, :, 0].tolist() == [5.0, 6.0]


def test_compose_is_scipys_rotation_with_scale_and_shift() -> None:
    turn = random_turns(1, 4)
    shift, scale = np.arange(12.0).reshape(4, 3), np.array([[1.0, 2.0, -3.0]] * 4)
    got = compose(shift, turn, scale)
    assert np.allclose(got[:, :3, :3], Rotation.from_quat(turn).as_matrix() * scale[:, None, :])
    assert np.array_equal(got[:, :3, 3], shift)
    assert np.array_equal(got[:, 3], np.tile((0.0, 0.0, 0.0, 1.0), (4, 1)))


def chain() -> tuple[Rig, list[Channel]]:
    """Three animated nodes, the last given first, with a static matrix between the first two."""
    above = np.eye(4)
    above[:3, 3] = (0.0, 5.0, 0.0)
    rest = {"translation": np.zeros(3), "rotation": np.array([0.0, 0.0, 0.0, 1.0]), "scale": np.ones(3)}
    nodes = [
        RigNode(9, 4, np.eye(4), **rest),
        RigNode(4, 2, above, **rest),
        RigNode(2, -1, np.eye(4), **rest),
    ]
    channels = [
        Channel(2, "translation", TIMES, np.cumsum(np.ones((5, 3)), axis=0), "LINEAR"),
        Channel(4, "rotation", TIMES, random_turns(5, 5), "LINEAR"),
        Channel(9, "scale", TIMES, np.linspace(1.0, 2.0, 15).reshape(5, 3), "LINEAR"),
    ]
    return Rig(nodes, channels), channels


def test_a_rig_multiplies_parents_before_children_whatever_their_order() -> None:
    rig, channels = chain()
    above = np.eye(4)
    above[:3, 3] = (0.0, 5.0, 0.0)
    poses = rig.poses(AT)
    for k, t in enumerate(AT):
        value = {
            c.path: sample_keys(TIMES, c.values[None], "LINEAR", np.array([t]), c.path == "rotation")[0, 0]
            for c in channels
        }
        first = compose(value["translation"], np.array([0.0, 0, 0, 1]), np.ones(3))
        second = first @ above @ compose(np.zeros(3), unit(value["rotation"]), np.ones(3))
        third = second @ np.diag([*value["scale"], 1.0])
        assert np.allclose(poses[rig.row[2], k], first)
        assert np.allclose(poses[rig.row[4], k], second)
        assert np.allclose(poses[rig.row[9], k], third)


def test_times_far_from_zero_keep_their_precision() -> None:
    times = np.array([1e6, 1e6 + 1.0])
    got = sample_keys(times, np.array([[[0.0], [1.0]]]), "LINEAR", np.array([1e6 + 1 / 240]), rotation=False)
    assert got[0, 0, 0] == pytest.approx(1 / 240, rel=1e-6)
