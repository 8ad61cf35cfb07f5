"""The one frozen kernel of the frameless techniques: a chunk of samples, each at its own time, in one launch.

What goes in and what comes out are two flat buffers of rows, so that a launch costs one copy each way. The same lanes
carry the visibility rays of the sampler's reprojected crosshairs (Dayal et al. 2005, section 6.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.image import display_encoded
from renderers.pixels import hilbert_order, inverse_order
from renderers.rng import combined
from renderers.skins import refuse_deforming

IN = 8
"""Columns of an input row: x, y (px), time (s after t1), then a visibility ray's target (3, tracer space), its time,
and whether there is one (1 or 0)."""
OUT = 16
"""Columns of an output row; see the constants below."""
RED, GREEN, BLUE, LOCAL_X, LOCAL_Y, LOCAL_Z, MOVER, VISIBLE = range(8)
COUNTED = ("shadow", "ambient_occlusion", "reflection", "transmission", "probe")
FIRST_COUNT = 8
CLAMPED = FIRST_COUNT + len(COUNTED)
LUMA = CLAMPED + 1
FAR = 1000.0
"""Where the background is taken to be, in tracer units (the scene's radius is below 2)."""


CURVE = 128
"""Cells along each side of the square whose Hilbert curve orders the lanes."""
PACKET = 16
"""Lanes that go through one instruction together (AVX-512)."""


def hilbert_ranks() -> np.ndarray:
    """(CURVE, CURVE) int32: where each cell of the square stands along its Hilbert curve."""
    return inverse_order(hilbert_order(CURVE, CURVE)).astype(np.int32).reshape(CURVE, CURVE)


@njit(cache=True)
def coherent_order(rows: np.ndarray, ranks: np.ndarray, order: np.ndarray) -> None:
    """Write to ``order`` (n,) uint32 the rows in an order that lets packets of lanes see the same things.

    Sorted along a Hilbert curve over the rows' box (``ranks`` as `hilbert_ranks` has them); then packets are dealt out,
    as neighbouring packets cost alike and threads take runs of them (6,666 samples of the kitchen on 2 cores: as they
    come 24 ms, by rows of cells 21, dealt out 17; 3,216 samples by rows of cells 11.0, along the curve 10.5).
    """
    lanes = len(rows)
    least_x, least_y, most_x, most_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(lanes):
        least_x, most_x = min(least_x, rows[k, 0]), max(most_x, rows[k, 0])
        least_y, most_y = min(least_y, rows[k, 1]), max(most_y, rows[k, 1])
    # square cells: the longer side of the rows' box has CURVE of them
    scale = (len(ranks) - 1e-3) / max(most_x - least_x, most_y - least_y, 1e-3)
    cell = np.empty(lanes, np.int64)
    start = np.zeros(ranks.size + 1, np.int64)
    for k in range(lanes):
        cell[k] = ranks[int((rows[k, 1] - least_y) * scale), int((rows[k, 0] - least_x) * scale)]
        start[cell[k] + 1] += 1
    for k in range(ranks.size):
        start[k + 1] += start[k]
    # where each packet of the sorted lanes goes: steps of about the golden section, without a common divisor
    packets = lanes // PACKET
    step = max(1, int(packets * 0.618))
    while _divisor(step, packets) > 1:
        step += 1
    for k in range(lanes):
        place = start[cell[k]]
        start[cell[k]] += 1
        packet = place // PACKET
        if packet < packets:
            place = packet * step % packets * PACKET + place % PACKET
        order[place] = k


@njit(cache=True)
def _divisor(a: int, b: int) -> int:
    while b:
        a, b = b, a % b
    return a


@dataclass(frozen=True)
class HostPoses:
    """What moves in one refresh, for the host's own projections (tracer space, float64).

    ``camera`` (K, 3, 4) and ``movers`` (M + 1, K, 3, 4) at the knots from t0 to t1; ``window`` (M + 1, 2): seconds
    after t1 in which each exists; ``lens``: span t0 - t1 (s), centre x, y (px), a pixel's size one unit ahead.
    """

    camera: np.ndarray
    movers: np.ndarray
    window: np.ndarray
    lens: np.ndarray


def host_poses(state: EngineState) -> HostPoses:
    """The poses that the kernels of ``state`` use."""
    knots = state.camera.poses.knots
    return HostPoses(
        camera=np.array(state.camera.poses.forward.numpy(), np.float64).reshape(knots, 3, 4),
        movers=np.array(state.poses.forward.numpy(), np.float64).reshape(-1, knots, 3, 4),
        window=np.array(state.poses.window.numpy(), np.float64).reshape(-1, 2),
        lens=np.array(
            [
                state.camera.poses.span_s.numpy()[0],
                state.camera.center_x_px.numpy()[0],
                state.camera.center_y_px.numpy()[0],
                state.camera.pixel.numpy()[0],
            ],
            np.float64,
        ),
    )


class FramelessRays:
    """Samples of an engine's scene at their own places and times. ``follow_movers``: hits are told in their mover's own
    space, so that they can be found where it has moved to; else as points that rest. Raises InputError for scenes with
    meshes that deform: those have one shape a view."""

    def __init__(self, engine: Engine, follow_movers: bool = True, visibility: bool = True) -> None:
        refuse_deforming(engine.scene, "frameless sampling")
        self.engine, self.follow_movers = engine, follow_movers
        self._visibility = visibility
        self._ranks = hilbert_ranks()
        self._kernel = frozen(self._trace)
        self._out: dict[int, Any] = {}

    @property
    def recordings(self) -> int:
        """How often the kernel was recorded."""
        return self._kernel.recordings

    def _trace(self, state: EngineState, lane: Any, rows: Any, seed: Any, exposure: Any, out: Any) -> Any:
        """``lane``: each lane's row, in whatever order."""
        first = dr.gather(mi.Vector4f, rows, lane * 2)
        second = dr.gather(mi.Vector4f, rows, lane * 2 + 1)
        time_s = first.z
        # The sample.
        ray = self.engine.camera_ray(state, first.x, first.y, time_s)
        sample = self.engine.sample(state, ray, time_s, rng=combined(seed, lane))
        place = sample.point_local if self.follow_movers else sample.point
        mover = mi.Float(sample.mover) if self.follow_movers else mi.Float(0)
        place = dr.select(sample.hit, place, mi.Point3f(ray.o + ray.d * FAR))
        mover = dr.select(sample.hit, mover, 0)
        visible = mi.Float(1)
        if self._visibility:
            # The ray from a reprojected crosshair's centre to the eye.
            asked = second.w > 0
            eye = self.engine.camera_ray(state, first.x, first.y, second.z).o
            target = mi.Point3f(first.w, second.x, second.y)
            seen = self.engine.visible(state, target, mi.Point3f(eye), second.z, asked)
            visible = dr.select(asked & ~seen, mi.Float(0), 1)
        counts = [mi.Float(sample.rays[kind]) for kind in COUNTED]
        color = sample.color
        base = lane * (OUT // 4)
        dr.scatter(out, mi.Vector4f(color.x, color.y, color.z, place.x), base)
        dr.scatter(out, mi.Vector4f(place.y, place.z, mover, visible), base + 1)
        dr.scatter(out, mi.Vector4f(*counts[:4]), base + 2)
        dr.scatter(out, mi.Vector4f(counts[4], mi.Float(sample.clamped), display_luma(color, exposure), 0), base + 3)
        return out

    def trace(self, state: EngineState, rows: np.ndarray, seed: int, exposure: float = 1.0) -> np.ndarray:
        """(n, IN) float32 rows -> (n, OUT) float32 results, valid until the next call of the same n; n may be 0.

        ``exposure``: what the luma is shown with.
        """
        lanes = len(rows)
        if lanes not in self._out:
            if len(self._out) >= 64:
                self._out.clear()
            self._out[lanes] = opaque_float(np.zeros(lanes * OUT))
        order = np.empty(lanes, np.uint32)
        if lanes:
            coherent_order(rows, self._ranks, order)
        out = self._kernel(
            lanes, state, opaque_uint(order), opaque_float(rows), opaque_uint(seed), opaque_float(exposure),
            self._out.pop(lanes),
        )  # fmt: skip
        if out is None:
            return np.zeros((0, OUT), np.float32)
        self._out[lanes] = out
        found: np.ndarray = out.numpy().reshape(lanes, OUT)
        return found


def display_luma(color: Any, exposure: Any) -> Any:
    """0.299 R + 0.587 G + 0.114 B of the sRGB values that the exposed linear colour is shown with (0 to 1).

    Called inside kernels: one power for each channel of each sample cost the sampler's control a quarter of its time.
    """
    shown = display_encoded(color, exposure)
    return 0.299 * shown.x + 0.587 * shown.y + 0.114 * shown.z


def counted(totals: np.ndarray, primary: int, visibility: int) -> dict[str, int]:
    """`Frame.rays` from the sums of the result columns (OUT,)."""
    rays = {"primary": primary, "visibility": visibility}
    return rays | {kind: int(totals[FIRST_COUNT + k]) for k, kind in enumerate(COUNTED)}
