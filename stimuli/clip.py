"""The clip store: clips on disk, named by the identity of their request, published whole or not at all.

    STORE/clips/IDENTITY/    manifest.json, cost.json, 000000.exr ...     (immutable once there)
    STORE/parts/IDENTITY/    units of work of a clip that is being made (`stimuli.clip_parts`)
    STORE/building/          directories of living processes; renamed into place when whole
    STORE/play/              display-encoded frames (`stimuli.play_cache`)

The manifest holds a checksum of each frame, of the request (the clip's name) and of itself; ``cost.json`` (times, rays,
machine, date) stands outside all of them.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
import socket
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import Any

import psutil

from stimuli.clip_request import CHANNEL_BYTES, ClipRequest
from stimuli.errors import InputError, problem
from stimuli.exr import Picture, read_exr

FORMAT = 1
MANIFEST, COST = "manifest.json", "cost.json"
_IDENTITY_LENGTH = 64


def frame_name(index: int) -> str:
    """The file name of frame ``index``."""
    return f"{index:06d}.exr"


def sha256_of(path: Path) -> str:
    """sha256 (hex) of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Sorted keys, so equal data are equal bytes; whole or not at all (renamed into place)."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
    beside.write_text(json.dumps(data, sort_keys=True, indent=1, allow_nan=False) + "\n")
    os.replace(beside, path)


def request_from_dict(data: Mapping[str, Any]) -> ClipRequest:
    """A `ClipRequest` from its JSON form. InputError where keys are missing or unknown."""
    known = {field.name for field in fields(ClipRequest)}
    if unknown := sorted(set(data) - known):
        raise InputError(problem("clip request", "unknown keys", ", ".join(unknown), "the fields of ClipRequest"))
    values = dict(data)
    for key in ("size_px", "geometry", "gaze"):
        if isinstance(values.get(key), list):
            values[key] = tuple(values[key])
    try:
        return ClipRequest(**values)
    except TypeError as error:
        raise InputError(problem("clip request", "missing keys", error, "a whole request")) from error


def manifest_digest(manifest: Mapping[str, Any]) -> str:
    """sha256 of the manifest without its own ``sha256`` entry."""
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


@dataclass(frozen=True)
class Clip:
    """A published clip: ``manifest`` as read (its own checksum verified), frames on demand."""

    directory: Path
    request: ClipRequest
    manifest: Mapping[str, Any]

    @property
    def identity(self) -> str:
        """The clip's name in the store."""
        return self.directory.name

    @property
    def frame_count(self) -> int:
        """How many frames the clip has."""
        return len(self.manifest["files"])

    @property
    def byte_count(self) -> int:
        """Bytes of all frames on disk, as the manifest says."""
        return sum(int(entry["bytes"]) for entry in self.manifest["files"])

    def frame_path(self, index: int) -> Path:
        """The EXR file of frame ``index``; IndexError outside the clip."""
        if not 0 <= index < self.frame_count:
            raise IndexError(f"frame {index} of a clip of {self.frame_count}")
        return self.directory / self.manifest["files"][index]["name"]

    def frame(self, index: int) -> Picture:
        """Frame ``index``: half R G B, other channels, attributes."""
        return read_exr(self.frame_path(index))

    def cost(self) -> dict[str, Any]:
        """Times, rays, machine and date; empty where the file is lost (it is no part of the clip)."""
        path = self.directory / COST
        return json.loads(path.read_text()) if path.is_file() else {}


