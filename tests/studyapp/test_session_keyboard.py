"""A person's session in a real window: keys go through GLFW's callback, keyboard and presenter into the file."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from protocols.trial import Trial
from studyapp.cli import main
from studyapp.present.frame_loop import ask_realtime, children_stay_normal, leave_realtime
from studyapp.session_file import read_header, verify

ROOT = Path(__file__).parents[2]
STUDY = """\
study: keyed
seed: 7
display: {refresh_hz: 60, size_px: [640, 360], width_m: 0.53, distance_m: 0.6, background: 0.8}
defaults: {size_px: [48, 32], duration_s: 0.1, warm_up_s: 0, gap_px: 8, iti_s: 0.05}
scenes:
  tunnel: {scene: tunnel_geom, start_s: 1, exposure: 1.0}
conditions:
  plain: {technique: vanilla}
  slow: {technique: vanilla, rate_hz: 30}
timing: {requeue: false, max_missed: 1000}
questions:
  which: {kind: choice, text: Which one?}
  rate: {kind: likert, text: The sequence was free of artifacts.}
blocks:
  - {name: welcome, kind: instructions, text: Press a key.}
  - name: pairs
    kind: forced_choice
    compare: {of: [plain, slow]}
    factors: {scene: [tunnel]}
    questions: [which]
  - name: ratings
    kind: likert
    factors: {scene: [tunnel], condition: [plain]}
    questions: [rate]
"""

# Every tenth refresh a finger goes down on the next key, as GLFW's own callback says it, and up again.
CHILD = """
import sys
import glfw
from studyapp.cli import main
from studyapp.display import glfw_display

keys = [glfw.KEY_A, glfw.KEY_RIGHT, glfw.KEY_3]
flips = [0]
real = glfw_display.GlfwDisplay.flip

def flip(self):
    flips[0] += 1
    if flips[0] > 600 and flips[0] % 10 == 0:
        key = keys[flips[0] // 10 % len(keys)]
        self._on_key(self._window, key, glfw.get_key_scancode(key), glfw.PRESS, 0)
        self._on_key(self._window, key, glfw.get_key_scancode(key), glfw.RELEASE, 0)
    return real(self)

glfw_display.GlfwDisplay.flip = flip
sys.exit(main(sys.argv[1:]))
"""


def test_a_session_by_keyboard_in_a_window(tmp_path: Path) -> None:
    if shutil.which("xvfb-run") is None:
        pytest.skip("xvfb-run is not installed")
    protocol, data = tmp_path / "keyed.yaml", tmp_path / "data"
    protocol.write_text(STUDY)
    assert main(["render", str(protocol), "--workers", "1"]) == 0
    environment = {key: value for key, value in os.environ.items() if key != "WAYLAND_DISPLAY"}
    arguments = ["run", str(protocol), "--participant", "1", "--display", "glfw", "--data", str(data)]
    command = ["xvfb-run", "-a", "-s", "-screen 0 1280x720x24", sys.executable, "-c", CHILD, *arguments]
    done = subprocess.run(
        [*command, "--override", "display_lock=a test without a vblank", "--override", "stamp_class=a test"],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    path = data / "keyed_p1_1.sqlite"
    assert verify(path) == []
    db = sqlite3.connect(path)
    header = read_header(db)
    assert header["observer_kind"] == "person"
    assert header["certificate"]["background_code"] == 204
    assert header["certificate"]["priority"] == "normal"
    plan = [Trial.from_dict(trial) for trial in header["plan"]]
    rows = db.execute("SELECT trial, answer, device, raw, rt_ns, press_ns FROM responses ORDER BY trial").fetchall()
    db.close()
    assert len(rows) == 2
    for number, answer, device, raw, rt_ns, press_ns in rows:
        question = plan[number].questions[0]
        assert device == "keyboard"
        assert question.keys[raw.decode()] == answer
        assert rt_ns > 0
        assert press_ns > header["started_ns"]


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="no SCHED_RESET_ON_FORK on this system")
def test_real_time_priority_stays_with_the_presenter_and_ends_with_the_session() -> None:
    said = ask_realtime()
    try:
        if not said.startswith("fifo"):
            assert said.startswith("refused")
            pytest.skip(f"real-time priority was {said}")
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
        children_stay_normal()
        asked = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"]
        assert int(subprocess.check_output(asked)) == os.SCHED_OTHER
    finally:
        leave_realtime()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
