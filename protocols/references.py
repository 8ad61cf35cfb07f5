"""Names in a protocol that must lead somewhere: conditions, scenes, factors, questions, techniques and parameters."""

from __future__ import annotations

import difflib
import json
from collections.abc import Collection, Iterator, Mapping
from fractions import Fraction
from itertools import product
from math import comb, prod
from typing import Any

from pydantic import ValidationError

from protocols.blocks import PAIR_KINDS, WORD_KINDS, Block, ExplicitTrial
from protocols.cells import block_cells
from protocols.study import Study, varied_name
from renderers.catalogue import CATALOGUE

MAX_TRIALS = 3000
Loc = tuple[str | int, ...]
Problem = tuple[Loc, str, str, str]
FIXED_PATHS = frozenset({"file", "still", "sway", "toycar", "interactive"})
OWN_COLUMNS = frozenset({"scene", "condition", "technique", "path", "fixation", "side", "pair", "repetition", "block"})


def unknown(loc: Loc, what: str, word: str, choices: Collection[str]) -> Problem:
    """The problem that ``word`` is none of ``choices``, with the nearest of them."""
    near = difflib.get_close_matches(word[:64], list(choices), n=1, cutoff=0.55)
    listed = " | ".join(list(choices)[:30]) or "(there are none)"
    return loc, what, repr(word), (f"{near[0]!r} (did you mean that?), " if near else "") + f"one of {listed}"


def reference_problems(study: Study, written: Mapping[str, Any]) -> Iterator[Problem]:
    """All names that lead nowhere and values that do not fit each other. ``written``: the file as plain values, whose
    faulty parts may be missing from ``study``; a name that is written there counts as declared."""
    names = _Declared(study, written)
    yield from _conditions(study, names)
    for name, scene in study.scenes.items():
        yield from names.settings(scene.model_dump(exclude_none=True), ("scenes", name), f"scenes.{name}")
    yield from names.settings(study.defaults.model_dump(exclude_none=True), ("defaults",), "defaults")
    seen: set[str] = set()
    for index, block in enumerate(study.blocks):
        if block.name in seen:
            yield (
                ("blocks", index, "name"),
                f"blocks[{index}].name",
                f"{block.name!r} a second time",
                "a name of its own",
            )
        seen.add(block.name)
        yield from _block(study, names, index, block)
    for name, levels in study.participants.between.items():
        for level, settings in levels.items():
            where = ("participants", "between", name, level)
            yield from names.settings(settings.model_dump(exclude_none=True), where, ".".join(map(str, where)))
    yield from _analysis(study, names)
    yield from _observer(study, names)
    yield from _matches(study, names)


class _Declared:
    """The names that a protocol declares."""

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


def _conditions(study: Study, names: _Declared) -> Iterator[Problem]:
    if isinstance(study.techniques, list):
        for index, name in enumerate(study.techniques):
            if name not in CATALOGUE and name not in study.conditions:
                yield unknown(("techniques", index), f"techniques[{index}]", name, list(CATALOGUE))
    refresh = Fraction(study.display.refresh_hz)
    for name, condition in study.conditions.items():
        loc, what = ("conditions", name), f"conditions.{name}"
        if condition.rate_hz is not None and (refresh / Fraction(condition.rate_hz)).denominator != 1:
            wanted = f"{study.display.refresh_hz} divided by a whole number (the display's refresh rate)"
            yield (*loc, "rate_hz"), f"{what}.rate_hz", condition.rate_hz, wanted
        if condition.external:
            continue
        if condition.technique not in CATALOGUE:
            yield unknown((*loc, "technique"), f"{what}.technique", condition.technique, list(CATALOGUE))
            continue
        yield from parameter_problems(condition.technique, condition.params, (*loc, "params"), f"{what}.params")


def parameter_problems(technique: str, params: Mapping[str, Any], loc: Loc, what: str) -> Iterator[Problem]:
    """Unknown parameters, wrong types and values out of range, by the technique's own model."""
    model = CATALOGUE[technique].params
    try:
        model.model_validate_json(json.dumps(params), strict=True)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            key = str(detail["loc"][0]) if detail["loc"] else ""
            if detail["type"] == "extra_forbidden":
                yield unknown((*loc, key), f"{what}.{key}", key, list(model.model_fields))
            else:
                said = detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
                yield (*loc, key), f"{what}.{key}".rstrip("."), repr(detail["input"])[:60], said[0].lower() + said[1:]


def _block(study: Study, names: _Declared, index: int, block: Block) -> Iterator[Problem]:
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


