"""Whether the slots of the design are filled: who counts, who is to be replaced, and what has two people in it."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.exclusions import Exclusions
from analysis.rows import rows_of_table
from analysis.sessions import Session


def recruitment_words(sessions: Sequence[Session], exclusions: Exclusions) -> list[str]:
    """Sentences about slots: how many of the protocol's are filled by somebody who is analysed, which to run again, and
    those with two people of whom nobody is excluded. Nothing where the session files do not tell."""
    told = [session.header["recruitment"] for session in sessions if session.header.get("recruitment")]
    if not told:
        return []
    target, replaces = int(told[-1]["target"]), bool(told[-1]["replace_excluded"])
    left_out = {row.participant for row in rows_of_table(exclusions.participants) if row.excluded}
    people: dict[int, list[str]] = {}
    for session in sessions:
        own = people.setdefault(session.slot, [])
        if session.participant not in own:
            own.append(session.participant)
    kept = {slot: [who for who in own if who not in left_out] for slot, own in people.items()}
    filled = sum(1 for slot in range(1, target + 1) if kept.get(slot))
    said = [f"{filled} of the {target} slots of the protocol are filled by participants who are analysed."]
    empty = [slot for slot in sorted(people) if not kept[slot]]
    if empty and replaces:
        who = ", ".join(f"{slot} (of {', '.join(people[slot])})" for slot in empty)
        said.append(
            f"To be run again by somebody else, under a code of their own (run --participant N --code CODE): {who}."
        )
    elif empty:
        said.append("Who is excluded is not replaced (replace_excluded: false).")
    shared = [f"{slot} ({', '.join(own)})" for slot, own in sorted(kept.items()) if len(own) > 1]
    if shared:
        said.append(
            f"Several participants of a slot are analysed, so that orders are not balanced: {', '.join(shared)}."
        )
    return said
