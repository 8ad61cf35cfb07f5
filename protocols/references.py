"""Names in a protocol that must lead somewhere: conditions, scenes, factors, questions, techniques and parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from protocols.block_references import block_problems
from protocols.camera_keys import path_problems
from protocols.condition_references import channel_problems, condition_problems, match_problems
from protocols.names import OWN_COLUMNS, Declared, Loc, Problem, unknown
from protocols.study import Study
from renderers.catalogue import CATALOGUE


def reference_problems(study: Study, written: Mapping[str, Any]) -> Iterator[Problem]:
    """All names that lead nowhere and values that do not fit each other.
    ``written``: see `Declared`."""
    names = Declared(study, written)
    if study.display.view == "headset":
        able = " | ".join(name for name, entry in CATALOGUE.items() if entry.headset)
        wanted = (
            "monitor: sessions are shown on a monitor, and a headset's runtime would pace and warp the frames itself "
            f"(pictures of it: studyapp scene SCENE --technique {able} --view headset)"
        )
        yield ("display", "view"), "display.view", "'headset'", wanted
    yield from path_problems(study.paths)
    yield from condition_problems(study)
    yield from channel_problems(study)
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
        yield from block_problems(study, names, index, block)
    for name, levels in study.participants.between.items():
        for level, settings in levels.items():
            where = ("participants", "between", name, level)
            yield from names.settings(settings.model_dump(exclude_none=True), where, ".".join(map(str, where)))
    yield from _analysis(study, names)
    yield from _observer(study, names)
    yield from match_problems(study, names)


def _analysis(study: Study, names: Declared) -> Iterator[Problem]:
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


def _observer(study: Study, names: Declared) -> Iterator[Problem]:
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
