"""Participant N's trials in order: a pure function of the protocol, N and the seed."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from protocols.blocks import PAIR_KINDS, WORD_KINDS, Block
from protocols.cells import Cell, block_cells, explicit_cell, panel
from protocols.latin import balanced_rows
from protocols.quantity import seconds
from protocols.question import QuestionSpec
from protocols.shuffle import constrained_order
from protocols.sides import SLOTS, placements
from protocols.study import Study
from protocols.trial import Panel, Question, Trial
from stimuli.errors import InputError, problem


def plan(study: Study, participant: int, seed: int | None = None) -> tuple[Trial, ...]:
    """The trials of participant (slot) ``participant`` >= 1, practice, catch trials, words and breaks included.

    ``seed``: instead of the study's own. Blocks with an adaptive procedure hold no trials here: see
    `protocols.adaptive.procedure`. Raises InputError where an order's constraints cannot be met.
    """
    if participant < 1:
        raise InputError(problem("participant", "number", participant, "a whole number from 1"))
    seed = study.seed if seed is None else seed
    group = group_of(study, participant, seed)
    trials: list[Trial] = []
    for block in ordered_blocks(study, group, participant, seed):
        trials += _block_trials(study, block, group, participant, seed)
    return tuple(replace(trial, index=index) for index, trial in enumerate(trials))


def stream(seed: int, *words: str | int) -> np.random.Generator:
    """A generator of its own for each purpose (text is taken by its CRC-32): the same on every machine."""
    entropy = [seed, *(zlib.crc32(word.encode()) if isinstance(word, str) else word for word in words)]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy)))


def group_of(study: Study, participant: int, seed: int | None = None) -> dict[str, str]:
    """The levels of the between-subject factors: each combination once in every run of as many participants."""
    between = study.participants.between
    combinations = [dict(zip(between, pick, strict=True)) for pick in product(*between.values())]
    turn, place = divmod(participant - 1, len(combinations))
    order = stream(study.seed if seed is None else seed, "groups", turn).permutation(len(combinations))
    return combinations[int(order[place])]


def ordered_blocks(study: Study, group: Mapping[str, str], participant: int, seed: int) -> list[Block]:
    """The blocks this person sees; blocks of words keep their places when the others change theirs."""
    blocks = [b for b in study.blocks if all(group.get(factor) == level for factor, level in b.only.items())]
    places = [i for i, block in enumerate(blocks) if block.kind not in WORD_KINDS]
    if study.block_order == "as_written" or len(places) < 2:
        return blocks
    if study.block_order == "latin":
        rows = balanced_rows(len(places))
        order = list(rows[(participant - 1) % len(rows)])
    else:
        order = [int(i) for i in stream(seed, "blocks", participant).permutation(len(places))]
    out = list(blocks)
    for place, chosen in zip(places, order, strict=True):
        out[place] = blocks[places[chosen]]
    return out


def _block_trials(study: Study, block: Block, group: Mapping[str, str], participant: int, seed: int) -> list[Trial]:
    if block.kind in WORD_KINDS:
        return [Trial(0, block.name, block.kind, text=block.text or "")]
    if block.adaptive is not None:
        return []
    maker = TrialMaker(study, block, group, participant, seed)
    cells = block_cells(study, block, group, participant - 1)
    repetitions = 1 if block.trials is not None else block.repetitions
    instances = [(cell, repetition) for repetition in range(repetitions) for cell in cells]
    # Sides are drawn for couples of participants (1, 2), (3, 4), ...: the second sees the mirror image.
    side_rng = stream(seed, "sides", block.name, (participant - 1) // 2)
    placed = placements([c.members for c, _ in instances], [c.key for c, _ in instances], participant, side_rng)
    main = [maker.trial(cell, order, repetition) for (cell, repetition), order in zip(instances, placed, strict=True)]
    main = _in_order(block, instances, main, participant, stream(seed, "order", block.name, participant))
    main = maker.with_catch(main, cells, stream(seed, "catch", block.name, participant))
    practice = maker.practice(cells, stream(seed, "practice", block.name, participant))
    return practice + _with_breaks(block, main)


def _with_breaks(block: Block, trials: list[Trial]) -> list[Trial]:
    if block.break_every is None:
        return trials
    out: list[Trial] = []
    for place, trial in enumerate(trials):
        if place and place % block.break_every == 0:
            out.append(Trial(0, block.name, "break", text=block.break_text))
        out.append(trial)
    return out


def _in_order(
    block: Block,
    instances: Sequence[tuple[Cell, int]],
    trials: list[Trial],
    participant: int,
    rng: np.random.Generator,
) -> list[Trial]:
    """The trials in the order that ``block.order`` asks for."""
    order = block.order
    if order.by == "as_written":
        return trials
    factor = order.latin or order.blocked_by
    if factor is None:
        return _shuffled(block, trials, rng)
    levels = sorted({cell.levels[factor] for cell, _ in instances}, key=[c.levels[factor] for c, _ in instances].index)
    repetitions = sorted({repetition for _, repetition in instances})
    runs = [repetitions] if order.by == "blocked" else [[repetition] for repetition in repetitions]
    rows = balanced_rows(len(levels))
    out: list[Trial] = []
    for turn, run in enumerate(runs):
        # One row of the square for each participant and repetition, or the levels at random.
        row = rows[(participant - 1 + turn) % len(rows)] if order.latin == factor else rng.permutation(len(levels))
        for level in [levels[int(i)] for i in row]:
            part = [
                t
                for t, (cell, rep) in zip(trials, instances, strict=True)
                if cell.levels[factor] == level and rep in run
            ]
            out += _shuffled(block, part, rng)
    return out


def _shuffled(block: Block, trials: list[Trial], rng: np.random.Generator) -> list[Trial]:
    longest, distance = block.order.max_in_a_row, block.order.min_distance
    columns = {name: [column(trial, name) for trial in trials] for name in {*longest, *distance}}
    order = constrained_order(columns or {"": [""] * len(trials)}, rng, longest, distance)
    if order is None:
        kept = {
            **{f"max_in_a_row {k}": v for k, v in longest.items()},
            **{f"min_distance {k}": v for k, v in distance.items()},
        }
        said = ", ".join(f"{name} {value}" for name, value in kept.items())
        raise InputError(problem(f"block {block.name}", "order", said, "constraints that some order can meet"))
    return [trials[i] for i in order]


def column(trial: Trial, name: str) -> str:
    """A trial's value of a factor, or of scene, condition, technique, side, pair, cell ..."""
    candidates = [p for p in trial.panels if p.role != "reference"]
    if name in trial.factors:
        return trial.factors[name]
    own = {
        "scene": trial.scene,
        "condition": "|".join(sorted(p.condition for p in candidates)),
        "technique": "|".join(sorted(p.technique for p in candidates)),
        "path": trial.path,
        "fixation": trial.fixation,
        "side": candidates[0].condition if candidates else "",
        "block": trial.block,
        "repetition": str(trial.repetition),
    }
    if name == "cell":
        return own["condition"] + "@" + ":".join(f"{k}={v}" for k, v in sorted(trial.factors.items()))
    return own[name]


