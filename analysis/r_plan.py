"""The planned tests of analysis.R: helper functions in R, and one call a planned test with its own options.

Base R, afex (ANOVA), lme4 and lmerTest (mixed models), and ordinal (cumulative link models) where it is installed. What
R's packages do otherwise than the report stands as a comment beside the call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from analysis.comparisons import is_adaptive
from analysis.multiplicity import ALIASES
from analysis.plan import rows_of
from analysis.plan_tests import formula_of, pair_of, random_terms
from analysis.planned_test import Plan, Test, column_of
from stimuli.errors import InputError

HELPERS = """
# ---- the planned tests: their rows, then each by its own function
own_rows <- function(dv, block = NULL, where = list()) {
  own <- trials
  if (!is.null(block)) own <- own[own$block %in% block, ]
  for (column in names(where)) own <- own[as.character(own[[column]]) %in% where[[column]], ]
  if (!is.null(dv)) {
    own$dv <- as.numeric(own[[dv]])
    own <- own[!is.na(own$dv), ]
  }
  own
}
chosen_rows <- function(question = NULL, ...) {
  own <- own_rows(NULL, ...)
  column <- paste0("response_", question)
  if (is.null(question) || !(column %in% names(own))) return(own[!is.na(own$winner), ])
  pairs <- strsplit(own$condition, "|", fixed = TRUE)
  good <- mapply(function(pair, answer) length(pair) == 2 && !is.na(answer) && answer %in% pair, pairs, own[[column]])
  own <- own[good, ]
  own$winner <- own[[column]]
  own$loser <- mapply(function(pair, answer) c(pair[pair != answer], answer)[1], pairs[good], own$winner)
  own
}
asked_rows <- function(own, asked) {
  own <- own[own$winner == asked | own$loser == asked, ]
  own$dv <- as.numeric(own$winner == asked)
  own
}
right_rows <- function(...) {
  own <- own_rows(NULL, ...)
  varied <- grepl("@", own$condition, fixed = TRUE) & is.na(own$correct) & !is.na(own$winner)
  own <- own[!is.na(own$correct) | varied, ]
  is_right <- function(correct, side, response, winner) {
    if (is.na(correct)) return(!grepl("@", winner, fixed = TRUE))
    if (!grepl("..", correct, fixed = TRUE)) return(correct %in% c(side, response))
    ends <- as.numeric(strsplit(correct, "..", fixed = TRUE)[[1]])
    given <- suppressWarnings(as.numeric(response))
    !is.na(given) && given >= ends[1] && given <= ends[2]
  }
  own$dv <- as.numeric(mapply(is_right, own$correct, own$side, own$response, own$winner))
  own
}
as_factors <- function(own, names) {
  for (name in names) own[[name]] <- factor(own[[name]], sort(unique(as.character(own[[name]])), method = "radix"))
  own$participant <- factor(own$participant)
  own
}
person_means <- function(own, factors) aggregate(own["dv"], own[c("participant", factors)], mean)
# participants by levels of one factor, those without every level left out
wide_means <- function(own, factor) {
  means <- person_means(as_factors(own, factor), factor)
  wide <- tapply(means$dv, means[c("participant", factor)], mean)
  wide[stats::complete.cases(wide), , drop = FALSE]
}
planned_anova <- function(own, within, between = NULL) {
  cells <- person_means(as_factors(own, c(within, between)), c(within, between))
  model <- aov_ez("participant", "dv", cells, within = within, between = between)
  as.data.frame(model$anova_table)
}
planned_oneway <- function(own, between) {
  means <- person_means(as_factors(own, between), between)
  as.data.frame(anova(lm(means$dv ~ means[[between]])))
}
planned_pairs <- function(own, factor, adjust) {
  wide <- wide_means(own, factor)
  one <- function(pair) {
    a <- wide[, pair[1]]
    b <- wide[, pair[2]]
    if (sd(a - b) < 1e-12) return(data.frame(mean_diff = mean(a - b), t = NA, df = NA, p = NA))  # t needs a spread
    test <- t.test(a, b, paired = TRUE)
    data.frame(mean_diff = mean(a - b), t = unname(test$statistic), df = unname(test$parameter), p = test$p.value)
  }
  pairs <- t(combn(colnames(wide), 2))
  made <- cbind(data.frame(a = pairs[, 1], b = pairs[, 2]), do.call(rbind, apply(pairs, 1, one, simplify = FALSE)))
  made$p_adjusted <- p.adjust(made$p, adjust)
  made
}
planned_friedman <- function(own, factor) {
  test <- friedman.test(wide_means(own, factor))
  data.frame(chi2 = unname(test$statistic), df = unname(test$parameter), p = test$p.value)
}
planned_wilcoxon <- function(own, factor, a, b) {
  wide <- wide_means(own[own[[factor]] %in% c(a, b), ], factor)
  test <- wilcox.test(wide[, a], wide[, b], paired = TRUE, exact = FALSE, correct = FALSE)
  data.frame(statistic = unname(test$statistic), p_normal = test$p.value)
}
planned_tost <- function(own, factor, a, b, low, high) {
  wide <- wide_means(own[own[[factor]] %in% c(a, b), ], factor)
  above <- t.test(wide[, a], wide[, b], paired = TRUE, mu = low, alternative = "greater")
  below <- t.test(wide[, a], wide[, b], paired = TRUE, mu = high, alternative = "less")
  data.frame(mean_diff = mean(wide[, a] - wide[, b]), t_low = unname(above$statistic), t_high = unname(below$statistic),
             df = unname(above$parameter), p = max(above$p.value, below$p.value))
}
planned_share <- function(own, p0) {
  shares <- tapply(own$dv, factor(own$participant), mean)
  single <- nrow(own) == length(shares)
  test <- if (single) binom.test(sum(own$dv), nrow(own), p0)
          else if (length(shares) > 1 && sd(shares) > 1e-12) t.test(shares, mu = p0) else list(p.value = NA)
  data.frame(participants = length(shares), share = mean(shares), p = test$p.value)
}
planned_lmm <- function(own, formula, factors) {
  model <- lmerTest::lmer(as.formula(formula), as_factors(own, factors))
  if (isSingular(model)) cat("singular fit: the report lets variances be negative here, and its p differs\\n")
  list(terms = as.data.frame(coef(summary(model))), f_tests = as.data.frame(anova(model, type = 3)))
}
planned_clmm <- function(own, formula, factors) {
  if (!requireNamespace("ordinal", quietly = TRUE)) return("ordinal is not installed: no cumulative link model")
  own <- as_factors(own, factors)
  own$dv <- factor(own$dv, ordered = TRUE)
  as.data.frame(coef(summary(ordinal::clmm(as.formula(formula), own, nAGQ = 10))))
}
planned_glmm <- function(own, formula, factors) {
  one <- lengths(regmatches(formula, gregexpr("|", formula, fixed = TRUE))) == 1
  model <- glmer(as.formula(formula), as_factors(own, factors), family = binomial, nAGQ = if (one) 21 else 1)
  as.data.frame(coef(summary(model)))
}
planned_scale <- function(chosen, link = "logit", unit = 1) {
  items <- sort(unique(c(chosen$winner, chosen$loser)), method = "radix")
  x <- sapply(items, function(item) (chosen$winner == item) - (chosen$loser == item))
  x <- matrix(x, nrow = nrow(chosen))
  # separated answers (a warning, a huge value) and unconnected items (NA) have no finite value
  fit <- glm(rep(1, nrow(chosen)) ~ 0 + x[, -1, drop = FALSE], family = binomial(link))
  data.frame(item = items, value = c(0, unname(coef(fit))) / unit)
}
planned_summary <- function(own, by) {
  made <- aggregate(own["dv"], own[by], function(v) c(n = length(v), mean = mean(v), sd = sd(v), median = median(v)))
  do.call(data.frame, made)
}
planned_mcnemar <- function(own, factor, a, b) {
  wide <- wide_means(own[own[[factor]] %in% c(a, b), ], factor)
  counts <- c(sum(wide[, a] > wide[, b]), sum(wide[, a] < wide[, b]))
  p <- if (sum(counts) > 0) binom.test(counts[1], sum(counts))$p.value else NA
  data.frame(b = counts[1], c = counts[2], p = p)
}
planned_cochran <- function(own, factor) {
  y <- wide_means(own, factor)
  k <- ncol(y)
  q <- (k - 1) * (k * sum(colSums(y)^2) - sum(y)^2) / (k * sum(y) - sum(rowSums(y)^2))
  data.frame(Q = q, df = k - 1, p = pchisq(q, k - 1, lower.tail = FALSE))
}
planned_dprime <- function(own) {
  own$m <- lengths(strsplit(own$condition, "|", fixed = TRUE))
  made <- aggregate(own["dv"], own[c("participant", "m")], mean)
  share <- function(d, m) integrate(function(z) dnorm(z - d) * pnorm(z)^(m - 1), -10, 15, rel.tol = 1e-10)$value
  one <- function(p, m) {
    if (p <= 0 || p >= 1) return(if (p <= 0) -Inf else Inf)
    uniroot(function(d) share(d, m) - p, c(-8, 8), tol = 1e-10)$root
  }
  made$dprime <- mapply(one, made$dv, made$m)
  made
}
"""

_PAIRED = {"wilcoxon": "planned_wilcoxon", "tost": "planned_tost", "mcnemar": "planned_mcnemar"}


def text(value: str) -> str:
    """An R string."""
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + escaped.replace("\n", " ").replace("\r", " ") + '"'


def _vector(values: Sequence[str]) -> str:
    return f"c({', '.join(map(text, values))})"


def _column(name: str) -> str:
    """The key of a named list."""
    return f"`{name}`"


def planned_tests(plan: Plan, kept: pd.DataFrame) -> str:
    """The script's part for a stated plan: every test in its order, those that R does not make as comments."""
    parts = [HELPERS]
    for test in plan.tests:
        hypothesis = " ".join(str(test.options.get("hypothesis") or "").split())
        parts.append(f"\n# {_plain(test.name)} ({test.test}){': ' + hypothesis if hypothesis else ''}\n")
        family = test.options.get("family")
        if family:
            parts.append(f"# the report adjusts the p values of the family {_plain(str(family))} together\n")
        try:
            parts += [_call(one, name, kept, plan) for one, name in _separately(test, kept)]
        except InputError as error:
            parts.append(f"# not made: {_plain(str(error))}\n")
    return "".join(parts)


