"""Who is let in: the protocol's inclusion questions, answered on the command line, checked against their bounds."""

from __future__ import annotations

import json
from collections.abc import Mapping

from protocols.participants import Inclusion
from protocols.study import Study
from stimuli.errors import InputError, problem

INCLUSION_OVERRIDE = "inclusion"


def answers_about_self(
    study: Study, simulated: bool, about: Mapping[str, str], overrides: Mapping[str, str]
) -> dict[str, str]:
    """Answers to the inclusion questions, JSON; InputError where a person's are missing or miss the bound."""
    asked = study.participants.inclusion
    if simulated:
        return {inclusion.name: json.dumps("simulated: meets the bound") for inclusion in asked}
    problems, out = [], {}
    unknown = sorted(set(about) - {inclusion.name for inclusion in asked})
    for name in unknown:
        wanted = " | ".join(inclusion.name for inclusion in asked) or "none: the protocol asks nothing"
        problems.append(problem("--about", "question", name, wanted))
    for inclusion in asked:
        given = about.get(inclusion.name)
        if given is None:
            problems.append(problem("--about", inclusion.name, "no answer", f"an answer to: {inclusion.text}"))
            continue
        value, why = _meets(inclusion, given)
        out[inclusion.name] = json.dumps(value)
        if why is not None and not overrides.get(INCLUSION_OVERRIDE):
            problems.append(problem("--about", inclusion.name, given, f"{why} (or --override inclusion=REASON)"))
    if problems:
        raise InputError(*problems)
    return out


def _meets(inclusion: Inclusion, given: str) -> tuple[object, str | None]:
    """(value, None), or (value, what was wanted) where the bound is missed."""
    if inclusion.kind == "number":
        try:
            number = float(given)
        except ValueError:
            return given, "a number"
        low = -float("inf") if inclusion.at_least is None else inclusion.at_least
        high = float("inf") if inclusion.at_most is None else inclusion.at_most
        return number, None if low <= number <= high else f"a number from {low:g} to {high:g}"
    if inclusion.kind == "yes_no":
        if given not in ("yes", "no"):
            return given, "yes | no"
        fits = inclusion.equals is None or (given == "yes") == inclusion.equals
        return given, None if fits else ("yes" if inclusion.equals else "no")
    wanted = inclusion.one_of if inclusion.one_of is not None else inclusion.options
    return given, None if given in wanted else " | ".join(wanted)
