"""Clips from any other renderer: PNG or EXR sequences, or lossless video, brought into the store with provenance
'external'. Trials, presenter and report treat them like any other clip.

``transfer`` says what the numbers are: ``linear`` light, ``srgb`` codes, or ``pq`` (SMPTE ST 2084, with
``white_cd_m2`` as 1). Alpha is refused unless it is opaque: a mixture with an unknown background is no stimulus.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np

from stimuli.clip import Clip, ClipStore, sha256_of
from stimuli.clip_parts import PartWriter, assemble
from stimuli.clip_request import ClipRequest
from stimuli.encode import linear_from_pq, linear_from_srgb
from stimuli.errors import InputError, problem
from stimuli.exr import read_exr
from stimuli.png import read_png

Transfer = Literal["srgb", "linear", "pq"]
TRANSFERS = ("srgb", "linear", "pq")
PICTURES = (".png", ".exr")
VIDEOS = (".mkv", ".mov", ".avi", ".mp4", ".nut", ".y4m")
LOSSLESS_CODECS = ("ffv1", "huffyuv", "ffvhuff", "utvideo", "png", "rawvideo", "qtrle", "magicyuv")
FORMATS_8, FORMATS_16 = re.compile(r"gbrp|rgb24|bgr24|0rgb|rgb0|bgr0|0bgr"), re.compile(r"(gbrp16|rgb48|bgr48)(le|be)")
IMPORTED = "imported:"


@dataclass(frozen=True)
class Import:
    """What the user says about frames that carry no such facts. ``technique`` and ``scene`` are the names that a
    protocol uses (``technique: imported:NAME``); ``exposure`` multiplies linear light at display encoding."""

    rate_hz: str
    technique: str
    scene: str
    transfer: Transfer
    exposure: float = 1.0
    white_cd_m2: float = 100.0


def frame_files(source: Path) -> tuple[Path, ...]:
    """The pictures of a folder (one type, ordered by the number in their names), or of a single picture file.

    InputError for an empty folder, mixed types, names without a number, and numbers that are missing or twice.
    """
    if source.is_file():
        return (source,)
    if not source.is_dir():
        raise InputError(problem(source, "frames", "nothing there", "a folder of PNG or EXR files, or a video"))
    files = [path for path in source.iterdir() if path.suffix.lower() in PICTURES]
    kinds = {path.suffix.lower() for path in files}
    if len(kinds) != 1:
        raise InputError(
            problem(source, "frames", " and ".join(sorted(kinds)) or "no pictures", "PNG or EXR files only")
        )
    numbered: dict[int, Path] = {}
    for path in sorted(files):
        digits = re.findall(r"\d+", path.stem)
        if not digits:
            raise InputError(problem(path, "name", path.name, "a number in it, as in frame_0001.png"))
        number = int(digits[-1])
        if number in numbered:
            raise InputError(problem(path, "frame number", f"{number}, as {numbered[number].name}", "each number once"))
        numbered[number] = path
    first, last = min(numbered), max(numbered)
    if missing := next((number for number in range(first, last) if number not in numbered), None):
        raise InputError(problem(source, "frames", f"no frame {missing}", f"all from {first} to {last}"))
    return tuple(numbered[number] for number in sorted(numbered))


def to_linear(values: np.ndarray, about: Import) -> np.ndarray:
    """Linear light of code values in [0, 1] (``linear``: as they are, any range)."""
    if about.transfer == "linear":
        return values
    return linear_from_srgb(values) if about.transfer == "srgb" else linear_from_pq(values, about.white_cd_m2)


def _read_frame(path: Path, about: Import) -> np.ndarray:
    """(H, W, 3) float32 linear light of one picture file. InputError where values are not finite."""
    if path.suffix.lower() == ".exr":
        picture = read_exr(path)
        if picture.color is None:
            raise InputError(problem(path, "channels", " ".join(picture.channels), "R G B"))
        alpha = picture.channels.get("A")
        if alpha is not None and not (alpha == 1).all():
            raise InputError(problem(path, "alpha", f"down to {alpha.min():g}", "1 everywhere, or no alpha"))
        values = picture.color.astype(np.float64)
    else:
        values = read_png(path)
    if not np.isfinite(values).all():
        raise InputError(problem(path, "pixels", "nan or infinity", "finite numbers"))
    return to_linear(values, about).astype(np.float32)


def find_ffmpeg() -> str | None:
    """A video decoder: ffmpeg on the path, or the package imageio-ffmpeg's; None where there is none."""
    if found := shutil.which("ffmpeg"):
        return found
    return str(import_module("imageio_ffmpeg").get_ffmpeg_exe()) if find_spec("imageio_ffmpeg") else None


