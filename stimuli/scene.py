"""A scene is data: meshes, rigid movers, lights, a camera path. Nothing here traces or draws.

The glTF vocabulary is pyrender's own: `Primitive` (vertex arrays), `pyrender.MetallicRoughnessMaterial`
(with `pyrender.Texture` and `pyrender.Sampler`). What glTF 2.0's core lacks stands beside it: Phong values, area
lights, pose tracks. World: right-handed, +y up where the file says nothing; metres for our own scenes.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, runtime_checkable

import numpy as np

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")  # pyrender picks its platform at import; ours never needs a display
import pyrender

RGB = tuple[float, float, float]


class PoseTrack(Protocol):
    """Where something is over time; a pure function that may be asked for any time."""

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) float64 scene seconds -> (T, 4, 4) float64 local-to-world matrices. End values hold outside the keys."""
        ...


@runtime_checkable
class MountedTrack(PoseTrack, Protocol):
    """A track that moves along with another, its ``carrier``: ``pose(t)`` is ``pose_on(carrier.pose(t), t)``."""

    @property
    def carrier(self) -> PoseTrack:
        """What it is mounted on."""
        ...

    def pose_on(self, carrier_pose: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4) local-to-world matrices, given those of the carrier at (T,) times."""
        ...


@dataclass(frozen=True)
class StillTrack:
    """A pose that never changes."""

    matrix: np.ndarray

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """The same (4, 4) matrix for each of the (T,) times."""
        return np.broadcast_to(np.asarray(self.matrix, np.float64), (np.size(time_s), 4, 4)).copy()


class CameraPath(Protocol):
    """A camera over time: camera-to-world poses (it looks down its own -z, +y up) and a vertical field of view."""

    @property
    def yfov_rad(self) -> float:
        """Vertical field of view."""
        ...

    @property
    def name(self) -> str:
        """What the path is called."""
        ...

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) float64 scene seconds -> (T, 4, 4) float64 camera-to-world matrices, rigid."""
        ...


@dataclass(frozen=True)
class StillCamera:
    """A camera that stands still."""

    matrix: np.ndarray
    yfov_rad: float
    name: str = "still"

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """The same (4, 4) matrix for each of the (T,) times."""
        return np.broadcast_to(np.asarray(self.matrix, np.float64), (np.size(time_s), 4, 4)).copy()


@dataclass(frozen=True)
class Phong:
    """Classic Phong values (BART's ``aff_fm``); the base colour texture multiplies ``ambient`` and ``diffuse``.

    ``specular`` is also the mirror weight. ``shine`` is the exponent; ``transmission`` in [0, 1].
    """

    ambient: RGB
    diffuse: RGB
    specular: RGB
    shine: float
    transmission: float = 0.0
    index: float = 1.0


@dataclass(frozen=True)
class Material:
    """A glTF metallic-roughness material; ``phong`` replaces its shading model where a file gives such values.

    ``pbr`` carries factors, textures (`pyrender.Texture`: ``source`` uint8 array (H, W, C), ``sampler`` with GL wrap
    and filter enums), alphaMode/alphaCutoff and doubleSided. ``unlit``: base colour is emitted as it is. All textures
    are looked up at the part's texcoord_0, v downwards (glTF). ``emissiveFactor`` may exceed 1 (its strength included).
    ``captured``: a surface of the real room (mixed reality): its texture is the capture, it only receives shadows.
    ``ior``: F0 of a dielectric is ((ior - 1) / (ior + 1))^2; 0.04 for 1.5.
    """

    name: str
    pbr: pyrender.MetallicRoughnessMaterial
    phong: Phong | None = None
    transmission: float = 0.0
    unlit: bool = False
    ior: float = 1.5
    captured: bool = False


class Primitive(pyrender.Primitive):
    """pyrender's vertex arrays with exact indices: (F, 3) uint32 (pyrender's own setter rounds them to float32)."""

    @property
    def indices(self) -> np.ndarray:
        """(F, 3) uint32 vertex numbers."""
        return self._indices

    @indices.setter
    def indices(self, value: np.ndarray) -> None:
        self._indices = np.ascontiguousarray(value, dtype=np.uint32)


