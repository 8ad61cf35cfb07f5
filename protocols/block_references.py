"""What a block names: questions, conditions, factors and their levels, columns of its order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from protocols.blocks import PAIR_KINDS, SIDE_BY_SIDE_KINDS, WORD_KINDS, Block, ExplicitTrial
from protocols.condition_references import parameter_problems
from protocols.names import OWN_COLUMNS, Declared, Loc, Problem, unknown
from protocols.study import Study, varied_name
from renderers.catalogue import CATALOGUE


def block_problems(study: Study, names: Declared, index: int, block: Block) -> Iterator[Problem]:
    """All that is wrong with the names in the block at ``index``."""
    loc: Loc = ("blocks", index)
    what = f"blocks[{index}]"
    for place, question in enumerate(block.questions):
        if question not in names.questions:
            yield unknown((*loc, "questions", place), f"{what}.questions[{place}]", question, names.questions)
        elif question in study.questions:
            kind = study.questions[question].kind
            if kind == "choice" and block.kind not in PAIR_KINDS:
                yield (*loc, "questions", place), f"{what}.questions[{place}]", "a choice", "a question without slots"
    if block.reference is not None:
        yield from names.condition(block.reference, (*loc, "reference"), f"{what}.reference")
    for name, levels in block.factors.items():
        yield from _factor(names, name, levels, (*loc, "factors", name), f"{what}.factors.{name}")
    yield from names.settings(block.set.model_dump(exclude_none=True), (*loc, "set"), f"{what}.set")
    yield from _compare(study, names, block, loc, what)
    yield from _one_gaze(study, block, loc, what)
    yield from _adaptive(study, names, block, loc, what)
    columns = {*block.factors, *OWN_COLUMNS, "cell"}
    for key in ("max_in_a_row", "min_distance"):
        for word in getattr(block.order, key):
            if word not in columns:
                yield unknown((*loc, "order", key, word), f"{what}.order.{key}", word, sorted(columns))
    for key, word in (("blocked_by", block.order.blocked_by), ("latin", block.order.latin)):
        if word is not None and word not in block.factors:
            yield unknown((*loc, "order", key), f"{what}.order.{key}", word, list(block.factors))
    for factor, level in block.only.items():
        between = study.participants.between
        if factor not in names.between:
            yield unknown((*loc, "only", factor), f"{what}.only", factor, names.between)
        elif factor in between and level not in between[factor]:
            yield unknown((*loc, "only", factor), f"{what}.only.{factor}", level, list(between[factor]))
    for key in ("trials", "practice"):
        trials = getattr(block, key)
        if isinstance(trials, list):
            for place, trial in enumerate(trials):
                yield from _explicit(names, block, trial, (*loc, key, place), f"{what}.{key}[{place}]")
    if block.catch is not None:
        yield from _catch(study, names, block, loc, what)
    if block.kind not in WORD_KINDS and "scene" not in block.factors and len(study.scenes) > 1 and not block.trials:
        wanted = "factors: {scene: [...]} (with one scene alone it may be left out)"
        yield loc, what, f"no scene and {len(study.scenes)} scenes to choose from", wanted
    if block.kind == "likert" and not block.trials and not _sets_condition(study, block):
        yield loc, what, "no condition", "factors: {condition: [...]} or levels with condition:"


def _sets_condition(study: Study, block: Block) -> bool:
    tables = [*block.factors.values(), *study.participants.between.values()]
    return (
        "condition" in block.factors
        or block.set.condition is not None
        or study.defaults.condition is not None
        or any(level.condition is not None for table in tables for level in table.values())
    )


def _factor(names: Declared, name: str, levels: Mapping[str, Any], loc: Loc, what: str) -> Iterator[Problem]:
    choices = {"scene": names.scenes, "path": names.paths, "fixation": ["free", "fixed", "moving"]}.get(name)
    for place, (level, settings) in enumerate(levels.items()):
        at = (*loc, place) if not settings.model_fields_set else (*loc, level)
        if choices is not None and level not in choices:
            yield unknown(at, f"{what}", level, choices)
        if name == "condition" and settings.condition is None:
            yield from names.condition(level, at, what)
        yield from names.settings(settings.model_dump(exclude_none=True), (*loc, level), f"{what}.{level}")


def _compare(study: Study, names: Declared, block: Block, loc: Loc, what: str) -> Iterator[Problem]:
    compare = block.compare
    if compare is None:
        return
    for place, word in enumerate(compare.of):
        yield from names.condition(word, (*loc, "compare", "of", place), f"{what}.compare.of[{place}]")
    of = study.expand(compare.of)
    if len(of) < compare.alternatives and not (names.has_techniques and not CATALOGUE):
        wanted = f"at least {compare.alternatives} conditions"
        yield (*loc, "compare", "of"), f"{what}.compare.of", f"{len(of)} conditions", wanted
    if compare.against is not None and compare.against not in of:
        yield unknown((*loc, "compare", "against"), f"{what}.compare.against", compare.against, of)
    for place, members in enumerate(compare.sets if isinstance(compare.sets, list) else ()):
        at = (*loc, "compare", "sets", place)
        if len(set(members)) != compare.alternatives or len(members) != compare.alternatives:
            yield at, f"{what}.compare.sets[{place}]", f"{members}", f"{compare.alternatives} different conditions"
        for word in members:
            if word not in of:
                yield unknown(at, f"{what}.compare.sets[{place}]", word, of)
    for word in compare.spread_over:
        if word not in block.factors:
            yield unknown((*loc, "compare", "spread_over"), f"{what}.compare.spread_over", word, list(block.factors))


def _one_gaze(study: Study, block: Block, loc: Loc, what: str) -> Iterator[Problem]:
    """Panels side by side that follow the gaze: an eye is at one of them, and each was made for an eye at its own."""
    if block.kind not in SIDE_BY_SIDE_KINDS:
        return
    compare, catch, varied = block.compare, block.catch, block.adaptive
    named: list[tuple[Loc, str | None]] = [
        (("compare", "of"), name) for name in study.expand(compare.of if compare else [])
    ]
    named.append((("reference",), block.reference))
    named += [(("catch", key), getattr(catch, key)) for key in ("good", "bad") if catch is not None]
    named += [(("adaptive", key), getattr(varied, key)) for key in ("test", "standard") if varied is not None]
    for key in ("trials", "practice"):
        trials = getattr(block, key)
        for place, trial in enumerate(trials if isinstance(trials, list) else ()):
            named += [((key, place, "compare"), name) for name in trial.compare or ()]
    known = study.all_conditions()
    for at, name in named:
        technique = known[name].technique if name is not None and name in known else ""
        if technique in CATALOGUE and CATALOGUE[technique].gaze_contingent:
            said = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in at)
            wanted = f"no gaze-contingent technique side by side ({technique} follows one gaze): two_interval or likert"
            yield (*loc, *at), f"{what}{said}", str(name), wanted


def _adaptive(study: Study, names: Declared, block: Block, loc: Loc, what: str) -> Iterator[Problem]:
    varied = block.adaptive
    if varied is None or varied.kind == "active_pairs":
        return
    at: Loc = (*loc, "adaptive")
    for key, word in (("test", varied.test), ("standard", varied.standard)):
        yield from names.condition(str(word), (*at, key), f"{what}.adaptive.{key}")
    for value in varied.values:
        made = study.all_conditions().get(varied_name(str(varied.test), value))
        if made is not None and made.technique in CATALOGUE:
            place = f"{what}.adaptive ({varied.parameter} = {value:g})"
            yield from parameter_problems(made.technique, made.params, (*at, "values"), place)


def _explicit(names: Declared, block: Block, trial: ExplicitTrial, loc: Loc, what: str) -> Iterator[Problem]:
    for factor, level in trial.levels.items():
        if factor in block.factors:
            if level not in block.factors[factor]:
                yield unknown((*loc, "levels", factor), f"{what}.levels.{factor}", level, list(block.factors[factor]))
        elif factor == "scene" and level not in names.scenes:
            yield unknown((*loc, "levels", factor), f"{what}.levels.{factor}", level, names.scenes)
        elif factor == "condition":
            yield from names.condition(level, (*loc, "levels", factor), f"{what}.levels.{factor}")
        elif factor not in OWN_COLUMNS:
            yield unknown((*loc, "levels", factor), f"{what}.levels", factor, [*block.factors, "scene", "condition"])
    if "scene" not in trial.levels and len(names.scenes) > 1:
        yield loc, what, "no scene", f"levels: {{scene: {' | '.join(names.scenes)}}}"
    if block.kind in PAIR_KINDS and trial.compare is None:
        yield loc, what, "no compare", "compare: [CONDITION, CONDITION]"
    for place, word in enumerate(trial.compare or ()):
        yield from names.condition(word, (*loc, "compare", place), f"{what}.compare[{place}]")
    yield from names.settings(trial.set.model_dump(exclude_none=True), (*loc, "set"), f"{what}.set")


def _catch(study: Study, names: Declared, block: Block, loc: Loc, what: str) -> Iterator[Problem]:
    catch = block.catch
    if catch is None:
        return
    for key, word in (("good", catch.good), ("bad", catch.bad)):
        if word is not None:
            yield from names.condition(word, (*loc, "catch", key), f"{what}.catch.{key}")
    if block.kind in PAIR_KINDS and (catch.good is None or catch.bad is None):
        yield (*loc, "catch"), f"{what}.catch", "not both of good and bad", "good: CONDITION and bad: CONDITION"
    if block.kind == "likert" and (catch.expect is None or (catch.good is None) == (catch.bad is None)):
        yield (
            (*loc, "catch"),
            f"{what}.catch",
            "no expect, or not one of good and bad",
            "bad: CONDITION, expect: [LOW, HIGH]",
        )
    if catch.question is not None and catch.question not in block.questions:
        yield unknown((*loc, "catch", "question"), f"{what}.catch.question", catch.question, block.questions)
