"""A session: the planned trials in order, each durable before the next begins, failed ones shown again.

What a session is made of (display, devices, log, clips) is put together by the commands; this module runs it.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby

from protocols.adaptive import Procedure
from protocols.trial import Trial
from studyapp import clock
from studyapp.seams import FrameSource
from studyapp.session_log import LogStatistics, SessionLog
from studyapp.trial import TrialDone, TrialRunner

MAX_ATTEMPTS = 3
"""A trial whose timing failed is shown again at its block's end, at most so often in all; the last stays flagged."""

Sources = Callable[[Trial], Mapping[str, FrameSource]]


class SessionStopped(RuntimeError):
    """The session ended before its plan did; everything answered so far is on disk."""


@dataclass(frozen=True)
class Progress:
    """Where a session stands: planned indices that are done, those that wait at their block's end because their timing
    failed, presentations of each, the next presentation's number."""

    done: Collection[int] = ()
    requeued: Collection[int] = ()
    attempts: Mapping[int, int] = field(default_factory=dict)
    next_number: int = 0


@dataclass
class Session:
    """One run of a plan. ``reconnect`` waits for lost devices and says what is still missing ([]: go on);
    ``requeue``: trials whose timing failed are shown again at the block's end; ``before_commit``: may add events that
    are to be durable together with the trial; ``on_trial``: told of each durable trial."""

    log: SessionLog
    runner: TrialRunner
    sources: Sources
    reconnect: Callable[[], list[str]] = field(default=lambda: [])
    requeue: bool = True
    on_trial: Callable[[TrialDone], None] | None = None
    before_commit: Callable[[Trial, int], None] | None = None

    def run(self, plan: Sequence[Trial], progress: Progress | None = None) -> int:
        """Run what is left of ``plan``; returns the number of presentations. Raises SessionStopped and LogFailed."""
        progress = progress or Progress()
        number, attempts = progress.next_number, dict(progress.attempts)
        for _, block in groupby(plan, key=lambda trial: trial.block):
            left = [trial for trial in block if trial.index not in progress.done]
            queue = deque(sorted(left, key=lambda trial: trial.index in progress.requeued))
            while queue:
                trial = queue.popleft()
                attempt = attempts.get(trial.index, 0)
                attempts[trial.index] = attempt + 1
                done = self._one(trial, number, attempt)
                number += 1
                self._after(trial, done, queue, attempt)
        return number - progress.next_number

    def run_procedure(
        self,
        procedure: Procedure,
        prepare: Callable[[Trial], Trial],
        progress: Progress | None = None,
        answers: Mapping[int, str | None] | None = None,
    ) -> int:
        """Run a procedure that learns from the answers; returns the number of presentations.

        ``answers``: planned index -> condition chosen, of trials that an interrupted session had done: the procedure is
        sent them again, and so stands where it stood. ``prepare`` gives a trial's clips and keeps it in the stored
        plan. A trial whose timing failed is shown again at once: what comes next hangs on its answer.
        """
        progress, known = progress or Progress(), answers or {}
        number, attempts = progress.next_number, dict(progress.attempts)
        try:
            trial = next(procedure)
            while True:
                chosen = known.get(trial.index)
                if trial.index not in progress.done:
                    trial = prepare(trial)
                    queue = deque([trial])
                    while queue:
                        trial = queue.popleft()
                        attempt = attempts.get(trial.index, 0)
                        attempts[trial.index] = attempt + 1
                        done = self._one(trial, number, attempt)
                        number += 1
                        self._after(trial, done, queue, attempt)
                    chosen = next((row.chosen for row in done.responses if row.kind == "choice"), None)
                trial = procedure.send(chosen)
        except StopIteration:
            return number - progress.next_number

    def _one(self, trial: Trial, number: int, attempt: int) -> TrialDone:
        self.log.begin_trial(number)
        sources = self.sources(trial) if trial.panels else {}
        done = self.runner.run(trial, sources, number, attempt)
        if self.before_commit is not None:
            self.before_commit(trial, number)
        # Nothing goes on before the writer has it on the disk.
        self.log.commit_trial(done.row, done.responses)
        if self.on_trial is not None:
            self.on_trial(done)
        return done

    def _after(self, trial: Trial, done: TrialDone, queue: deque[Trial], attempt: int) -> None:
        """Put a failed trial back, or stop."""
        if done.status == "aborted":
            raise SessionStopped(f"trial {trial.index}: stopped by a key; go on with --resume")
        if done.status == "device_lost":
            self.log.event("session", "device_lost", json.dumps({"trial": done.row.trial}))
            missing = self.reconnect()
            if missing:
                self.log.note("stopped: " + "; ".join(missing))
                raise SessionStopped(f"trial {trial.index}: device lost: {'; '.join(missing)}; go on with --resume")
            self.log.event("session", "device_back", json.dumps({"trial": done.row.trial}))
            queue.appendleft(trial)
        elif done.status == "timing_failed" and self.requeue:
            if attempt + 1 < MAX_ATTEMPTS:
                queue.append(trial)
            else:
                self.log.note(f"trial {trial.index}: timing failed {MAX_ATTEMPTS} times; the last stays, flagged")


def finish(log: SessionLog) -> LogStatistics:
    """Close a session whose plan is done."""
    return log.finish({"completed_utc": clock.wall_clock_utc()})
