"""Meshes whose vertices move (skins, morphs) on the device: one shape a view, recomputed in numpy, traced as it is.

A view's rays all see the shape of its t1 (rigid movers alone have a pose of their own at each ray's time), so
techniques whose samples have times of their own refuse such scenes. The shape of t0 is kept for motion vectors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from renderers.backend import mi
from renderers.frozen import opaque_float
from renderers.geometry import Geometry
from renderers.space import TracerSpace
from stimuli.errors import InputError, problem
from stimuli.scene import Scene

if TYPE_CHECKING:
    from renderers.tracer import SceneArrays


def refuse_deforming(scene: Scene, technique: str) -> None:
    """Raise InputError where ``scene`` has meshes whose vertices move: for samples with times of their own."""
    if scene.skins:
        names = sorted({scene.static[skin.part].name for skin in scene.skins})
        raise InputError(
            problem(
                f"{scene.name}: {technique}", "samples with times of their own",
                f"meshes whose vertices move ({', '.join(names)})", "rigid bodies, or a technique of whole frames",
            )
        )  # fmt: skip


class Skins:
    """The deforming meshes of a scene: ``scenes`` are the Mitsuba scenes of the body that deforms."""

    def __init__(self, scene: Scene, space: TracerSpace, geometry: Geometry, scenes: list[Any]) -> None:
        assert geometry.deforming is not None
        self._scene, self._space, self._run = scene, space, geometry.deforming
        self._vertices = geometry.vertices.copy()
        self._values = [mi.traverse(made) for made in scenes]
        self._interval: tuple[float, float] | None = None

    def shape(self, time_s: float) -> np.ndarray:
        """(V, 6) float32 tracer-space positions and unit normals (0: flat) at ``time_s``, in the arrays' order."""
        rows = []
        for number in self._run.order:
            skin = self._scene.skins[number]
            positions, normals = skin.track.vertices(time_s)
            points = self._space.points(positions)
            if not np.isfinite(points).all():
                where = f"{self._scene.name}: mesh {self._scene.static[skin.part].name}"
                raise InputError(
                    problem(where, f"vertex position at {time_s:g} s", "one that is not finite", "finite numbers")
                )
            rows.append(np.concatenate([points, np.zeros_like(points) if normals is None else normals], axis=1))
        return np.concatenate(rows).astype(np.float32)

    def pose(self, arrays: SceneArrays, t0_s: float, t1_s: float) -> None:
        """Give ``arrays`` the shapes of both times, and rebuild the traversal structures for that of ``t1_s``."""
        if self._interval == (t0_s, t1_s):
            return
        run = self._run
        now = self.shape(t1_s)
        before = np.zeros((run.vertices, 4), np.float32)
        before[:, :3] = now[:, :3] if t0_s == t1_s else self.shape(t0_s)[:, :3]
        place = slice(run.first_vertex, run.first_vertex + run.vertices)
        self._vertices[place, :3], self._vertices[place, 4:7] = now[:, :3], now[:, 3:]
        arrays.vertices, arrays.before = opaque_float(self._vertices), opaque_float(before)
        for values in self._values:
            values["mesh.vertex_positions"] = opaque_float(now[:, :3])
            values.update()
        self._interval = t0_s, t1_s
