"""Parts of a clip that is being made: written by one worker each, published whole, joined to a clip exactly.

A part is STORE/parts/IDENTITY/NAME/ with the EXR files of frames [first, stop), ``part.json`` (checksums, cost) and
``light.npz``. It does not matter who made a part or how a clip was divided: the joined clip has the same bytes.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import socket
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stimuli.clip import COST, Clip, ClipStore, frame_name, sha256_of, write_json
from stimuli.clip_request import ClipRequest
from stimuli.displayed_light import BINS, Light, join, measure_light, summarise
from stimuli.errors import InputError, problem
from stimuli.exr import write_exr

PART, LIGHT = "part.json", "light.npz"


@dataclass(frozen=True)
class FrameCost:
    """What one frame took: seconds by stage, rays by kind, shading results that had to be clamped."""

    seconds: Mapping[str, float] = field(default_factory=dict)
    rays: Mapping[str, int] = field(default_factory=dict)
    clamped: int = 0


def frame_attributes(request: ClipRequest, index: int) -> dict[str, Any]:
    """The ``renderer/*`` attributes of a frame: its provenance and its place in the clip."""
    names = (
        "scene",
        "scene_sha256",
        "technique",
        "params",
        "path",
        "rate_hz",
        "start_s",
        "seed",
        "exposure",
        "lighting",
    )
    return {
        **{name: value for name, value in asdict(request).items() if name in names},
        "clip": request.identity,
        "engine_version": request.engine_version,
        "frame": index,
        "frame_count": request.frame_count,
    }


class PartWriter:
    """Writes frames [first, ...) of a clip into a directory of its own; nothing is visible before `publish`."""

    def __init__(self, store: ClipStore, request: ClipRequest, first: int = 0) -> None:
        self.building = store.new_building()
        self._store, self._request, self._first = store, request, first
        self._files: list[dict[str, Any]] = []
        self._costs: list[FrameCost] = []
        self._facts: dict[str, dict[str, float]] = {}
        self._channels: list[str] | None = None
        self._totals: list[float] = []
        self._clipped: list[int] = []
        self._histogram = np.zeros(BINS, np.uint64)

    def add(
        self,
        color: np.ndarray,
        channels: Mapping[str, np.ndarray] | None = None,
        cost: FrameCost | None = None,
        facts: Mapping[str, float] | None = None,
    ) -> None:
        """Store the next frame: (H, W, 3) linear colour and optional (H, W) channels, the same in every frame.

        ``facts`` are numbers that follow from the request (a measured error); the manifest lists them by frame.
        """
        width, height = self._request.size_px
        if color.shape != (height, width, 3):
            raise InputError(problem(self._request.scene, "frame shape", color.shape, (height, width, 3)))
        names = sorted(channels or {})
        if self._channels is None:
            self._channels = names
        if names != self._channels:
            raise InputError(
                problem(self._request.scene, "channels", names, f"{self._channels}, as in the first frame")
            )
        index = self._first + len(self._files)
        path = self.building / frame_name(index)
        write_exr(path, color, channels, frame_attributes(self._request, index))
        self._files.append({"name": path.name, "sha256": sha256_of(path), "bytes": path.stat().st_size})
        total, clipped = measure_light(color, self._request.exposure, self._histogram)
        self._totals.append(total)
        self._clipped.append(clipped)
        self._costs.append(cost or FrameCost())
        if facts:
            self._facts[str(index)] = dict(facts)

    def publish(self, name: str) -> Path:
        """Make the part visible under ``name``; where it is there already, this one is thrown away."""
        pixels = self._request.size_px[0] * self._request.size_px[1]
        np.savez(
            self.building / LIGHT, totals=self._totals, clipped=self._clipped, pixels=pixels, histogram=self._histogram
        )
        part = {
            "first": self._first,
            "files": self._files,
            "channels": self._channels or [],
            "costs": [asdict(cost) for cost in self._costs],
            "facts": self._facts,
            "light_sha256": sha256_of(self.building / LIGHT),
        }
        write_json(self.building / PART, part)
        return publish_part(self._store, self._request.identity, name, self.building)

    def abandon(self) -> None:
        """Remove what was written."""
        shutil.rmtree(self.building, ignore_errors=True)


def publish_part(store: ClipStore, identity: str, name: str, building: Path) -> Path:
    """Rename ``building`` to the part ``name``; an equal part that is there already stays."""
    target = store.root / "parts" / identity / name
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.rename(building, target)
    except OSError:
        if not target.is_dir():
            raise
        shutil.rmtree(building)
    return target


def part_directory(store: ClipStore, identity: str, name: str) -> Path:
    """Where the part is, or would be."""
    return store.root / "parts" / identity / name


def has_part(store: ClipStore, identity: str, name: str) -> bool:
    """Whether a part was published (it is checked byte by byte when it is joined)."""
    return part_directory(store, identity, name).is_dir()


class DamagedPart(InputError):
    """A part whose bytes are not those that were written; ``name`` has to be made again."""

    def __init__(self, name: str, why: str) -> None:
        self.name = name
        super().__init__(problem(name, "part of a clip", why, "as written"))


def _read_part(directory: Path) -> tuple[dict[str, Any], Light]:
    """The description and the light of a part, every byte checked."""
    try:
        part = json.loads((directory / PART).read_text())
        for entry in part["files"]:
            if sha256_of(directory / entry["name"]) != entry["sha256"]:
                raise DamagedPart(directory.name, f"other bytes in {entry['name']}")
        if sha256_of(directory / LIGHT) != part["light_sha256"]:
            raise DamagedPart(directory.name, f"other bytes in {LIGHT}")
        with np.load(directory / LIGHT) as light:
            totals, clipped = tuple(map(float, light["totals"])), tuple(map(int, light["clipped"]))
            return part, Light(totals, clipped, int(light["pixels"]), light["histogram"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, DamagedPart):
            raise
        raise DamagedPart(directory.name, f"unreadable ({type(error).__name__})") from error


def assemble(
    store: ClipStore,
    request: ClipRequest,
    names: Sequence[str],
    provenance: str = "rendered",
    facts: Mapping[str, Any] | None = None,
    cost: Mapping[str, Any] | None = None,
) -> Clip:
    """Join the parts ``names`` (in frame order) to a published clip and remove them.

    ``facts`` go into the manifest (they must follow from the request alone), ``cost`` into cost.json. DamagedPart
    names a part to be made again; InputError where the parts are not the whole clip.
    """
    building = store.new_building()
    files: list[dict[str, Any]] = []
    costs: list[dict[str, Any]] = []
    lights: list[Light] = []
    channels: list[str] = []
    by_frame: dict[str, dict[str, float]] = {}
    for name in names:
        directory = part_directory(store, request.identity, name)
        part, light = _read_part(directory)
        if part["first"] != len(files):
            raise InputError(problem(name, "first frame", part["first"], len(files)))
        for entry in part["files"]:
            _link(directory / entry["name"], building / entry["name"])
        files += part["files"]
        costs += part["costs"]
        channels = part["channels"]
        by_frame.update(part["facts"])
        lights.append(light)
    if len(files) != request.frame_count:
        raise InputError(problem(request.identity, "frames", len(files), request.frame_count))
    machine = {"host": socket.gethostname(), "system": platform.platform(), "python": platform.python_version()}
    write_json(building / COST, {**(cost or {}), "machine": machine, "frames": costs})
    manifest = {
        "provenance": provenance,
        "channels": ["B", "G", "R", *channels],
        "files": files,
        "luminance": summarise(join(lights)),
        **({"frame_facts": by_frame} if by_frame else {}),
        **(facts or {}),
    }
    clip = store.publish(building, request, manifest)
    shutil.rmtree(store.root / "parts" / request.identity, ignore_errors=True)
    return clip


def _link(source: Path, target: Path) -> None:
    """A second name for a file; a copy where the file system has no hard links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
