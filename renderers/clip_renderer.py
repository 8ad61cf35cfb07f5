"""The frames of a stored clip: scene, camera path, gaze, warm-up and loop, as its request says.

A technique with memory is first shown ``warm_up_s`` of what comes before frame 0 (`render_clip` does not do that). A
closed loop is a scene that comes back after the clip's duration; it is warmed up by whole periods, so that frame 0
follows on the last frame.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from renderers.backend import dr
from renderers.catalogue import CATALOGUE, TECHNIQUES, entry
from renderers.clip_channels import SCENE_CHANNELS, SceneChannels, samples_of
from renderers.clip_frames import technique_params
from renderers.eccentricity import gaze_at
from renderers.engine import Engine
from renderers.fixation_target import with_fixation_target
from renderers.loops import closed_loop
from renderers.reference import ReferenceRenderer
from renderers.render_unit import RenderedFrame
from renderers.technique import Frame, Gaze, Technique, View, ViewGeometry
from renderers.units import Unit, block_sizes, twin_seed
from stimuli.camera_path import PATH_NAMES, camera_path, read_camera_path
from stimuli.clip_job import ClipJob
from stimuli.clip_parts import FrameCost
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError, problem
from stimuli.load import load_scene
from stimuli.scene import CameraPath, Scene


def keyed_camera(scene: Scene, keys: str) -> CameraPath:
    """The camera of a protocol's path: JSON, a list of {time_s, position, look_at, yfov_deg}, or what a path file holds
    (`read_camera_path`)."""
    held: Any = json.loads(keys)
    tree: dict[str, Any] = held if isinstance(held, dict) else {"keys": held}
    entries = [dict(entry) for entry in tree["keys"]]
    fields = [entry.pop("yfov_deg", None) for entry in entries]
    tree["keys"] = [{**entry, "time_s": float(entry["time_s"])} for entry in entries]
    if "yfov_deg" not in tree and (given := [value for value in fields if value is not None]):
        tree["yfov_deg"] = given[0]
    with TemporaryDirectory() as directory:  # the reader of path files checks every key
        file = Path(directory) / "protocol_keys.json"
        file.write_text(json.dumps(tree))
        return read_camera_path(file, scene.camera.yfov_rad)


def scene_and_camera(job: ClipJob) -> tuple[Scene, CameraPath]:
    """What the clip shows, with a fixation target where the eye is to follow one and the scene has none.

    InputError where the scene is not the one that the request names.
    """
    request = job.request
    scene = load_scene(job.scene_file, animation=request.animation)
    if scene.sha256 != request.scene_sha256:
        got = f"content {scene.sha256[:12]}..."
        raise InputError(problem(job.scene_file, "scene", got, f"{request.scene_sha256[:12]}..., as requested"))
    if job.path_keys:
        camera = keyed_camera(scene, job.path_keys)
    else:
        camera = camera_path(scene, request.path if request.path in PATH_NAMES else job.path_file or request.path)
    if request.gaze == "moving":
        times = (float(Fraction(request.start_s)), float(Fraction(request.duration_s)))
        scene = with_fixation_target(scene, camera, *times, path_seed(request))
    return closed_loop(scene, camera, request) if request.loop == "closed" else (scene, camera)


def path_seed(request: ClipRequest) -> int:
    """The seed of a moving target's path: of the study's seed, the scene and the condition."""
    told = [request.seed, request.scene_sha256, request.technique, dict(request.params)]
    return int.from_bytes(hashlib.sha256(json.dumps(told, sort_keys=True).encode()).digest()[:8])


def warm_up_frames(request: ClipRequest) -> int:
    """Frames before frame 0 that are rendered and thrown away; whole periods for a closed loop."""
    wanted = round(Fraction(request.warm_up_s) * Fraction(request.rate_hz))
    if request.loop != "closed":
        return wanted
    return max(1, math.ceil(wanted / request.frame_count)) * request.frame_count


def geometry_of(request: ClipRequest) -> ViewGeometry | None:
    """The request's (width_m, height_m, distance_m, offset right, offset up); None: the camera's own field."""
    if request.geometry is None:
        return None
    if len(request.geometry) != 5:
        raise InputError(
            problem(request.scene, "geometry", request.geometry, "width, height, distance, offset x and y")
        )
    width_m, height_m, distance_m, right_m, up_m = request.geometry
    return ViewGeometry(width_m, height_m, distance_m, (right_m, up_m))


def gaze_of(request: ClipRequest, scene: Scene, camera: CameraPath, t1: Fraction) -> Gaze | None:
    """Where the eye looks at ``t1``: the request's fixed direction, or the scene's fixation target ('moving')."""
    if request.gaze != "moving":
        return request.gaze if isinstance(request.gaze, tuple) else None
    target = scene.fixation_target
    if target is None:
        raise InputError(
            problem(request.scene, "moving gaze", "no mover called target", "a scene with a fixation target")
        )
    at = np.array([float(t1)])
    own = np.linalg.inv(camera.pose(at)[0]) @ target.track.pose(at)[0][:, 3]
    if own[2] >= 0:
        raise InputError(
            problem(request.scene, "moving gaze", f"the target is behind the eye at {float(t1):g} s", "in front")
        )
    x, y = own[0] / -own[2], own[1] / -own[2]
    geometry = geometry_of(request)
    if geometry is not None:
        # The picture's plane stands at the screen: its half height is tan(yfov / 2) in front of a pinhole.
        half = math.tan(camera.yfov_rad / 2)
        x = x / half * geometry.height_m / 2 + geometry.offset_m[0]
        y = y / half * geometry.height_m / 2 + geometry.offset_m[1]
    return gaze_at((x, y), geometry)


def technique_class(name: str) -> type[Technique]:
    """The technique called ``name`` in the catalogue, or ``module:Class`` from outside. InputError where it is not."""
    if ":" not in name:
        entry(name)
        return TECHNIQUES[name]
    module, _, attribute = name.partition(":")
    try:
        found: type[Technique] = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(
            problem("technique", "module:Class", repr(name), f"one that can be imported ({error})")
        ) from error
    return found


def technique_settings(name: str, params: Mapping[str, Any]) -> BaseModel:
    """The checked parameters of a technique, from the catalogue or from outside. InputError, a line a mistake."""
    if ":" not in name:
        checked: BaseModel = technique_params(name, params)
        return checked
    try:
        return technique_class(name).Params(**params)
    except ValidationError as error:
        lines = [
            problem(f"{name}: {e['loc']}", e["msg"].lower(), repr(e["input"]), "its own Params") for e in error.errors()
        ]
        raise InputError(*lines) from error


class ClipRenderer:
    """Renders units; the scene and the engine of the last clip stay, so that a clip's units share their kernels."""

    def __init__(self, threads: int | None) -> None:
        if threads is not None:
            dr.set_thread_count(threads)
            import numba

            numba.set_num_threads(threads)
        self._key: tuple[Any, ...] = ()
        self._held: tuple[Scene, CameraPath, Engine] | None = None
        self._techniques: dict[tuple[str, int], Technique] = {}
        self._scene_channels: tuple[tuple[int, tuple[int, int]], SceneChannels] | None = None

    def _prepared(self, job: ClipJob) -> tuple[Scene, CameraPath, Engine]:
        """Scene, camera and engine of ``job``."""
        request = job.request
        follows, closed = request.gaze == "moving", request.loop == "closed"  # both make a scene of the clip's own
        times = (request.start_s, request.duration_s, request.rate_hz) if follows or closed else None
        key = (
            job.scene_file, request.scene_sha256, request.animation, request.path, job.path_keys, request.lighting,
            request.loop, times, path_seed(request) if follows else None,
        )  # fmt: skip
        if self._held is None or key != self._key:
            scene, camera = scene_and_camera(job)
            self._held = scene, camera, Engine(scene, lighting=request.lighting)  # type: ignore[arg-type]
            self._key = key
            self._techniques, self._scene_channels = {}, None
        return self._held

    def _technique(self, request: ClipRequest, engine: Engine, seed: int) -> Technique:
        """The technique of ``request`` with ``seed``, made once a clip and reset for each unit."""
        key = request.identity, seed
        if key not in self._techniques:
            if not any(kept == request.identity for kept, _ in self._techniques):
                self._techniques.clear()
            params = technique_settings(request.technique, request.params)
            made = technique_class(request.technique)
            self._techniques[key] = made(engine, request.size_px, params, seed, "total")
        self._techniques[key].reset(seed)
        return self._techniques[key]

    def frames(self, job: ClipJob, unit: Unit) -> Iterator[RenderedFrame]:
        """The frames of ``unit``: see `renderers.render_unit.UnitRenderer`."""
        request = job.request
        scene, camera, engine = self._prepared(job)
        known = CATALOGUE.get(request.technique)
        if known is not None and known.averages:
            yield from self._averaged(request, unit, scene, camera, engine)
            return
        technique = self._technique(request, engine, request.seed)
        alone = known is not None and known.stateless and request.lighting != "probes"  # probes remember
        before = 0 if alone else warm_up_frames(request)
        for k in range(unit.first - before, unit.stop):
            view = view_of(request, scene, camera, k, before, cut=k == unit.first - before)
            frame = technique.render(view)
            if k >= unit.first:
                color, cost = (_color(frame),), _cost(frame)
                yield RenderedFrame(k, color, (1,), self._channels(request, engine, technique, frame, view), cost)

    def _averaged(
        self, request: ClipRequest, unit: Unit, scene: Scene, camera: CameraPath, engine: Engine
    ) -> Iterator[RenderedFrame]:
        """Frames of the reference in sample blocks; a second picture of three frames where there is but one block."""
        technique = self._technique(request, engine, request.seed)
        assert isinstance(technique, ReferenceRenderer)
        sizes = block_sizes(int(request.params["spp"]))
        low, high = unit.blocks or (0, len(sizes))
        probes = {0, request.frame_count // 2, request.frame_count - 1} if len(sizes) == 1 else set()
        for k in range(unit.first, unit.stop):
            view = view_of(request, scene, camera, k, 0, cut=True)
            made = []
            for block in range(low, high):
                frame = technique.render_samples(view, sum(sizes[:block]), sizes[block])
                made.append((_color(frame), _cost(frame)))
            # Of all blocks together: every worker gives the same.
            channels = self._channels(request, engine, technique, None, view)
            twin = None
            if k in probes:
                other = self._technique(request, engine, twin_seed(request.seed))
                twin = _color(other.render(view))
            yield RenderedFrame(
                k, tuple(color for color, _ in made), sizes[low:high], channels, total_cost([cost for _, cost in made]),
                twin,
            )  # fmt: skip

    def _channels(
        self, request: ClipRequest, engine: Engine, technique: Technique, frame: Frame | None, view: View
    ) -> dict[str, np.ndarray]:
        """The channels that the request asks for; ``frame`` None: the average of all of a reference's samples."""
        found: dict[str, np.ndarray] = {}
        for name in request.channels:
            if frame is not None and name in frame.channels:
                found[name] = np.array(frame.channels[name])
            elif name in SCENE_CHANNELS and name not in found:
                if self._scene_channels is None or self._scene_channels[0] != (id(engine), request.size_px):
                    self._scene_channels = (id(engine), request.size_px), SceneChannels(engine, request.size_px)
                found |= self._scene_channels[1].of(view)
            elif name == "samples" and frame is None:
                found[name] = np.full(request.size_px[::-1], int(request.params["spp"]), np.uint32)
            elif name == "samples":
                assert frame is not None
                found[name] = samples_of(technique, frame, view, request.size_px)
            elif name not in found:
                has = " | ".join([*SCENE_CHANNELS, "samples", *(frame.channels if frame is not None else ())])
                raise InputError(problem(request.technique, "channels", name, f"one of {has}"))
        return {name: found[name] for name in request.channels}


def view_of(request: ClipRequest, scene: Scene, camera: CameraPath, k: int, before: int, cut: bool) -> View:
    """Frame ``k`` of the clip (negative: warm-up) for a technique; its index counts from the warm-up's start."""
    rate = Fraction(request.rate_hz)
    t1 = Fraction(request.start_s) + k / rate
    return View(
        index=k + before,
        t0=t1 - 1 / rate,
        t1=t1,
        size_px=request.size_px,
        camera=camera,
        gaze=gaze_of(request, scene, camera, t1),
        geometry=geometry_of(request),
        exposure=request.exposure,
        tone=request.tone,
        cut=cut,
    )


def total_cost(costs: list[FrameCost]) -> FrameCost:
    """The cost of several renders of one frame."""
    return FrameCost(
        {key: sum(cost.seconds[key] for cost in costs) for key in costs[0].seconds},
        {kind: sum(cost.rays[kind] for cost in costs) for kind in costs[0].rays},
        sum(cost.clamped for cost in costs),
    )


def _color(frame: Frame) -> np.ndarray:
    return np.array(frame.color, np.float32)


def _cost(frame: Frame) -> FrameCost:
    rays = {kind: int(count) for kind, count in frame.rays.items()}
    return FrameCost({stage: float(s) for stage, s in frame.seconds.items()}, rays, int(frame.clamped))
