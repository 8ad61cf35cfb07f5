"""The analysis plan: what is tested, on which numbers, with which exclusions; written before there are data."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from protocols.quantity import Model, Name, Text

TESTS = (
    "rm_anova", "oneway_anova", "posthoc_t", "aligned_rank_anova", "friedman", "wilcoxon", "likert_summary",
    "binomial_choice", "binomial_mixed", "bradley_terry", "thurstone", "cumulative_link", "linear_mixed",
    "psychometric", "tost", "mcnemar", "cochran_q", "dprime", "agreement",
)  # fmt: skip
TestName = Literal[
    "rm_anova", "oneway_anova", "posthoc_t", "aligned_rank_anova", "friedman", "wilcoxon", "likert_summary",
    "binomial_choice", "binomial_mixed", "bradley_terry", "thurstone", "cumulative_link", "linear_mixed",
    "psychometric", "tost", "mcnemar", "cochran_q", "dprime", "agreement",
]  # fmt: skip


class PlannedTest(Model):
    """One test. ``test``: a function of `analysis`; the other keys are its arguments, or choose its rows.

    ``block``, ``question``, ``where`` (column -> levels) choose rows; ``a``, ``b``: the two levels of a paired test;
    ``low``, ``high``: equivalence bounds; ``family``: tests whose p values are adjusted together; ``separately_by``:
    the test is made once for each level of these columns; ``effects``: those the hypothesis is about.
    """

    name: Name
    test: TestName
    hypothesis: Text | None = None
    primary: bool = True
    block: Name | None = None
    question: Name | None = None
    where: dict[Name, list[str]] = Field(default_factory=dict)
    dv: Literal["rating", "rt_s", "choice", "correct"] = "rating"
    within: list[Name] = Field(default_factory=list)
    between: list[Name] = Field(default_factory=list)
    subject: Name = "participant"
    separately_by: list[Name] = Field(default_factory=list)
    effects: list[str] = Field(default_factory=list)
    a: str | None = None
    b: str | None = None
    low: float | None = None
    high: float | None = None
    choice: str | None = Field(default=None, description="the condition whose choices are counted")
    p0: Annotated[float, Field(gt=0, lt=1)] | None = None
    x: Name | None = Field(default=None, description="the stimulus value of a psychometric function")
    formula: str | None = None
    random: str | None = None
    adjust: Literal["holm", "bonferroni", "fdr_bh", "none"] | None = None
    family: Name | None = None
    unit: Literal["jod", "z"] | None = None
    method: str | None = None


class Exclusion(Model):
    """One rule by which a trial or a person is left out, stated before data exist.

    ``rule``: missed_refreshes (more than ``limit`` in a trial), timed_out, too_fast (rt below ``limit`` s), too_slow,
    catch (share right below ``limit``), straight_lining (the same answer in at least ``limit`` of the trials),
    incomplete (less than ``limit`` of the trials answered), gaze_loss, gaze_off_fixation, side_bias.
    """

    rule: Literal[
        "missed_refreshes", "timed_out", "too_fast", "too_slow", "catch", "straight_lining", "incomplete", "gaze_loss",
        "gaze_off_fixation", "side_bias",
    ]  # fmt: skip
    limit: float | None = None
    of: Literal["trial", "participant"] | None = None
    reason: str | None = None


class AnalysisPlan(Model):
    """The plan as the session's header stores it (``analysis_plan``), see `as_dict`."""

    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05
    adjust: Literal["holm", "bonferroni", "fdr_bh", "none"] = "holm"
    tests: list[PlannedTest] = Field(default_factory=list)
    exclusions: list[Exclusion] = Field(default_factory=list)
    power_for: Name | None = Field(default=None, description="the test whose power decides the number of participants")
    power: Annotated[float, Field(gt=0, lt=1)] = 0.9

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready: {alpha, adjust, tests: [{name, test, dv, within, ...}], exclusions: [{rule, limit}], ...}."""
        return self.model_dump(mode="json", exclude_none=True)