@dataclass(frozen=True)
class Part:
    """One primitive of triangles with one material. ``matrix`` (4, 4) float64 takes it to world (static) or body space.

    ``primitive``: positions (N, 3) float32, normals (N, 3) or None (flat), texcoord_0 (N, 2) or None, color_0 (N, 4)
    linear, multiplying the base colour, or None, indices (F, 3) uint32, wound so that the front face is
    counter-clockwise *after* ``matrix`` (and the mover's pose), mirroring matrices included. ``positions64`` holds the
    file's own float64 coordinates where float32 would lose them.
    """

    name: str
    primitive: Primitive
    material: Material
    matrix: np.ndarray = field(default_factory=lambda: np.eye(4))
    positions64: np.ndarray | None = None

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) float64 vertex positions before ``matrix``."""
        return np.asarray(self.primitive.positions if self.positions64 is None else self.positions64, np.float64)


@dataclass(frozen=True)
class Mover:
    """A rigid body: parts that move together, the body's pose over time, and the seconds in which it exists."""

    name: str
    parts: tuple[Part, ...]
    track: PoseTrack
    visible_s: tuple[float, float] = (-np.inf, np.inf)


class VertexTrack(Protocol):
    """Where the vertices of a deforming mesh are over time; a pure function."""

    def vertices(self, time_s: float) -> tuple[np.ndarray, np.ndarray | None]:
        """World positions (N, 3) float64 and unit normals (N, 3), or None where the mesh has none, at one time."""
        ...


@dataclass(frozen=True)
class Skin:
    """A skinned mesh: ``Scene.static[part]`` is its shape at time 0 (identity matrix), ``track`` moves it."""

    part: int
    track: VertexTrack


@dataclass(frozen=True)
class Light:
    """A light. ``track`` carries it (its position and direction are then in the track's space).

    point, spot: ``intensity`` in radiance * m^2 per channel, falling off with the squared distance unless
    ``falloff`` is 'none' (BART). spot: full inside ``inner_rad``, none outside ``outer_rad``, about ``direction``.
    directional: ``intensity`` is irradiance on a facing surface; ``direction`` is where the light travels to.
    area: a one-sided rectangle ``corner``, ``edge_u``, ``edge_v`` emitting ``intensity`` (radiance) along
    ``direction``. sphere: ``position``, ``radius``, radiance ``intensity`` (a point light of intensity * pi * r^2, or
    sampled). ``range_m`` cuts a glTF light off.
    """

    kind: Literal["point", "spot", "directional", "area", "sphere"]
    intensity: RGB
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    falloff: Literal["inverse_square", "none"] = "inverse_square"
    inner_rad: float = 0.0
    outer_rad: float = np.pi / 4
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    edge_u: tuple[float, float, float] = (1.0, 0.0, 0.0)
    edge_v: tuple[float, float, float] = (0.0, 1.0, 0.0)
    radius: float = 0.0
    range_m: float = np.inf
    track: PoseTrack | None = None
    name: str = ""


@dataclass(frozen=True)
class Scene:
    """Everything that is shown, as data.

    ``ambient`` multiplies Phong ambient terms and base colours. ``sha256`` identifies the content (of the files, or of
    a procedural recipe and its version). ``notes`` are lines that the user should hear (what was assumed or ignored).
    ``duration_s`` is the length of the scene's own animation (0: it does not move). ``view`` is a second, fixed view
    where the files name one (BART's ``view``), whether or not ``camera`` moves. ``skins`` say which static parts
    deform; `scene_at` poses them, and whoever ignores them sees them still, as at time 0.
    """

    name: str
    static: tuple[Part, ...]
    movers: tuple[Mover, ...]
    lights: tuple[Light, ...]
    camera: CameraPath
    sha256: str
    ambient: RGB = (0.0, 0.0, 0.0)
    background: RGB = (0.0, 0.0, 0.0)
    default_exposure: float | None = None
    duration_s: float = 0.0
    notes: tuple[str, ...] = ()
    view: CameraPath | None = None
    skins: tuple[Skin, ...] = ()

    @property
    def fixation_target(self) -> Mover | None:
        """The mover that an observer is to follow: the first with 'target' in its name; None where there is none."""
        return next((mover for mover in self.movers if "target" in mover.name.lower()), None)

    @property
    def triangle_count(self) -> int:
        """Triangles of all parts, static and moving."""
        parts = [*self.static, *(part for mover in self.movers for part in mover.parts)]
        return sum(len(part.primitive.indices) for part in parts)


def scene_at(scene: Scene, time_s: float) -> Scene:
    """``scene`` with its skinned parts as they are at ``time_s``; the same object where it has none."""
    if not scene.skins:
        return scene
    static = list(scene.static)
    for skin in scene.skins:
        part = static[skin.part]
        positions, normals = skin.track.vertices(time_s)
        primitive = Primitive(
            positions=positions,
            normals=normals,
            texcoord_0=part.primitive.texcoord_0,
            color_0=part.primitive.color_0,
            indices=part.primitive.indices,
            material=part.primitive.material,
        )
        static[skin.part] = replace(part, primitive=primitive, positions64=positions)
    return replace(scene, static=tuple(static))
