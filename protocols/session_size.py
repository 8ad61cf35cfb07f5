"""Sessions that nobody could sit through."""

from __future__ import annotations

from collections.abc import Iterator
from math import comb, prod

from protocols.blocks import WORD_KINDS, Block
from protocols.names import Problem
from protocols.study import Study

MAX_TRIALS = 3000


def size_of_block(study: Study, block: Block) -> int:
    """How many trials a block has for one participant, by arithmetic, before anything is formed."""
    if block.kind in WORD_KINDS:
        return 1
    practice = sum(t.repetitions for t in block.practice) if isinstance(block.practice, list) else block.practice
    extra = practice + (block.catch.trials if block.catch else 0)
    if block.adaptive is not None:
        return block.adaptive.trials * prod(len(levels) for levels in block.factors.values())
    if block.trials is not None:
        return sum(trial.repetitions for trial in block.trials) + extra
    compare, cells = block.compare, 1
    spread = compare.spread_over if compare is not None else []
    for name, levels in block.factors.items():
        count = len(study.expand(list(levels))) if name == "condition" else len(levels)
        cells *= 1 if name in spread else count
    if compare is not None:
        of = len(study.expand(compare.of))
        cells *= len(compare.sets) if isinstance(compare.sets, list) else comb(of, compare.alternatives)
    return cells * block.repetitions + extra


def size_problems(study: Study) -> Iterator[Problem]:
    """Sessions that nobody could sit through (and that no plan should try to hold)."""
    sizes = [size_of_block(study, block) for block in study.blocks]
    for index, size in enumerate(sizes):
        if size > MAX_TRIALS:
            yield ("blocks", index), f"blocks[{index}]", f"{size} trials", f"at most {MAX_TRIALS} for a participant"
    if sum(sizes) > MAX_TRIALS and max(sizes) <= MAX_TRIALS:
        yield ("blocks",), "blocks", f"{sum(sizes)} trials", f"at most {MAX_TRIALS} for a participant"