def _factor(names: _Declared, name: str, levels: Mapping[str, Any], loc: Loc, what: str) -> Iterator[Problem]:
    choices = {"scene": names.scenes, "path": names.paths, "fixation": ["free", "fixed", "moving"]}.get(name)
    for place, (level, settings) in enumerate(levels.items()):
        at = (*loc, place) if not settings.model_fields_set else (*loc, level)
        if choices is not None and level not in choices:
            yield unknown(at, f"{what}", level, choices)
        if name == "condition" and settings.condition is None:
            yield from names.condition(level, at, what)
        yield from names.settings(settings.model_dump(exclude_none=True), (*loc, level), f"{what}.{level}")


def _compare(study: Study, names: _Declared, block: Block, loc: Loc, what: str) -> Iterator[Problem]:
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
    if block.kind in ("side_by_side", "forced_choice"):
        shown = study.all_conditions()
        for name in [*of, *([block.reference] if block.reference else [])]:
            technique = shown[name].technique if name in shown else ""
            if technique in CATALOGUE and CATALOGUE[technique].gaze_contingent:
                wanted = (
                    f"no gaze-contingent technique side by side ({technique} follows one gaze): two_interval or likert"
                )
                yield (*loc, "compare", "of"), f"{what}.compare.of", name, wanted


def size_of_block(study: Study, block: Block) -> int:
    """How many trials a block has for one participant, by arithmetic, before anything is formed."""
    if block.kind in WORD_KINDS:
        return 1
    practice = sum(t.repetitions for t in block.practice) if isinstance(block.practice, list) else block.practice
    extra = practice + (block.catch.trials if block.catch else 0)
    if block.adaptive is not None:
        return block.adaptive.trials * prod(len(levels) for levels in block.factors.values())
    if block.trials is not None:
        return sum(trial.repetitions for trial in block.trials) + extra
    compare, cells = block.compare, 1
    spread = compare.spread_over if compare is not None else []
    for name, levels in block.factors.items():
        count = len(study.expand(list(levels))) if name == "condition" else len(levels)
        cells *= 1 if name in spread else count
    if compare is not None:
        of = len(study.expand(compare.of))
        cells *= len(compare.sets) if isinstance(compare.sets, list) else comb(of, compare.alternatives)
    return cells * block.repetitions + extra


def size_problems(study: Study) -> Iterator[Problem]:
    """Sessions that nobody could sit through (and that no plan should try to hold)."""
    sizes = [size_of_block(study, block) for block in study.blocks]
    for index, size in enumerate(sizes):
        if size > MAX_TRIALS:
            yield ("blocks", index), f"blocks[{index}]", f"{size} trials", f"at most {MAX_TRIALS} for a participant"
    if sum(sizes) > MAX_TRIALS and max(sizes) <= MAX_TRIALS:
        yield ("blocks",), "blocks", f"{sum(sizes)} trials", f"at most {MAX_TRIALS} for a participant"


def gaze_problems(study: Study) -> Iterator[Problem]:
    """A picture made for one gaze cannot be stored for an eye that is free to look anywhere. Only for a study whose
    names all lead somewhere."""
    between = study.participants.between
    groups = [dict(zip(between, pick, strict=True)) for pick in product(*between.values())]
    known = study.all_conditions()
    for index, block in enumerate(study.blocks):
        told: set[str] = set()
        if block.kind in WORD_KINDS or block.adaptive is not None:
            continue
        cells = (cell for group in groups for cell in block_cells(study, block, group))
        for name, settings in ((name, cell.settings) for cell in cells for name in cell.members):
            condition = known.get(name)
            entry = CATALOGUE.get(condition.technique) if condition else None
            if condition is None or entry is None or not entry.gaze_contingent or name in told:
                continue
            live = settings.get("live") if condition.live is None else condition.live
            if settings.get("fixation") == "free" and not live:
                told.add(name)
                got = f"{name} ({condition.technique}) with a free gaze from the store"
                wanted = "live: true, or fixation: fixed | moving (what the eye will do is not known beforehand)"
                yield ("blocks", index), f"blocks[{index}]", got, wanted


def _adaptive(study: Study, names: _Declared, block: Block, loc: Loc, what: str) -> Iterator[Problem]:
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


def _explicit(names: _Declared, block: Block, trial: ExplicitTrial, loc: Loc, what: str) -> Iterator[Problem]:
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


def _catch(study: Study, names: _Declared, block: Block, loc: Loc, what: str) -> Iterator[Problem]:
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


