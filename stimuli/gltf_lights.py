"""Lights of KHR_lights_punctual: point, spot and directional lights that stand where their node does."""

from __future__ import annotations

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.gltf_animation import NodeTrack
from stimuli.gltf_buffers import Document
from stimuli.scene import Light


def punctual_light(document: Document, index: int, matrix: np.ndarray, track: NodeTrack | None) -> Light:
    """Light ``index`` of the file on a node with the (4, 4) world ``matrix``, or carried by ``track``.

    Intensities (candela, lux) are taken as they are, as radiance * m^2 and irradiance: the exposure settles the scale.
    """
    lights = document.json.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    if not 0 <= index < len(lights):
        raise InputError(problem(document.path, "light of a node", index, f"0 to {len(lights) - 1}"))
    entry = lights[index]
    kind = entry.get("type")
    if kind not in ("point", "spot", "directional"):
        raise InputError(problem(document.path, f"light {index} type", kind, "point | spot | directional"))
    power = float(entry.get("intensity", 1.0))
    red, green, blue = (power * float(c) for c in entry.get("color", (1.0, 1.0, 1.0)))
    spot = entry.get("spot", {})
    place = matrix if track is None else np.eye(4)
    # A light shines along its node's -z; scale does not count.
    length = float(np.linalg.norm(place[:3, 2])) or 1.0
    x, y, z = (float(c) for c in -place[:3, 2] / length)
    return Light(
        kind=kind,
        intensity=(red, green, blue),
        position=(float(place[0, 3]), float(place[1, 3]), float(place[2, 3])),
        direction=(x, y, z),
        inner_rad=float(spot.get("innerConeAngle", 0.0)),
        outer_rad=float(spot.get("outerConeAngle", np.pi / 4)),
        range_m=float(entry.get("range", np.inf)),
        track=track,
        name=str(entry.get("name", f"light {index}")),
    )
