"""The README promises commands: each must exist and take the options it shows."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

import pytest

from studyapp.cli import _load, command_names

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
COMMANDS = [line.strip() for line in README.splitlines() if line.startswith("    studyapp ")]


def parser_of(name: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=name, exit_on_error=False)
    _load(name).configure(parser)
    return parser


def test_the_two_commands_are_make_targets() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for target in ("demo", "test"):
        assert f"make {target}" in README
        assert f"\n{target}:" in makefile


def test_ci_calls_what_the_readme_says() -> None:
    assert "make test" in (ROOT / ".ci" / "run").read_text()


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_of_the_readme_can_be_typed(line: str) -> None:
    _, name, *arguments = shlex.split(line)
    assert name in command_names()
    parser_of(name).parse_args(arguments)


def test_the_examples_of_the_commands_can_be_typed() -> None:
    for name in command_names():
        _, command, *arguments = shlex.split(_load(name).EXAMPLE.split(" > ")[0])
        assert command == name
        parser_of(name).parse_args(arguments)


def test_pictures_of_the_readme_are_there() -> None:
    for part in README.split("](")[1:]:
        target = part.split(")")[0]
        if not target.startswith("http"):
            assert (ROOT / target).exists(), target
