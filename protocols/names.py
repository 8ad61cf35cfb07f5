"""The names that a protocol declares, and the problem of a name that leads nowhere."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from protocols.study import Study
from stimuli.clip_request import PATH_NAMES

Loc = tuple[str | int, ...]
Problem = tuple[Loc, str, str, str]
FIXED_PATHS = frozenset(PATH_NAMES)
OWN_COLUMNS = frozenset({"scene", "condition", "technique", "path", "fixation", "side", "pair", "repetition", "block"})


def unknown(loc: Loc, what: str, word: str, choices: Collection[str]) -> Problem:
    """The problem that ``word`` is none of ``choices``, with the nearest of them."""
    near = difflib.get_close_matches(word[:64], list(choices), n=1, cutoff=0.55)
    listed = " | ".join(list(choices)[:30]) or "(there are none)"
    return loc, what, repr(word), (f"{near[0]!r} (did you mean that?), " if near else "") + f"one of {listed}"


class Declared:
    """The names that a protocol declares. ``written``: the file as plain values, whose faulty parts may be missing from
    ``study``; a name that is written there counts as declared."""

    def __init__(self, study: Study, written: Mapping[str, Any]) -> None:
        def keys(name: str) -> list[str]:
            value = written.get(name)
            return [str(key) for key in value] if isinstance(value, dict) else []

        self.conditions = list(dict.fromkeys([*study.all_conditions(), *keys("conditions")]))
        self.scenes = list(dict.fromkeys([*study.scenes, *keys("scenes")]))
        self.questions = list(dict.fromkeys([*study.questions, *keys("questions")]))
        self.paths = [*sorted(FIXED_PATHS), *dict.fromkeys([*study.paths, *keys("paths")])]
        blocks = written.get("blocks") if isinstance(written.get("blocks"), list) else []
        raw = [block for block in blocks or [] if isinstance(block, dict)]
        self.blocks = [str(block.get("name")) for block in raw]
        factors = [block["factors"] for block in raw if isinstance(block.get("factors"), dict)]
        people = written.get("participants")
        between = people.get("between") if isinstance(people, dict) else None
        self.between = list(between) if isinstance(between, dict) else []
        self.factors = list(dict.fromkeys([str(n) for table in factors for n in table] + self.between))
        self.has_techniques = "techniques" in written

    def settings(self, values: Mapping[str, Any], loc: Loc, what: str) -> Iterator[Problem]:
        """Names inside a settings table."""
        if "path" in values and values["path"] not in self.paths:
            yield unknown((*loc, "path"), f"{what}.path", values["path"], self.paths)
        if "condition" in values and values["condition"] not in self.conditions:
            yield unknown((*loc, "condition"), f"{what}.condition", values["condition"], self.conditions)

    def condition(self, word: str, loc: Loc, what: str) -> Iterator[Problem]:
        """A condition's name, or ``techniques``."""
        if word not in self.conditions and not (word == "techniques" and self.has_techniques):
            yield unknown(loc, what, word, [*self.conditions, *(["techniques"] if self.has_techniques else [])])