@dataclass(frozen=True)
class ClipStore:
    """A directory of clips. Nothing is read or made before it is asked for."""

    root: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", Path(self.root))
        if self.root.exists() and not self.root.is_dir():
            raise InputError(problem(self.root, "store", "a file", "a directory"))

    @property
    def clips(self) -> Path:
        """Where whole clips are."""
        return self.root / "clips"

    def directory(self, identity: str) -> Path:
        """Where the clip of this identity is, or would be."""
        return self.clips / identity

    def has(self, identity: str) -> bool:
        """Whether a clip of this name was published. It says nothing about damage: see `problems_of`."""
        return bool(identity) and (self.directory(identity) / MANIFEST).is_file()

    def identities(self) -> list[str]:
        """Names of all published clips, sorted."""
        if not self.clips.is_dir():
            return []
        with os.scandir(self.clips) as entries:
            return sorted(entry.name for entry in entries if entry.is_dir() and _is_identity(entry.name))

    def foreign(self) -> list[Path]:
        """What lies among the clips and is none."""
        known = set(self.identities())
        return sorted(path for path in self.clips.iterdir() if path.name not in known) if self.clips.is_dir() else []

    def open(self, identity: str) -> Clip:
        """The clip; its manifest and the presence and size of every file are checked, the frames' bytes are not.

        InputError, one line a problem, where there is no such clip or it is damaged.
        """
        clip, problems = _open(self.directory(identity))
        if clip is None or problems:
            raise InputError(*problems)
        return clip

    def open_verified(self, identity: str) -> Clip:
        """Like `open`, and every byte is read and compared with its checksum."""
        if problems := self.problems_of(identity):
            raise InputError(*problems)
        return self.open(identity)

    def problems_of(self, identity: str, read_bytes: bool = True) -> list[str]:
        """What is wrong with a clip, one line each; empty where it is whole. ``read_bytes``: compare checksums too."""
        clip, problems = _open(self.directory(identity))
        if clip is None or not read_bytes:
            return problems
        return problems + _wrong_bytes(clip)

    def published(self) -> Iterator[Clip]:
        """Every clip whose manifest can be read, in order of identity."""
        for identity in self.identities():
            clip, _ = _open(self.directory(identity))
            if clip is not None:
                yield clip

    def externals(self) -> list[Clip]:
        """Clips that were imported from another renderer."""
        return [clip for clip in self.published() if clip.manifest["provenance"] == "external"]

    def publish(self, building: Path, request: ClipRequest, manifest: Mapping[str, Any]) -> Clip:
        """Complete ``building`` (which holds the frames and cost.json) with its manifest and move it into place.

        ``manifest``: files, frames, luminance, provenance and what else is known; request, identity and checksums are
        added here. Everything reaches the disk before the one rename that makes the clip visible. A damaged clip of
        the same name gives way; a whole one stays and ``building`` is thrown away.
        """
        whole = {**manifest, "format": FORMAT, "identity": request.identity, "request": asdict(request)}
        whole = json.loads(json.dumps(whole, allow_nan=False))
        whole["sha256"] = manifest_digest(whole)
        write_json(building / MANIFEST, whole)
        for path in building.iterdir():
            _flush(path)
        _flush(building)
        target = self.directory(request.identity)
        self.clips.mkdir(parents=True, exist_ok=True)
        if target.exists() and self.problems_of(request.identity):
            self.discard(request.identity)
        try:
            os.rename(building, target)
        except OSError:
            if not self.has(request.identity):
                raise
            shutil.rmtree(building)  # another process was quicker; equal requests have equal clips
        _flush(self.clips)
        return self.open(request.identity)

    def discard(self, identity: str) -> None:
        """Remove a clip; it disappears as a whole first, then its files are deleted."""
        doomed = self.new_building()
        os.rename(self.directory(identity), doomed / "discarded")
        shutil.rmtree(doomed)

    def new_building(self) -> Path:
        """A fresh directory of this process, on the store's own file system; see `clear_abandoned`."""
        path = self.root / "building" / f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(6)}"
        path.mkdir(parents=True)
        return path

    def clear_abandoned(self) -> int:
        """Remove what dead processes of this machine left in ``building``; returns how many directories."""
        building = self.root / "building"
        gone = 0
        for path in sorted(building.iterdir()) if building.is_dir() else []:
            host, _, rest = path.name.rpartition("-")[0].rpartition("-")
            if host == socket.gethostname() and rest.isdigit() and not psutil.pid_exists(int(rest)):
                shutil.rmtree(path, ignore_errors=True)
                gone += 1
        return gone