def _analysis(study: Study, names: _Declared) -> Iterator[Problem]:
    seen: set[str] = set()
    columns = sorted({*names.factors, *OWN_COLUMNS, "participant", "observer_kind"})
    for index, test in enumerate(study.analysis.tests):
        loc: Loc = ("analysis", "tests", index)
        what = f"analysis.tests[{index}]"
        if test.name in seen:
            yield (*loc, "name"), f"{what}.name", f"{test.name!r} a second time", "a name of its own"
        seen.add(test.name)
        if test.block is not None and test.block not in names.blocks:
            yield unknown((*loc, "block"), f"{what}.block", test.block, names.blocks)
        if test.question is not None and test.question not in names.questions:
            yield unknown((*loc, "question"), f"{what}.question", test.question, names.questions)
        for key in ("within", "between", "separately_by"):
            for place, word in enumerate(getattr(test, key)):
                if word not in columns:
                    yield unknown((*loc, key, place), f"{what}.{key}[{place}]", word, columns)
        for word in test.where:
            if word not in columns:
                yield unknown((*loc, "where", word), f"{what}.where", word, columns)
        if test.choice is not None and test.choice not in names.conditions:
            yield unknown((*loc, "choice"), f"{what}.choice", test.choice, names.conditions)
        if test.test == "tost" and (test.low is None or test.high is None or test.low >= test.high):
            yield loc, what, f"low {test.low}, high {test.high}", "bounds low < high, since the test is tost"
        if test.test in ("rm_anova", "friedman", "aligned_rank_anova", "posthoc_t", "cochran_q") and not test.within:
            yield loc, what, "no within", f"within: [FACTOR, ...], since the test is {test.test}"
    power_for = study.analysis.power_for
    if power_for is not None and power_for not in seen:
        yield unknown(("analysis", "power_for"), "analysis.power_for", power_for, sorted(seen))


def _observer(study: Study, names: _Declared) -> Iterator[Problem]:
    known = [*names.conditions, *CATALOGUE]
    for word in study.observer.utilities:
        if word not in known:
            yield unknown(("observer", "utilities", word), "observer.utilities", word, known)
    for scene, table in study.observer.scene_utilities.items():
        if scene not in names.scenes:
            yield unknown(("observer", "scene_utilities", scene), "observer.scene_utilities", scene, names.scenes)
        for word in table:
            if word not in known:
                at_scene = ("observer", "scene_utilities", scene, word)
                yield unknown(at_scene, f"observer.scene_utilities.{scene}", word, known)
    for question, model in study.observer.likert.items():
        loc: Loc = ("observer", "likert", question)
        what = f"observer.likert.{question}"
        if question not in names.questions:
            yield unknown(loc, what, question, names.questions)
        elif question in study.questions and model.thresholds is not None:
            wanted = len(study.questions[question].answers) - 1
            if len(model.thresholds) != wanted:
                yield (*loc, "thresholds"), f"{what}.thresholds", f"{len(model.thresholds)}", f"{wanted} thresholds"
        for index, means in enumerate(model.means):
            for place, word in enumerate(means.by):
                if word not in names.factors and word not in OWN_COLUMNS:
                    at: Loc = (*loc, "means", index, "by", place)
                    yield unknown(at, f"{what}.means[{index}].by", word, sorted({*names.factors, *OWN_COLUMNS}))
            for key in means.values:
                if len(key.split(":")) != len(means.by):
                    at = (*loc, "means", index, "values", key)
                    yield at, f"{what}.means[{index}].values", repr(key), f"levels of {':'.join(means.by)}"


def _matches(study: Study, names: _Declared) -> Iterator[Problem]:
    shown = study.all_conditions()
    for index, match in enumerate(study.match):
        loc: Loc = ("match", index)
        what = f"match[{index}]"
        for place, word in enumerate(match.conditions):
            yield from names.condition(word, (*loc, "conditions", place), f"{what}.conditions[{place}]")
        if match.to is not None:
            yield from names.condition(match.to, (*loc, "to"), f"{what}.to")
        for place, knob in enumerate(match.knobs):
            at: Loc = (*loc, "knobs", place)
            said = f"{what}.knobs[{place}]"
            yield from names.condition(knob.condition, (*at, "condition"), f"{said}.condition")
            technique = shown[knob.condition].technique if knob.condition in shown else ""
            if technique in CATALOGUE and knob.parameter not in CATALOGUE[technique].params.model_fields:
                fields = list(CATALOGUE[technique].params.model_fields)
                yield unknown((*at, "parameter"), f"{said}.parameter", knob.parameter, fields)