def _plain(words: str) -> str:
    return " ".join(words.split())


def _separately(test: Test, kept: pd.DataFrame) -> list[tuple[Test, str]]:
    """The test at every combination of levels of ``separately_by``, each with its name."""
    if not test.separately_by:
        return [(test, test.name)]
    own, _ = rows_of(kept, test)
    columns = list(test.separately_by)
    levels = pd.concat([column_of(own, name, test) for name in columns], axis=1).dropna().astype(str).drop_duplicates()
    found = []
    for combination in sorted(levels.itertuples(index=False, name=None)):
        where = {**test.where, **{name: [level] for name, level in zip(columns, combination, strict=True)}}
        found.append((replace(test, where=where, separately_by=()), f"{test.name}: {', '.join(combination)}"))
    return found


def _call(test: Test, name: str, kept: pd.DataFrame, plan: Plan) -> str:
    """One test as R; a comment where it is the report's alone. Raises InputError as the test itself does."""
    own, dv = rows_of(kept, test)
    if own.empty:
        return "# no analysed trial answers this test\n"
    if test.test != "psychometric" and test.dv in ("choice", "correct") and is_adaptive(own).any():
        return "# not made: a staircase or QUEST+ chose these trials\n"
    made = _made(test, own, dv, plan)
    if made is None:
        return f"# {test.test} is the report's own: not made here\n"
    return f"keep({text(name)}, {made})\n"


