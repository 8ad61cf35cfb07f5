"""PNG pictures as numbers in [0, 1]: 8 and 16 bits, grey and colour (Pillow keeps 16 bits of grey only)."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from stimuli.errors import InputError, problem


def _opaque(path: Path, pixels: np.ndarray, full: float) -> np.ndarray:
    """RGB of an (H, W, C) array; InputError where its alpha is not everywhere ``full``."""
    channels = pixels.shape[2]
    if channels in (2, 4) and not (pixels[..., -1] == full).all():
        raise InputError(
            problem(path, "alpha", f"down to {pixels[..., -1].min()}", f"{full:g} everywhere, or no alpha")
        )
    colors = pixels[..., : channels - (channels in (2, 4))]
    return np.repeat(colors, 3, axis=2) if colors.shape[2] == 1 else colors


def read_png(path: Path) -> np.ndarray:
    """(H, W, 3) float64 in [0, 1] of an 8- or 16-bit PNG, grey or colour. Pillow keeps 16 bits of grey only, so colour
    of 16 bits is decoded here. InputError for anything else."""
    try:
        with Image.open(path) as image:
            if image.format != "PNG":
                raise InputError(problem(path, "frame", str(image.format), "PNG or EXR"))
            depth = _png_bit_depth(path)
            if depth == 16 and image.mode not in ("I;16", "I"):
                pixels, full = _read_png16(path), 65535.0
            elif depth == 16:
                pixels, full = np.asarray(image, np.uint16)[..., None], 65535.0
            else:
                mode = "RGBA" if "A" in image.mode or "transparency" in image.info else "RGB"
                pixels, full = np.asarray(image.convert(mode)), 255.0
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(problem(path, "frame", f"unreadable ({error})", "a PNG file")) from error
    return _opaque(path, pixels, full) / full


def _png_bit_depth(path: Path) -> int:
    """The bit depth in a PNG's IHDR chunk."""
    return path.read_bytes()[24]


def _read_png16(path: Path) -> np.ndarray:
    """(H, W, C) uint16 of a non-interlaced 16-bit RGB or RGBA PNG (PNG specification, 9.2: the five filters)."""
    data = path.read_bytes()
    width, height, _, kind, _, _, interlace = struct.unpack(">IIBBBBB", data[16:29])
    if interlace or kind not in (2, 4, 6):
        raise InputError(problem(path, "16-bit PNG", "interlaced or of another kind", "plain RGB, RGBA or grey"))
    channels = {2: 3, 4: 2, 6: 4}[kind]
    packed, at = b"", 8
    while at < len(data):
        size, name = struct.unpack(">I4s", data[at : at + 8])
        packed += data[at + 8 : at + 8 + size] if name == b"IDAT" else b""
        at += 12 + size
    step, stride = 2 * channels, 2 * channels * width
    lines = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, stride + 1)
    above = np.zeros(stride, np.uint8)
    out = np.empty((height, stride), np.uint8)
    for y, line in enumerate(lines):
        above = out[y] = _unfilter(int(line[0]), line[1:], above, step)
    return out.view(">u2").reshape(height, width, channels).astype(np.uint16)


def _unfilter(kind: int, line: np.ndarray, above: np.ndarray, step: int) -> np.ndarray:
    """One scan line without its PNG filter: 0 none, 1 left, 2 above, 3 their mean, 4 Paeth."""
    if kind == 0:
        return line
    if kind == 2:
        return line + above
    pixels, up = line.reshape(-1, step).astype(np.int64), above.reshape(-1, step).astype(np.int64)
    if kind == 1:
        return (np.cumsum(pixels, axis=0) & 255).astype(np.uint8).reshape(-1)
    left, corner = np.zeros(step, np.int64), np.zeros(step, np.int64)
    out = np.empty_like(pixels)
    for x in range(len(pixels)):
        if kind == 3:
            guess = (left + up[x]) >> 1
        else:
            whole = left + up[x] - corner
            a, b, c = np.abs(whole - left), np.abs(whole - up[x]), np.abs(whole - corner)
            guess = np.where((a <= b) & (a <= c), left, np.where(b <= c, up[x], corner))
        left = out[x] = (pixels[x] + guess) & 255
        corner = up[x]
    return out.astype(np.uint8).reshape(-1)
