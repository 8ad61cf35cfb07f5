"""The table of extremes of the lab's commands: each row is what a user types, and what must come of it."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image

from protocols.records import FLIP_DTYPE
from stimuli.clip import Clip, ClipStore
from stimuli.encode import encode
from studyapp.session_file import verify

STUDY = """\
study: far
display: {refresh_hz: REFRESH, size_px: [SCREEN]}
defaults: {size_px: [SIZE], duration_s: LENGTH, start_s: START, warm_up_s: 0, gap_px: 0, iti_s: 0, path: PATH}
scenes: {tunnel: {scene: tunnel_geom, exposure: EXPOSURE}}
paths: {own: [{time_s: 0, position: [0, 0.2, 0], look_at: [1, 0.3, -1], yfov_deg: FIELD}]}
conditions: {plain: vanilla, dense: {technique: TECHNIQUE}}
questions: {rate: {kind: likert, text: Was it clean?}}
blocks: [{name: r, kind: likert, questions: [rate], factors: {condition: [plain, dense]}}]
observer: {rt: {median_s: 0.1, sd_log: 0.1, shift_s: 0.05}}
"""
USUAL = {
    "REFRESH": "240", "SCREEN": "32, 32", "SIZE": "12, 8", "LENGTH": "1/120", "START": "1", "PATH": "file",
    "EXPOSURE": "1.0", "FIELD": "60", "TECHNIQUE": "temporally_dense",
}  # fmt: skip


def study(folder: Path, values: dict[str, str]) -> Path:
    """The protocol with these values."""
    text = STUDY
    for name, value in {**USUAL, **values}.items():
        text = text.replace(name, value)
    file = folder / "far.yaml"
    file.write_text(text)
    return file


@dataclass(frozen=True)
class Extreme:
    """``arguments`` for the command line, made in a folder; ``code`` and ``said``: exit code, and words of its output;
    ``holds``: what must be in the folder afterwards."""

    name: str
    arguments: Callable[[Path], list[str]]
    code: int = 0
    said: str = ""
    holds: Callable[[Path], None] = lambda folder: None


def clips_in(folder: Path) -> list[Clip]:
    """The whole clips in the store beside the protocol."""
    store = ClipStore(folder / ".clips")
    assert all(store.problems_of(identity) == [] for identity in store.identities())
    return list(store.published())


def rendered(name: str, **values: str) -> Extreme:
    """`studyapp render`: finite pictures of that size, as many as asked for, whole in the store."""
    width, height = (int(side) for side in {**USUAL, **values}["SIZE"].split(","))
    frames = round(Fraction({**USUAL, **values}["LENGTH"]) * Fraction({**USUAL, **values}["REFRESH"]))

    def holds(folder: Path) -> None:
        clips = clips_in(folder)
        assert len(clips) == 2
        for clip in clips:
            assert clip.frame_count == frames
            for k in range(frames):
                color = clip.frame(k).color
                assert color is not None
                assert color.shape == (height, width, 3)
                assert np.isfinite(color).all()
            # Something is seen in all but the blackest.
            assert color.max() > 0
            assert encode(color, clip.request.exposure).shape == (height, width, 4)

    return Extreme(f"render {name}", lambda folder: ["render", str(study(folder, values))], holds=holds)


def simulated(name: str, **values: str) -> Extreme:
    """`studyapp simulate`: two trials, a refresh a row, none missing, none twice."""
    frames = round(Fraction({**USUAL, **values}["LENGTH"]) * Fraction({**USUAL, **values}["REFRESH"]))

    def holds(folder: Path) -> None:
        path = folder / "data" / "far_p1_1.sqlite"
        assert verify(path) == []
        db = sqlite3.connect(path)
        rows = db.execute("SELECT trial, data FROM flips ORDER BY trial, chunk").fetchall()
        assert db.execute("SELECT COUNT(*) FROM trials WHERE status = 'ok'").fetchone()[0] == 2
        db.close()
        for trial in (0, 1):
            flips = np.concatenate([np.frombuffer(data, FLIP_DTYPE) for number, data in rows if number == trial])
            shown = flips["source"][:, 0]
            np.testing.assert_array_equal(shown[shown >= 0], np.arange(frames))
            assert (np.diff(flips["refresh"]) == 1).all()

    command = ["--participants", "1", "--jobs", "1"]
    return Extreme(
        f"simulate {name}",
        lambda folder: ["simulate", str(study(folder, values)), *command, "--data", str(folder / "data")],
        holds=holds,
    )


def imported(name: str, size_px: tuple[int, int], rate: str, count: int = 2) -> Extreme:
    """`studyapp store import` of PNG frames of that size."""

    def arguments(folder: Path) -> list[str]:
        (folder / "frames").mkdir()
        for k in range(count):
            Image.new("RGB", size_px, (10 * k, 255, 0)).save(folder / "frames" / f"{k:04d}.png")
        about = ["--rate", rate, "--technique", "other", "--scene", "tunnel", "--transfer", "srgb"]
        return ["store", "import", str(folder / "frames"), *about, "--store", str(folder / ".clips")]

    def holds(folder: Path) -> None:
        (clip,) = clips_in(folder)
        assert clip.request.size_px == size_px
        assert Fraction(clip.request.rate_hz) == Fraction(rate)
        color = clip.frame(1).color
        assert color is not None
        assert (encode(color, 1.0)[..., :3] == (10, 255, 0)).all()

    return Extreme(f"import {name}", arguments, holds=holds)


def refused(name: str, said: str, command: str = "render", **values: str) -> Extreme:
    """One line on stderr, exit code 2, and nothing made."""

    def holds(folder: Path) -> None:
        assert not list((folder / ".clips").glob("clips/*"))
        assert not list((folder / ".clips").glob("parts/*"))

    return Extreme(f"{command} {name}", lambda folder: [command, str(study(folder, values))], 2, said, holds)


def _empty_store(folder: Path) -> list[str]:
    (folder / ".clips").mkdir()
    return ["store", "verify", "--store", str(folder / ".clips")]


def _no_frames(folder: Path) -> list[str]:
    (folder / "frames").mkdir()
    about = ["--rate", "240", "--technique", "other", "--scene", "s", "--transfer", "srgb"]
    return ["store", "import", str(folder / "frames"), *about, "--store", str(folder / ".clips")]


TABLE: tuple[Extreme, ...] = (
    *(rendered(f"{size} px", SIZE=size) for size in ("1, 1", "1, 31", "31, 1", "17, 13")),
    *(rendered(f"at {rate} Hz", REFRESH=rate, LENGTH=f"2/{rate}") for rate in ("24", "1000")),
    rendered("at 60000/1001 Hz", REFRESH="60000/1001", LENGTH="1001/30000"),
    rendered("a single frame", LENGTH="1/240"),
    rendered("after 1e6 s", START="1000000"),
    *(rendered(f"field of {field} degrees", FIELD=field, PATH="own") for field in ("0.01", "179")),
    *(rendered(f"exposure {exposure}", EXPOSURE=exposure) for exposure in ("1.0e-12", "1.0e+12")),
    refused("60000x60000", "bytes", SIZE="16384, 16384", SCREEN="16384, 16384", TECHNIQUE="adaptive_frameless"),
    refused("no frame at all", "more than 0", LENGTH="0"),
    refused("a panel larger than the display", "at most 32x32", "check", SIZE="64, 64"),
    *(simulated(f"at {rate} Hz", REFRESH=rate, LENGTH=f"24/{rate}") for rate in ("24", "1000")),
    simulated("at 120000/1001 Hz", REFRESH="120000/1001", LENGTH="1001/10000"),
    simulated("a single frame", LENGTH="1/240"),
    simulated("panels of 8k", SIZE="7680, 4320", SCREEN="7680, 4320"),
    simulated("panels of one pixel", SIZE="1, 1", SCREEN="1, 1"),
    simulated("after 1e6 s", START="1000000"),
    imported("of one pixel", (1, 1), "240"),
    imported("of one row at 24000/1001 Hz", (31, 1), "24000/1001"),
    imported("at 1000 Hz", (2, 3), "1000"),
    Extreme("import nothing", _no_frames, 2, "frames"),
    Extreme("an empty store", _empty_store, 0, "0 clips"),
    Extreme("no store", lambda folder: ["store", "ls", "--store", str(folder / "none")], 2, "wanted a clip store"),
    Extreme("the participant 0", lambda folder: ["plan", str(study(folder, {})), "--participant", "0"], 2, "from 1"),
    Extreme("the participant 1e9", lambda folder: ["plan", str(study(folder, {})), "--participant", "1000000000"]),
    Extreme("nobody", lambda folder: ["simulate", str(study(folder, {})), "--participants", "0"], 2, "1 to 10000"),
    Extreme("no worker", lambda folder: ["render", str(study(folder, {})), "--workers", "0"], 2, "at least 1"),
)
