"""Splats by OpenGL: samples are vertices that the card projects, weighs and adds up (Dayal et al. 2005, 5.2 and 6.2).

The stream stays on the card: a refresh uploads what is new in it, the filters and the splat sizes, and reads the sums
back. Samples are added in the order in which they lie in the ring, with float32 sums.
"""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import moderngl
import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers
from renderers.adaptive_frameless.splats import Filter, Scenery
from renderers.gl.context import context_for

REBASE_S = 64.0
"""Sample times on the card are float32 seconds after a base that moves this often: 4 us apart at most."""
_FAR = 3e38
_UNITS = ("movers", "sizes", "filters", "nearest", "nearest_age")


class GlSplats:
    """`splats.Splats` in an OpenGL context of its own, without a window; ``kept``: room of the stream."""

    name = "moderngl"

    def __init__(self, size_px: tuple[int, int], kept: int) -> None:
        self.size_px = size_px
        self.gl = context_for("adaptive_frameless", "splats")
        folder = files("renderers.adaptive_frameless")
        with self.gl:
            self._program: Any = self.gl.program(  # uniforms by name: their kinds are not told apart in its types
                vertex_shader=folder.joinpath("splat.vert.glsl").read_text(),
                fragment_shader=folder.joinpath("splat.frag.glsl").read_text(),
            )
            self._stream = [self.gl.buffer(reserve=kept * size, dynamic=True) for size in (4 * c.STREAM_F, 4, 4)]
            formats = (("4f 4f /i", "color_x", "yz_px"), ("1i /i", "mover"), ("1f /i", "time_s"))
            self._vertices = self.gl.vertex_array(
                self._program, [(buffer, *form) for buffer, form in zip(self._stream, formats, strict=True)]
            )
            self._textures = {
                "movers": self.gl.texture((4, 1), 4, dtype="f4"),
                "sizes": self.gl.texture(size_px, 1, dtype="f4"),
                "filters": self.gl.texture(size_px, 3, dtype="f4"),
                "nearest": self.gl.texture(size_px, 1, dtype="f4"),
                "nearest_age": self.gl.texture(size_px, 2, dtype="f4"),
            }
            for unit, name in enumerate(_UNITS):
                self._program[name] = unit
            self._program["size_px"] = size_px
            self._sum_target, self._cover_target = (self.gl.texture(size_px, n, dtype="f4") for n in (4, 2))
            self._target = self.gl.framebuffer([self._sum_target, self._cover_target])
            self._nearest = self.gl.framebuffer([self._textures["nearest"]])
            self._nearest_age = self.gl.framebuffer([self._textures["nearest_age"]])
            self.gl.enable_only(moderngl.BLEND)
            self.gl.blend_func = moderngl.ONE, moderngl.ONE
        pixels = size_px[0] * size_px[1]
        self._sums = np.zeros((pixels, 4), np.float32)
        self._coverage = np.zeros((pixels, 2), np.float32)
        self._known: np.ndarray | None = None  # the stream that lies on the card
        self._put, self._base_s = 0, 0.0

    def _upload(self, b: Buffers, now_s: float) -> None:
        """Bring the ring on the card up to date."""
        room, put = len(b.stream_t), int(b.number[c.PUT])
        if self._known is not b.stream_f or now_s - self._base_s > REBASE_S:
            self._known, self._base_s, self._put = b.stream_f, now_s, put - int(b.number[c.KEPT])
        first, count = self._put % room, min(put - self._put, room)
        for start, stop in ((first, min(first + count, room)), (0, max(0, first + count - room))):
            if stop > start:
                times = (b.stream_t[start:stop] - self._base_s).astype(np.float32)
                columns = (b.stream_f[start:stop], b.stream_i[start:stop], times)
                for buffer, values in zip(self._stream, columns, strict=True):
                    buffer.write(np.ascontiguousarray(values), offset=start * values.strides[0])
        self._put = put

    def _describe(self, scenery: Scenery, f: Filter, filters: np.ndarray, sizes: np.ndarray) -> None:
        """Poses, filters and sizes to the card."""
        movers = np.zeros((len(scenery.movers), 4, 4), np.float32)
        movers[:, :3] = scenery.movers
        movers[:, 3, 0] = (scenery.window[:, 0] <= 0) & (scenery.window[:, 1] >= 0)
        if self._textures["movers"].height != len(movers):
            self._textures["movers"].release()
            self._textures["movers"] = self.gl.texture((4, len(movers)), 4, dtype="f4")
        for name, values in (("movers", movers), ("sizes", sizes), ("filters", filters)):
            self._textures[name].write(np.ascontiguousarray(values, np.float32))
        p: Any = self._program
        p["camera"].write(np.ascontiguousarray(scenery.camera, np.float32))
        p["lens"].value = tuple(scenery.lens[1:4])
        p["now_s"].value = scenery.now_s - self._base_s
        p["reproject"].value = int(f.reproject)
        p["tail"].value = f.tail
        p["depth_tolerance"].value = f.depth_tolerance if f.depth_tolerance < np.inf else 0.0

    def _pass(self, number: int, target: moderngl.Framebuffer, clear: float, equation: int, samples: int) -> None:
        self._program["pass_number"].value = number
        for unit, name in enumerate(_UNITS):
            # no texture is read while it is drawn to
            drawn = (number == 1 and name == "nearest") or (number == 2 and name == "nearest_age")
            self._textures["filters" if drawn else name].use(unit)
        target.use()
        target.clear(clear, clear, clear, clear)
        self.gl.blend_equation = equation, equation
        self._vertices.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=samples)

    def draw(
        self, b: Buffers, scenery: Scenery, f: Filter, filters: np.ndarray, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `Splats`."""
        samples = int(b.number[c.KEPT])
        with self.gl:
            self._upload(b, scenery.now_s)
            self._describe(scenery, f, filters, sizes)
            if f.depth_tolerance < np.inf:
                self._pass(1, self._nearest, _FAR, moderngl.MIN, samples)
                self._pass(2, self._nearest_age, _FAR, moderngl.MIN, samples)
            self._pass(0, self._target, 0.0, moderngl.FUNC_ADD, samples)
            self._sum_target.read_into(self._sums)
            self._cover_target.read_into(self._coverage)
        return self._sums, self._coverage

    def close(self) -> None:
        """Free the context and all that is in it."""
        held: tuple[Any, ...] = (
            self._vertices, self._program, *self._stream, self._target, self._nearest, self._nearest_age,
            *self._textures.values(), self._sum_target, self._cover_target,
        )  # fmt: skip
        for item in held:
            item.release()
        self.gl.release()
