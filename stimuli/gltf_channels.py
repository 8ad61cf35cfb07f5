"""The animation of a glTF file that is played: channels of nodes, and of the weights of morph targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.gltf_animation import Channel
from stimuli.gltf_buffers import Document
from stimuli.gltf_morphs import WeightTrack

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}


@dataclass(frozen=True)
class Animation:
    """Its name, the channels of nodes, and the weights by node."""

    name: str
    channels: list[Channel]
    weights: dict[int, WeightTrack]


def read_animation(document: Document, wanted: str | None) -> Animation:
    """The animation called ``wanted`` (None: the first; without channels where the file has none). InputError where
    there is no such animation, or a channel's keys are not what the specification asks for."""
    animations = document.items("animations")
    names = [str(entry.get("name", f"animation {i}")) for i, entry in enumerate(animations)]
    if wanted is not None and wanted not in names:
        raise InputError(problem(document.path, "animation", repr(wanted), f"one of {' | '.join(names) or '(none)'}"))
    if not animations:
        return Animation("", [], {})
    chosen = 0 if wanted is None else names.index(wanted)
    if wanted is None and len(names) > 1:
        document.note(f"{document.path.name}: {len(names)} animations, the first ({names[0]}) is played")
    channels: list[Channel] = []
    weights: dict[int, WeightTrack] = {}
    for number, channel in enumerate(animations[chosen].get("channels", [])):
        target = channel.get("target", {})
        path, node = target.get("path"), target.get("node")
        if (path not in WIDTHS and path != "weights") or node is None:
            document.note(f"{document.path.name}: animation channel of {path!r} without a node to move is not played")
            continue
        entry = document.item("nodes", node, "animation channel")
        where = f"{document.path}: animation {names[chosen]!r} channel {number}"
        width = _target_count(document, entry) if path == "weights" else WIDTHS[path]
        if not width:
            document.note(f"{document.path.name}: weights of node {node}, which has no morph targets, are not played")
            continue
        read = _read_channel(document, animations[chosen], channel, node, path, width, where)
        if path == "weights":
            weights[node] = WeightTrack(read.times_s, read.values, read.interpolation)
        else:
            channels.append(read)
    return Animation(names[chosen], channels, weights)


def _target_count(document: Document, node: dict[str, Any]) -> int:
    """The most morph targets that a primitive of the node's mesh has."""
    mesh = document.item("meshes", node["mesh"], "node") if "mesh" in node else {}
    return max((len(primitive.get("targets", [])) for primitive in mesh.get("primitives", [])), default=0)


def _read_channel(
    document: Document, animation: dict[str, Any], channel: dict[str, Any], node: int, path: Any, width: int, where: str
) -> Channel:
    sampler = animation["samplers"][channel["sampler"]]
    kind = sampler.get("interpolation", "LINEAR")
    times = document.array(sampler["input"])[:, 0]
    values = document.array(sampler["output"])
    if path == "weights" and values.size % width == 0:
        values = values.reshape(-1, width)  # one number a target and key
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise InputError(problem(where, "interpolation", kind, "LINEAR | STEP | CUBICSPLINE"))
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0.0).any():
        raise InputError(problem(where, "key times", "none, unsorted or nan", "increasing finite seconds"))
    per_key = 3 if kind == "CUBICSPLINE" else 1
    if values.shape != (len(times) * per_key, width):
        got, wanted = f"{values.shape[0]} x {values.shape[1]}", f"{len(times) * per_key} x {width}"
        raise InputError(problem(where, f"{path} keys", got, wanted))
    if not np.isfinite(values).all():
        raise InputError(problem(where, f"{path} keys", "nan or inf", "finite numbers"))
    shaped = values.reshape(len(times), 3, width) if per_key == 3 else values
    return Channel(node, path, times, shaped, kind, times_key=int(sampler["input"]))
