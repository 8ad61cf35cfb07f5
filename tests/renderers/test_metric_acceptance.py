"""A metric is used only if it ranks planted failures right: each is worse than the healthy sequence, by both eyes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np
import pytest

from renderers import tradeoff
from renderers.engine import Engine
from renderers.metrics import SequenceError, sequence_error
from renderers.tradeoff import Conditions, Setting
from stimuli import load_scene
from stimuli.camera_path import camera_path
from stimuli.encode import display_values
from stimuli.scene import CameraPath, Scene
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit, velocity_for

BY_EYE = ("rmse_still", "rmse_tracking", "flip_still", "flip_tracking")
"""Every error that the tradeoff ranks by."""


@dataclass(frozen=True)
class Sequences:
    """The linear pictures of the healthy technique from one refresh before the compared ones, of the planted mosaic,
    and the gold standard."""

    early: list[np.ndarray]
    mosaic: list[np.ndarray]
    gold: tradeoff.Gold

    @property
    def healthy(self) -> list[np.ndarray]:
        """The compared refreshes."""
        return self.early[1:]


def texture() -> tuple[Scene, CameraPath]:
    """A textured wall that slides by 2.5 px a refresh."""
    camera = SlidingCamera(velocity_for((2.5, 1.0), 4.0, CONDITIONS["texture"].size_px[1], 240))
    wall = quad((-8, -8, -4), (16, 0, 0), (0, 16, 0), unlit(noise_pixels(3, 256, 4)))
    return scene_of(wall, camera=camera), camera


def toy_car() -> tuple[Scene, CameraPath]:
    """The procedural scene with its own path, at a rate at which it moves by pixels."""
    scene = load_scene("toy_car")
    return scene, camera_path(scene, "toycar")


SUBJECTS: dict[str, Callable[[], tuple[Scene, CameraPath]]] = {"texture": texture, "toy_car": toy_car}
CONDITIONS = {
    "texture": Conditions(size_px=(64, 48), frames=8, warm_up_frames=9, reference_spp=16, flip_windows=2),
    "toy_car": Conditions(
        size_px=(96, 64), frames=8, warm_up_frames=9, reference_spp=16, flip_windows=2, rate_hz=Fraction(60)
    ),
}


@lru_cache
def sequences(subject: str) -> Sequences:
    """Rendered once for all failures."""
    scene, camera = SUBJECTS[subject]()
    engine, conditions = Engine(scene), CONDITIONS[subject]
    gold = tradeoff.gold_standard(engine, camera, conditions, lambda n: None)
    longer = replace(conditions, warm_up_frames=8, frames=9)
    rate = conditions.rate_hz
    early = tradeoff.shown_by(engine, camera, Setting("temporally_dense", {}, rate), gold.exposure, longer)
    bare = Setting("temporally_dense", {"reproject": False}, rate)
    mosaic = tradeoff.shown_by(engine, camera, bare, gold.exposure, conditions)
    return Sequences(early.colors, mosaic.colors, gold)


def without_reprojection(found: Sequences) -> list[np.ndarray]:
    """The 2x2 mosaic of the last four refreshes as it stands."""
    return found.mosaic


def wrong_pixel_order(found: Sequences) -> list[np.ndarray]:
    """The four pixels of each tile stand in each other's places."""

    def shuffled(color: np.ndarray) -> np.ndarray:
        tiles = color.reshape(color.shape[0] // 2, 2, color.shape[1] // 2, 2, 3)
        return tiles[:, ::-1, :, ::-1].reshape(color.shape)

    return [shuffled(color) for color in found.healthy]


def one_refresh_late(found: Sequences) -> list[np.ndarray]:
    """Each refresh shows the last one's picture."""
    return found.early[:-1]


def history_never_cleared(found: Sequences) -> list[np.ndarray]:
    """Old pictures stay in a running mean, unmoved and unclamped."""
    mean, out = found.early[0], []
    for color in found.healthy:
        mean = 0.5 * mean + 0.5 * color
        out.append(mean)
    return out


def dimmer_by_a_tenth(found: Sequences) -> list[np.ndarray]:
    """Nine tenths of the light."""
    return [0.9 * color for color in found.healthy]


def error_of(colors: list[np.ndarray], gold: tradeoff.Gold) -> SequenceError:
    """Errors as the tradeoff computes them."""
    values = [display_values(color, gold.exposure).astype(np.float32) for color in colors]
    return sequence_error(values, gold.values, gold.motion, gold.ppd, 2)


@pytest.mark.parametrize("subject", list(SUBJECTS))
@pytest.mark.parametrize(
    "planted",
    [without_reprojection, wrong_pixel_order, one_refresh_late, history_never_cleared, dimmer_by_a_tenth],
)
def test_a_planted_failure_is_ranked_worse(subject: str, planted: Callable[[Sequences], list[np.ndarray]]) -> None:
    found = sequences(subject)
    healthy, failed = asdict(error_of(found.healthy, found.gold)), asdict(error_of(planted(found), found.gold))
    ranking = {name: (healthy[name], failed[name]) for name in BY_EYE}
    assert all(bad > good for good, bad in ranking.values()), ranking


def test_the_subjects_move_by_pixels() -> None:
    for subject in SUBJECTS:
        speed = np.linalg.norm(sequences(subject).gold.motion, axis=-1)
        assert speed.max() > 1, subject