def _rows(test: Test, own: pd.DataFrame, dv: str) -> str:
    """The R expression of the test's rows."""
    some = []
    if test.options.get("block") is not None:
        some.append(f"block = {text(str(test.options['block']))}")
    if test.where:
        wheres = ", ".join(f"{_column(name)} = {_vector(levels)}" for name, levels in test.where.items())
        some.append(f"where = list({wheres})")
    rest = "".join(f", {one}" for one in some)
    if test.dv == "correct":
        return f"right_rows({rest.removeprefix(', ')})"
    if test.dv != "choice":
        return f"own_rows({text(dv)}{rest})"
    question = test.options.get("question")
    chosen = f"chosen_rows({text(str(question)) if question else 'NULL'}{rest})"
    if test.test in ("bradley_terry", "thurstone"):
        return chosen
    asked = test.options.get("choice") or test.options.get("a") or min({*own["winner"], *own["loser"]})
    return f"asked_rows({chosen}, {text(str(asked))})"


def _made(test: Test, own: pd.DataFrame, dv: str, plan: Plan) -> str | None:
    """The R call on the rows; None where there is none."""
    rows, first = _rows(test, own, dv), text(test.within[0] if test.within else "condition")
    if test.subject != "participant":
        return None
    if test.test == "tost" and None in (test.options.get("low"), test.options.get("high")):
        return None
    match test.test:
        case "rm_anova":
            between = f", {_vector(test.between)}" if test.between else ""
            return f"planned_anova({rows}, {_vector(test.within)}{between})"
        case "oneway_anova":
            return f"planned_oneway({rows}, {text(test.between[0])})"
        case "posthoc_t":
            adjust = str(test.options.get("adjust") or plan.adjust)
            return f"planned_pairs({rows}, {first}, {text(ALIASES.get(adjust, adjust))})"
        case "friedman":
            return f"planned_friedman({rows}, {first})"
        case "cochran_q":
            return f"planned_cochran({rows}, {first})"
        case "wilcoxon" | "tost" | "mcnemar":
            pair = pair_of(own, dv, test)
            bounds = f", {test.options['low']:g}, {test.options['high']:g}" if test.test == "tost" else ""
            return f"{_PAIRED[test.test]}({rows}, {first}, {text(pair.a)}, {text(pair.b)}{bounds})"
        case "likert_summary":
            return f"planned_summary({rows}, {_vector(test.within or ('condition',))})"
        case "bradley_terry":
            return f"planned_scale({rows})"
        case "thurstone" if test.options.get("method") in (None, "ml"):
            unit = "qnorm(0.75)" if test.options.get("unit") != "z" else "1"
            return f'planned_scale({rows}, "probit", {unit})'
        case "dprime":
            return f"planned_dprime({rows})"
        case "binomial_choice":
            m = own["condition"].astype(str).str.count(r"\|").max() + 1
            chance = float(test.options.get("p0") or (1 / m if test.dv == "correct" and m > 1 else 0.5))
            return f"planned_share({rows}, {chance!r})"
        case "linear_mixed" | "cumulative_link" | "binomial_mixed":
            return _mixed(test, own, dv, rows)
        case _:
            return None


def _mixed(test: Test, own: pd.DataFrame, dv: str, rows: str) -> str:
    """A mixed model with the random effects that the report gives it."""
    formula = str(test.options.get("formula") or f"{dv} ~ 1") if test.test == "binomial_mixed" else formula_of(dv, test)
    right = formula.partition("~")[2].strip()
    random = random_terms(own, test, formula)
    written = " + ".join(["dv ~ " + right, *(one if one.startswith("(") else f"(1|{one})" for one in random)])
    factors = [str(name) for name in own if str(name) in right and not pd.api.types.is_numeric_dtype(own[name])]
    call = {"linear_mixed": "planned_lmm", "cumulative_link": "planned_clmm", "binomial_mixed": "planned_glmm"}
    names = _vector(factors) if factors else "character(0)"
    return f"{call[test.test]}({rows}, {text(written)}, {names})"
