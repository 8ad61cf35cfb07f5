"""Which button means what, now: boxes have numbered buttons, questions have named keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from protocols.trial import Question
from stimuli.errors import InputError, problem


def question_keys(question: Question) -> dict[str, str]:
    """Key name -> answer of a question, as the presenter reads it; {} where any key goes on."""
    if question.keys:
        return dict(question.keys)
    if question.kind == "likert":
        return {str(value): str(value) for value in range(question.low, question.high + 1)}
    return {option: option for option in question.options}


def button_map(question: Question | None, buttons: Sequence[str]) -> dict[str, str]:
    """Button -> key name for ``question``: by name where the box has every key of it, else in order, first key on
    the first button. {} (buttons keep their names) where any key goes on.

    Raises InputError where the question has more keys than the box has buttons.
    """
    keys = list(question_keys(question)) if question is not None else []
    if all(key in buttons for key in keys):
        return {key: key for key in keys}
    if len(keys) > len(buttons):
        where = f"question {question.name}" if question is not None else "question"
        raise InputError(problem(where, "keys", f"{len(keys)} ({', '.join(keys)})", f"at most {len(buttons)} buttons"))
    return dict(zip(buttons, keys, strict=False))


def key_for(question: Question, answer: str) -> str:
    """The key that gives ``answer``; KeyError where none does."""
    return next(key for key, meaning in question_keys(question).items() if meaning == answer)


def button_for(mapping: Mapping[str, str], key: str) -> str:
    """The button that is ``key`` now; the key itself where nothing is mapped."""
    return next((button for button, name in mapping.items() if name == key), key)
