from __future__ import annotations

from pathlib import Path

import pytest

from protocols import load_study
from protocols.design import plan
from protocols.load import LIBRARY
from stimuli.errors import InputError
from tests.protocols.tiny import TEXT, tiny


def written(folder: Path, text: str, name: str = "s.yaml") -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def problems(folder: Path, text: str) -> list[str]:
    file = written(folder, text)
    with pytest.raises(InputError) as caught:
        load_study(file)
    return [line.replace(str(file), "s.yaml") for line in caught.value.problems]


def test_a_file_gives_the_model(tmp_path: Path) -> None:
    assert load_study(written(tmp_path, TEXT)) == tiny()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("study: tiny", "study: Tiny!", "s.yaml:1:1: study: got 'Tiny!', wanted a name like my_study"),
        ("reference: gold", "reference: glod", "s.yaml:14:5: blocks[0].reference: got 'glod', wanted 'gold' (did"),
        ("technique: reference", "technique: refrence", "s.yaml:4:10: conditions.gold.technique: got 'refrence'"),
        ("{spp: 4}", "{ssp: 4}", "s.yaml:4:41: conditions.gold.params.ssp: got 'ssp', wanted 'spp'"),
        ("{spp: 4}", "{spp: 0}", "s.yaml:4:41: conditions.gold.params.spp: got 0, wanted greater than or equal to 1"),
        ("{spp: 4}", "{spp: four}", "s.yaml:4:41: conditions.gold.params.spp: got 'four', wanted a valid integer"),
        ("rate_hz: 120", "rate_hz: 100", "s.yaml:6:30: conditions.half.rate_hz: got 100, wanted 240 divided by"),
        ("rate_hz: 120", "rate_hz: fast", "s.yaml:6:30: conditions.half.rate_hz: got 'fast', wanted a number"),
        ("rate_hz: 120", "rate_hz: 0", "s.yaml:6:30: conditions.half.rate_hz: got 0, wanted more than 0"),
        ("repetitions: 2", "repetitions: '2'", "s.yaml:24:5: blocks[1].repetitions: got '2', wanted a whole number"),
        ("repetitions: 2", "repetitions: 2.5", "s.yaml:24:5: blocks[1].repetitions: got 2.5, wanted a whole number"),
        ("repetitions: 2", "repetition: 2", "s.yaml:24:5: blocks[1].repetition: got unknown key 'repetition'"),
        ("kind: likert\n    f", "kind: likrt\n    f", "s.yaml:19:5: blocks[1].kind: got 'likrt', wanted 'likert' (did"),
        ("questions: [clean]", "questions: [clan]", "s.yaml:23:17: blocks[1].questions[0]: got 'clan', wanted 'clean'"),
        ("questions: [clean]", "questions: [closer]", "s.yaml:23:17: blocks[1].questions[0]: got a choice, wanted"),
        ("scene: [a, b]}", "scene: [a, c]}", "s.yaml:16:26: blocks[0].factors.scene: got 'c', wanted one of a | b"),
        ("compare: {of: [full, half, dense]}", "compare: {of: [full]}", "s.yaml:15:15: blocks[0].compare.of: got 1"),
        ("    compare: {of: [full, half, dense]}\n", "", "s.yaml:12:5: blocks[0]: got no compare, wanted compare: {of"),
        ("    reference: gold\n", "", "s.yaml:12:5: blocks[0]: got no reference, wanted reference: CONDITION"),
        ("  - name: rating", "  - name: pairs", "s.yaml:18:5: blocks[1].name: got 'pairs' a second time"),
        ("scenes: {a: tunnel_geom, b: bar}", "", "s.yaml:1:1: scenes: got nothing, wanted a value here"),
    ],
)  # fmt: skip
def test_each_mistake_is_named_at_its_place(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert TEXT.count(old) >= 1
    found = problems(tmp_path, TEXT.replace(old, new, 1))
    assert any(line.startswith(expected) for line in found), "\n".join(found)


def test_all_problems_are_told_at_once_and_in_order(tmp_path: Path) -> None:
    text = TEXT.replace("reference: gold", "reference: glod").replace("{spp: 4}", "{spp: -1}")
    text = (
        text.replace("repetitions: 2", "repetitons: 2")
        .replace("rate_hz: 120", "rate_hz: 7")
        .replace("kind: choice", "kind: chose")
    )
    found = problems(tmp_path, text)
    lines = [int(line.split(":")[1]) for line in found]
    assert lines == [4, 6, 9, 14, 24]


def test_a_faulty_part_does_not_make_its_name_unknown(tmp_path: Path) -> None:
    found = problems(
        tmp_path, TEXT.replace("half: {technique: vanilla, rate_hz: 120}", "half: {technique: vanilla, rate: 120}")
    )
    assert len(found) == 1
    assert "unknown key 'rate', wanted 'rate_hz'" in found[0]


def test_gaze_contingent_techniques_may_not_stand_side_by_side(tmp_path: Path) -> None:
    found = problems(tmp_path, TEXT.replace("full: vanilla", "full: foveated"))
    assert any("no gaze-contingent technique side by side" in line for line in found)


def test_a_free_gaze_cannot_be_stored(tmp_path: Path) -> None:
    text = TEXT.replace("full: vanilla", "full: foveated").replace("of: [full, half, dense]", "of: [half, dense]")
    found = problems(tmp_path, text)
    assert found == [
        "s.yaml:18:5: blocks[1]: got full (foveated) with a free gaze from the store, wanted live: true, or fixation: "
        "fixed | moving (what the eye will do is not known beforehand)"
    ]
    assert load_study(written(tmp_path, text + "    set: {live: true}\n")).blocks[1].set.live


def test_extends_lays_a_variant_over_its_base(tmp_path: Path) -> None:
    written(tmp_path, TEXT, "base.yaml")
    text = "extends: base.yaml\nstudy: variant\nquestions: {clean: {high: 2}}\n"
    text += "blocks:\n  - {name: rating, repetitions: 5}\n"
    study = load_study(written(tmp_path, text))
    assert study.study == "variant"
    assert [block.name for block in study.blocks] == ["pairs", "rating"]
    assert study.blocks[1].repetitions == 5
    assert study.blocks[1].kind == "likert"
    assert study.questions["clean"].high == 2


def test_a_mistake_in_the_base_is_told_in_the_base(tmp_path: Path) -> None:
    written(tmp_path, TEXT.replace("reference: gold", "reference: glod"), "base.yaml")
    with pytest.raises(InputError, match=r"base\.yaml:14:5: blocks\[0\]\.reference"):
        load_study(written(tmp_path, "extends: base.yaml\nstudy: variant\n"))


def test_extends_in_a_circle_is_refused(tmp_path: Path) -> None:
    written(tmp_path, "extends: s.yaml\n", "base.yaml")
    assert "extends" in problems(tmp_path, "extends: base.yaml\n" + TEXT)[0]


def test_a_bare_name_is_looked_up_in_the_library() -> None:
    assert load_study("demo").study == "demo"
    assert load_study(LIBRARY / "demo.yaml") == load_study("demo")


def test_sizes_are_read_at_every_level_of_the_cascade(tmp_path: Path) -> None:
    """A scene's own, a level's, a block's: each a list in the file."""
    text = TEXT.replace("{a: tunnel_geom", "{a: {scene: tunnel_geom, size_px: [64, 48]}").replace(
        "      scene: [a, b]\n",
        "      scene: [a, b]\n      size: {small: {size_px: [32, 24]}, wide: {size_px: [96, 24]}}\n",
    )
    file = tmp_path / "s.yaml"
    file.write_text(text)
    shown = [trial for trial in plan(load_study(file), 1) if trial.panels]
    assert {tuple(t.settings["size_px"]) for t in shown if t.block == "pairs" and t.scene == "a"} == {(64, 48)}
    assert {tuple(t.settings["size_px"]) for t in shown if t.block == "rating"} == {(32, 24), (96, 24)}
    for wrong in ("[64]", "[64, 0]", "[64, 48, 3]", "64", "[a, b]"):
        file.write_text(text.replace("[64, 48]", wrong))
        with pytest.raises(InputError, match=r"s.yaml:2:\d+: scenes.a.size_px"):
            load_study(file)


@pytest.mark.parametrize("name", ["x" * 5000, "../" * 600 + "x", "''", ".", "a: b"])
def test_names_that_no_file_has_are_named_in_one_line(name: str, tmp_path: Path) -> None:
    for key in ("extends: NAME\n", "paths: {walk: NAME}\n"):
        file = tmp_path / "s.yaml"
        file.write_text(TEXT + key.replace("NAME", name))
        with pytest.raises(InputError) as caught:
            load_study(file)
        assert any(f"s.yaml:{len(TEXT.splitlines()) + 1}:" in line for line in caught.value.problems)
