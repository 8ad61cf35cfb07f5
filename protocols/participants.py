"""Who takes part: how many, in which slots and groups, who is let in, and what happens with those left out."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from protocols.blocks import Levels
from protocols.quantity import Model, Name, Share, Text, wrong


class Inclusion(Model):
    """Asked or measured before trial 1. A person who misses the bound does not start (or starts under an override).

    ``kind``: number (``at_least``, ``at_most``), yes_no (``equals``), choice (``options``, ``one_of``).
    """

    name: Name
    kind: Literal["number", "yes_no", "choice"]
    text: Text
    at_least: float | None = None
    at_most: float | None = None
    equals: bool | None = None
    options: list[str] = Field(default_factory=list)
    one_of: list[str] | None = None
    measured: bool = Field(default=False, description="measured by the experimenter rather than asked")

    @model_validator(mode="after")
    def _consistent(self) -> Inclusion:
        if self.kind == "choice" and not self.options:
            raise wrong("no options", "options, since the kind is choice")
        if self.one_of is not None and not set(self.one_of) <= set(self.options):
            raise wrong(self.one_of, f"some of {self.options}")
        return self


class Participants(Model):
    """Participant numbers are slots of the design (order, sides, keys, group); the person's code is another thing.

    ``between``: factors whose levels are given to people instead of trials; slots go round all combinations in
    seeded blocks, so that groups never differ by more than one person.
    """

    target: Annotated[int, Field(ge=1, le=10_000)] = 12
    replace_excluded: bool = Field(
        default=True, description="an excluded person's slot is run again with somebody else"
    )
    naive: bool = Field(default=True, description="participants do not know what the study is about")
    inclusion: list[Inclusion] = Field(default_factory=list)
    between: dict[Name, Levels] = Field(default_factory=dict)
    catch_pass_mark: Share = Field(default=0.0, description="share of catch trials that must be right")
    stopping_rule: Text = "Data are collected until the target number of included participants is reached."
    payment: str | None = None
