"""kill -9 at random moments of simulated sessions: no committed trial lost, no unreadable file, each cell exactly once.

Each round starts a session in a process of its own on the virtual display with real lines, kills the presenter, the
writer, the device reader or an emulator at a random moment, looks at the file, and resumes until the design is
complete. What had been committed at the kill is read from the file a moment before and after.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from protocols.records import has_table
from studyapp.session_file import read_header, verify

ROOT = Path(__file__).parents[2]
VICTIMS = ("presenter", "writer", "reader", "emulator_0", "emulator_1")
STUDY = """\
study: killed
seed: 5
display: {refresh_hz: 240, size_px: [320, 120]}
defaults: {size_px: [48, 32], duration_s: 0.5, warm_up_s: 0, iti_s: 0.2}
scenes:
  tunnel: {scene: tunnel_geom, exposure: 1.0}
conditions:
  plain: {technique: vanilla}
  slow: {technique: vanilla, rate_hz: 60}
  held: {technique: vanilla, rate_hz: 30}
questions:
  which: {kind: choice, text: Which one?}
blocks:
  - name: pairs
    kind: forced_choice
    compare: {of: [plain, slow, held]}
    factors: {scene: [tunnel]}
    repetitions: 60
    questions: [which]
"""
TRIALS = 180
SESSION = "killed_p1_1.sqlite"


@dataclass(frozen=True)
class Round:
    """One killed session. ``committed``: trials in the file right after the kill; ``lost``: of those committed before
    it that are gone afterwards; ``problems``: what is wrong with the completed file ([]: nothing)."""

    victim: str
    after_s: float
    committed: int
    lost: int
    readable: bool
    resumes: int
    problems: list[str]


def session_arguments(folder: Path, data: Path) -> list[str]:
    """The command of a session whose protocol lies in ``folder`` and whose file goes to ``data``."""
    protocol = folder / "killed.yaml"
    protocol.write_text(STUDY)
    return [sys.executable, "-m", "studyapp", "run", str(protocol), "--participant", "1", "--display", "virtual",
            "--observer", "simulated", "--data", str(data)]  # fmt: skip


def start(arguments: list[str], folder: Path) -> tuple[subprocess.Popen[str], dict[str, int]]:
    """The session's process, and those that it has started by role, once it has begun."""
    pids_file = folder / "pids.json"
    pids_file.unlink(missing_ok=True)
    process = subprocess.Popen([*arguments, "--pids", str(pids_file)], cwd=ROOT, stderr=subprocess.PIPE, text=True,
                               stdout=subprocess.DEVNULL)  # fmt: skip
    while process.poll() is None:
        try:
            return process, {**json.loads(pids_file.read_text()), "presenter": process.pid}
        except (FileNotFoundError, json.JSONDecodeError):
            time.sleep(0.002)
    raise RuntimeError(process.communicate()[1])


def one_round(folder: Path, victim: str, after_s: float) -> Round:
    """Start, kill, look, resume until complete."""
    arguments = session_arguments(folder, folder)
    process, pids = start(arguments, folder)
    time.sleep(after_s)
    path = folder / SESSION
    before = trial_rows(path)
    if process.poll() is None:
        # A session that has just ended has no process left to kill.
        with contextlib.suppress(ProcessLookupError):
            os.kill(pids[victim], signal.SIGKILL)
    process.communicate()
    problems: list[str] = []
    try:
        after = trial_rows(path)
        readable = True
    except sqlite3.Error as error:
        problems.append(str(error))
        return Round(victim, after_s, len(before), len(before), False, 0, problems)
    lost = len(before - after)
    resumes = 0
    while not complete(path) and resumes < 5:
        resumes += 1
        done = subprocess.run([*arguments, "--resume"], cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode:
            problems.append(done.stderr.strip()[-200:])
    problems += verify(path)
    final = trial_rows(path)
    lost += len(before - final)
    problems += cell_problems(final)
    return Round(victim, after_s, len(after), lost, readable, resumes, problems)


def cell_problems(rows: set[tuple[int, int, str]]) -> list[str]:
    """A line where not every cell of the design was well shown exactly once."""
    cells = Counter(planned for _, planned, status in rows if status == "ok")
    if cells == Counter(range(TRIALS)):
        return []
    return [f"cells: {len(cells)} of {TRIALS}, most often {max(cells.values(), default=0)} times"]


def trial_rows(path: Path) -> set[tuple[int, int, str]]:
    """(presentation, planned trial, status) of every committed trial."""
    db = sqlite3.connect(path, timeout=10)
    try:
        if not has_table(db, "trials"):
            return set()
        return set(db.execute("SELECT trial, planned, status FROM trials").fetchall())
    finally:
        db.close()


def complete(path: Path) -> bool:
    """Is the session's plan done?"""
    db = sqlite3.connect(path)
    try:
        return bool(read_header(db).get("completed_utc"))
    finally:
        db.close()


def prove(rounds: int = 200, seed: int = 1) -> list[Round]:
    """``rounds`` kills, victims in turn, moments uniform over the session's length (about 0.8 s after its start)."""
    rng = random.Random(seed)
    results = []
    for number in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            results.append(one_round(Path(folder), VICTIMS[number % len(VICTIMS)], rng.uniform(0.0, 0.8)))
        print(number, results[-1], flush=True)
    return results


if __name__ == "__main__":
    found = prove(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
    summary = {
        "kills": len(found),
        "committed_trials_lost": sum(r.lost for r in found),
        "unreadable_files": sum(not r.readable for r in found),
        "rounds_with_problems": sum(bool(r.problems) for r in found),
        "killed_in_the_middle": sum(0 < r.committed < TRIALS for r in found),
        "rounds": [asdict(r) for r in found],
    }
    Path("evidence").mkdir(exist_ok=True)
    Path("evidence/kill_sessions.json").write_text(json.dumps(summary, indent=1))
    print({key: value for key, value in summary.items() if key != "rounds"})
    sys.exit(bool(summary["committed_trials_lost"] or summary["unreadable_files"] or summary["rounds_with_problems"]))
