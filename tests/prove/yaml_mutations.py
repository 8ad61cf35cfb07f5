"""Mutated protocols: ``studyapp check`` answers 0 or 2, in one line a problem, within 2 s and 500 MB.

``python -m tests.prove.yaml_mutations`` tries 2,000 and writes evidence/yaml_mutations.json; the test suite a fraction.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from protocols.load import LIBRARY
from studyapp.cli import main
from tests.evidence import write_evidence

LIMIT_S = 2.0
LIMIT_MB = 500
KEY = re.compile(r"^(\s*(?:- )?\{?)([a-z_]+)(: ?)(.*)$")
VALUES = (
    "-1",
    "0",
    "1e9",
    "999999999999999999999",
    ".nan",
    "null",
    "[]",
    "{}",
    "true",
    "'text'",
    "[[1], 2]",
    "1/0",
    "é",
)


@dataclass(frozen=True)
class Outcome:
    """What one mutated file did. ``seconds``: of the processor, so that a busy machine does not count; ``wall_s``: as
    somebody who waits would count."""

    kind: str
    code: int
    seconds: float
    wall_s: float
    said: str
    line: int | None  # of the planted mistake, where it must be named there


def mutate(text: str, kind: str, rng: np.random.Generator) -> tuple[str, int | None]:
    """``text`` with one mistake of ``kind``; and its line (from 1) where any reader would look for it there."""
    lines = text.splitlines()
    keyed = [i for i, line in enumerate(lines) if KEY.match(line) and not line.lstrip().startswith("#")]
    at = int(rng.choice(keyed))
    match = KEY.match(lines[at])
    assert match is not None
    head, key, colon, value = match.groups()
    if kind == "deleted":
        del lines[at]
        return "\n".join(lines), None
    if kind == "renamed":
        lines[at] = f"{head}{key}x{colon}{value}"
        return "\n".join(lines), None
    if kind == "retyped":
        lines[at] = f"{head}{key}{colon}{VALUES[int(rng.integers(len(VALUES)))]}"
        return "\n".join(lines), None
    if kind == "reindented":
        lines[at] = " " * int(rng.integers(1, 7)) + lines[at]
        return "\n".join(lines), None
    if kind == "tab":
        lines[at] = "\t" + lines[at]
        return "\n".join(lines), at + 1
    if kind == "unknown_key":
        place = next(i for i, line in enumerate(lines) if line.startswith("seed:"))
        lines.insert(place, "refresh_rate: 240")
        return "\n".join(lines), place + 1
    if kind == "duplicate_key":
        lines.append("seed: 1")
        return "\n".join(lines), len(lines)
    if kind == "bad_reference":
        places = [i for i, line in enumerate(lines) if "questions: [" in line]
        place = int(rng.choice(places))
        lines[place] = lines[place].replace("questions: [", "questions: [nosuchquestion, ")
        return "\n".join(lines), place + 1
    if kind == "cyclic":
        lines.append("about: &loop [*loop]")
        return "\n".join(lines), len(lines)
    if kind == "laughs":
        lines.append("about: {a: &a [" + ",".join("x" * 10) + "],")
        lines += [f" {b}: &{b} [{','.join([f'*{a}'] * 10)}]," for a, b in zip("abcdefgh", "bcdefghi", strict=True)]
        lines.append("}")
        return "\n".join(lines), None
    if kind == "huge":
        return text + "\n# " + "x" * int(rng.integers(10**5, 2 * 10**7)), None
    if kind == "many":
        return text + "\nabout: [" + "1," * int(rng.integers(10**3, 6 * 10**4)) + "]\n", None
    if kind == "deep":
        return text + "\nabout: " + "[" * int(rng.integers(20, 5000)), None
    if kind == "number":
        numbers = list(re.finditer(r"(?<=[ \[])\d+(\.\d+)?(?=[,}\]\s])", text))
        chosen = numbers[int(rng.integers(len(numbers)))]
        new = str(rng.choice(["0", "1", "1000", "999", "16384", "1000000", "-5", "0.000001"]))
        return text[: chosen.start()] + new + text[chosen.end() :], None
    # bytes: a few characters replaced anywhere
    raw = list(text)
    for place in rng.integers(0, len(raw), int(rng.integers(1, 6))):
        raw[place] = chr(int(rng.choice([0, 9, 10, 32, 34, 38, 39, 42, 45, 58, 91, 93, 123, 125, 233, 8364])))
    return "".join(raw), None


KINDS = (
    "deleted", "renamed", "retyped", "reindented", "tab", "unknown_key", "duplicate_key", "bad_reference", "cyclic",
    "laughs", "huge", "many", "deep", "number", "bytes",
)  # fmt: skip


def run(count: int, seed: int = 0) -> list[Outcome]:
    """``count`` mutated library files through the command line, in this process."""
    sources = {file.stem: file.read_text(encoding="utf-8") for file in sorted(LIBRARY.glob("*.yaml"))}
    names = list(sources)
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        for index in range(count):
            rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, index])))
            kind = KINDS[index % len(KINDS)]
            text, line = mutate(sources[names[int(rng.integers(len(names)))]], kind, rng)
            file = Path(folder) / f"m{index}.yaml"
            file.write_text(text, encoding="utf-8")
            out, err = io.StringIO(), io.StringIO()
            start, began = time.process_time(), time.perf_counter()
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = main(["check", str(file)])
            took, waited = time.process_time() - start, time.perf_counter() - began
            outcomes.append(Outcome(kind, code, took, waited, err.getvalue(), line))
            file.unlink()
    return outcomes


def faults(outcomes: list[Outcome], limit_s: float = LIMIT_S) -> list[str]:
    """What broke the promise: one line each."""
    found = []
    for index, o in enumerate(outcomes):
        if o.code not in (0, 2):
            found.append(f"{index} {o.kind}: exit {o.code}")
        if o.code == 2 and (not o.said.strip() or "Traceback" in o.said):
            found.append(f"{index} {o.kind}: said {o.said[:200]!r}")
        if o.code == 2 and not all(", wanted " in said for said in o.said.strip().splitlines()):
            found.append(f"{index} {o.kind}: not in the form got, wanted: {o.said[:300]!r}")
        if o.seconds > limit_s:
            found.append(f"{index} {o.kind}: {o.seconds:.2f} s")
        if o.line is not None and f":{o.line}:" not in o.said:
            found.append(f"{index} {o.kind}: line {o.line} is not named in {o.said[:200]!r}")
    return found


def fresh(count: int, seed: int = 2) -> list[tuple[float, float, float]]:
    """(wall s, processor s, peak MB) of the command in ``count`` processes of its own, as the user starts it."""
    sources = [file.read_text(encoding="utf-8") for file in sorted(LIBRARY.glob("*.yaml"))]
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for index in range(count):
            rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, index])))
            file = Path(folder) / f"m{index}.yaml"
            file.write_text(mutate(sources[index % len(sources)], KINDS[index % len(KINDS)], rng)[0], encoding="utf-8")
            began = time.perf_counter()
            child = subprocess.Popen(
                [sys.executable, "-m", "studyapp", "check", str(file)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            _, status, used = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            assert child.returncode in (0, 2), (index, child.returncode)
            found.append((time.perf_counter() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024))
    return found


def prove(count: int = 2000) -> dict[str, object]:
    """The full-length evidence."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    outcomes = run(count)
    alone = np.array(fresh(max(1, count // 20)))
    codes = Counter((o.kind, o.code) for o in outcomes)
    return {
        "files": count,
        "exit_codes": {f"{kind} {code}": n for (kind, code), n in sorted(codes.items())},
        "slowest_processor_s": max(o.seconds for o in outcomes),
        "slowest_wall_s": max(o.wall_s for o in outcomes),
        "in_processes_of_their_own": {
            "files": len(alone),
            "slowest_wall_s": alone[:, 0].max(),
            "slowest_processor_s": alone[:, 1].max(),
            "peak_mb": alone[:, 2].max(),
        },
        "load_average": os.getloadavg(),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "peak_before_mb": before,
        "faults": faults(outcomes)
        + [f"a process of its own: {p:.2f} s, {mb:.0f} MB" for _, p, mb in alone if p > LIMIT_S or mb > LIMIT_MB],
    }


if __name__ == "__main__":
    evidence = prove(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
    write_evidence("yaml_mutations", evidence)
    print(json.dumps(evidence, indent=1))
    sys.exit(1 if evidence["faults"] else 0)
