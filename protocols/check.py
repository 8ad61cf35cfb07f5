"""What a valid protocol amounts to: trials, balance, minutes, clips, disk, upload; and what it cannot do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations

from protocols.adaptive import procedure
from protocols.blocks import WORD_KINDS, Block
from protocols.design import column, plan
from protocols.gaze_demands import SAME_SAMPLES, BelowFullRate, below_full_rate
from protocols.names import Problem
from protocols.requests import ClipSpec, clip_specs
from protocols.session_size import size_of_block
from protocols.study import Study
from protocols.trial import Trial
from stimuli.clip_request import CHANNEL_BYTES

WORDS_S = 15.0  # a screen of words is read for about this long
EXR_BYTES_PER_PX = 6.0  # half-float RGB, before compression
PLAY_BYTES_PER_PX = 4


@dataclass(frozen=True)
class BlockSummary:
    """One block as one participant meets it. ``balance``: what is counted -> (least, most). ``adaptive``: the procedure
    that makes its trials as the answers come (``trials`` is then the most there can be), '' without one."""

    name: str
    kind: str
    trials: int
    practice: int
    catch: int
    minutes: float
    balance: dict[str, tuple[int, int]]
    adaptive: str = ""


@dataclass(frozen=True)
class Summary:
    """The plan of a study in numbers. Bytes are upper bounds (before compression)."""

    study: str
    participants: int
    trials: int
    minutes: float
    blocks: tuple[BlockSummary, ...]
    clips: tuple[ClipSpec, ...]
    frames: int
    store_bytes: int
    play_bytes: int
    upload_bytes: int
    largest_trial_bytes: int
    notes: tuple[str, ...]
    below_full_rate: tuple[BelowFullRate, ...] = ()


def summarise(study: Study, participants: Sequence[int] | None = None) -> Summary:
    """The summary of ``study``; balance is counted over ``participants`` (default: slots 1 to the target, at most 24,
    fewer where sessions are long).

    Raises InputError where an order's constraints cannot be met.
    """
    first = plan(study, participants[0] if participants else 1)
    # As many people as keep the count short; an even number, since sides are mirrored in couples.
    most = max(2, 6000 // max(len(first), 1) // 2 * 2)
    slots = list(participants or range(1, min(study.participants.target, 24, most) + 1))
    plans = [first, *(plan(study, slot) for slot in slots[1:])]
    clips = clip_specs(study)
    stored = [spec for spec in clips if not spec.live]
    pixels = [spec.size_px[0] * spec.size_px[1] for spec in stored]
    sizes = [px * spec.frame_count for px, spec in zip(pixels, stored, strict=True)]
    shown = [trial for trial in first if trial.panels]
    blocks = tuple(_block(study, block, plans) for block in study.blocks if block.kind not in WORD_KINDS)
    below = below_full_rate(study)
    learning = [block for block in blocks if block.adaptive]
    return Summary(
        study=study.study,
        participants=study.participants.target,
        trials=len(shown) + sum(block.trials for block in learning),
        minutes=sum(trial_seconds(study, trial) for trial in first) / 60 + sum(block.minutes for block in learning),
        blocks=blocks,
        clips=clips,
        frames=sum(spec.frame_count for spec in stored),
        store_bytes=int(sum(size * _stored_bytes(spec) for size, spec in zip(sizes, stored, strict=True))),
        play_bytes=sum(sizes) * PLAY_BYTES_PER_PX,
        upload_bytes=max((_upload(trial) for trial in shown), default=0),
        largest_trial_bytes=max((_trial_bytes(trial) for trial in shown), default=0),
        notes=(*_notes(study, clips), *_mirror_notes(shown), *_full_rate_notes(below)),
        below_full_rate=below,
    )


def _stored_bytes(spec: ClipSpec) -> float:
    """Bytes of a pixel in the store, its channels included."""
    return EXR_BYTES_PER_PX + sum(CHANNEL_BYTES.get(name, 2) for name in spec.channels)


def trial_seconds(study: Study, trial: Trial) -> float:
    """How long a trial takes, answers included."""
    if not trial.panels:
        return WORDS_S
    watch = trial.duration_s
    if trial.kind == "two_interval":
        # Both intervals, and the reference before them where there is one.
        watch = trial.duration_s * len(trial.panels) + float(trial.settings["interval_gap_s"]) * (len(trial.panels) - 1)
    answers = sum(study.questions[question.name].expected_s for question in trial.questions)
    return watch + answers + float(trial.settings["iti_s"])


def _upload(trial: Trial) -> int:
    """Bytes that one refresh may have to move to the display: every panel at once."""
    width, height = trial.settings["size_px"]
    at_once = 1 if trial.kind == "two_interval" else len(trial.panels)
    return int(width) * int(height) * PLAY_BYTES_PER_PX * at_once


def _trial_bytes(trial: Trial) -> int:
    width, height = trial.settings["size_px"]
    frames = sum(round(Fraction(str(trial.settings["duration_s"])) * Fraction(panel.rate_hz)) for panel in trial.panels)
    return int(width) * int(height) * PLAY_BYTES_PER_PX * frames


def _full_rate_notes(rows: Iterable[BelowFullRate]) -> Iterable[str]:
    for row in rows:
        if row.share < SAME_SAMPLES:
            below = f"{row.share:.1%} of its pixels below full rate"
            yield f"condition {row.condition}: {below}: it shows what full rate shows"


def _mirror_notes(trials: Iterable[Trial]) -> Iterable[str]:
    """What a mirrored layout does to the panels, once a block."""
    told: set[str] = set()
    for trial in trials:
        mirror = trial.settings["mirror"]
        if mirror == "none" or trial.block in told:
            continue
        told.add(trial.block)
        if trial.kind == "two_interval" or len(trial.panels) < 2:
            yield f"block {trial.block}: mirror: {mirror} changes nothing: one panel stands in the middle"
        elif mirror == "sides":
            yield f"block {trial.block}: mirror: sides: slot left stands on the right (for displays seen by a mirror)"


def first_adaptive_trial(study: Study, block: Block, participant: int = 1) -> Trial | None:
    """The first trial that ``block`` would show; None where the participant's group does not see it."""
    return next((trial for trial in procedure(study, participant) if trial.block == block.name), None)


