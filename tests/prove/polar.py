"""Energy of the light probes over 10,000 frames: never above a furnace's own, never growing once the light is out."""

from __future__ import annotations

import json

import numpy as np

from renderers.engine import Engine
from renderers.parameters import Probes
from tests.evidence import write_evidence
from tests.renderers.polar.rooms import furnace, irradiance_at, state_at

ALBEDO = 0.95
FRAMES = 10_000


def levels(engine: Engine, first: int, frames: int, every: int) -> list[float]:
    """The brightest irradiance / pi at the room's middle, every ``every`` frames."""
    found = []
    for k in range(first, first + frames):
        state = state_at(engine, k)
        if k % every == 0:
            found.append(float(irradiance_at(engine, state, np.zeros((6, 3)), np.r_[np.eye(3), -np.eye(3)]).max()))
    return found


def prove(frames: int = FRAMES, every: int = 50) -> dict[str, object]:
    """Half of the frames lit, half dark. Raises AssertionError where energy grows."""
    settings = Probes(grid=(2, 2, 2), rays=16, settle_passes=0, every_frames=1, occlusion_rays=0)
    lit = Engine(furnace(ALBEDO, 1.0)).with_probes(settings)
    bright = levels(lit, 0, frames // 2, every)
    limit = 1 / (1 - ALBEDO)
    assert max(bright) <= limit * 1.001, max(bright)
    dark = Engine(furnace(ALBEDO, 0.0)).with_probes(settings)
    state_at(dark, -1)
    dark.indirect.arrays.irradiance = lit.indirect.arrays.irradiance
    fading = levels(dark, 0, frames // 2, every)
    assert (np.diff(fading) <= 1e-6 * limit).all()
    return {"frames": frames, "limit": limit, "brightest": max(bright), "last_lit": bright[-1], "fading": fading[::10]}


if __name__ == "__main__":
    result = prove()
    write_evidence("polar", result)
    print(json.dumps(result, indent=1))
