"""The camera path 'interactive': a synthetic visitor who looks round and steps about, clear of the scene's surfaces.

It stands in for the hand of Dayal et al. 2005 (their 'Interactive' recording is not public): abrupt turns, stops and
strafes. Nothing of it was recorded from a person.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stimuli.clearance import Clearance
from stimuli.scene import Scene

DURATION_S = 20.0
_SEED = 20050901
_MOST_DRAWS = 64
"""After so many steps that would come too near to something, the visitor stays where they are, and turns only."""
_LEAST_MARGIN = 1e-3
"""Of a step: a start that touches something allows no steps at all."""
_NOTICE_S = 0.1
"""How often movers are looked at while the visitor walks or rests."""

Keys = tuple[np.ndarray, np.ndarray, np.ndarray]


def interactive_keys(scene: Scene, start: np.ndarray, step_m: float) -> Keys:
    """Seconds (K,), positions (K, 3) and quaternions (K, 4) xyzw, to be joined by straight lines.

    20 s of looks (up to 40 degrees aside, 10 up or down) and steps of up to ``step_m`` times (2, 0.2, 2) from ``start``
    (4, 4), each 0.4 to 1.2 s, with pauses of 0.2 to 1 s. All of it keeps half the start's own distance from every
    surface (at most half of ``step_m``): a step that would not is drawn anew.
    """
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(_SEED)))
    times, places, turns = [0.0], [start[:3, 3]], [Rotation.from_matrix(start[:3, :3])]
    clearance = Clearance(scene, places[0], 6.0 * step_m)
    margin_m = max(0.5 * clearance.at(places[0], np.zeros(1), step_m), _LEAST_MARGIN * step_m)
    while times[-1] < DURATION_S:
        heading, nod = rng.uniform(-0.7, 0.7), rng.uniform(-0.17, 0.17)
        look = Rotation.from_rotvec([0.0, heading, 0.0]) * turns[0] * Rotation.from_rotvec([nod, 0.0, 0.0])
        offset = rng.uniform(-1.0, 1.0, 3) * np.array([2.0, 0.2, 2.0]) * step_m
        move_s, rest_s = rng.uniform(0.4, 1.2), rng.uniform(0.2, 1.0)
        turn_by = (look * turns[-1].inv()).as_rotvec()
        origin, from_place, from_turn = times[-1], places[-1], turns[-1]
        # Minimum-jerk profile (Flash and Hogan 1985).
        share = np.linspace(0.0, 1.0, 13)[1:]
        done = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        to = _clear_place(clearance, margin_m, rng, from_place, start[:3, 3] + offset, start[:3, 3], step_m,
                          origin + share * move_s, done, rest_s)  # fmt: skip
        times += [*(origin + share * move_s), origin + move_s + rest_s]
        places += [*(from_place + done[:, None] * (to - from_place)), to]
        turns += [Rotation.from_rotvec(part * turn_by) * from_turn for part in done]
        turns.append(turns[-1])
    return np.array(times), np.array(places), np.array([turn.as_quat() for turn in turns])


def _clear_place(
    clearance: Clearance, margin_m: float, rng: np.random.Generator, begin: np.ndarray, wanted: np.ndarray,
    centre: np.ndarray, step_m: float, times_s: np.ndarray, done: np.ndarray, rest_s: float,
) -> np.ndarray:  # fmt: skip
    """``wanted`` (3,), or the first of up to `_MOST_DRAWS` other places to which the way from ``begin`` is clear."""
    rest = np.append(np.arange(times_s[-1], times_s[-1] + rest_s, _NOTICE_S), times_s[-1] + rest_s)
    for _ in range(_MOST_DRAWS):
        if clearance.along(begin, wanted, margin_m):
            stops = [(begin + part * (wanted - begin), np.array([at])) for part, at in zip(done, times_s, strict=True)]
            if all(clearance.at(place, at, 2.0 * margin_m) >= margin_m for place, at in [*stops, (wanted, rest)]):
                return wanted
        wanted = centre + rng.uniform(-1.0, 1.0, 3) * np.array([2.0, 0.2, 2.0]) * step_m
    return begin
