"""glTF 2.0 files (.gltf, .glb) as scene data: static parts, rigid movers, lights, a camera.

A mover is a rigid body: all mesh nodes under the same nearest animated node. Its pose is that node's world matrix.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.gltf_animation import NodeTrack, Rig, RigNode, compose, unit
from stimuli.gltf_buffers import Document, open_document
from stimuli.gltf_channels import WIDTHS, read_animation
from stimuli.gltf_lights import punctual_light
from stimuli.gltf_materials import MaterialReader
from stimuli.gltf_meshes import ReadPrimitive, read_primitive
from stimuli.gltf_morphs import WeightTrack
from stimuli.gltf_skins import MorphTrack, SkinTrack
from stimuli.scene import CameraPath, Light, Mover, Part, PoseTrack, Primitive, Skin, StillCamera, VertexTrack

_REST = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True)
class TrackCamera:
    """A camera carried by a track; the matrix is made rigid (scale and shear of its node do not count)."""

    track: PoseTrack
    yfov_rad: float
    name: str = "file"

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) -> (T, 4, 4) rigid camera-to-world matrices."""
        return rigid(self.track.pose(time_s))


@dataclass
class GltfContent:
    """What a glTF file holds. ``node_track`` finds the track (or matrix) of a node by its name."""

    path: Path
    static: list[Part] = field(default_factory=list)
    movers: list[Mover] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    skins: list[Skin] = field(default_factory=list)
    camera: CameraPath | None = None
    duration_s: float = 0.0
    animation: str = ""
    has_phong: bool = False
    notes: list[str] = field(default_factory=list)
    digest: Any = None
    node_poses: dict[str, tuple[Rig, int, np.ndarray]] = field(default_factory=dict)

    def node_track(self, name: str) -> NodeTrack | np.ndarray | None:
        """The `NodeTrack` of the node called ``name``, its matrix where it never moves, None where there is none."""
        if name not in self.node_poses:
            return None
        rig, animated, below = self.node_poses[name]
        return below if animated < 0 else NodeTrack(rig, animated, below)


def rigid(matrix: np.ndarray) -> np.ndarray:
    """(..., 4, 4) with the rotation part made orthonormal and right-handed: z kept, y next, x from both."""
    z = _unit3(matrix[..., :3, 2])
    y = matrix[..., :3, 1]
    y = _unit3(y - np.sum(y * z, -1, keepdims=True) * z)
    result = np.zeros(matrix.shape)
    result[..., :3, 0] = np.cross(y, z)
    result[..., :3, 1], result[..., :3, 2] = y, z
    result[..., :3, 3] = matrix[..., :3, 3]
    result[..., 3, 3] = 1.0
    return result


def read_gltf(path: Path, animation: str | None = None) -> GltfContent:
    """Read a file. ``animation``: by name; None takes the first. InputError where it cannot be read."""
    return _Reader(open_document(path), animation).read()


