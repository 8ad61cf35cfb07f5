"""Measured choices of the clip store: EXR compression, raw against compressed play cache, speed of encoding, and how
long a store of 20,000 frames takes to list and verify.

``python -m tests.prove.clip_formats [--store DIR]`` writes evidence/clip_formats.json. The pictures are frames of
the tunnel (rendered at each size), so compression meets what it will meet.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from renderers import render_clip
from stimuli import load_scene
from stimuli.clip import ClipStore
from stimuli.clip_parts import PartWriter, assemble
from stimuli.clip_request import ClipRequest
from stimuli.encode import encode
from stimuli.exr import COMPRESSIONS, read_exr, write_exr
from tests.evidence import write_evidence

SIZES = ((192, 144), (512, 512), (960, 540), (1920, 1080))


def frames_of(size_px: tuple[int, int], count: int = 4) -> list[np.ndarray]:
    """Frames of the tunnel, 1 sample a pixel."""
    made = render_clip(load_scene("tunnel_geom"), "vanilla", size_px, 240, f"{count}/240", start_s=1.0, exposure=0.5)
    return [frame.color for frame in made]


def median_ms(action: Callable[[], Any], repeats: int) -> float:
    """The median time of ``action`` in ms, after one call that does not count."""
    action()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        action()
        times.append(time.perf_counter() - began)
    return round(1e3 * float(np.median(times)), 3)


def exr_compressions(frames: list[np.ndarray], folder: Path) -> dict[str, Any]:
    """Write and read time and size of a frame for each lossless compression."""
    path, out = folder / "frame.exr", {}
    for name in COMPRESSIONS:
        repeats = 15 if frames[0].size < 300_000 else 5

        def write(name: str = name) -> None:
            write_exr(path, frames[0], compression=name)

        out[name] = {
            "write_ms": median_ms(write, repeats),
            "read_ms": median_ms(lambda: read_exr(path), repeats),
            "kilobytes": round(path.stat().st_size / 1e3, 1),
        }
    return out


def play_containers(frames: list[np.ndarray], folder: Path) -> dict[str, Any]:
    """One encoded frame to hand: from a raw mapped file (touched before), and decompressed by blosc2."""
    codes = np.stack([encode(frame, 0.5) for frame in frames])
    raw = folder / "frames.rgba"
    raw.write_bytes(codes.tobytes())
    mapped = np.memmap(raw, np.uint8, "r", 0, codes.shape)
    mapped.reshape(-1)[::4096].max()
    target = np.empty(codes.shape[1:], np.uint8)
    out: dict[str, Any] = {
        "raw_view_ms": median_ms(lambda: mapped[1], 50),
        "raw_copy_ms": median_ms(lambda: np.copyto(target, mapped[1]), 20),
        "raw_kilobytes": round(codes[1].nbytes / 1e3, 1),
    }
    try:
        import blosc2
    except ImportError:
        return {**out, "blosc2": "not installed here"}
    for codec in ("LZ4", "ZSTD"):
        for level in (1, 5):
            chosen, data = blosc2.Codec[codec], codes[1].tobytes()
            packed = blosc2.compress2(data, codec=chosen, clevel=level, typesize=4, nthreads=1)
            out[f"blosc2_{codec.lower()}_{level}"] = {
                "decode_ms": median_ms(lambda packed=packed: blosc2.decompress2(packed, nthreads=1), 20),
                "kilobytes": round(len(packed) / 1e3, 1),
            }
    return out


def large_store(folder: Path, clips: int = 84, frames: int = 240) -> dict[str, Any]:
    """A store of clips * frames small frames: time to list, to verify names and sizes, to verify every byte; and the
    share of the last that plain reading of the same files takes."""
    store = ClipStore(folder / "large")
    picture = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)
    base = ClipRequest(
        scene="toy", scene_sha256="00" * 32, technique="vanilla", params={}, size_px=(32, 24), rate_hz="240",
        duration_s=f"{frames}/240",
    )  # fmt: skip
    for seed in range(clips):
        request = replace(base, seed=seed)
        writer = PartWriter(store, request)
        for _ in range(frames):
            writer.add(picture)
        writer.publish("all")
        assemble(store, request, ["all"])

    def timed(action: Callable[[], Any]) -> float:
        began = time.perf_counter()
        action()
        return round(time.perf_counter() - began, 3)

    identities = store.identities()
    files = [path for identity in identities for path in store.directory(identity).iterdir()]
    return {
        "frames": clips * frames,
        "list_s": timed(lambda: list(store.published())),
        "verify_sizes_s": timed(lambda: [store.problems_of(name, read_bytes=False) for name in identities]),
        "verify_bytes_s": timed(lambda: [store.problems_of(name) for name in identities]),
        "read_alone_s": timed(lambda: [path.read_bytes() for path in files]),
        "problems": sum(len(store.problems_of(name)) for name in identities),
    }


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; exit code 1 where the large store takes 10 s or more beside reading."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clips", type=int, default=84)
    parser.add_argument("--out", default="evidence/clip_formats.json")
    args = parser.parse_args(arguments)
    result: dict[str, Any] = {"cores": os.cpu_count()}
    with TemporaryDirectory() as name:
        folder = Path(name)
        for size in SIZES:
            frames = frames_of(size)
            target = np.empty((size[1], size[0], 4), np.uint8)
            half = frames[0].astype(np.float16)
            result[f"{size[0]}x{size[1]}"] = {
                "exr": exr_compressions(frames, folder),
                "play": play_containers(frames, folder),
                "encode_float32_ms": median_ms(lambda f=frames, t=target: encode(f[0], 0.5, out=t), 20),
                "encode_half_ms": median_ms(lambda h=half, t=target: encode(h, 0.5, out=t), 20),
            }
        result["large_store"] = large = large_store(folder, args.clips)
    large["passed"] = large["verify_bytes_s"] - large["read_alone_s"] < 10 and not large["problems"]
    write_evidence("clip_formats", result, args.out)
    print(json.dumps(result, indent=2))
    return 0 if large["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
