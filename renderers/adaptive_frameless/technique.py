"""Adaptive frameless rendering (Dayal, Woolley, Watson and Luebke, EGSR 2005).

Crosshairs of samples, each at its own time, go where a closed loop finds colour changing over space and time; each
refresh is reconstructed from the newest samples, moved along with camera and movers. Choices where the paper is silent
are parameters. Samples are traced in launches of many chunks of 25 crosshairs (renderers traced in parallel, as the
paper has it in its section 8): a launch's tiles are drawn at its start, every sample has its own time, and results are
taken in crosshair by crosshair with the tiling adjusted after each chunk. With the default of two launches a refresh
the controller knows all but the last 8 ms. (One makes the sampler a tenth faster; the kitchen's error grows by 1.7 %
on Interactive, 1.1 % on Bart, none on Toycar, and what a moved object uncovers is found later.)

Control, in the paper's sense (section 7: 'the control machinery'): drawing tiles and places, choosing crosshairs to
reproject, taking in what was found (deep buffer, queues, gradients, sums and errors of tiles), and splitting and
merging. The stage 'control' is all of that; rays, occlusion rays among them, are 'trace'; 'reconstruct' is the other
half of the computation that the paper's share refers to.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.budget import SampleClock
from renderers.adaptive_frameless.buffers import Settings
from renderers.adaptive_frameless.compiled import drop_stale_code
from renderers.adaptive_frameless.overlay import debug_pictures
from renderers.adaptive_frameless.rays import CLAMPED, IN, OUT, FramelessRays, counted, host_poses
from renderers.adaptive_frameless.reconstructor import Reconstructor
from renderers.adaptive_frameless.sampler import SAMPLES_PER_VISIT, Poses, Sampler
from renderers.adaptive_frameless.splats import Filter, Scenery, make_splats
from renderers.backend import dr, is_cuda
from renderers.engine import Engine, EngineState
from renderers.parameters import AdaptiveFrameless as AdaptiveFramelessParameters
from renderers.pixels import inverse_order, pixel_centres, tile_order
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from stimuli.errors import InputError, problem

LONGEST = 3.0
"""Filters reach back at most this many times as far as the stream: where nothing changes its oldest samples then still
weigh exp(-0.5), and all sharpen the picture (with 1, tilted bars at rest kept 0.67 of their first error, now 0.53)."""


def sampler_settings(size_px: tuple[int, int], p: AdaptiveFramelessParameters, exposure: float) -> Settings:
    """The parameters as compiled code takes them; limits on the number of tiles follow from the picture's size."""
    pixels = size_px[0] * size_px[1]
    most = max(1, min(pixels, max(p.least_tiles, pixels // p.least_mean_tile_px)))
    return Settings(
        width=size_px[0], height=size_px[1], depth=p.depth, reprojected=p.reprojected, least_tile_px=p.least_tile_px,
        least_tiles=min(p.least_tiles, most), most_tiles=most, moves=p.tiling_moves, chunk=p.chunk_crosshairs,
        kappa=p.kappa, lam=p.lambda_, m=p.m, gain=p.i, area_power=p.area_power, decay_per_s=p.decay_per_s,
        exposure=exposure, followed=p.temporal_gradient == "followed",
    )  # fmt: skip


class AdaptiveFrameless:
    """Sampler and reconstructor; `show` gives the debug pictures of the last refresh."""

    name: ClassVar[str] = "adaptive_frameless"
    Params: ClassVar[type[AdaptiveFramelessParameters]] = AdaptiveFramelessParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: AdaptiveFramelessParameters, seed: int,
        measure: Measure,
    ) -> None:  # fmt: skip
        if min(size_px) < 1:
            raise InputError(problem("size_px", "picture size", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
        if params.kappa + params.lambda_ > 1:
            raise InputError(
                problem("adaptive_frameless", "kappa + lambda_", params.kappa + params.lambda_, "at most 1")
            )
        self.engine, self.size_px, self.params = engine, size_px, params
        drop_stale_code()
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._rays = FramelessRays(engine, follow_movers=params.reproject_movers)
        self._kept = max(1, round(params.samples_kept_per_px * size_px[0] * size_px[1]))
        self._splats = make_splats(params.splats, is_cuda(), size_px, self._kept)
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
        self._clock = SampleClock(self.params.samples_per_s / SAMPLES_PER_VISIT)
        self._filled_s = 0.0
        self.sampler: Sampler | None = None
        self.reconstructor: Reconstructor | None = None

    def _fill(self, view: View, state: EngineState, now_s: float) -> tuple[np.ndarray, int]:
        """One sample a pixel at t1 into new buffers; the sums of the result columns, and how many samples."""
        pixels = self.size_px[0] * self.size_px[1]
        self.sampler = Sampler(sampler_settings(self.size_px, self.params, view.exposure), self._kept, self._rng)
        self.reconstructor = Reconstructor(self.size_px, self._splats, self.params.least_splat_px)
        order = tile_order(*self.size_px)
        rows = np.zeros((pixels, IN), np.float32)
        rows[:, 0], rows[:, 1] = pixel_centres(order, self.size_px[0])
        found = self._rays.trace(state, rows, int(self._rng.integers(1 << 32)), view.exposure)
        self._filled_s = now_s
        self.sampler.first_fill(now_s, found[inverse_order(order)])
        return found.sum(axis=0, dtype=np.float64), pixels

    def _sample(self, view: View, state: EngineState, poses: Poses) -> tuple[np.ndarray, int, int]:
        """This interval's chunks, one after another; the sums of result columns, primary and visibility rays."""
        assert self.sampler is not None
        totals, visibility = np.zeros(OUT), 0
        times_s = self._clock.take(view.t1 - view.t0)
        chunk_size = self.params.chunk_crosshairs
        size = max(1, math.ceil(len(times_s) / chunk_size / self.params.launches)) * chunk_size
        seeds = self._rng.integers(1 << 32, size=-(-len(times_s) // size)).tolist()
        with self._watch.stage("control"):
            chunk = self.sampler.plan(poses, times_s[:size])
        for k, seed in enumerate(seeds):
            with self._watch.stage("trace"):
                found = self._rays.trace(state, chunk.rows, seed, self.sampler.settings.exposure)
            with self._watch.stage("control"):
                following = times_s[(k + 1) * size : (k + 2) * size]
                chunk, asked = self.sampler.turn(poses, chunk, found, totals, following)
                visibility += asked
        return totals, len(times_s) * SAMPLES_PER_VISIT, visibility

    def render(self, view: View) -> Frame:
        """The picture at t1: this interval's samples taken, then all kept ones reconstructed."""
        now_s, visibility = float(view.t1), 0
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(view, self.size_px)
                host = host_poses(state)
                poses = Poses(host.camera, host.movers, host.window, host.lens, now_s)
            if self.sampler is None or view.cut:
                with self._watch.stage("trace"):
                    totals, primary = self._fill(view, state, now_s)
            else:
                totals, primary, visibility = self._sample(view, state, poses)
            with self._watch.stage("reconstruct"):
                color = self._reconstruct(view, poses)
        return Frame(
            color=color,
            rays=counted(totals, primary, visibility),
            seconds=dict(self._watch.seconds),
            time_s=float(view.index * (view.t1 - view.t0)),
            clamped=int(totals[CLAMPED]),
        )

    def _reconstruct(self, view: View, poses: Poses) -> np.ndarray:
        assert self.sampler is not None
        assert self.reconstructor is not None
        p, b = self.params, self.sampler.buffers
        f = Filter(
            samples_per_s=p.samples_per_s,
            volume=p.filter_volume,
            least_spatial=p.least_spatial_gradient,
            least_temporal=p.least_temporal_gradient,
            most_extent_s=max(float(view.t1 - view.t0), LONGEST * len(b.stream_t) / p.samples_per_s),
            refresh_s=float(view.t1 - view.t0),
            tail=p.filter_tail,
            depth_tolerance=1.0 + p.depth_tolerance if p.depth_tolerance > 0 else np.inf,
            reproject=p.reproject,
            fill_age_s=poses.t1_s - self._filled_s if b.number[c.PUT] <= len(b.stream_t) else math.inf,
        )
        movers = np.ascontiguousarray(poses.movers[:, -1])
        scenery = Scenery(poses.camera[-1], movers, poses.window, poses.lens, poses.t1_s)
        return self.reconstructor.reconstruct(b, scenery, f)

    def show(self, view: View) -> dict[str, np.ndarray]:
        """Debug pictures of the last frame, see `overlay.debug_pictures`; empty before the first."""
        if self.sampler is None or self.reconstructor is None:
            return {}
        width, height = self.size_px
        picture, coverage = self.reconstructor.picture.reshape(height, width, 3), self.reconstructor.coverage[:, 0]
        return debug_pictures(self.sampler.buffers, self.sampler.settings, self.params.samples_per_s, picture, coverage)

    def close(self) -> None:
        """Free what the splats hold outside Python."""
        self._splats.close()

    def tiles(self) -> int:
        """How many tiles there are now."""
        return 0 if self.sampler is None else int(self.sampler.buffers.number[c.LEAVES])
