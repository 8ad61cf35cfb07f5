from __future__ import annotations

from tests.prove.yaml_mutations import KINDS, faults, run


def test_mutated_protocols_end_with_0_or_2_and_name_what_was_planted() -> None:
    outcomes = run(6 * len(KINDS), seed=1)
    # Four times the limit here, since other work may share the machine; `make prove` holds it as it is.
    assert faults(outcomes, limit_s=8.0) == []
    assert {o.code for o in outcomes} == {0, 2}
