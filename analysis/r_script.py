"""analysis.R: the report's main tables once more, from trials.csv, with afex, lmerTest and base R."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from analysis.sessions import Session

_HEAD = """\
# {study}: the main tables from trials.csv, with R. Made by `studyapp export --csv`.
# {who}
# Needs R >= 4.1 with afex and lme4 (lmerTest comes with afex):  Rscript analysis.R  (in this folder)
suppressPackageStartupMessages({{
  library(lme4)
  library(afex)
}})
results <- list()  # every table of this script by name
not_made <- function(error) {{
  cat("not made:", conditionMessage(error), "\\n")
  NULL
}}
keep <- function(name, table) {{
  cat("\\n==", name, "\\n")
  table <- tryCatch(table, error = not_made)  # too few participants, say: the tables after it are still made
  if (is.null(table)) return(invisible())
  print(table)
  results[[name]] <<- table
}}
afex_options(type = 3, correction_aov = "GG", es_aov = c("ges", "pes"))
trials <- read.csv("trials.csv", stringsAsFactors = FALSE, check.names = FALSE,
                   colClasses = c(participant = "character"), na.strings = "")
trials <- trials[!(trials$excluded %in% c("True", "TRUE", TRUE)), ]
trials$participant <- factor(trials$participant)
"""
_QUESTION = """
# ---- {name}: {text}
tryCatch({{
rated <- trials[!is.na(trials[["{dv}"]]), ]
{block}rated$dv <- as.numeric(rated[["{dv}"]])
{factors}
# repetitions are averaged within participants
cells <- aggregate(dv ~ participant + {plus}, rated, mean)
model <- aov_ez("participant", "dv", cells, within = c({within}){between})
keep("{name}: ANOVA", as.data.frame(model$anova_table))
keep("{name}: sphericity", summary(model)$sphericity.tests)
# paired t tests of participant means, Holm
means <- aggregate(dv ~ participant + {first}, rated, mean)
complete <- names(which(table(means$participant) == nlevels(means[[{first_quoted}]])))
means <- droplevels(means[means$participant %in% complete, ])
means <- means[order(means[[{first_quoted}]], means$participant), ]
pairs <- t(combn(levels(means[[{first_quoted}]]), 2))
tests <- apply(pairs, 1, function(pair) {{
  a <- means$dv[means[[{first_quoted}]] == pair[1]]
  b <- means$dv[means[[{first_quoted}]] == pair[2]]
  if (sd(a - b) < 1e-12) return(c(mean(a - b), NA, NA, NA))  # t needs a spread
  test <- t.test(a, b, paired = TRUE)
  c(test$estimate, test$statistic, test$parameter, test$p.value)
}})
tests <- data.frame(pairs, t(tests))
names(tests) <- c("a", "b", "mean_diff", "t", "df", "p")
tests$p_holm <- p.adjust(tests$p, "holm")
keep("{name}: pairs of {first_plain}", tests)
friedman <- friedman.test(dv ~ {first} | participant, means)
keep("{name}: Friedman", data.frame(chi2 = friedman$statistic, df = friedman$parameter, p = friedman$p.value))
# participants differ in their effects too: without those terms their repetitions would count as independent
random <- "(1 | participant)"
for (factor in c({within})) if (max(table(rated$participant, rated[[factor]])) > 1)
  random <- paste0(random, " + (1 | participant:`", factor, "`)")
mixed <- lmerTest::lmer(as.formula(paste("dv ~ {star} +", random)), rated)
keep("{name}: mixed model", as.data.frame(coef(summary(mixed))))
}}, error = not_made)
"""
_CHOICES = """
# ---- choices, block by block: Bradley-Terry as a logistic regression without intercept, one column a condition
bradley_terry <- function(chosen) {
  items <- sort(unique(c(chosen$winner, chosen$loser)), method = "radix")
  x <- sapply(items, function(item) (chosen$winner == item) - (chosen$loser == item))
  x <- matrix(x, nrow = nrow(chosen))
  # separated answers (a warning, a huge value) and unconnected items (NA) have no finite ability
  fit <- glm(rep(1, nrow(chosen)) ~ 0 + x[, -1, drop = FALSE], family = binomial)
  # model-based errors: the report's are over participants, and wider where they differ
  se <- sqrt(diag(as.matrix(vcov(fit, complete = TRUE))))
  data.frame(item = items, ability = c(0, unname(coef(fit))), se_of_trials = c(0, unname(se)))
}
pair_shares <- function(chosen) {
  of_pair <- function(pair) {
    own <- chosen[chosen$winner %in% pair & chosen$loser %in% pair, ]
    if (nrow(own) == 0) return(NULL)
    who <- droplevels(own$participant)
    shares <- tapply(own$winner == pair[1], who, mean)
    # the participant is the unit: exact where each gave one answer, else t of their shares
    p <- NA
    if (all(table(who) == 1)) p <- binom.test(sum(shares), length(shares))$p.value
    else if (length(shares) > 1 && sd(shares) > 0) p <- t.test(shares, mu = 0.5)$p.value
    data.frame(a = pair[1], b = pair[2], participants = length(shares), share = mean(shares), p = p)
  }
  do.call(rbind, combn(sort(unique(c(chosen$winner, chosen$loser)), method = "radix"), 2, of_pair, simplify = FALSE))
}
# trials that a staircase or QUEST+ chose (NAME@VALUE) set their shares themselves: they are not tested
compared <- trials[!is.na(trials$winner) & !grepl("@", trials$condition, fixed = TRUE), ]
for (block in unique(compared$block)) {
  keep(paste0(block, ": Bradley-Terry"), bradley_terry(compared[compared$block == block, ]))
  keep(paste0(block, ": pairs"), pair_shares(compared[compared$block == block, ]))
}
"""


def _quoted(text: str) -> str:
    return re.sub(r"[\n\r]+", " ", text).replace("\\", "\\\\").replace('"', '\\"')


def _name(text: str) -> str:
    """A column name as R's formulas take it."""
    return text if re.fullmatch(r"[A-Za-z.][A-Za-z0-9._]*", text) else f"`{text}`"


