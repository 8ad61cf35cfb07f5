"""OpenEXR in and out: half-float R G B and named channels, single part, scan lines, chromaticities of Rec.709.

Channel names and types (decisions.md): ``R G B albedo.R/G/B motion.X motion.Y`` half, ``Z`` float, ``samples class``
uint. Attributes of ours are strings named ``renderer/NAME`` that hold JSON. Equal pixels and attributes give equal
bytes: the header holds no date and no machine.

Compression was chosen by measurement (`python -m tests.prove.clip_formats`; 2 cores, tunnel at 512x512): none 4.4 ms to
write, 1.5 to read, 1582 kB; ZIP 14.6, 3.6, 757 kB; PIZ 12.1, 4.7, 746 kB. ZIP: half the disk, the fastest of the two to
read, and every reader knows it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from stimuli.errors import InputError, problem

REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""x, y of red, green, blue and white."""
PREFIX = "renderer/"
COMPRESSIONS = {
    "none": OpenEXR.NO_COMPRESSION,
    "rle": OpenEXR.RLE_COMPRESSION,
    "zips": OpenEXR.ZIPS_COMPRESSION,
    "zip": OpenEXR.ZIP_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
}
_FLOAT_CHANNELS = frozenset({"Z"})
_UINT_CHANNELS = frozenset({"samples", "class"})
_HALF_MAX = 65504.0


def channel_dtype(name: str) -> type[np.floating] | type[np.unsignedinteger]:
    """The type in which the channel ``name`` is stored: float32 (Z), uint32 (samples, class), else float16."""
    if name in _FLOAT_CHANNELS:
        return np.float32
    return np.uint32 if name in _UINT_CHANNELS else np.float16


@dataclass(frozen=True)
class Picture:
    """What one EXR file holds. ``color`` (H, W, 3) or None where the file lacks R, G or B; ``channels`` the others, by
    name; ``attributes`` the decoded ``renderer/*`` values without their prefix."""

    color: np.ndarray | None
    channels: Mapping[str, np.ndarray] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)


def to_half(values: np.ndarray) -> np.ndarray:
    """float16, rounded to nearest even; values beyond +-65504 are held there, nan stays nan."""
    if values.dtype == np.float16:
        return values
    return np.clip(values, -_HALF_MAX, _HALF_MAX).astype(np.float16)


def write_exr(
    path: Path,
    color: np.ndarray,
    channels: Mapping[str, np.ndarray] | None = None,
    attributes: Mapping[str, Any] | None = None,
    compression: str = "zip",
) -> None:
    """Write (H, W, 3) linear colour and (H, W) ``channels``; ``attributes`` become ``renderer/NAME`` JSON strings.

    Raises InputError for shapes that do not fit, ValueError for a value that JSON cannot hold.
    """
    if color.ndim != 3 or color.shape[2] != 3 or color.size == 0:
        raise InputError(problem(path, "picture shape", color.shape, "(height, width, 3), not empty"))
    half = to_half(color)
    planes = {name: np.ascontiguousarray(half[..., i]) for i, name in enumerate("RGB")}
    for name, values in (channels or {}).items():
        if values.shape != color.shape[:2]:
            raise InputError(problem(path, f"channel {name}", values.shape, color.shape[:2]))
        dtype = channel_dtype(name)
        planes[name] = to_half(values) if dtype is np.float16 else np.ascontiguousarray(values, dtype)
    header: dict[str, Any] = {
        "compression": COMPRESSIONS[compression],
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709_CHROMATICITIES,
    }
    for name, value in (attributes or {}).items():
        header[PREFIX + name] = json.dumps(value, sort_keys=True, allow_nan=False)
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()}).write(str(path))


def read_exr(path: Path) -> Picture:
    """Read a single-part file. InputError where it is no EXR file or is damaged; foreign attributes are left out."""
    if not Path(path).is_file():
        raise InputError(problem(path, "EXR file", "nothing", "a file"))
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())
            planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except (RuntimeError, ValueError) as error:
        raise InputError(problem(path, "EXR file", f"unreadable ({str(error).splitlines()[0]})", "OpenEXR")) from error
    color = np.stack([planes.pop(name) for name in "RGB"], axis=-1) if {"R", "G", "B"} <= planes.keys() else None
    attributes: dict[str, Any] = {}
    for name, value in header.items():
        if name.startswith(PREFIX):
            try:
                attributes[name.removeprefix(PREFIX)] = json.loads(value)
            except (TypeError, json.JSONDecodeError) as error:
                raise InputError(problem(path, f"attribute {name}", repr(value), "JSON")) from error
    return Picture(color, planes, attributes)
