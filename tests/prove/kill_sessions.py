"""kill -9 at random moments of simulated sessions: no committed trial lost, no unreadable file, each cell exactly once.

A session runs in a process of its own on the virtual display with real lines; the presenter, the writer, the device
reader or an emulator is killed at a random moment, the file is looked at, and the session resumed, to be killed again,
until its design is complete. What had been committed at a kill is read from the file a moment before and after.

``python -m tests.prove.kill_sessions [KILLS] [SEED]`` writes evidence/kill_sessions.json after every session.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, cycle
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from protocols.records import has_table
from studyapp.cli import main
from studyapp.session_file import read_header, verify
from tests.evidence import write_evidence

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
LONGEST_S = 0.4  # half of what all trials take


@dataclass(frozen=True)
class Kill:
    """One kill, ``after_s`` after the session had begun or gone on. ``committed``: trials in the file right after it;
    ``lost``: of those committed before it that are gone; ``problems``: what was wrong, with the completed file too at
    a session's last kill ([]: nothing)."""

    session: int
    victim: str
    after_s: float
    committed: int
    lost: int
    readable: bool
    problems: list[str]


def session_arguments(folder: Path, data: Path) -> list[str]:
    """The command of a session whose protocol lies in ``folder`` and whose file goes to ``data``."""
    protocol = folder / "killed.yaml"
    protocol.write_text(STUDY)
    return [sys.executable, "-m", "studyapp", "run", str(protocol), "--participant", "1", "--display", "virtual",
            "--observer", "simulated", "--data", str(data)]  # fmt: skip


class Started:
    """A session in a process of its own (forked from a server that has the imports behind it), as `subprocess.Popen`
    would have it. ``words``: a pipe that all of its processes write their errors to."""

    def __init__(self, arguments: list[str], words: Path) -> None:
        words.unlink(missing_ok=True)
        os.mkfifo(words)
        self._words = os.open(words, os.O_RDONLY | os.O_NONBLOCK)
        context = get_context("forkserver")
        context.set_forkserver_preload(["studyapp.commands.run", "studyapp.run_session"])
        self._process = context.Process(target=_run_session, args=(arguments, str(words)))
        self._process.start()
        self.pid = int(self._process.pid or 0)

    def poll(self) -> int | None:
        """The exit code; None while it runs."""
        return self._process.exitcode

    @property
    def returncode(self) -> int | None:
        """As `poll`."""
        return self._process.exitcode

    def kill(self) -> None:
        """kill -9."""
        self._process.kill()

    def communicate(self, timeout: float = 600.0) -> tuple[None, str]:
        """Wait for it, and for every process of its own; (None, what they said)."""
        self._process.join(timeout)
        os.set_blocking(self._words, True)
        said = b""
        while chunk := os.read(self._words, 65536):
            said += chunk
        os.close(self._words)
        return None, said.decode()


def _run_session(arguments: list[str], words: str) -> None:
    os.dup2(os.open(words, os.O_WRONLY), 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.chdir(ROOT)
    sys.exit(main(arguments))


def start(arguments: list[str], folder: Path) -> tuple[Started, dict[str, int]]:
    """The session of the command line ``arguments``, and the processes that it has started by role, once it has
    begun."""
    pids_file = folder / "pids.json"
    pids_file.unlink(missing_ok=True)
    process = Started([*arguments[3:], "--pids", str(pids_file)], folder / "words")
    while process.poll() is None:
        try:
            return process, {**json.loads(pids_file.read_text()), "presenter": process.pid}
        except (FileNotFoundError, json.JSONDecodeError):
            time.sleep(0.002)
    raise RuntimeError(process.communicate()[1])


def one_session(folder: Path, number: int, victims: Iterator[str], rng: random.Random) -> list[Kill]:
    """Run one session to its end through kill after kill."""
    arguments, path = session_arguments(folder, folder), folder / SESSION
    kills: list[Kill] = []
    seen: set[tuple[int, int, str]] = set()
    while not path.exists() or not complete(path):
        process, pids = start([*arguments, "--resume"] if path.exists() else arguments, folder)
        victim, after_s = next(victims), rng.uniform(0.0, LONGEST_S)
        time.sleep(after_s)
        before = trial_rows(path)
        killed = False
        if process.poll() is None:
            # A session that has just ended has no process left to kill.
            with contextlib.suppress(ProcessLookupError):
                os.kill(pids[victim], signal.SIGKILL)
                killed = True
        said = process.communicate()[1].strip()
        problems = [f"more than a line: {said[-200:]}"] if len(said.splitlines()) > 1 else []
        try:
            after = trial_rows(path)
        except sqlite3.Error as error:
            return [*kills, Kill(number, victim, after_s, 0, len(before), False, [*problems, str(error)])]
        seen |= before
        if killed or problems:
            kills.append(Kill(number, victim, after_s, len(after), len(seen - after), True, problems))
    if kills:
        kills[-1].problems.extend([*verify(path), *cell_problems(trial_rows(path))])
    return kills


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


def prove(kills: int = 200, seed: int = 1) -> list[Kill]:
    """At least ``kills`` kills, victims in turn, in as many sessions as that takes; on record after each of them."""
    rng, victims = random.Random(seed), cycle(VICTIMS)
    found: list[Kill] = []
    for number in count():
        with tempfile.TemporaryDirectory() as folder:
            found += one_session(Path(folder), number, victims, rng)
        _record(found)
        print(number, len(found), sum(kill.lost for kill in found), [k for k in found if k.problems], flush=True)
        if len(found) >= kills:
            break
    return found


def _record(found: list[Kill]) -> dict[str, Any]:
    summary = {
        "kills": len(found),
        "sessions": len({kill.session for kill in found}),
        "committed_trials_lost": sum(kill.lost for kill in found),
        "unreadable_files": sum(not kill.readable for kill in found),
        "kills_with_problems": sum(bool(kill.problems) for kill in found),
        "killed_in_the_middle": sum(0 < kill.committed < TRIALS for kill in found),
    }
    write_evidence("kill_sessions", {**summary, "each": found})
    return summary


if __name__ == "__main__":
    given = [int(word) for word in sys.argv[1:]]
    result = _record(prove(*given))
    print(result)
    sys.exit(bool(result["committed_trials_lost"] or result["unreadable_files"] or result["kills_with_problems"]))