class _Reader:
    """One pass over the nodes of one document."""

    def __init__(self, document: Document, animation: str | None) -> None:
        self._document = document
        self._materials = MaterialReader(document)
        self._nodes = document.items("nodes")
        self._primitives: dict[tuple[int, int, tuple[float, ...]], ReadPrimitive | None] = {}
        self._arrays: dict[tuple[int, bool], Primitive] = {}
        self._parts: dict[int, list[Part]] = {}
        self._content = GltfContent(document.path, notes=document.notes, digest=document.digest)
        played = read_animation(document, animation)
        self._content.animation = played.name
        self._channels, self._weights = played.channels, played.weights
        self._animated = {channel.node for channel in self._channels}
        # Per visited node: nearest animated node (itself included; -1: none) and the matrix from there to it.
        self._anchor: dict[int, tuple[int, np.ndarray]] = {}
        self._rig_nodes: list[RigNode] = []
        self._walk()

    def read(self) -> GltfContent:
        content = self._content
        for node in self._anchor:
            self._read_node(node)
        names = {node: str(self._nodes[node].get("name", f"node {node}")) for node in self._parts}
        content.movers = [
            Mover(names[node], tuple(parts), NodeTrack(self._rig, node)) for node, parts in self._parts.items() if parts
        ]
        materials = [part.material for part in [*content.static, *(p for m in content.movers for p in m.parts)]]
        content.has_phong = any(material.phong is not None for material in materials)
        ends = [float(channel.times_s[-1]) for channel in self._channels]
        ends += [float(track.times_s[-1]) for node, track in self._weights.items() if node in self._anchor]
        content.duration_s = max(ends, default=0.0)
        for node, (animated, below) in self._anchor.items():
            name = str(self._nodes[node].get("name", f"node {node}"))
            content.node_poses.setdefault(name, (self._rig, animated, below))
        return content

    @cached_property
    def _rig(self) -> Rig:
        return Rig(self._rig_nodes, [channel for channel in self._channels if channel.node in self._anchor])

    @cached_property
    def _start(self) -> np.ndarray:
        """World matrices of the animated nodes at time 0."""
        return self._rig.poses(np.zeros(1))[:, 0]

    def _world_at_start(self, node: int) -> np.ndarray:
        animated, below = self._anchor[node]
        return below if animated < 0 else self._start[self._rig.row[animated]] @ below

    # --- nodes ---

    def _walk(self) -> None:
        """Visit the scene's nodes, parents first; fill `_anchor` and `_rig_nodes`."""
        queue = [(root, -1, np.eye(4)) for root in reversed(self._roots())]
        while queue:
            node, animated, above = queue.pop()
            entry = self._document.item("nodes", node, "scene or children")
            if node in self._anchor:
                raise InputError(problem(self._document.path, f"node {node}", "reached twice", "a tree of nodes"))
            if node in self._animated:
                if "matrix" in entry:
                    self._document.note(
                        f"{self._document.path.name}: animated node {node} has a matrix, which glTF forbids; ignored"
                    )
                rest = {key: np.asarray(entry.get(key, value), np.float64) for key, value in _REST.items()}
                self._rig_nodes.append(RigNode(node, animated, above, **rest))
                animated, below = node, np.eye(4)
            else:
                below = above @ self._local(node, entry)
            self._anchor[node] = animated, below
            queue.extend((child, animated, below) for child in reversed(entry.get("children", [])))

    def _roots(self) -> list[int]:
        scenes = self._document.items("scenes")
        if scenes:
            return list(self._document.item("scenes", self._document.json.get("scene", 0), "scene").get("nodes", []))
        children = {child for entry in self._nodes for child in entry.get("children", [])}
        return [node for node in range(len(self._nodes)) if node not in children]

    def _local(self, node: int, entry: dict[str, Any]) -> np.ndarray:
        if "matrix" in entry:
            local = np.asarray(entry["matrix"], np.float64).reshape(4, 4).T
        else:
            parts = {key: np.asarray(entry.get(key, value), np.float64) for key, value in _REST.items()}
            local = compose(parts["translation"], unit(parts["rotation"]), parts["scale"])
        if not np.isfinite(local).all():
            raise InputError(problem(self._document.path, f"node {node}", "nan or inf in its matrix", "finite numbers"))
        return local

    def _read_node(self, node: int) -> None:
        entry = self._nodes[node]
        if "mesh" in entry:
            self._read_mesh_node(node, entry)
        if "camera" in entry:
            self._read_camera(node, entry["camera"])
        light = entry.get("extensions", {}).get("KHR_lights_punctual", {}).get("light")
        if light is not None:
            animated, below = self._anchor[node]
            track = None if animated < 0 else NodeTrack(self._rig, animated, below)
            self._content.lights.append(punctual_light(self._document, light, below, track))

    def _read_mesh_node(self, node: int, entry: dict[str, Any]) -> None:
        animated, below = self._anchor[node]
        mirrored = bool(np.linalg.det(self._world_at_start(node)[:3, :3]) < 0.0)
        for name, primitive in self._mesh_primitives(entry):
            if "skin" in entry and primitive.joints is not None:
                self._read_skinned(name, primitive, entry["skin"], self._weights.get(node))
                continue
            if node in self._weights and primitive.targets is not None:
                for copy in self._instances(entry):
                    flip = mirrored != bool(np.linalg.det(copy[:3, :3]) < 0.0)
                    row = -1 if animated < 0 else self._rig.row[animated]
                    faces = primitive.indices[:, ::-1] if flip else primitive.indices
                    track = self._weights[node].narrowed(len(primitive.targets.position_steps))
                    morph = MorphTrack(primitive.targets, track, faces.astype(np.int64), self._rig, row, below @ copy)
                    self._add_deforming(name, primitive, faces, morph)
                continue
            target = self._content.static if animated < 0 else self._parts.setdefault(animated, [])
            for copy in self._instances(entry):
                flip = mirrored != bool(np.linalg.det(copy[:3, :3]) < 0.0)
                key = id(primitive), flip
                if key not in self._arrays:
                    self._arrays[key] = primitive.as_pyrender(flip)
                target.append(Part(name, self._arrays[key], primitive.material, below @ copy, primitive.positions64))

    def _instances(self, entry: dict[str, Any]) -> np.ndarray:
        """(I, 4, 4) matrices of EXT_mesh_gpu_instancing; one identity where the node has none."""
        attributes = entry.get("extensions", {}).get("EXT_mesh_gpu_instancing", {}).get("attributes", {})
        given = {key: self._document.array(attributes[key.upper()]) for key in _REST if key.upper() in attributes}
        if not given:
            return np.eye(4)[None]
        count = len(next(iter(given.values())))
        parts = {key: given.get(key, np.tile(rest, (count, 1))) for key, rest in _REST.items()}
        if any(values.shape != (count, WIDTHS[key]) for key, values in parts.items()):
            got = ", ".join(f"{key} {values.shape}" for key, values in parts.items())
            raise InputError(problem(self._document.path, "EXT_mesh_gpu_instancing", got, f"{count} of each"))
        return compose(parts["translation"], unit(parts["rotation"]), parts["scale"])

    def _mesh_primitives(self, node: dict[str, Any]) -> Iterator[tuple[str, ReadPrimitive]]:
        index = node["mesh"]
        mesh = self._document.item("meshes", index, "node")
        weights = tuple(float(w) for w in node.get("weights", mesh.get("weights", [])))
        for number in range(len(mesh.get("primitives", []))):
            key = index, number, weights
            if key not in self._primitives:
                self._primitives[key] = read_primitive(self._document, self._materials, mesh, number, list(weights))
            primitive = self._primitives[key]
            if primitive is not None:
                base = str(node.get("name", mesh.get("name", f"mesh {index}")))
                yield (base if number == 0 else f"{base}#{number}"), primitive

    def _read_skinned(self, name: str, primitive: ReadPrimitive, skin_index: int, weights: WeightTrack | None) -> None:
        skin = self._document.item("skins", skin_index, "node")
        joints = list(skin.get("joints", []))
        assert primitive.joints is not None
        where = f"skin {skin_index} joint"
        if primitive.joints.size and int(primitive.joints.max()) >= len(joints):
            raise InputError(problem(self._document.path, where, int(primitive.joints.max()), f"below {len(joints)}"))
        missing = [joint for joint in joints if joint not in self._anchor]
        if missing:
            raise InputError(problem(self._document.path, where, missing[0], "a node of the scene"))
        bind = np.tile(np.eye(4), (len(joints), 1, 1))
        if "inverseBindMatrices" in skin:
            stored = self._document.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
            if len(stored) < len(joints):
                raise InputError(problem(self._document.path, f"skin {skin_index} matrices", len(stored), len(joints)))
            bind = stored[: len(joints)]
        anchors = [self._anchor[joint] for joint in joints]
        rows = np.array([-1 if animated < 0 else self._rig.row[animated] for animated, _ in anchors])
        morph = None
        if weights is not None and primitive.targets is not None:
            morph = weights.narrowed(len(primitive.targets.position_steps))
        track = SkinTrack(primitive, self._rig, rows, np.stack([below for _, below in anchors]), bind, morph)
        moves = bool((rows >= 0).any()) or morph is not None
        self._add_deforming(name, primitive, primitive.indices, track, moves)

    def _add_deforming(
        self, name: str, primitive: ReadPrimitive, faces: np.ndarray, track: VertexTrack, moves: bool = True
    ) -> None:
        """A part as it is at 0 s, and (where it moves) the track of its vertices."""
        positions, normals = track.vertices(0.0)
        mesh = Primitive(
            positions=positions,
            normals=normals,
            texcoord_0=primitive.texcoord,
            color_0=primitive.color,
            indices=faces,
            material=primitive.material.pbr,
        )
        if moves:
            self._content.skins.append(Skin(len(self._content.static), track))
            shapes = "skinned and morphing meshes have one shape a refresh; frameless techniques refuse them"
            self._document.note(f"{self._document.path.name}: {shapes}")
        self._content.static.append(Part(name, mesh, primitive.material, np.eye(4), positions))

    # --- cameras and lights ---

    def _read_camera(self, node: int, index: int) -> None:
        camera = self._document.item("cameras", index, "node")
        if self._content.camera is not None:
            self._document.note(f"{self._document.path.name}: several cameras, the first in the tree is used")
            return
        if camera.get("type") != "perspective" or "perspective" not in camera:
            self._document.note(f"{self._document.path.name}: an orthographic camera is not used")
            return
        yfov = float(camera["perspective"].get("yfov", 0.0))
        if not 0.0 < yfov < np.pi:
            raise InputError(problem(self._document.path, f"camera {index} yfov", yfov, "radians between 0 and pi"))
        animated, below = self._anchor[node]
        if animated < 0:
            self._content.camera = StillCamera(rigid(below), yfov, "file")
        else:
            self._content.camera = TrackCamera(NodeTrack(self._rig, animated, below), yfov)


def _unit3(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(length > 0.0, length, 1.0)