def _between(sessions: Sequence[Session]) -> list[str]:
    """Between-participants factors with more than one level among the sessions."""
    levels: dict[str, set[str]] = {}
    for session in sessions:
        group = session.header.get("group")
        for name, level in (group if isinstance(group, Mapping) else {}).items():
            levels.setdefault(str(name), set()).add(str(level))
    return [name for name, found in levels.items() if len(found) > 1]


def _blocks(sessions: Sequence[Session], question: str) -> list[str]:
    """The blocks that ask the question, in the order of the plans: each is analysed by itself."""
    found: dict[str, None] = {}
    for session in sessions:
        for trial in session.header.get("plan") or []:
            if any(one["name"] == question for one in trial.get("questions", ())):
                found[str(trial["block"])] = None
    return list(found)


def r_script(
    sessions: Sequence[Session], questions: Mapping[str, Mapping[str, Any]], factors: Sequence[str], choices: bool,
    planned: str = "",
) -> str:  # fmt: skip
    """The script as text; the parts that this study's answers allow. ``planned`` (`analysis.r_plan.planned_tests`)
    stands in place of the tests derived from the design."""
    simulated = sessions[0].observer_kind == "simulated"
    who = "SIMULATED: no person answered." if simulated else "Answers by persons."
    parts = [_HEAD.format(study=_quoted(str(sessions[0].header.get("study", "study"))), who=who)]
    for name, question in questions.items():
        if planned or not factors:
            continue
        groups = _between(sessions)
        every = [*factors, *groups]
        lines = "\n".join(f'rated[["{_quoted(f)}"]] <- factor(rated[["{_quoted(f)}"]])' for f in every)
        quoted = [_name(factor) for factor in every]
        between = ", ".join(f'"{_quoted(group)}"' for group in groups)
        within = ", ".join(f'"{_quoted(factor)}"' for factor in factors)
        text = _quoted(str(question.get("text", "")))
        asking = _blocks(sessions, name)
        for block in asking if len(asking) > 1 else [None]:
            only = "" if block is None else f'rated <- rated[rated$block == "{_quoted(block)}", ]\n'
            title = name if block is None else f"{name}, block {_quoted(block)}"
            parts.append(
                _QUESTION.format(name=title, text=text, dv=_quoted(f"rating_{name}"), factors=lines, within=within,
                                 between=f", between = c({between})" if groups else "", plus=" + ".join(quoted),
                                 star=" * ".join(quoted), first=quoted[0], first_plain=_quoted(factors[0]),
                                 first_quoted=f'"{_quoted(factors[0])}"', block=only)
            )  # fmt: skip
    return "".join([*parts, planned, _CHOICES if choices else ""])
