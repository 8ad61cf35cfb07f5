"""Who sits in a slot of the design: the person's code, which analysis takes for the participant.

A slot (participant number) fixes order, sides, keys and group; the code is the person's. By default it is the slot's
number. A person who is excluded may be replaced: somebody else runs the same slot under a code of their own, so that
two people are never taken for one.
"""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from stimuli.errors import InputError, problem
from studyapp.resume import session_paths

_CODE = re.compile(r"[A-Za-z0-9]{1,20}")
_KEYS = ("participant", "slot", "observer_kind", "completed_utc", "plan")


@dataclass(frozen=True)
class _Sitting:
    """A session that has begun: who sat in which slot, and whether it is complete."""

    path: Path
    participant: str
    slot: int
    complete: bool


def _sittings(paths: Iterable[Path], observer_kind: str) -> Iterator[_Sitting]:
    for path in paths:
        db = sqlite3.connect(path)
        try:
            marks = ",".join("?" * len(_KEYS))
            found = dict(db.execute(f"SELECT key, value FROM header WHERE key IN ({marks})", _KEYS))
        except sqlite3.DatabaseError:
            continue  # not one of ours, or nothing in it yet
        finally:
            db.close()
        if "plan" in found and json.loads(found["observer_kind"]) == observer_kind:
            participant = str(json.loads(found["participant"]))
            # older headers know only the participant, whose code was the slot's number
            slot = int(json.loads(found.get("slot", found["participant"])))
            yield _Sitting(path, participant, slot, json.loads(found.get("completed_utc", "null")) is not None)


def person_code(folder: Path, study: str, slot: int, given: str, simulated: bool) -> tuple[str, int]:
    """(code, run) of a new session in ``slot``; ``run`` counts the person's own sessions, from 1.

    ``given``: what ``--code`` says, '' for the slot's own number. Raises InputError for a code that is none, is that of
    another slot or of somebody who withdrew, and where a person completed the slot already and nothing is given: the
    same person again, or another? (A simulated observer is the same again.)
    """
    if given and not _CODE.fullmatch(given):
        raise InputError(problem("--code", "code", repr(given), "1 to 20 letters and digits"))
    if given.isdigit() and given != str(slot):
        raise InputError(
            problem("--code", "code", given, f"a code with a letter in it, or the slot's own number {slot}")
        )
    code = given or str(slot)
    tombstone = folder / f"withdrawn_{code}.json"
    if tombstone.is_file():
        when = json.loads(tombstone.read_text())["withdrawn_utc"]
        wanted = f"--code with another code for whoever takes slot {slot} now"
        raise InputError(problem(f"slot {slot}", f"participant {code}", f"withdrawn on {when}", wanted))
    # The slot's number is nobody's code in another slot, so that only a code that is given is looked for in all.
    paths = sorted(folder.glob(f"{study}_p*_*.sqlite")) if given else session_paths(folder, study, slot)
    run = 1
    for one in _sittings(paths, "simulated" if simulated else "person"):
        if one.participant == code and one.slot != slot:
            got = f"the participant of slot {one.slot} ({one.path.name})"
            raise InputError(problem("--code", f"code {code}", got, "a code of its own"))
        if one.complete and not given and not simulated:
            got = f"complete, by participant {one.participant} ({one.path.name})"
            wanted = f"--code {one.participant} for the same person again, or another code for who replaces them"
            raise InputError(problem("participant", f"slot {slot}", got, wanted))
        run += one.participant == code
    return code, run
