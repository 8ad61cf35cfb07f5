"""From session files to statistics and a report; the public names are loaded when they are first asked for (PEP
562)."""

from __future__ import annotations

from importlib import import_module
from typing import Any

# Public name -> the module that defines it.
_HOME = {
    "load_sessions": "sessions",
    "rm_anova": "anova",
    "oneway_anova": "anova",
    "posthoc_t": "posthoc",
    "aligned_rank_anova": "ranks",
    "friedman": "ranks",
    "friedman_posthoc": "ranks",
    "wilcoxon": "signed_ranks",
    "likert_summary": "likert",
    "describe": "likert",
    "binomial_choice": "preference",
    "bradley_terry": "paired_comparison",
    "thurstone": "thurstone_scale",
    "compare_items": "paired_comparison",
    "circular_triads": "observers",
    "screen_observers": "observers",
    "cumulative_link": "ordinal",
    "binomial_mixed": "ordinal",
    "linear_mixed": "mixed",
    "psychometric": "psychometric_function",
    "tost": "equivalence",
    "mcnemar": "categorical",
    "cochran_q": "categorical",
    "dprime": "detection",
    "power": "power_by_simulation",
    "adjust_p": "multiplicity",
    "agreement": "rater_agreement",
    "check_reported": "reported_results",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'analysis' has no attribute {name!r}; it offers {', '.join(__all__)}")
    value = getattr(import_module(f"analysis.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
