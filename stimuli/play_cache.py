"""Clips as the presenter wants them: display codes, RGBA8, memory-mapped, lossless, made once from a verified clip.

One file a clip: a header of one page (JSON: clip, size, rate, encoding, checksum of the frames), then the frames, raw.
Raw was chosen by measurement (`python -m tests.prove.clip_formats`; 2 cores, tunnel at 512x512, one frame to hand): raw
0.001 ms and 1049 kB; blosc2 LZ4 0.28 ms and 581 kB; blosc2 ZSTD 0.69 ms and 329 kB; 960x540: 0.8 and 2.0 ms. A refresh
at 240 Hz has 4.2 ms for three panels' upload, drawing and log, so disk is spent rather than that time.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from stimuli.clip import Clip, ClipStore
from stimuli.encode import DisplayTable, encode
from stimuli.errors import InputError, problem

MAGIC = b"studyapp play cache 1\n"
HEADER_BYTES = 4096
_PAGE = 4096


class PlayedClip:
    """A `FrameSource` over a mapped file: ``frame(i)`` is a read-only view, no copy is made."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        header = _read_header(self.path)
        width, height = header["size_px"]
        self.clip: str = header["clip"]
        self.size_px: tuple[int, int] = (int(width), int(height))
        self.rate_hz = Fraction(header["rate_hz"])
        self.frame_count = int(header["frame_count"])
        self._sha256: str = header["sha256"]
        self.byte_count = self.frame_count * width * height * 4
        if self.path.stat().st_size != HEADER_BYTES + self.byte_count:
            raise InputError(
                problem(path, "play cache", f"{self.path.stat().st_size} bytes", HEADER_BYTES + self.byte_count)
            )
        shape = (self.frame_count, height, width, 4)
        self._frames = np.memmap(self.path, np.uint8, "r", HEADER_BYTES, shape)

    def frame(self, index: int) -> np.ndarray:
        """(H, W, 4) uint8 codes of frame ``index``; IndexError outside the clip."""
        if not 0 <= index < self.frame_count:
            raise IndexError(f"frame {index} of a clip of {self.frame_count}")
        return self._frames[index]

    def touch(self) -> None:
        """Bring every page into memory, so that no frame waits for the disk during a trial."""
        self._frames.reshape(-1)[::_PAGE].max(initial=0)

    def problems(self) -> list[str]:
        """Read every byte (which touches it too) and compare with the checksum; empty where all is well."""
        found = hashlib.sha256(self._frames.reshape(-1).data).hexdigest()
        if found == self._sha256:
            return []
        return [problem(self.path, "play cache", f"sha256 {found[:12]}...", f"{self._sha256[:12]}...")]


def _read_header(path: Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as file:
            head = file.read(HEADER_BYTES)
        if not head.startswith(MAGIC):
            raise ValueError("not a play cache")
        header = json.loads(head[len(MAGIC) :].rstrip(b"\0"))
        _ = [header[key] for key in ("clip", "size_px", "rate_hz", "frame_count", "sha256")]
        return header
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(problem(path, "play cache", f"unreadable ({error})", "as made")) from error


@dataclass(frozen=True)
class PlayCache:
    """The display-encoded clips of a store, for one display (``table`` None: sRGB)."""

    store: ClipStore
    table: DisplayTable | None = None

    def path(self, clip: Clip) -> Path:
        """Where the frames of this clip are, or would be; other pixels or another encoding are another file."""
        table = None if self.table is None else self.table.luminance_cd_m2
        made_of = [MAGIC.decode(), clip.identity, clip.manifest["sha256"], clip.request.tone, table]
        name = hashlib.sha256(json.dumps(made_of).encode()).hexdigest()
        return self.store.root / "play" / f"{name[:40]}.rgba"

    def played(self, clip: Clip) -> PlayedClip:
        """The clip's frames, made from the EXR files where they are not there yet or are damaged."""
        path = self.path(clip)
        if path.is_file():
            try:
                source = PlayedClip(path)
                if source.clip == clip.identity and not source.problems():
                    return source
            except InputError:
                pass  # damaged: a cache is simply made again from the clip, whose bytes have checksums of their own
        write_play_cache(path, clip, self.table)
        return PlayedClip(path)

    def unused(self) -> Iterator[Path]:
        """Files of clips that the store no longer holds, or that no encoding in use asks for."""
        directory = self.store.root / "play"
        for path in sorted(directory.iterdir()) if directory.is_dir() else []:
            try:
                if not self.store.has(_read_header(path)["clip"]):
                    yield path
            except InputError:
                yield path


def write_play_cache(path: Path, clip: Clip, table: DisplayTable | None = None) -> None:
    """Encode every frame of ``clip`` to ``path``; the file appears whole or not at all.

    InputError where a frame is not what the clip's manifest says.
    """
    width, height = clip.request.size_px
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    digest, codes = hashlib.sha256(), np.empty((height, width, 4), np.uint8)
    try:
        with open(beside, "wb") as file:
            file.write(b"\0" * HEADER_BYTES)
            for index in range(clip.frame_count):
                color = clip.frame(index).color
                if color is None or color.shape != (height, width, 3):
                    got = "no R, G and B" if color is None else color.shape
                    raise InputError(problem(clip.frame_path(index), "frame", got, (height, width, 3)))
                encode(color, clip.request.exposure, clip.request.tone, table, codes)
                digest.update(codes.data)
                file.write(codes.data)
            header = {
                "clip": clip.identity,
                "size_px": [width, height],
                "rate_hz": clip.request.rate_hz,
                "frame_count": clip.frame_count,
                "exposure": clip.request.exposure,
                "tone": clip.request.tone,
                "table": table is not None,
                "sha256": digest.hexdigest(),
            }
            file.seek(0)
            file.write(MAGIC + json.dumps(header, sort_keys=True).encode())
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
