"""Sessions on disks that fail: full or read-only beforehand, and full, read-only or gone in the middle.

The disk is an ext4 image on a loop device in a mount namespace of this module's own: filled by a file beside the
session, made read-only by the kernel as after an error on the medium (``errors=remount-ro`` and ``trigger_fs_error``),
or shut down with nothing of its journal written any more (what a pulled plug leaves). Each time: one clear line, every
trial that was committed still there, and once the disk is well again the session goes on to each cell exactly once.
Needs to be root on Linux; says so elsewhere.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import random
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from studyapp.session_file import verify
from tests.evidence import write_evidence
from tests.prove.kill_sessions import ROOT, SESSION, cell_problems, complete, session_arguments, start, trial_rows

DISK_MB = 64
EXT4_SHUTDOWN, NO_LOG_FLUSH = 0x8004587D, 2
INSIDE = "STUDYAPP_PROVE_MOUNTS"


@dataclass(frozen=True)
class Failure:
    """One disk that failed. ``said``: the session's last words; ``committed`` trials seen on it before; ``lost`` of
    them; ``problems``: of the words, the exit code or the completed file ([]: none)."""

    kind: str
    after_s: float
    exit_code: int
    said: str
    committed: int
    lost: int
    problems: list[str]


class Disk:
    """A small disk at ``at``."""

    def __init__(self, folder: Path) -> None:
        self.image, self.at = folder / "disk.img", folder / "disk"
        self.at.mkdir()
        with open(self.image, "wb") as file:
            file.truncate(DISK_MB << 20)
        _call("mkfs.ext4", "-q", "-m", "0", str(self.image))
        self.mount()

    def mount(self) -> None:
        """Attach it, its journal replayed, for reading and writing."""
        _call("mount", "-o", "loop,errors=remount-ro", str(self.image), str(self.at))

    def unmount(self) -> None:
        """Detach it."""
        _call("umount", str(self.at))

    def heal(self) -> None:
        """Detach, check and attach again."""
        self.unmount()
        # e2fsck gives 1 or 2 where it mended something.
        subprocess.run(["e2fsck", "-p", str(self.image)], check=False, capture_output=True)
        self.mount()
        (self.at / "filler").unlink(missing_ok=True)

    def fill(self, leave: int) -> None:
        """Have a file take all but ``leave`` bytes."""
        free = os.statvfs(self.at)
        with open(self.at / "filler", "wb") as file:
            os.posix_fallocate(file.fileno(), 0, max(1, free.f_bavail * free.f_frsize - leave))

    def lock(self) -> None:
        """Read-only by order (nobody writes to it)."""
        _call("mount", "-o", "remount,ro", str(self.at))

    def break_read_only(self) -> None:
        """Read-only by an error, whoever writes to it."""
        device = subprocess.run(
            ["findmnt", "-no", "SOURCE", str(self.at)], check=True, capture_output=True, text=True
        ).stdout.strip()
        Path(f"/sys/fs/ext4/{Path(device).name}/trigger_fs_error").write_text("a test")

    def pull_the_plug(self) -> None:
        """Nothing more is written, not even what the journal holds in memory."""
        handle = os.open(self.at, os.O_RDONLY)
        try:
            fcntl.ioctl(handle, EXT4_SHUTDOWN, struct.pack("I", NO_LOG_FLUSH))
        finally:
            os.close(handle)


def _call(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True)


@contextlib.contextmanager
def small_disk() -> Iterator[tuple[Path, Disk]]:
    """A folder, and a disk in it."""
    with tempfile.TemporaryDirectory() as name:
        disk = Disk(Path(name))
        try:
            yield Path(name), disk
        finally:
            disk.unmount()


def in_the_middle(kind: str, fail: Callable[[Disk], None], after_s: float) -> Failure:
    """A session whose disk fails ``after_s`` after it has begun, and that goes on once the disk is well."""
    with small_disk() as (folder, disk):
        arguments = session_arguments(folder, disk.at)
        process, _ = start(arguments, folder)
        time.sleep(after_s)
        before = trial_rows(disk.at / SESSION)
        fail(disk)
        said = process.communicate(timeout=120)[1].strip()
        problems = _unclear(process.returncode, 1, said)
        disk.heal()
        lost = len(before - trial_rows(disk.at / SESSION))
        again = subprocess.run([*arguments, "--resume"], cwd=ROOT, capture_output=True, text=True, check=False)
        if again.returncode:
            problems.append(f"resume: {again.stderr.strip()[-200:]}")
        final = trial_rows(disk.at / SESSION)
        problems += [*verify(disk.at / SESSION), *cell_problems(final)]
        return Failure(kind, after_s, process.returncode, said, len(before), lost + len(before - final), problems)


def beforehand(kind: str, fail: Callable[[Disk], None]) -> Failure:
    """A disk that cannot take a session: refused before anything is shown, and nothing is written."""
    with small_disk() as (folder, disk):
        fail(disk)
        found = sorted(disk.at.iterdir())
        done = subprocess.run(session_arguments(folder, disk.at), cwd=ROOT, capture_output=True, text=True, check=False)
        problems = _unclear(done.returncode, 2, done.stderr.strip())
        if sorted(disk.at.iterdir()) != found:
            problems.append("something was written")
        return Failure(kind, 0.0, done.returncode, done.stderr.strip(), 0, 0, problems)


def before_going_on() -> Failure:
    """An interrupted session on a disk that is read-only now: refused, not a byte changed; then it goes on."""
    with small_disk() as (folder, disk):
        arguments = session_arguments(folder, disk.at)
        process, pids = start(arguments, folder)
        time.sleep(0.2)
        process.kill()
        process.communicate()
        # The writer closes the file by itself.
        while Path(f"/proc/{pids['writer']}").exists():
            time.sleep(0.05)
        before = trial_rows(disk.at / SESSION)
        digest = hashlib.sha256((disk.at / SESSION).read_bytes()).hexdigest()
        disk.lock()
        refused = subprocess.run([*arguments, "--resume"], cwd=ROOT, capture_output=True, text=True, check=False)
        problems = _unclear(refused.returncode, 2, refused.stderr.strip())
        if hashlib.sha256((disk.at / SESSION).read_bytes()).hexdigest() != digest:
            problems.append("the file has changed")
        disk.heal()
        again = subprocess.run([*arguments, "--resume"], cwd=ROOT, capture_output=True, text=True, check=False)
        final = trial_rows(disk.at / SESSION)
        if again.returncode or not complete(disk.at / SESSION):
            problems.append(f"resume: {again.stderr.strip()[-200:]}")
        problems += [*verify(disk.at / SESSION), *cell_problems(final)]
        return Failure("read-only, resume", 0.2, refused.returncode, refused.stderr.strip(), len(before),
                       len(before - final), problems)  # fmt: skip


def _unclear(exit_code: int, wanted: int, said: str) -> list[str]:
    problems = [] if exit_code == wanted else [f"exit code {exit_code}, wanted {wanted}"]
    if len(said.splitlines()) != 1 or "Traceback" in said:
        problems.append(f"not one line: {said[-300:]}")
    return problems


def prove(rounds: int = 5, seed: int = 1) -> list[Failure]:
    """Every kind of failure; those in the middle of a session ``rounds`` times at random moments."""
    rng = random.Random(seed)
    found = [
        beforehand("full beforehand", lambda disk: disk.fill(1_000_000)),
        beforehand("read-only beforehand", Disk.lock),
        before_going_on(),
    ]
    middle: dict[str, Callable[[Disk], None]] = {
        "full in the middle": lambda disk: disk.fill(rng.randrange(0, 300_000)),
        "read-only in the middle": Disk.break_read_only,
        "plug pulled": Disk.pull_the_plug,
    }
    for kind, fail in middle.items():
        for _ in range(rounds):
            found.append(in_the_middle(kind, fail, rng.uniform(0.0, 0.5)))
            print(found[-1], flush=True)
    return found


if __name__ == "__main__":
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        print("bad_disks: not run: needs root on Linux (loop devices, mounts)")
        sys.exit(0)
    if INSIDE not in os.environ:
        # Mounts of a namespace of its own vanish with it.
        inside = ["unshare", "-m", sys.executable, "-m", "tests.prove.bad_disks", *sys.argv[1:]]
        sys.exit(subprocess.run(inside, env={**os.environ, INSIDE: "1"}, check=False).returncode)
    results = prove(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
    write_evidence("bad_disks", results)
    bad = [one for one in results if one.problems or one.lost]
    print(*(one for one in results[:3]), f"{len(results)} disks failed, {len(bad)} with problems", *bad, sep="\n")
    sys.exit(bool(bad))
