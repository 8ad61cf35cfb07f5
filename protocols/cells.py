"""A block's design as cells: which factor levels meet, with which settings and which conditions, before any order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any

from protocols.blocks import PAIR_KINDS, Block, ExplicitTrial
from protocols.conditions import Condition
from protocols.study import Study, varied_name
from protocols.trial import Panel
from renderers.catalogue import CATALOGUE


@dataclass(frozen=True)
class Cell:
    """One combination of factor levels; ``members``: the conditions that stand together (one in Likert trials)."""

    scene: str
    members: tuple[str, ...]
    levels: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Names the cell within its block."""
        return "|".join(self.members) + "@" + ":".join(f"{k}={v}" for k, v in self.levels.items())


def block_cells(study: Study, block: Block, group: Mapping[str, str], slot: int | None = None) -> tuple[Cell, ...]:
    """The cells of a block for the people of ``group`` (between factor -> level).

    ``slot`` chooses which levels a set of conditions meets where the block spreads sets over factors; None: all.
    """
    if block.trials is not None:
        return tuple(
            explicit_cell(study, block, trial, group) for trial in block.trials for _ in range(trial.repetitions)
        )
    factors = {name: factor_levels(study, name, list(levels)) for name, levels in block.factors.items()}
    if block.kind not in PAIR_KINDS:
        return tuple(
            _cell(study, block, dict(zip(factors, pick, strict=True)), group, ()) for pick in product(*factors.values())
        )
    sets = condition_sets(study, block) if block.adaptive is None else adaptive_sets(study, block)
    spread = block.compare.spread_over if block.compare is not None and slot is not None else []
    fixed = {name: levels for name, levels in factors.items() if name not in spread}
    moving = [dict(zip(spread, pick, strict=True)) for pick in product(*(factors[name] for name in spread))]
    cells = []
    for pick in product(*fixed.values()):
        base = dict(zip(fixed, pick, strict=True))
        for rank, members in enumerate(sets):
            # Neighbouring sets and neighbouring participants get different levels, all equally often.
            turn = moving[(rank + (slot or 0)) % len(moving)] if spread else {}
            levels = {name: {**base, **turn}[name] for name in factors}
            cells.append(_cell(study, block, levels, group, members))
    return tuple(cells)


def factor_levels(study: Study, factor: str, levels: list[str]) -> list[str]:
    """The levels of a factor; in ``condition``, ``techniques`` stands for the conditions of the study's line."""
    return list(study.expand(levels)) if factor == "condition" else levels


def condition_sets(study: Study, block: Block) -> tuple[tuple[str, ...], ...]:
    """The sets of conditions that stand together in a block of pairs (or triples, ...), in the order written."""
    compare = block.compare
    if compare is None:
        return ()
    of = study.expand(compare.of)
    if isinstance(compare.sets, list):
        return tuple(tuple(members) for members in compare.sets)
    sets = combinations(of, compare.alternatives)
    return tuple(members for members in sets if compare.against is None or compare.against in members)


def adaptive_sets(study: Study, block: Block) -> tuple[tuple[str, ...], ...]:
    """The pairs an adaptive block may come to show."""
    varied = block.adaptive
    if varied is None or varied.kind == "active_pairs":
        return condition_sets(study, block)
    return tuple((varied_name(str(varied.test), value), str(varied.standard)) for value in varied.values)


def explicit_cell(study: Study, block: Block, trial: ExplicitTrial, group: Mapping[str, str]) -> Cell:
    """The cell of a trial that is written out."""
    own = trial.set.model_dump(mode="json", exclude_none=True)
    return _cell(study, block, dict(trial.levels), group, tuple(trial.compare or ()), own)


def _cell(
    study: Study,
    block: Block,
    levels: dict[str, str],
    group: Mapping[str, str],
    members: tuple[str, ...],
    own: Mapping[str, Any] | None = None,
) -> Cell:
    scene = levels.get("scene") or next(iter(study.scenes))
    settings = study.base_settings(scene)
    _lay(settings, block.set.model_dump(mode="json", exclude_none=True))
    tables = {**study.participants.between, **block.factors}
    for name, level in {**group, **levels}.items():
        if name in ("path", "fixation", "condition"):
            settings[name] = level
        if name in tables and level in tables[name]:
            _lay(settings, tables[name][level].model_dump(mode="json", exclude_none=True))
    _lay(settings, own or {})
    if block.kind not in PAIR_KINDS:
        members = (str(settings["condition"]),) if "condition" in settings else ()
    return Cell(scene, members, levels, settings)


def _lay(settings: dict[str, Any], over: Mapping[str, Any]) -> None:
    """Lay one level of the cascade over the wider ones; parameters are joined, all else is replaced."""
    for key, value in over.items():
        settings[key] = {**settings.get("params", {}), **value} if key == "params" else value


def panel(study: Study, cell: Cell, name: str, slot: str, role: str = "candidate") -> Panel:
    """Condition ``name`` in ``slot``, with its parameters complete. The trial's own ``params`` go to every condition
    whose technique knows them, references excepted."""
    condition: Condition = study.all_conditions()[name]
    params = dict(condition.params)
    extra = cell.settings.get("params", {})
    if condition.technique in CATALOGUE:
        model = CATALOGUE[condition.technique].params
        if role != "reference":
            params.update({key: value for key, value in extra.items() if key in model.model_fields})
        params = model.model_validate(params).model_dump(mode="json")
    elif role != "reference":
        params.update(extra)
    rate = condition.rate_hz or cell.settings.get("rate_hz") or study.display.refresh_hz
    live = condition.live if condition.live is not None else bool(cell.settings.get("live"))
    return Panel(slot, name, condition.technique, role, params, str(rate), "", live)
