"""Rendering the frames of a live trial again, from the session's record of gaze, seed and start."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from protocols.load import library_path, read_study
from protocols.trial import Trial
from stimuli.clip import ClipStore
from stimuli.errors import InputError, problem
from studyapp.lab_file import table_of
from studyapp.live_sources import LiveSources, RecordedGaze
from studyapp.session_file import read_header
from studyapp.session_header import sha256_text
from studyapp.store_root import store_directory


@dataclass(frozen=True)
class Replayed:
    """``exact``: the last frame's codes, which depend on all before, have the recorded hash."""

    frames: int
    exact: bool


def replay(
    session: Path, number: int, logs: Sequence[tuple[Mapping[str, object], bytes]], protocol: str | None,
    store: str | None, out: Path | None,
) -> dict[str, Replayed]:  # fmt: skip
    """Slot -> what came of it. Raises InputError where the protocol is not the session's."""
    db = sqlite3.connect(session)
    header = read_header(db)
    (planned,) = db.execute("SELECT planned FROM trials WHERE trial=?", (number,)).fetchone()
    db.close()
    name = protocol or str(header["study"])
    study, text = read_study(name)
    if sha256_text(text) != header["protocol_sha256"]:
        wanted = f"the session's own ({str(header['protocol_sha256'])[:12]})"
        raise InputError(problem(name, "protocol", sha256_text(text)[:12], wanted))
    trial = Trial.from_dict(header["plan"][planned])
    clips = ClipStore(store_directory(name, store))
    table = table_of(header["certificate"].get("photometry"))
    results = {}
    for payload, frames in logs:
        slot = str(payload["slot"])
        gaze = RecordedGaze(frames)
        source = LiveSources(study, library_path(name).parent, clips, gaze, table).source(trial, slot)
        digest = ""
        for row in gaze.rows:
            codes = source.frame(int(row["frame"]))
            digest = hashlib.sha256(codes.tobytes()).hexdigest()
            if out is not None:
                out.mkdir(parents=True, exist_ok=True)
                Image.fromarray(codes[..., :3]).save(out / f"trial{number}_{slot}_{int(row['frame']):06d}.png")
        results[slot] = Replayed(len(gaze.rows), digest == payload["last_sha256"])
    return results
