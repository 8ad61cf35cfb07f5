"""The model of a protocol: everything a study says, checked in type and range. Names are checked in `references`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints

from protocols.analysis_plan import AnalysisPlan
from protocols.blocks import Block
from protocols.camera_keys import Paths
from protocols.conditions import DEFAULTS, Condition, ConditionEntry, Gaze, SceneEntry, Settings, Timing
from protocols.display import Display
from protocols.match import Match
from protocols.observer_model import ObserverModel
from protocols.participants import Participants
from protocols.quantity import Model, Name, Text
from protocols.question import QuestionSpec
from renderers.catalogue import side_by_side


class Deviation(Model):
    """One row of the table paper / here / why."""

    paper: Text
    here: Text
    why: Text


class Replication(Model):
    """Which study this repeats, how closely, and where it differs; printed in the report."""

    of: Text
    kind: Literal["direct", "conceptual", "proposal"]
    deviations: list[Deviation] = Field(default_factory=list)


def varied_name(test: str, value: float) -> str:
    """The name of an adaptive block's test condition at ``value``, all its digits; `varied_value` reads it."""
    short = f"{value:g}"
    return f"{test}@{short if float(short) == value else repr(float(value))}"


def varied_value(condition: str) -> float | None:
    """The value that stands in a name made by `varied_name`; None in the name of any other condition."""
    _, mark, value = condition.partition("@")
    try:
        return float(value) if mark else None
    except ValueError:
        return None


class Study(Model):
    """A whole protocol. See `protocols/library/*.yaml` for examples; `load_study` reads one."""

    study: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,40}$")]
    title: Text | None = None
    about: Text | None = None
    replication: Replication | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    display: Display = Display()
    defaults: Settings = Settings()
    scenes: Annotated[dict[Name, SceneEntry], Field(min_length=1, max_length=100)]
    paths: Paths = Field(default_factory=dict, description="camera paths: keys, or the name of a file of keys")
    techniques: Literal["all_side_by_side"] | list[Name] | None = Field(
        default=None, description="each becomes a condition of its own name, with default parameters"
    )
    conditions: dict[Name, ConditionEntry] = Field(default_factory=dict)
    questions: dict[Name, QuestionSpec]
    blocks: Annotated[list[Block], Field(min_length=1, max_length=100)]
    block_order: Literal["as_written", "shuffle", "latin"] = Field(
        default="as_written", description="order of the blocks with pictures; blocks of words keep their places"
    )
    participants: Participants = Participants()
    timing: Timing = Timing()
    gaze: Gaze = Gaze()
    analysis: AnalysisPlan = AnalysisPlan()
    observer: ObserverModel = ObserverModel()
    match: list[Match] = Field(default_factory=list)

    def technique_names(self) -> tuple[str, ...]:
        """The techniques of the ``techniques`` line; all_side_by_side: those of the catalogue that do not follow the
        gaze, without the reference itself."""
        if self.techniques == "all_side_by_side":
            return side_by_side()
        return tuple(self.techniques or ())

    def all_conditions(self) -> Mapping[str, Condition]:
        """name -> condition: those written, and one for each of ``techniques`` that is not."""
        named = {name: Condition(technique=name) for name in self.technique_names()}
        for block in self.blocks:
            # A varied condition is a condition of its own at each value: NAME@VALUE.
            varied = block.adaptive
            if varied is not None and varied.test in self.conditions and varied.parameter is not None:
                test = self.conditions[varied.test]
                for value in varied.values:
                    number = int(value) if value.is_integer() else value
                    made = test.model_copy(update={"params": {**test.params, varied.parameter: number}})
                    named[varied_name(varied.test, value)] = made
        return {**self.conditions, **{n: c for n, c in named.items() if n not in self.conditions}}

    def expand(self, names: list[str]) -> tuple[str, ...]:
        """Condition names with ``techniques`` replaced by the conditions of that line; each once, in order."""
        out: dict[str, None] = {}
        for name in names:
            out.update(dict.fromkeys(self.technique_names() if name == "techniques" else (name,)))
        return tuple(out)

    def base_settings(self, scene: str | None) -> dict[str, Any]:
        """The two widest levels of the cascade: built-in, the study's defaults, then the scene's own."""
        merged = DEFAULTS.model_dump(mode="json", exclude_none=True)
        merged.update(self.defaults.model_dump(mode="json", exclude_none=True))
        if scene is not None:
            own = self.scenes[scene].model_dump(mode="json", exclude_none=True)
            merged.update({key: value for key, value in own.items() if key in Settings.model_fields})
        return merged

    def analysis_plan(self) -> dict[str, Any]:
        """What the session's header keeps as ``analysis_plan``."""
        return {**self.analysis.as_dict(), "catch_pass_mark": self.participants.catch_pass_mark}

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, defaults filled in; what is hashed and frozen."""
        return self.model_dump(mode="json")
