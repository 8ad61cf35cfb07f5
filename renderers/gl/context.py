"""An OpenGL context without a window, and the depth mesh that foveated reprojection rasterises.

The only place where data crosses between Dr.Jit and moderngl: vertices go in, two flat arrays come out. Both cross as
host memory: moderngl maps no CUDA memory, so with `cuda` this is a round trip (about 12 bytes a pixel and frame), whose
time is the stage "crossing" where stages are measured.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from importlib.resources import files
from typing import Any

import moderngl
import numpy as np

from renderers.backend import dr, mi
from renderers.frozen import aligned
from stimuli.errors import InputError, problem

NEAR = 1e-3
"""The near plane, tracer units."""
FLOATS_A_VERTEX = 8
INDICES_A_CELL = 6

Stage = Callable[[str], AbstractContextManager[object]]
"""Measures what runs inside under a name (`renderers.stopwatch.Stopwatch.stage`)."""


def unmeasured(_: str) -> AbstractContextManager[object]:
    """A `Stage` that measures nothing."""
    return nullcontext()


def standalone_context() -> moderngl.Context:
    """A context of its own by EGL, which wants no display. moderngl's bare Exception where there is no driver."""
    return moderngl.create_standalone_context(require=330, backend="egl")  # type: ignore[arg-type]


def context_for(technique: str, part: str) -> moderngl.Context:
    """A `standalone_context` for a technique's ``part``, which numba could do as well. InputError without a driver."""
    try:
        return standalone_context()
    except Exception as error:  # moderngl raises nothing narrower
        wanted = f"an EGL driver (Debian: apt-get install libegl1 libgl1-mesa-dri), or {part}: numba"
        raise InputError(problem(technique, f"{part} by moderngl", error, wanted)) from error


class MeshRasteriser:
    """Draws a grid mesh of ``columns`` x ``rows`` vertices into ``size_px``; `close` frees its context.

    InputError where there is no OpenGL without a window. On llvmpipe its cost is the number of triangles and the length
    of their edges: at 1182x1464 half as many a side take half the time (so flat blocks are drawn whole:
    `renderers.foveated.mesh_blocks`); RG32F, RG16, RG32UI and RGBA32F differ by less than a third (35, 34, 40, 46 ms).
    """

    def __init__(self, size_px: tuple[int, int], columns: int, rows: int, stage: Stage = unmeasured) -> None:
        self.size_px, self._stage = size_px, stage
        self.gl = context_for("foveated", "rasteriser")
        shaders = files("renderers.gl")
        with self.gl:
            self._program = self.gl.program(
                vertex_shader=shaders.joinpath("mesh.vert.glsl").read_text(),
                fragment_shader=shaders.joinpath("mesh.frag.glsl").read_text(),
            )
            self._vertices = self.gl.buffer(reserve=columns * rows * FLOATS_A_VERTEX * 4, dynamic=True)
            self._indices = self.gl.buffer(reserve=(columns - 1) * (rows - 1) * INDICES_A_CELL * 4, dynamic=True)
            self._mesh = self.gl.vertex_array(self._program, [(self._vertices, "4f 4f", "at", "was")], self._indices)
            self._place = self.gl.texture(size_px, 2, dtype="f4")
            self._depth = self.gl.depth_texture(size_px)
            self._target = self.gl.framebuffer([self._place], self._depth)
            self.gl.enable_only(moderngl.DEPTH_TEST)
        pixels = size_px[0] * size_px[1]
        self._place_px = aligned(np.zeros(pixels * 2), np.float32)
        self._depth_values = aligned(np.zeros(pixels), np.float32)

    def draw(self, vertices: Any, indices: np.ndarray) -> tuple[Any, Any]:
        """Rasterise ``vertices`` (Float, 8 a vertex: clip position, then x, y of the last picture times depth, depth)
        as the triangles of ``indices`` (uint32, three each, at most two triangles a cell).

        Returns (place, depth), Float: H * W * 2 pixels of the last picture (nan: no mesh), H * W window depth in
        [0, 1]. Both are valid until the next call.
        """
        with self._stage("crossing"), self.gl:
            self._vertices.write(np.ascontiguousarray(vertices.numpy(), np.float32))
            self._indices.write(indices)
        with self._stage("raster"), self.gl:
            self._target.use()
            self._target.clear(float("nan"), float("nan"), 0.0, 0.0, depth=1.0)
            self._mesh.render(moderngl.TRIANGLES, vertices=len(indices))
            self.gl.finish()  # reading would wait for it
        with self._stage("crossing"), self.gl:
            dr.sync_thread()  # kernels that read the last result are done before it is written over
            self._place.read_into(self._place_px)
            self._depth.read_into(self._depth_values)
        return mi.Float(self._place_px), mi.Float(self._depth_values)

    def close(self) -> None:
        """Free the context and all that is in it."""
        for item in (self._mesh, self._vertices, self._indices, self._target, self._place, self._depth, self._program):
            item.release()
        self.gl.release()
