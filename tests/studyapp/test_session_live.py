"""Stored and live panels off-screen: frames are drawn, provenance is kept, a replay gives the same codes."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from protocols.records import FLIP_DTYPE
from studyapp.cli import main
from studyapp.present.live import LIVE_DTYPE

STUDY = """\
study: mixed
seed: 7
display: {refresh_hz: 240, size_px: [320, 120], width_m: 0.53, distance_m: 0.6}
defaults: {size_px: [48, 32], duration_s: 0.3, warm_up_s: 0, gap_px: 8, iti_s: 0.05}
scenes:
  tunnel: {scene: tunnel_geom, start_s: 1, exposure: 1.0}
conditions:
  plain: {technique: temporally_dense, rate_hz: 60, live: true}
  stored: {technique: vanilla, rate_hz: 30}
timing: {requeue: false}
gaze: {required: true, points: 5, accuracy_deg: 2.0, precision_deg: 2.0, latency_p95_ms: 60}
questions:
  rate: {kind: likert, text: The sequence was free of artifacts.}
blocks:
  - name: ratings
    kind: likert
    factors: {scene: [tunnel], condition: [plain, stored]}
    questions: [rate]
"""


def test_a_live_trial_is_recorded_and_replayed_bit_exact(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol, data = tmp_path / "mixed.yaml", tmp_path / "data"
    protocol.write_text(STUDY)
    assert main(["render", str(protocol), "--workers", "1"]) == 0
    # A display whose light is proportional to its code, and a sensor on the light patch.
    light = {"date": "2026-01-01", "codes": [0, 255], "luminance_cd_m2": [0.0, 100.0]}
    (tmp_path / "light.json").write_text(json.dumps(light))
    (tmp_path / "lab.yaml").write_text(
        "display: {kind: offscreen}\nphotometry: {file: light.json}\nsensor: {port: emulated}\n"
    )
    overrides = [f"--override={check}=a test on a shared machine" for check in
                 ("display_lock", "gaze_validation", "gaze_latency")]  # fmt: skip
    arguments = ["run", str(protocol), "--participant", "1", "--display", "offscreen", "--observer", "simulated"]
    assert main([*arguments, "--data", str(data), *overrides]) == 0
    path = data / "mixed_p1_1.sqlite"
    db = sqlite3.connect(path)
    (validation,) = db.execute("SELECT payload FROM events WHERE kind='validation'").fetchone()
    assert json.loads(validation)["targets"] == 5
    certificate = json.loads(db.execute("SELECT value FROM header WHERE key='certificate'").fetchone()[0])
    assert certificate["encoding"].startswith("measured table")
    assert certificate["onset"] == "onset by light sensor"
    assert certificate["light"]["edges"] > 900
    ((payload, raw),) = db.execute("SELECT payload, raw FROM events WHERE device='live'").fetchall()
    number = json.loads(payload)["trial"]
    frames = np.frombuffer(raw, LIVE_DTYPE)
    assert len(frames) >= 10
    assert np.all(frames["render_ns"] > 0)
    chunks = db.execute("SELECT data FROM flips WHERE trial=? ORDER BY chunk", (number,)).fetchall()
    flips = np.concatenate([np.frombuffer(chunk, FLIP_DTYPE) for (chunk,) in chunks])
    assert set(range(10)) <= set(flips["source"][:, 0].tolist())
    stored = json.loads(db.execute("SELECT panels FROM trials WHERE trial=?", (1 - number,)).fetchone()[0])
    clips = db.execute("SELECT clip FROM clips").fetchall()
    assert clips == [(stored[0]["clip"],)]
    db.close()
    capsys.readouterr()
    out = tmp_path / "frames"
    replay = ["replay", str(path), str(number), "--protocol", str(protocol), "--out", str(out)]
    assert main(replay) == 0
    assert "bit-exact" in capsys.readouterr().out
    pictures = sorted(out.iterdir())
    assert len(pictures) == len(frames)
    assert np.asarray(Image.open(pictures[-1])).std() > 5
    # Another seed is another picture: the replay says so.
    db = sqlite3.connect(path)
    changed = {**json.loads(payload), "last_sha256": "0"}
    db.execute("UPDATE events SET payload=? WHERE device='live'", (json.dumps(changed),))
    db.commit()
    db.close()
    assert main(replay) == 1
    assert main(["replay", str(path), str(1 - number), "--protocol", str(protocol)]) == 2
    assert main(["replay", str(path), "99", "--protocol", str(protocol)]) == 2
