"""A scene drawn by OpenGL as fast as it goes, to fly through it: base colours, textures, movers, a light at the eye.

No shadows, no mirrors, no lights of the scene's own: it shows where one is, not what a technique would show.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from stimuli.camera_path import scene_radius
from stimuli.scene import Mover, Part, Scene, scene_at

NEAR_SHARE, FAR_SHARE = 1e-3, 20.0  # of the bounding radius, as in `stimuli.preview`
_VERTEX = """#version 330
uniform mat4 to_eye, projection;
in vec3 place, normal; in vec2 uv; in vec4 tint;
out vec3 eye_place, eye_normal; out vec2 at; out vec4 color;
void main() {
    vec4 seen = to_eye * vec4(place, 1.0);
    eye_place = seen.xyz; eye_normal = mat3(to_eye) * normal; at = uv; color = tint;
    gl_Position = projection * seen;
}
"""
_FRAGMENT = """#version 330
uniform sampler2D base; uniform vec4 factor; uniform vec3 glow; uniform float cutoff;
in vec3 eye_place, eye_normal; in vec2 at; in vec4 color;
out vec4 shown;
void main() {
    vec4 texel = texture(base, at);
    vec4 own = vec4(pow(texel.rgb, vec3(2.2)), texel.a) * factor * color;
    if (own.a < cutoff) discard;
    vec3 n = dot(eye_normal, eye_normal) > 0.0 ? eye_normal : cross(dFdx(eye_place), dFdy(eye_place));
    float facing = abs(dot(normalize(n), normalize(eye_place)));
    shown = vec4(pow(min(own.rgb * (0.25 + 0.75 * facing) + glow, vec3(1.0)), vec3(1.0 / 2.2)), 1.0);
}
"""


@dataclass
class _Drawn:
    """A part on the graphics card. ``mover``: what carries it; ``skin``: it deforms, as this static part of a scene."""

    part: Part
    vertices: moderngl.Buffer
    array: moderngl.VertexArray
    texture: moderngl.Texture
    mover: Mover | None = None
    skin: int | None = None


class FlightPreview:
    """``scene`` in the context ``gl``. Everything is loaded once; `draw` paints into the framebuffer in use."""

    def __init__(self, gl: moderngl.Context, scene: Scene, yfov_rad: float) -> None:
        self._gl, self._scene, self._yfov_rad = gl, scene, yfov_rad
        self._radius = scene_radius(scene)
        self._program = gl.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        self._white = gl.texture((1, 1), 4, b"\xff\xff\xff\xff")
        self._textures: dict[int, moderngl.Texture] = {}
        bent = {skin.part for skin in scene.skins}
        self._drawn = [
            self._load(part, skin=number if number in bent else None) for number, part in enumerate(scene.static)
        ]
        self._drawn += [self._load(part, mover) for mover in scene.movers for part in mover.parts]

    def draw(self, pose: np.ndarray, time_s: float, size_px: tuple[int, int]) -> None:
        """The scene at ``time_s`` seen from ``pose`` (4, 4 camera-to-world)."""
        self._gl.enable_only(moderngl.DEPTH_TEST)
        red, green, blue = (min(1.0, max(0.0, value)) ** (1 / 2.2) for value in self._scene.background)
        self._gl.clear(red, green, blue, 1.0, 1.0)
        to_eye = np.linalg.inv(np.asarray(pose, np.float64))
        self._set("projection", self._projection(size_px))
        now = np.array([time_s])
        carried = {id(mover): mover.track.pose(now)[0] for mover in self._scene.movers}
        posed = scene_at(self._scene, time_s).static
        for one in self._drawn:
            if one.mover is not None and not one.mover.visible_s[0] <= time_s <= one.mover.visible_s[1]:
                continue
            part = one.part if one.skin is None else posed[one.skin]
            if one.skin is not None:
                one.vertices.write(_interleaved(part))
            matrix = part.matrix if one.mover is None else carried[id(one.mover)] @ part.matrix
            # Multiplied in float64: far from the origin nothing trembles.
            self._set("to_eye", to_eye @ matrix)
            pbr = part.material.pbr
            self._program["factor"].value = tuple(float(v) for v in pbr.baseColorFactor)  # type: ignore[union-attr]
            self._program["glow"].value = tuple(float(v) for v in pbr.emissiveFactor)  # type: ignore[union-attr]
            masked = pbr.alphaMode == "MASK"
            self._program["cutoff"].value = float(pbr.alphaCutoff or 0.5) if masked else 0.0  # type: ignore[union-attr]
            one.texture.use()
            one.array.render()

    def close(self) -> None:
        """Give everything back to the context."""
        for item in self._items():
            item.release()

    def _items(self) -> Iterator[Any]:
        for one in self._drawn:
            yield one.array
            yield one.vertices
        yield from self._textures.values()
        yield from (self._white, self._program)

    def _set(self, name: str, matrix: np.ndarray) -> None:
        # OpenGL reads matrices column by column.
        self._program[name].write(np.ascontiguousarray(matrix.T, np.float32).tobytes())  # type: ignore[union-attr]

    def _projection(self, size_px: tuple[int, int]) -> np.ndarray:
        near, far = NEAR_SHARE * self._radius, FAR_SHARE * self._radius
        scale = 1.0 / math.tan(self._yfov_rad / 2.0)
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1] = scale * size_px[1] / size_px[0], scale
        matrix[2, 2], matrix[2, 3] = (far + near) / (near - far), 2.0 * far * near / (near - far)
        matrix[3, 2] = -1.0
        return matrix

    def _load(self, part: Part, mover: Mover | None = None, skin: int | None = None) -> _Drawn:
        vertices = self._gl.buffer(_interleaved(part), dynamic=skin is not None)
        indices = self._gl.buffer(np.ascontiguousarray(part.primitive.indices, np.uint32).tobytes())
        layout = [(vertices, "3f 3f 2f 4f", "place", "normal", "uv", "tint")]
        array = self._gl.vertex_array(self._program, layout, indices)
        return _Drawn(part, vertices, array, self._texture(part), mover, skin)

    def _texture(self, part: Part) -> moderngl.Texture:
        source = getattr(part.material.pbr.baseColorTexture, "source", None)
        if source is None or part.primitive.texcoord_0 is None:
            return self._white
        if id(source) not in self._textures:
            rgba = _rgba(np.asarray(source))
            texture = self._gl.texture((rgba.shape[1], rgba.shape[0]), 4, rgba.tobytes())
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self._textures[id(source)] = texture
        return self._textures[id(source)]


def _rgba(codes: np.ndarray) -> np.ndarray:
    """(H, W, 4) uint8 from one to four channels; grey and grey with alpha are spread."""
    codes = codes if codes.ndim == 3 else codes[..., None]
    out = np.full((*codes.shape[:2], 4), 255, np.uint8)
    count = codes.shape[2]
    out[..., :3] = codes[..., :1] if count < 3 else codes[..., :3]
    if count in (2, 4):
        out[..., 3] = codes[..., -1]
    return out


def _interleaved(part: Part) -> bytes:
    """Place, normal (0: flat), texture coordinate and tint of every vertex, float32."""
    primitive, count = part.primitive, len(part.positions)
    rows = np.zeros((count, 12), np.float32)
    rows[:, :3] = part.positions
    if primitive.normals is not None:
        rows[:, 3:6] = primitive.normals
    if primitive.texcoord_0 is not None:
        rows[:, 6:8] = primitive.texcoord_0
    rows[:, 8:] = 1.0 if primitive.color_0 is None else primitive.color_0
    return rows.tobytes()
