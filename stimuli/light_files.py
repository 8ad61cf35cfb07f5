"""Light files beside a scene: ``STEM_scene.json`` (BART: point lights, ambient, background, view) and
``STEM_lights.json`` (sphere, area, sunsky, envmap). What each entry means: see `read_light_files`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.scene import RGB, Light, PoseTrack, StillCamera

NodeLookup = Callable[[str], PoseTrack | np.ndarray | None]
"""Node name -> its track, its matrix where it never moves, None where there is no such node."""


@dataclass
class LightFiles:
    """What the files beside a scene say; ``data`` are their bytes, for the scene's identity."""

    lights: list[Light] = field(default_factory=list)
    ambient: RGB = (0.0, 0.0, 0.0)
    background: RGB = (0.0, 0.0, 0.0)
    view: StillCamera | None = None
    notes: list[str] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def read_light_files(scene_file: Path, node: NodeLookup) -> LightFiles:
    """Both light files of ``scene_file``, where they are there.

    ``_scene.json``: point lights that do not fall off with distance (``pos``, ``color``, ``anim`` = the node that
    carries the light, ``pos`` then being in its space), ``ambient``, ``background``, ``view``. ``_lights.json``:
    ``sphere`` (center, radius, radiance), ``area`` (4 vertices, one-sided along normal, radiance), ``sunsky`` (its
    sun as a directional light, a constant sky), ``envmap`` without its picture = constant 1; others are named.
    """
    result = LightFiles()
    for ending, read in (("_scene.json", _read_bart), ("_lights.json", _read_lights)):
        file = scene_file.with_name(scene_file.stem + ending)
        if file.is_file():
            data = file.read_bytes()
            result.data.append(ending.encode() + data)
            try:
                tree = json.loads(data)
            except (UnicodeDecodeError, json.JSONDecodeError) as error:
                raise InputError(problem(file, "light file", str(error).replace("\n", " "), "JSON")) from error
            if not isinstance(tree, dict):
                raise InputError(problem(file, "light file", type(tree).__name__, "a JSON object"))
            read(file, tree, node, result)
    return result


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(4, 4) camera-to-world at ``eye``, looking at ``target``; where ``up`` is parallel to that another is taken."""
    back = np.asarray(eye, np.float64) - np.asarray(target, np.float64)
    length = np.linalg.norm(back)
    back = back / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    right = np.cross(np.asarray(up, np.float64), back)
    if np.linalg.norm(right) < 1e-9:
        right = np.cross(np.eye(3)[int(np.argmin(np.abs(back)))], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, np.cross(back, right), back, eye
    return matrix


def _read_bart(file: Path, tree: Mapping[str, Any], node: NodeLookup, result: LightFiles) -> None:
    for number, entry in enumerate(_entries(file, tree)):
        where = f"{file}: light {number}"
        position = _three(entry.get("pos"), where, "pos")
        carrier = str(entry.get("anim") or "")
        track: PoseTrack | None = None
        if carrier:
            found = node(carrier)
            if found is None:
                raise InputError(problem(where, "anim", repr(carrier), "the name of a node in the scene"))
            if isinstance(found, np.ndarray):
                x, y, z = (found @ np.array([*position, 1.0]))[:3]
                position = (float(x), float(y), float(z))
            else:
                track = found
        result.lights.append(
            Light(
                "point",
                _three(entry.get("color"), where, "color"),
                position,
                falloff="none",
                track=track,
                name=f"light {number}",
            )
        )
    if "ambient" in tree:
        result.ambient = _three(tree["ambient"], str(file), "ambient")
    if "background" in tree:
        result.background = _three(tree["background"], str(file), "background")
    view = tree.get("view")
    if isinstance(view, dict) and "from" in view:
        where = f"{file}: view"
        eye, target, up = (np.array(_three(view.get(key), where, key)) for key in ("from", "at", "up"))
        angle = view.get("angle", 45.0)
        angle = angle[0] if isinstance(angle, list) and angle else angle
        if not isinstance(angle, (int, float)) or not 0.0 < angle < 180.0:
            raise InputError(problem(where, "angle", angle, "degrees between 0 and 180"))
        result.view = StillCamera(look_at(eye, target, up), float(np.radians(angle)), "view")


def _read_lights(file: Path, tree: Mapping[str, Any], node: NodeLookup, result: LightFiles) -> None:
    unknown: set[str] = set()
    for number, entry in enumerate(_entries(file, tree)):
        where = f"{file}: light {number}"
        kind = entry.get("type")
        if kind == "sphere":
            radius = entry.get("radius")
            if not isinstance(radius, (int, float)) or not 0.0 < radius < np.inf:
                raise InputError(problem(where, "radius", radius, "a positive number"))
            centre, radiance = (
                _three(entry.get("center"), where, "center"),
                _three(entry.get("radiance"), where, "radiance"),
            )
            result.lights.append(Light("sphere", radiance, centre, radius=float(radius), name=f"sphere {number}"))
        elif kind == "area":
            result.lights.append(_area(entry, where, number, result))
        elif kind == "sunsky":
            _sunsky(entry, where, result)
        elif kind in ("envmap", "constant"):
            radiance = entry.get("radiance", (1.0, 1.0, 1.0))
            result.background = result.ambient = _three(list(radiance), where, "radiance")
            if kind == "envmap":
                result.notes.append(
                    f"{file.name}: the envmap has no picture; a constant sky of {result.background} stands for it"
                )
        else:
            unknown.add(str(kind))
    if unknown:
        result.notes.append(f"{file.name}: light types not known and left out: {', '.join(sorted(unknown))}")


def _area(entry: Mapping[str, Any], where: str, number: int, result: LightFiles) -> Light:
    vertices = entry.get("vertices")
    if not isinstance(vertices, list) or len(vertices) != 4:
        raise InputError(problem(where, "vertices", vertices, "four corners, going round"))
    corner = np.array([_three(vertex, where, "vertices") for vertex in vertices])
    edge_u, edge_v = corner[1] - corner[0], corner[3] - corner[0]
    across = np.cross(edge_u, edge_v)
    area = float(np.linalg.norm(across))
    if area <= 0.0:
        raise InputError(problem(where, "vertices", "a rectangle without area", "four different corners"))
    if np.linalg.norm(corner[2] - corner[0] - edge_u - edge_v) > 1e-3 * np.sqrt(area):
        result.notes.append(f"{where}: four corners that are no parallelogram; corners 1, 2 and 4 count")
    normal = np.array(_three(entry.get("normal", list(across / area)), where, "normal"))
    length = float(np.linalg.norm(normal))
    if length <= 0.0:
        raise InputError(problem(where, "normal", entry.get("normal"), "a direction"))
    return Light(
        "area",
        _three(entry.get("radiance"), where, "radiance"),
        position=_tuple(corner[0] + (edge_u + edge_v) / 2),
        direction=_tuple(normal / length),
        corner=_tuple(corner[0]),
        edge_u=_tuple(edge_u),
        edge_v=_tuple(edge_v),
        name=f"area {number}",
    )


def _sunsky(entry: Mapping[str, Any], where: str, result: LightFiles) -> None:
    """The sun as a directional light; the sky as one radiance."""
    to_sun = entry.get("sun_direction", entry.get("sunDirection", entry.get("direction")))
    toward = np.array(_three(to_sun, where, "sun_direction"))
    length = float(np.linalg.norm(toward))
    if length <= 0.0:
        raise InputError(problem(where, "sun_direction", to_sun, "a direction"))
    irradiance = _three(list(entry.get("sun_irradiance", (np.pi, np.pi, np.pi))), where, "sun_irradiance")
    sky = _three(list(entry.get("sky_radiance", (0.3, 0.3, 0.3))), where, "sky_radiance")
    result.lights.append(Light("directional", irradiance, direction=_tuple(-toward / length), name="sun"))
    result.background = result.ambient = sky
    result.notes.append(f"{where}: sunsky = its sun as a directional light and a constant sky of {sky}")


def _entries(file: Path, tree: Mapping[str, Any]) -> list[dict[str, Any]]:
    entries = tree.get("lights", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(problem(file, "lights", type(entries).__name__, "a list of objects"))
    return entries


def _three(value: object, where: str, what: str) -> RGB:
    if (
        not isinstance(value, (list, tuple))
        or len(value) != 3
        or not all(isinstance(item, (int, float)) and np.isfinite(item) for item in value)
    ):
        raise InputError(problem(where, what, value, "three finite numbers"))
    a, b, c = (float(item) for item in value)
    return (a, b, c)


def _tuple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in vector)
    return (x, y, z)