def _block(study: Study, block: Block, plans: Sequence[Sequence[Trial]]) -> BlockSummary:
    if block.adaptive is not None:
        most, first = size_of_block(study, block), first_adaptive_trial(study, block)
        seconds = 0.0 if first is None else trial_seconds(study, first) * most
        return BlockSummary(block.name, block.kind, most, 0, 0, seconds / 60, {}, block.adaptive.kind)
    name = block.name
    mine = [[trial for trial in trials if trial.block == name] for trials in plans]
    usual = next((trials for trials in mine if trials), [])
    main = [trial for trials in mine for trial in trials if trial.panels and not trial.practice and not trial.catch]
    return BlockSummary(
        name=name,
        kind=block.kind,
        trials=sum(1 for t in usual if t.panels and not t.practice and not t.catch),
        practice=sum(1 for t in usual if t.practice),
        catch=sum(1 for t in usual if t.catch),
        minutes=sum(trial_seconds(study, trial) for trial in usual) / 60,
        balance=balance(main),
    )


def balance(trials: Iterable[Trial]) -> dict[str, tuple[int, int]]:
    """How evenly things occur over ``trials``: each cell, each factor's levels, each condition at the first slot, and
    each two conditions against each other: name -> (least, most)."""
    listed = list(trials)
    if not listed:
        return {}
    factors = [name for name in listed[0].factors if name != "pair"]
    counts: dict[str, Counter[str]] = {"cell": Counter(column(trial, "cell") for trial in listed)}
    for name in factors:
        counts[name] = Counter(trial.factors[name] for trial in listed)
    pairs = [[p for p in trial.panels if p.role != "reference"] for trial in listed]
    if any(len(panels) > 1 for panels in pairs):
        first: Counter[str] = Counter()
        for panels in pairs:
            for rank, shown in enumerate(panels):
                first[shown.condition] += 1 if rank == 0 else -1 if rank == len(panels) - 1 else 0
        counts["first_minus_last_slot"] = first
        counts["pair"] = Counter(
            "|".join(sorted(two)) for panels in pairs for two in combinations([p.condition for p in panels], 2)
        )
    return {name: (min(count.values()), max(count.values())) for name, count in counts.items() if count}


def _notes(study: Study, clips: Sequence[ClipSpec]) -> Iterable[str]:
    """What is allowed and should still be known."""
    compared = {name for match in study.match for name in match.conditions}
    for block in study.blocks:
        if block.compare is not None:
            loose = [n for n in study.expand(block.compare.of) if n not in compared]
            if loose:
                yield f"block {block.name}: unmatched comparison ({', '.join(loose)}); the report labels it so"
    if not study.analysis.tests:
        yield "no analysis plan: every result will be labelled exploratory"
    for spec in clips:
        if spec.loop == "closed" and spec.path == "file":
            yield f"scene {spec.scene}: a closed loop needs a periodic path"
            break
    if study.replication is not None and study.replication.kind == "proposal":
        yield f"a proposal, not a replication: {study.replication.of}"


def size_problems(study: Study) -> list[Problem]:
    """Trials whose panels do not fit on the display, one for each block."""
    found: dict[str, Problem] = {}
    places = {block.name: index for index, block in enumerate(study.blocks)}
    width, height = study.display.size_px
    for trial in plan(study, 1):
        if not trial.panels:
            continue
        w, h = (int(side) for side in trial.settings["size_px"])
        gap = int(trial.settings["gap_px"])
        across = {"two_interval": 1, "likert": 1}.get(trial.kind, 2 if len(trial.panels) == 4 else len(trial.panels))
        down = 2 if trial.kind == "forced_choice" and len(trial.panels) == 4 else 1
        need = (w * across + gap * (across - 1), h * down + gap * (down - 1))
        if need[0] > width or need[1] > height:
            wanted = f"at most {width}x{height} px (display.size_px)"
            what = f"block {trial.block}: panels"
            found[trial.block] = ("blocks", places[trial.block]), what, f"{need[0]}x{need[1]} px", wanted
    return list(found.values())