def _is_identity(name: str) -> bool:
    return len(name) == _IDENTITY_LENGTH and set(name) <= set("0123456789abcdef")


def _flush(path: Path) -> None:
    """Bring a file or a directory entry to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _open(directory: Path) -> tuple[Clip | None, list[str]]:
    """Read and check a manifest against itself, its name, and the names and sizes of the files beside it."""
    path = directory / MANIFEST
    if not path.is_file():
        return None, [problem(directory, "clip", "nothing", "a rendered or imported clip (studyapp render)")]
    try:
        manifest = json.loads(path.read_text())
        request = request_from_dict(manifest["request"])
        files = {str(entry["name"]): int(entry["bytes"]) for entry in manifest["files"]}
        stated = str(manifest["sha256"]), str(manifest["identity"]), int(manifest["format"])
        _ = manifest["luminance"]["mean"], manifest["provenance"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        return None, [problem(path, "manifest", f"unreadable ({type(error).__name__}: {error})", "as published")]
    if stated[2] != FORMAT:
        return None, [problem(path, "format", stated[2], FORMAT)]
    problems = []
    if manifest_digest(manifest) != stated[0]:
        problems.append(problem(path, "manifest", "changed since publication", f"sha256 {stated[0][:12]}..."))
    if not request.identity == stated[1] == directory.name:
        got = f"request {request.identity[:12]}, stated {stated[1][:12]}"
        problems.append(problem(path, "identity", got, f"the directory's name {directory.name[:12]}"))
    wanted = [frame_name(i) for i in range(request.frame_count)]
    if list(files) != wanted or not wanted:
        problems.append(problem(path, "frames", f"{len(files)} files", f"{len(wanted)} from {frame_name(0)} on"))
    with os.scandir(directory) as entries:
        sizes = {entry.name: entry.stat().st_size if entry.is_file() else -1 for entry in entries}
    for name, size in files.items():
        if name not in sizes:
            problems.append(problem(directory / name, "frame", "no file", f"{size} bytes"))
        elif sizes[name] != size:
            problems.append(problem(directory / name, "frame", f"{sizes[name]} bytes", f"{size} bytes"))
    for name in sorted(set(sizes) - set(files) - {MANIFEST, COST}):
        problems.append(problem(directory / name, "foreign file", name, "only what the manifest names"))
    return Clip(directory, request, manifest), problems


def _wrong_bytes(clip: Clip) -> list[str]:
    """Frames whose bytes differ from their checksum (files of the wrong size are already known)."""

    def check(entry: Mapping[str, Any]) -> str | None:
        path = clip.directory / entry["name"]
        if not path.is_file() or path.stat().st_size != entry["bytes"]:
            return None
        found = sha256_of(path)
        if found == entry["sha256"]:
            return None
        return problem(path, "frame", f"sha256 {found[:12]}...", f"{entry['sha256'][:12]}...")

    with ThreadPoolExecutor(max_workers=2) as pool:  # hashing releases the interpreter lock
        return [line for line in pool.map(check, clip.manifest["files"]) if line is not None]


@dataclass(frozen=True)
class Estimate:
    """What a set of requests takes at most on disk (lossless compression saves about a third of ``exr_bytes``)."""

    clips: int
    frames: int
    exr_bytes: int
    play_bytes: int


def estimate_disk(requests: Sequence[ClipRequest]) -> Estimate:
    """Frames and bytes of ``requests``, each identity once, with the channels that each asks for beside R G B."""
    once = list({request.identity: request for request in requests}.values())
    pixels = [request.frame_count * request.size_px[0] * request.size_px[1] for request in once]
    each = [6 + sum(CHANNEL_BYTES.get(name, 2) for name in request.channels) for request in once]
    exr_bytes = sum(count * size for count, size in zip(pixels, each, strict=True))
    return Estimate(len(once), sum(request.frame_count for request in once), exr_bytes, sum(pixels) * 4)


def rate_of(request: ClipRequest) -> Fraction:
    """The clip's exact rate in Hz."""
    return Fraction(request.rate_hz)
