"""Does the adaptive order pay? RMSE of four orders over directions and speeds of a textured wall, three seeds.

Asked: at 0 and 90 degrees lower than always-hourglass, always-bowtie and random; at 6 to 24 degrees and mirrored lower
than random; at 45 degrees random, which it is. Averaged over |m| = 2 + j/8 px a frame, j = 0..7.
"""

from __future__ import annotations

import json
import math
from fractions import Fraction

import numpy as np

from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.parameters import Reference
from renderers.parameters import TemporallyDense as Params
from renderers.reference import ReferenceRenderer
from renderers.temporally_dense.technique import TemporallyDense
from stimuli.encode import display_values
from tests.evidence import write_evidence
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit, velocity_for

RATE = Fraction(240)
ORDERS = ("adaptive", "hourglass", "bowtie", "random")


def measure(
    angles_deg: tuple[float, ...],
    seeds: tuple[int, ...],
    size_px: int,
    frames: int,
    spp: int,
    warm_up: int = 8,
    block: int = 4,
) -> dict[float, dict[str, list[float]]]:
    """angle -> order -> RMSE (x 255, of display values, over the eight speeds) for each seed."""
    size = (size_px, size_px)
    found: dict[float, dict[str, list[float]]] = {a: {order: [] for order in ORDERS} for a in angles_deg}
    for seed in seeds:
        wall = quad((-20, -20, -4), (40, 0, 0), (0, 40, 0), unlit(noise_pixels(seed, 1024, block)), "wall")
        engine = Engine(scene_of(wall))
        reference = ReferenceRenderer(engine, size, Reference(spp=spp), 0, "total")
        techniques = {order: TemporallyDense(engine, size, Params(order=order), seed, "total") for order in ORDERS}
        for angle in angles_deg:
            squares = dict.fromkeys(ORDERS, 0.0)
            for j in range(8):
                length = 2 + j / 8
                motion = (length * math.cos(math.radians(angle)), length * math.sin(math.radians(angle)))
                camera = SlidingCamera(velocity_for(motion, 4, size_px, 240))
                views = [view_at(k, RATE, Fraction(1), size, camera, cut=k == 0) for k in range(warm_up + frames)]
                truth = [display_values(reference.render(view).color) for view in views[warm_up:]]
                for order, technique in techniques.items():
                    technique.reset(seed)
                    shown = [display_values(technique.render(view).color) for view in views][warm_up:]
                    squares[order] += float(np.mean((np.array(shown) - np.array(truth)) ** 2)) / 8
            for order in ORDERS:
                found[angle][order].append(255 * math.sqrt(squares[order]))
    return found


def prove() -> dict[str, object]:
    """The whole measurement."""
    angles = (0.0, 6.0, 12.0, 18.0, 24.0, 45.0, 66.0, 72.0, 78.0, 84.0, 90.0)
    found = measure(angles, (1, 2, 3), 128, 24, 16)
    return {"rmse_codes": {str(angle): orders for angle, orders in found.items()}}


if __name__ == "__main__":
    result = prove()
    write_evidence("temporally_dense_orders", result)
    print(json.dumps(result, indent=1))
