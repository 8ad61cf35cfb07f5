"""What one refresh costs here: upload, draw and flip of one 512x512 streamed panel, without waiting for a refresh.

Run as ``python -m studyapp.present.bench [glfw|offscreen]`` it prints JSON (a window needs a process of its own).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from fractions import Fraction
from typing import Any

import moderngl
import numpy as np

from protocols.records import FLIP_DTYPE
from studyapp.clock import now_ns
from studyapp.display.choose import open_display
from studyapp.present.frame_loop import undisturbed
from studyapp.present.layout import place_panels
from studyapp.present.presenter import KeptFlips
from studyapp.present.uploader import PanelTexture, Quads
from studyapp.seams import Display

SIZE = (512, 512)
WARM_UP, REFRESHES = 100, 1000


class StreamedClip:
    """Noise frames, each another one: nothing can be reused between refreshes."""

    rate_hz = Fraction(240)

    def __init__(self, size_px: tuple[int, int] = SIZE, frame_count: int = 64, seed: int = 0) -> None:
        self.size_px, self.frame_count = size_px, frame_count
        rng = np.random.default_rng(seed)
        self._frames = rng.integers(0, 256, (frame_count, size_px[1], size_px[0], 4), np.uint8)

    def frame(self, index: int) -> np.ndarray:
        """(H, W, 4) uint8."""
        return self._frames[index]


def work_per_refresh(display: Display, refreshes: int = REFRESHES) -> dict[str, Any]:
    """Milliseconds a refresh, by part; the display must not wait for vblanks (swap interval 0, or off-screen)."""
    gl = display.context()
    if not isinstance(gl, moderngl.Context):
        raise ValueError("work_per_refresh: display: got one without pixels, wanted a window or an off-screen buffer")
    clip, quads = StreamedClip(), Quads(gl, display.size_px)
    (rect,) = place_panels({"centre": clip.size_px}, display.size_px)
    texture = PanelTexture(gl, quads, rect, clip)
    sink, row = KeptFlips(), np.zeros(1, FLIP_DTYPE)
    finish = getattr(display, "swap_and_finish", gl.finish)
    parts = np.zeros((WARM_UP + refreshes, 4))
    texture.fetch(0)
    with undisturbed():
        for place in range(WARM_UP + refreshes):
            started = now_ns()
            gl.clear(0.47, 0.47, 0.47, 1.0)
            texture.draw(place % clip.frame_count)
            drawn = now_ns()
            texture.fetch((place + 1) % clip.frame_count)
            uploaded = now_ns()
            finish()
            flipped = now_ns()
            row[0] = (
                place,
                flipped,
                flipped,
                flipped,
                0,
                0,
                (place, -1, -1, -1),
                uploaded - drawn,
                drawn - started,
                -1,
            )
            sink.put(row)
            done = now_ns()
            parts[place] = drawn - started, uploaded - drawn, flipped - uploaded, done - started
    texture.release()
    quads.release()
    kept = parts[WARM_UP:] / 1e6
    median = np.median(kept, axis=0)
    return {
        "display": display.description,
        "draw_ms": float(median[0]),
        "upload_ms": float(median[1]),
        "flip_ms": float(median[2]),
        "work_ms": float(median[3]),
        "work_p99_ms": float(np.percentile(kept[:, 3], 99)),
        "refreshes": refreshes,
    }


def measure(kind: str) -> dict[str, Any]:
    """One kind of display, in this process."""
    display = open_display(kind, SIZE, 240)
    try:
        return work_per_refresh(display)
    finally:
        display.close()


def present_bench() -> dict[str, Any]:
    """Section of ``studyapp bench``: work per refresh off-screen, and on a window (under Xvfb where no display is).

    Keys: offscreen, window: {draw_ms, upload_ms, flip_ms, work_ms, work_p99_ms, ...}, or {absent: why}.
    """
    command = [sys.executable, "-m", "studyapp.present.bench"]
    window = [*command, "glfw"]
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        if shutil.which("xvfb-run") is None:
            return {"offscreen": _child([*command, "offscreen"]), "window": {"absent": "no display and no xvfb-run"}}
        window = ["xvfb-run", "-a", "-s", "-screen 0 1280x720x24", *window]
    return {"offscreen": _child([*command, "offscreen"]), "window": _child(window)}


def _child(command: list[str]) -> dict[str, Any]:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        return {"absent": said[-1] if said else f"exit code {done.returncode}"}
    return json.loads(done.stdout)


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1] if len(sys.argv) > 1 else "offscreen")))
