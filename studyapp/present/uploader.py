"""Pictures on their way to the display: textures filled one refresh ahead (what may be played at all: `admission`).

A panel owns two textures: one is shown while the next refresh's frame is written into the other. On GPUs the write
goes through a ring of pixel buffers (the copy to the device then runs beside the draw); a software rasteriser has no
device to copy to, a second copy in memory is only a loss there, so it is written directly.
"""

from __future__ import annotations

import moderngl
import numpy as np

from stimuli.errors import InputError, problem
from studyapp.gaze.angles import ScreenGeometry
from studyapp.present.layout import PanelRect
from studyapp.seams import FrameSource

VERTEX = """
#version 330
in vec2 place;
in vec2 texel;
out vec2 uv;
void main() { uv = texel; gl_Position = vec4(place, 0.0, 1.0); }
"""
FRAGMENT = """
#version 330
uniform sampler2D picture;
in vec2 uv;
out vec4 code;
void main() { code = texelFetch(picture, ivec2(uv), 0); }
"""
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "SwiftShader")
PBO_RING = 3


def is_software(gl: moderngl.Context) -> bool:
    """True where OpenGL runs on the CPU."""
    return any(name in str(gl.info["GL_RENDERER"]) for name in SOFTWARE_RENDERERS)


class Quads:
    """The program that draws textures 1:1 at pixel rectangles; one per context."""

    def __init__(self, gl: moderngl.Context, display_px: tuple[int, int]) -> None:
        self._gl, self._display_px = gl, display_px
        self._program = gl.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)

    def quad(self, rect: PanelRect) -> tuple[moderngl.Buffer, moderngl.VertexArray]:
        """Vertices of one rectangle; texel coordinates run from its top left."""
        width, height = self._display_px
        x0, x1 = 2 * rect.x_px / width - 1, 2 * (rect.x_px + rect.width_px) / width - 1
        y0, y1 = 1 - 2 * rect.y_px / height, 1 - 2 * (rect.y_px + rect.height_px) / height
        u0, u1 = (rect.width_px, 0) if rect.flipped else (0, rect.width_px)
        corners = [x0, y0, u0, 0, x0, y1, u0, rect.height_px, x1, y0, u1, 0, x1, y1, u1, rect.height_px]
        buffer = self._gl.buffer(np.array(corners, "f4"))
        return buffer, self._gl.vertex_array(self._program, [(buffer, "2f 2f", "place", "texel")])

    def release(self) -> None:
        """Give the program back."""
        self._program.release()


class Sprite:
    """A still RGBA8 picture at a rectangle: words, crosses, the light patch. Transparent parts show what is below."""

    def __init__(self, gl: moderngl.Context, quads: Quads, rect: PanelRect, picture: np.ndarray) -> None:
        self._gl = gl
        self._texture = gl.texture((rect.width_px, rect.height_px), 4, np.ascontiguousarray(picture), alignment=1)
        self._buffer, self._vertices = quads.quad(rect)
        self._blended = bool((picture[..., 3] < 255).any())

    def draw(self) -> None:
        """Draw it now."""
        if self._blended:
            self._gl.enable(moderngl.BLEND)
        self._texture.use(0)
        self._vertices.render(moderngl.TRIANGLE_STRIP)
        if self._blended:
            self._gl.disable(moderngl.BLEND)

    def release(self) -> None:
        """Give texture and vertices back."""
        for thing in (self._vertices, self._buffer, self._texture):
            thing.release()


class GazeMark:
    """A small square where the eye looks, above everything else: for protocols that show gaze to the participant."""

    def __init__(self, gl: moderngl.Context, screen: ScreenGeometry, side_px: int, code: int) -> None:
        self._gl, self._screen, self._side_px, self._level = gl, screen, side_px, code / 255

    def draw(self, x_dva: float, y_dva: float) -> None:
        """Draw it now; nothing where the eye looks past the screen."""
        x, y = self._screen.from_dva(x_dva, y_dva)
        width, height = self._screen.size_px
        left = round(float(x) * width - self._side_px / 2)
        low = round((1 - float(y)) * height - self._side_px / 2)
        if -self._side_px < left < width and -self._side_px < low < height:
            self._gl.scissor = (left, low, self._side_px, self._side_px)
            self._gl.clear(self._level, self._level, self._level, 1.0)
            self._gl.scissor = None


class PanelTexture:
    """One panel's two textures and the frames they hold."""

    def __init__(self, gl: moderngl.Context, quads: Quads, rect: PanelRect, source: FrameSource) -> None:
        if source.size_px != (rect.width_px, rect.height_px):
            wanted = f"{rect.width_px}x{rect.height_px}"
            raise InputError(problem(f"panel {rect.slot}", "clip size", "{}x{}".format(*source.size_px), wanted))
        self._source = source
        self._textures = [gl.texture(source.size_px, 4, alignment=1) for _ in range(2)]
        for texture in self._textures:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._holds = [-1, -1]
        self._shown = 0
        size = source.size_px[0] * source.size_px[1] * 4
        self._ring = [] if is_software(gl) else [gl.buffer(reserve=size, dynamic=True) for _ in range(PBO_RING)]
        self._turn = 0
        self._buffer, self._vertices = quads.quad(rect)
        self.live = bool(getattr(source, "live", False))

    def fetch(self, index: int) -> None:
        """Have frame ``index`` in a texture; a write only where it is not there yet."""
        if index in self._holds:
            return
        spare = 1 - self._shown
        self._write(spare, index)

    def draw(self, index: int) -> None:
        """Draw frame ``index``, fetching it now where nobody did before (after a miss, and live)."""
        if self.live and index != self._holds[self._shown]:
            self._write(1 - self._shown, index)
        self.fetch(index)
        self._shown = self._holds.index(index)
        self._textures[self._shown].use(0)
        self._vertices.render(moderngl.TRIANGLE_STRIP)

    def forget(self) -> None:
        """Hold nothing (a live source begins anew)."""
        self._holds = [-1, -1]

    def _write(self, place: int, index: int) -> None:
        frame = self._source.frame(index)
        texture = self._textures[place]
        if self._ring:
            ring = self._ring[self._turn]
            self._turn = (self._turn + 1) % len(self._ring)
            ring.orphan()
            ring.write(frame)
            texture.write(ring)
        else:
            texture.write(frame)
        self._holds[place] = index

    def release(self) -> None:
        """Give textures, buffers and vertices back."""
        self._vertices.release()
        for thing in (self._buffer, *self._ring):
            thing.release()
        for texture in self._textures:
            texture.release()