class TrialMaker:
    """Makes the trials of one block for one participant (a value's worth of context, no state)."""

    def __init__(self, study: Study, block: Block, group: Mapping[str, str], participant: int, seed: int) -> None:
        self.study, self.block, self.group, self.participant, self.seed = study, block, group, participant, seed
        self._panels: dict[tuple[str, str], Panel] = {}
        self._questions: dict[tuple[str, ...], tuple[Question, ...]] = {}

    def trial(self, cell: Cell, order: tuple[str, ...], repetition: int, **marks: Any) -> Trial:
        """One trial of ``cell`` with the candidates in ``order`` of the slots."""
        block = self.block
        slots = SLOTS[(block.kind, len(order))] if block.kind in PAIR_KINDS else ("centre",)
        panels = [self._panel(cell, name, slot) for name, slot in zip(order, slots, strict=True)]
        if block.reference is not None:
            slot = "reference" if block.kind == "two_interval" else "centre" if len(order) == 2 else "reference"
            panels.insert(0 if slot == "reference" else 1, self._panel(cell, block.reference, slot, "reference"))
        factors = {**self.group, **cell.levels}
        if block.kind in PAIR_KINDS:
            factors["pair"] = "|".join(sorted(order))
        settings = {k: v for k, v in cell.settings.items() if k not in ("path", "fixation", "duration_s", "condition")}
        return Trial(
            index=0, block=block.name, kind=block.kind, scene=cell.scene, path=str(cell.settings["path"]),
            panels=tuple(panels), questions=self._asked(tuple(slots)), duration_s=seconds(cell.settings["duration_s"]),
            repetition=repetition, text=block.text or "", fixation=str(cell.settings["fixation"]), factors=factors,
            settings={**settings, "duration_s": cell.settings["duration_s"], "feedback": block.feedback}, **marks,
        )  # fmt: skip

    def _panel(self, cell: Cell, name: str, slot: str, role: str = "candidate") -> Panel:
        extra = cell.settings.get("params")
        if extra:
            return panel(self.study, cell, name, slot, role)
        key = (name + "\0" + role + "\0" + str(cell.settings.get("rate_hz")) + str(cell.settings.get("live")), slot)
        if key not in self._panels:
            self._panels[key] = panel(self.study, cell, name, slot, role)
        return self._panels[key]

    def _asked(self, slots: tuple[str, ...]) -> tuple[Question, ...]:
        if slots not in self._questions:
            named = [(name, self.study.questions[name]) for name in self.block.questions]
            self._questions[slots] = tuple(
                question(name, spec, slots, exchanged(name, spec, self.participant, self.seed)) for name, spec in named
            )
        return self._questions[slots]

    def with_catch(self, trials: list[Trial], cells: Sequence[Cell], rng: np.random.Generator) -> list[Trial]:
        """Catch trials put among ``trials`` at random places, never first."""
        catch = self.block.catch
        if catch is None or not cells:
            return trials
        out = list(trials)
        chosen = rng.permutation(len(cells))
        for number in range(catch.trials):
            cell = cells[int(chosen[number % len(cells)])]
            if self.block.kind in PAIR_KINDS:
                pair = (catch.good or "", catch.bad or "")
                made = self.trial(cell, pair if (number + self.participant) % 2 else pair[::-1], 0, catch=True)
                made = replace(
                    made, correct=next(p.slot for p in made.panels if p.condition == pair[0] and p.role != "reference")
                )
            else:
                shown = Cell(cell.scene, (catch.bad or catch.good or "",), cell.levels, cell.settings)
                low, high = catch.expect or (0, 0)
                made = replace(self.trial(shown, shown.members, 0, catch=True), correct=f"{low}..{high}")
            out.insert(int(rng.integers(min(1, len(out)), len(out) + 1)), made)
        return out

    def practice(self, cells: Sequence[Cell], rng: np.random.Generator) -> list[Trial]:
        """Practice trials: those written, or random cells, with ``practice_set`` laid over them."""
        asked, over = self.block.practice, self.block.practice_set.model_dump(mode="json", exclude_none=True)
        if isinstance(asked, list):
            drawn = [explicit_cell(self.study, self.block, t, self.group) for t in asked for _ in range(t.repetitions)]
        else:
            # As many different cells as there are, then from the start again.
            rounds = [rng.permutation(len(cells)) for _ in range(-(-asked // max(len(cells), 1)))] if cells else []
            drawn = [cells[int(i)] for i in np.concatenate(rounds)[:asked]] if rounds else []
        drawn = [replace(cell, settings={**cell.settings, **over}) for cell in drawn]
        orders = placements([c.members for c in drawn], [c.key for c in drawn], self.participant, rng)
        return [self.trial(cell, order, 0, practice=True) for cell, order in zip(drawn, orders, strict=True)]


def exchanged(name: str, spec: QuestionSpec, participant: int, seed: int) -> bool:
    """True where this participant's scale or keys run the other way: one of each couple (1, 2), (3, 4), ..."""
    return spec.balance and int(stream(seed, "keys", name, (participant - 1) // 2).integers(2)) == participant % 2


def question(name: str, spec: QuestionSpec, slots: tuple[str, ...], swapped: bool) -> Question:
    """The question as it is put to this participant, keys included."""
    options: tuple[str, ...] = ()
    if spec.kind == "choice":
        options = (*slots, "tie") if spec.ties else slots
        usual = {"left": "left", "right": "right", "centre": "down", "first": "left", "second": "right"}
        keys = {usual.get(slot, str(place)): slot for place, slot in enumerate(slots, 1)}
        if swapped and slots == ("first", "second"):
            keys = {"left": "second", "right": "first"}
        if spec.ties:
            keys["space"] = "tie"
    elif spec.kind == "likert":
        answers = spec.answers[::-1] if swapped else spec.answers
        names = [str(n) for n in range(1, 10)] + ["0", "minus"]
        keys = dict(zip(names, answers, strict=False))
    else:
        options, keys = ("ok",), {"space": "ok"}
    if spec.keys is not None:
        keys = dict(spec.keys)
        if swapped:
            keys = dict(zip(keys, reversed(keys.values()), strict=True))
    return Question(
        name, spec.text, spec.kind, options, spec.low, spec.high, spec.labels, keys, spec.window_s, spec.min_view_s
    )
