"""One planned trial: what `protocols/design.py` yields, the presenter shows and the session file records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

TrialKind = Literal["side_by_side", "forced_choice", "two_interval", "likert", "instructions", "consent", "break"]
"""side_by_side: reference in the middle and candidates on the sides; forced_choice: n panels at once; two_interval:
one after the other; likert: one sequence, then questions; the rest show words only."""


@dataclass(frozen=True)
class Panel:
    """One picture of a trial. ``slot``: left | centre | right | ... or first | second; ``role``: candidate | reference
    | catch. ``condition`` is the protocol's name for technique + parameters + rate; ``clip`` is the ClipRequest's
    identity (sha256 hex), '' before the request could be formed; ``live``: rendered per refresh instead of played."""

    slot: str
    condition: str
    technique: str
    role: str = "candidate"
    params: Mapping[str, Any] = field(default_factory=dict)
    rate_hz: str = "240"
    clip: str = ""
    live: bool = False


@dataclass(frozen=True)
class Question:
    """What is asked after (or during) a trial.

    ``kind``: choice (options are slots), likert (``low``..``high`` with ``labels``), confirm. ``keys`` maps a device
    key name to the answer, already counterbalanced for this participant. ``window_s`` None: no limit.
    """

    name: str
    text: str
    kind: Literal["choice", "likert", "confirm"]
    options: tuple[str, ...] = ()
    low: int = -3
    high: int = 3
    labels: Mapping[str, str] = field(default_factory=dict)
    keys: Mapping[str, str] = field(default_factory=dict)
    window_s: float | None = None
    min_view_s: float = 0.0


@dataclass(frozen=True)
class Trial:
    """One trial as planned. ``index`` is its place in the participant's plan; ``factors`` are the design's own columns
    (factor name -> level), kept whole for the analysis. ``correct`` is the right answer of a catch trial."""

    index: int
    block: str
    kind: TrialKind
    scene: str = ""
    path: str = "file"
    panels: tuple[Panel, ...] = ()
    questions: tuple[Question, ...] = ()
    duration_s: float = 0.0
    repetition: int = 0
    practice: bool = False
    catch: bool = False
    correct: str | None = None
    text: str = ""
    fixation: str = "free"
    factors: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    """The cascade's result, JSON-ready: size_px, start_s, warm_up_s, lighting, animation, loop, gap_px, mirror,
    interval_gap_s, iti_s, response ('after' | 'during'), replays, feedback, ... (`protocols.conditions.Settings`)."""

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, the form stored in session files."""
        return asdict(self)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Trial:
        """The inverse of `as_dict`."""
        known = dict(data)
        known["panels"] = tuple(Panel(**panel) for panel in data["panels"])
        known["questions"] = tuple(Question(**{**q, "options": tuple(q["options"])}) for q in data["questions"])
        return Trial(**known)


def is_right(correct: str, *given: str | None) -> bool:
    """Whether a catch trial was answered rightly. ``correct``: a slot, or ``low..high`` for ratings within a range;
    ``given``: the slot chosen and/or the rating as text."""
    if ".." not in correct:
        return correct in given
    low, high = (float(end) for end in correct.split(".."))
    return any(low <= float(answer) <= high for answer in given if answer is not None and _is_number(answer))


def _is_number(text: str) -> bool:
    return text.lstrip("+-").replace(".", "", 1).isdigit()
