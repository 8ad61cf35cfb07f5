"""analysis.R: the report's main tables once more, from trials.csv, with afex, emmeans and lme4."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from analysis.sessions import Session

_HEAD = """\
# {study}: the main tables from trials.csv, with R. Made by `studyapp export --csv`.
# {who}
# Needs R >= 4.1 with afex, emmeans and lme4:  Rscript analysis.R  (in this folder)
suppressPackageStartupMessages({{
  library(afex)
  library(emmeans)
  library(lme4)
}})
afex_options(type = 3, correction_aov = "GG", es_aov = c("ges", "pes"))
trials <- read.csv("trials.csv", stringsAsFactors = FALSE, check.names = FALSE,
                   colClasses = c(participant = "character"), na.strings = "")
trials <- trials[!(trials$excluded %in% c("True", "TRUE", TRUE)), ]
trials$participant <- factor(trials$participant)
"""
_QUESTION = """
# ---- {name}: {text}
rated <- trials[!is.na(trials[["{dv}"]]), ]
rated$dv <- as.numeric(rated[["{dv}"]])
{factors}
# repetitions are averaged within participants
cells <- aggregate(dv ~ participant + {plus}, rated, mean)
model <- aov_ez("participant", "dv", cells, within = c({within}))
print(model)
print(pairs(emmeans(model, ~ {first}), adjust = "holm"))
means <- aggregate(dv ~ participant + {first}, rated, mean)
print(friedman.test(dv ~ {first} | participant, means))
print(summary(lmer(dv ~ {star} + (1 | participant), rated)))
"""
_CHOICES = """
# ---- choices: Bradley-Terry as a logistic regression without intercept; one column a condition
chosen <- trials[!is.na(trials$winner), ]
items <- sort(unique(c(chosen$winner, chosen$loser)))
x <- sapply(items, function(item) (chosen$winner == item) - (chosen$loser == item))
fit <- glm(rep(1, nrow(chosen)) ~ 0 + x[, -1, drop = FALSE], family = binomial)
# model-based errors: the report's are over participants, and wider where they differ
print(summary(fit))
for (pair in combn(items, 2, simplify = FALSE)) {
  own <- chosen[chosen$winner %in% pair & chosen$loser %in% pair, ]
  if (nrow(own) == 0) next
  shares <- tapply(own$winner == pair[1], droplevels(own$participant), mean)
  if (all(table(droplevels(own$participant)) == 1)) {
    print(pair); print(binom.test(sum(shares), length(shares)))
  } else if (length(shares) > 1 && sd(shares) > 0) {
    print(pair); print(t.test(shares, mu = 0.5))  # the participant is the unit
  }
}
"""


def _quoted(text: str) -> str:
    return re.sub(r"[\n\r]+", " ", text).replace("\\", "\\\\").replace('"', '\\"')


def _name(text: str) -> str:
    """A column name as R's formulas take it."""
    return text if re.fullmatch(r"[A-Za-z.][A-Za-z0-9._]*", text) else f"`{text}`"


def r_script(
    sessions: Sequence[Session], questions: Mapping[str, Mapping[str, Any]], factors: Sequence[str], choices: bool
) -> str:
    """The script as text; the parts that this study's answers allow."""
    simulated = sessions[0].observer_kind == "simulated"
    who = "SIMULATED: no person answered." if simulated else "Answers by persons."
    parts = [_HEAD.format(study=_quoted(str(sessions[0].header.get("study", "study"))), who=who)]
    for name, question in questions.items():
        if not factors:
            continue
        lines = "\n".join(f'rated[["{_quoted(f)}"]] <- factor(rated[["{_quoted(f)}"]])' for f in factors)
        quoted = [_name(factor) for factor in factors]
        within = ", ".join(f'"{_quoted(factor)}"' for factor in factors)
        text = _quoted(str(question.get("text", "")))
        parts.append(
            _QUESTION.format(name=name, text=text, dv=_quoted(f"rating_{name}"), factors=lines, within=within,
                             plus=" + ".join(quoted), star=" * ".join(quoted), first=quoted[0])
        )  # fmt: skip
    return "".join([*parts, _CHOICES if choices else ""])