def _video_facts(source: Path, ffmpeg: str) -> tuple[int, int, int]:
    """(width, height, bits a channel: 8 or 16) of a losslessly coded RGB video. InputError for any other."""
    said = subprocess.run(
        [ffmpeg, "-hide_banner", "-i", str(source)], capture_output=True, text=True, check=False
    ).stderr
    line = next((part for part in said.splitlines() if " Video: " in part), None)
    found = re.search(r"Video: (\w+)[^,]*, (\w+)(?:\([^)]*\))?, (?:.*?, )?(\d+)x(\d+)", line or "")
    if found is None:
        raise InputError(problem(source, "video", "no readable video stream", "lossless RGB video"))
    codec, pixels, width, height = found[1], found[2], int(found[3]), int(found[4])
    bits = 8 if FORMATS_8.fullmatch(pixels) else 16 if FORMATS_16.fullmatch(pixels) else 0
    if codec not in LOSSLESS_CODECS or not bits:
        raise InputError(
            problem(
                source,
                "video",
                f"{codec} {pixels}",
                f"a lossless codec ({' '.join(LOSSLESS_CODECS)}) in RGB of 8 or 16 bits",
            )
        )
    return width, height, bits


def _video_frames(source: Path, about: Import) -> tuple[tuple[int, int], Callable[[], Iterator[np.ndarray]]]:
    """((width, height), a call that yields the frames as float32 linear light, decoded without loss)."""
    ffmpeg = find_ffmpeg()
    if ffmpeg is None:
        raise InputError(problem(source, "video", "no decoder", "ffmpeg on the path, or the package imageio-ffmpeg"))
    width, height, bits = _video_facts(source, ffmpeg)
    # 8 bits are asked for as 8: the decoder's way to 16 is a shift, which is not the same value
    out = "rgb24" if bits == 8 else "rgb48le"
    command = [ffmpeg, "-v", "error", "-i", str(source), "-f", "rawvideo", "-pix_fmt", out, "-"]

    def frames() -> Iterator[np.ndarray]:
        size = width * height * 3 * bits // 8
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            while data := process.stdout.read(size):
                if len(data) != size:
                    raise InputError(problem(source, "video", "a frame cut short", "whole frames"))
                codes = np.frombuffer(data, f"<u{bits // 8}").reshape(height, width, 3) / (2.0**bits - 1)
                yield to_linear(codes, about).astype(np.float32)
            said = process.stderr.read().decode(errors="replace").strip().splitlines()
        if process.returncode:
            raise InputError(problem(source, "video", said[-1] if said else "unreadable", "a whole video file"))

    return (width, height), frames


def _content_sha256(files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        digest.update(sha256_of(path).encode())
    return digest.hexdigest()


def import_frames(source: Path, about: Import, store: ClipStore) -> Clip:
    """Bring frames into ``store`` as a clip of ``imported:NAME``; the same frames twice are the same clip.

    InputError, one line, for anything that cannot be taken as it is: nothing is scaled, cropped or guessed.
    """
    source = Path(source)
    rate = _positive_rate(about.rate_hz)
    if about.transfer not in TRANSFERS:
        raise InputError(problem("--transfer", "transfer", repr(about.transfer), " | ".join(TRANSFERS)))
    if not (np.isfinite(about.exposure) and about.exposure > 0):
        raise InputError(problem("--exposure", "exposure", about.exposure, "a finite number above 0"))
    files: tuple[Path, ...] = (source,)
    if source.suffix.lower() in VIDEOS and source.is_file():
        size, frames = _video_frames(source, about)
        count = sum(1 for _ in frames())  # decoded twice, so that a long video need not fit into memory
    else:
        files = frame_files(source)
        first = _read_frame(files[0], about)
        size = (first.shape[1], first.shape[0])
        count = len(files)

        def frames() -> Iterator[np.ndarray]:
            return (_read_frame(path, about) for path in files)

    if count == 0:
        raise InputError(problem(source, "frames", "none", "at least one"))
    request = ClipRequest(
        scene=about.scene, scene_sha256=hashlib.sha256(about.scene.encode()).hexdigest(),
        technique=IMPORTED + about.technique.removeprefix(IMPORTED), params={}, size_px=size, rate_hz=str(rate),
        duration_s=str(count / rate), warm_up_s="0", exposure=about.exposure, external_sha256=_content_sha256(files),
        extra={"transfer": about.transfer, **({"white_cd_m2": about.white_cd_m2} if about.transfer == "pq" else {})},
    )  # fmt: skip
    if store.has(request.identity) and not store.problems_of(request.identity):
        return store.open(request.identity)
    writer = PartWriter(store, request)
    try:
        for index, color in enumerate(frames()):
            if color.shape[:2] != (size[1], size[0]):
                got = f"{color.shape[1]}x{color.shape[0]}"
                raise InputError(problem(files[index], "frame size", got, f"{size[0]}x{size[1]}, as the first"))
            writer.add(color)
        writer.publish("imported")
    finally:
        writer.abandon()
    return assemble(store, request, ["imported"], provenance="external", cost={"source": source.name})


def _positive_rate(text: str) -> Fraction:
    try:
        rate = Fraction(text)
    except (ValueError, ZeroDivisionError) as error:
        raise InputError(problem("--rate", "rate", repr(text), "a number such as 240 or 60000/1001")) from error
    if rate <= 0:
        raise InputError(problem("--rate", "rate", text, "above 0"))
    return rate
