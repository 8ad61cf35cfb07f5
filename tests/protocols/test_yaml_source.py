from __future__ import annotations

import time
from pathlib import Path

import pytest

from protocols.yaml_source import MAX_BYTES, parse_yaml, read_yaml
from stimuli.errors import InputError


def problems(text: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "f.yaml")
    return caught.value.problems


def test_scalars_follow_the_core_schema() -> None:
    text = "a: 1\nb: 1.5\nc: 1e3\nd: true\ne: no\nf: '1'\ng: null\nh: 60000/1001\ni: -.5\n"
    expected = {"a": 1, "b": 1.5, "c": 1000.0, "d": True, "e": "no", "f": "1", "g": None, "h": "60000/1001", "i": -0.5}
    assert parse_yaml(text, "f").plain() == expected


def test_every_key_has_its_place() -> None:
    root = parse_yaml("a: 1\nb:\n  - c: 2\n    dd: 3\n", "f.yaml")
    assert str(root.find(("b", 0, "dd"))) == "f.yaml:4:5"
    assert str(root.find(("b", 0, "nowhere"))) == "f.yaml:3:5"


def test_aliases_and_merge_keys_bring_their_values() -> None:
    root = parse_yaml("x: &q {a: 1, b: 2}\ny: {<<: *q, b: 3}\nz: *q\n", "f")
    assert root.plain() == {"x": {"a": 1, "b": 2}, "y": {"b": 3, "a": 1}, "z": {"a": 1, "b": 2}}


@pytest.mark.parametrize(
    ("text", "where", "what"),
    [
        ("a: &a [*a]\n", "f.yaml:1:8", "alias"),
        ("a: *b\n", "f.yaml:1:4", "alias"),
        ("a: 1\na: 2\n", "f.yaml:2:1", "key 'a'"),
        ("a:\n\t- 1\n", "f.yaml:2:1", "indentation"),
        ("- a\n", "f.yaml:1:1", "document"),
        ("", "f.yaml:1:1", "document"),
        ("a: 1\n---\nb: 1\n", "f.yaml:2:1", "document"),
        ("a: !!python/object:os.system x\n", "f.yaml:1:4", "tag"),
        ("a: .inf\n", "f.yaml:1:4", "number"),
        ("a: 1e999\n", "f.yaml:1:4", "number"),
        ("a: " + "9" * 5000 + "\n", "f.yaml:1:4", "number"),
        ("a: b: c\n", "f.yaml:1:5", "yaml"),
        ("? [x]\n: 1\n", "f.yaml:1:3", "key"),
        ("a: " + "[" * 5000, "f.yaml:1:27", "depth"),
    ],
)
def test_what_is_wrong_is_named_at_its_place(text: str, where: str, what: str) -> None:
    line = problems(text)[0]
    assert line.startswith(f"{where}: {what}: got ")
    assert ", wanted " in line


def test_a_billion_laughs_are_refused_quickly() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    start = time.perf_counter()
    assert "values after aliases" in problems("\n".join(lines))[0]
    assert time.perf_counter() - start < 2


def test_a_huge_file_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "big.yaml"
    file.write_bytes(b"a: 1\n" * (MAX_BYTES // 4))
    with pytest.raises(InputError, match="bytes"):
        read_yaml(file)


def test_many_parts_are_refused_before_they_are_all_read() -> None:
    start = time.perf_counter()
    assert "parts" in problems("a: [" + "1," * 60_000 + "]")[0]
    assert time.perf_counter() - start < 2


def test_text_that_is_not_utf8_is_named_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / "latin.yaml"
    file.write_bytes(b"a: 1\nb: caf\xe9\n")
    with pytest.raises(InputError, match=r"latin\.yaml:2:7: encoding"):
        read_yaml(file)


def test_a_file_that_is_missing_or_a_folder_is_one_line(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(InputError) as caught:
            read_yaml(path)
        assert len(caught.value.problems) == 1
