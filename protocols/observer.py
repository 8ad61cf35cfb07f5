"""Simulated observers: pure functions from (trial, observer, generator) to answers.

Choices: the utilities of the candidates (with this observer's own preferences), a side bias and Gumbel noise; so
between two the chance is logistic in their difference. Ratings: thresholds on a latent scale, or cell means that hold
exactly over the population. See `protocols.observer_model`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from protocols.design import column, stream
from protocols.observer_model import LikertModel, ObserverModel
from protocols.study import Study
from protocols.trial import Panel, Question, Trial

FIRST_SLOTS = ("left", "first", "top_left")


@dataclass(frozen=True)
class Answer:
    """One answer. ``answer``: slot, rating as text, 'tie' or 'ok'; ``chosen``: the condition chosen; ``key``: the
    device key that gives this answer; ``latency_s``: from the moment the question can be answered; ``rt_s``: from
    stimulus onset (as session files store it). ``timed_out``: no answer (``answer`` '' and ``rt_s`` the window's end).
    """

    question: str
    kind: str
    answer: str
    rating: float | None
    chosen: str | None
    key: str
    latency_s: float
    rt_s: float
    timed_out: bool = False


@dataclass(frozen=True)
class Observer:
    """One simulated person: the model and what is this person's own. All deviations are in logits (utilities) or
    scale points (ratings by cell means)."""

    participant: int
    seed: int
    model: ObserverModel
    techniques: Mapping[str, str]  # condition -> technique
    preference: Mapping[str, float]  # condition -> deviation
    scene_preference: Mapping[tuple[str, str], float]  # (scene, condition) -> deviation
    side_bias: float
    slowness: float  # factor on the median reaction time
    rating_offset: Mapping[str, float]  # question -> offset
    level_offset: Mapping[tuple[str, str, str], float]  # (question, factor, level) -> offset

    def utility(self, scene: str, condition: str) -> float:
        """This person's utility of a condition in a scene, in logits."""
        model = self.model
        technique = self.techniques.get(condition, condition)
        mean = model.utilities.get(condition, model.utilities.get(technique, model.default_utility))
        there = model.scene_utilities.get(scene, {})
        mean += there.get(condition, there.get(technique, 0.0))
        return mean + self.preference.get(condition, 0.0) + self.scene_preference.get((scene, condition), 0.0)


def draw_observer(study: Study, participant: int, seed: int) -> Observer:
    """The simulated person in slot ``participant``: a pure function of the protocol's model, the slot and ``seed``.

    Every deviation has a stream of its own name, so that a condition added to the study leaves the others as they are.
    """
    model = study.observer
    conditions = study.all_conditions()

    def normal(sd: float, *words: str) -> float:
        return sd * float(stream(seed, "observer", participant, *words).standard_normal()) if sd else 0.0

    levels: dict[tuple[str, str, str], float] = {}
    for question, likert in model.likert.items():
        for factor, sd in likert.level_sd.items():
            for level in _levels(study, factor):
                levels[question, factor, level] = normal(sd, "level", question, factor, level)
    return Observer(
        participant=participant,
        seed=seed,
        model=model,
        techniques={name: condition.technique for name, condition in conditions.items()},
        preference={name: normal(model.sd.condition, "condition", name) for name in conditions},
        scene_preference={
            (scene, name): normal(model.sd.scene_condition, "scene", scene, name)
            for scene in study.scenes
            for name in conditions
        },
        side_bias=model.side_bias + normal(model.side_bias_sd, "side"),
        slowness=math.exp(normal(model.rt.observer_sd_log, "rt")),
        rating_offset={q: normal(likert.observer_sd, "rating", q) for q, likert in model.likert.items()},
        level_offset=levels,
    )


def _levels(study: Study, factor: str) -> list[str]:
    """All levels that a factor has anywhere in the study."""
    if factor == "condition":
        return list(study.all_conditions())
    if factor == "scene":
        return list(study.scenes)
    tables = [block.factors[factor] for block in study.blocks if factor in block.factors]
    tables += [study.participants.between[factor]] if factor in study.participants.between else []
    return list(dict.fromkeys(level for table in tables for level in table))


def trial_stream(seed: int, participant: int, trial: Trial, attempt: int = 0) -> np.random.Generator:
    """The generator for one presentation: a pure function of seed, person, trial and attempt, whatever came before."""
    return stream(seed, "answers", participant, trial.index, attempt)


def answer(
    trial: Trial, observer: Observer, rng: np.random.Generator, errors: Mapping[str, float] | None = None
) -> tuple[Answer, ...]:
    """The answers to all questions of ``trial``, in order; () where it asks nothing.

    ``errors``: slot -> the metric of what was really shown there; used where the model has ``pictures``.
    """
    start = 0.0 if trial.settings.get("response") == "during" else _shown_s(trial)
    answers: list[Answer] = []
    for question in trial.questions:
        given = _one(trial, question, observer, rng, start, errors)
        start = given.rt_s
        answers.append(given)
    return tuple(answers)


def _shown_s(trial: Trial) -> float:
    """Seconds from stimulus onset to its end."""
    if trial.kind == "two_interval":
        gap = float(trial.settings.get("interval_gap_s", 0.0))
        return trial.duration_s * len(trial.panels) + gap * max(len(trial.panels) - 1, 0)
    return trial.duration_s


def _one(
    trial: Trial,
    question: Question,
    observer: Observer,
    rng: np.random.Generator,
    start: float,
    errors: Mapping[str, float] | None,
) -> Answer:
    model = observer.model
    # The same draws in the same order for every trial, so that no branch shifts the stream of the next question.
    lapse, silent, guess = rng.random(3)
    z = float(rng.standard_normal())
    latency = model.rt.shift_s + model.rt.median_s * observer.slowness * math.exp(model.rt.sd_log * z)
    latency = max(latency, question.min_view_s)
    chosen, rating = None, None
    if question.kind == "choice":
        candidates = [panel for panel in trial.panels if panel.role != "reference"]
        noise = rng.gumbel(size=len(candidates))
        if lapse < model.lapse:
            said = candidates[int(guess * len(candidates))].slot
        else:
            said = _choice(trial, question, candidates, observer, noise, errors)
        chosen = next((panel.condition for panel in candidates if panel.slot == said), None)
    elif question.kind == "likert":
        points = question.high - question.low + 1
        rating = float(question.low + int(guess * points)) if lapse < model.lapse else None
        noise = rng.standard_normal(2)
        if rating is None:
            rating = float(_rating(trial, question, observer, noise, errors))
        said = str(int(rating))
    else:
        said = "ok"
    late = question.window_s is not None and latency > question.window_s
    if late or (question.kind != "confirm" and silent < model.no_answer and question.window_s is not None):
        window = float(question.window_s or 0.0)
        return Answer(question.name, question.kind, "", None, None, "", window, start + window, True)
    key = next((key for key, meaning in question.keys.items() if meaning == said), "")
    return Answer(question.name, question.kind, said, rating, chosen, key, latency, start + latency)


def _utility(trial: Trial, panel: Panel, observer: Observer, errors: Mapping[str, float] | None) -> float:
    pictures = observer.model.pictures
    if pictures is None or errors is None:
        return observer.utility(trial.scene, panel.condition)
    own = observer.preference.get(panel.condition, 0.0)
    return (
        own
        + observer.scene_preference.get((trial.scene, panel.condition), 0.0)
        - (pictures.logits_per_unit * errors[panel.slot])
    )


def _choice(
    trial: Trial,
    question: Question,
    candidates: list[Panel],
    observer: Observer,
    noise: np.ndarray,
    errors: Mapping[str, float] | None,
) -> str:
    """The slot of the largest utility + bias + noise; 'tie' where the two best are within the tie width."""
    felt = [
        _utility(trial, panel, observer, errors)
        + (observer.side_bias if panel.slot in FIRST_SLOTS else 0.0)
        + float(extra)
        for panel, extra in zip(candidates, noise, strict=True)
    ]
    order = sorted(range(len(felt)), key=lambda i: -felt[i])
    if "tie" in question.options and felt[order[0]] - felt[order[1]] < observer.model.tie_width:
        return "tie"
    return candidates[order[0]].slot


def _rating(
    trial: Trial, question: Question, observer: Observer, noise: np.ndarray, errors: Mapping[str, float] | None
) -> int:
    likert = observer.model.likert.get(question.name) or LikertModel(mean=(question.low + question.high) / 2)
    own = observer.rating_offset.get(question.name, 0.0)
    if likert.thresholds is not None:
        # Logistic noise from a normal one through the distribution function.
        share = min(max(float(ndtr(noise[0])), 1e-12), 1 - 1e-12)
        latent = own + likert.noise_sd * math.log(share / (1 - share))
        latent += _utility(trial, trial.panels[0], observer, errors)
        shift = sum(table.get(_level(trial, name), 0.0) for name, table in likert.threshold_shift.items())
        return question.low + sum(1 for threshold in likert.thresholds if latent > threshold + shift)
    factors = {name: _level(trial, name) for name in likert.level_sd}
    own += sum(observer.level_offset.get((question.name, name, level), 0.0) for name, level in factors.items())
    place = latent_mean(cell_mean(likert, trial), latent_sd(likert), question.low, question.high)
    latent = place + own + likert.noise_sd * float(noise[0])
    return int(min(max(math.floor(latent + 0.5), question.low), question.high))


def _level(trial: Trial, name: str) -> str:
    """A trial's level of a factor, '' where it has none."""
    return column(trial, name) if name in trial.factors or name in ("scene", "technique", "condition") else ""


def cell_mean(likert: LikertModel, trial: Trial) -> float:
    """The mean rating that the model states for the cell of ``trial``."""
    total = float(likert.mean or 0.0)
    for means in likert.means:
        total += means.values.get(":".join(_level(trial, name) for name in means.by), 0.0)
    return total


def latent_sd(likert: LikertModel) -> float:
    """SD over observers and trials of the latent rating."""
    return math.sqrt(likert.observer_sd**2 + likert.noise_sd**2 + sum(sd**2 for sd in likert.level_sd.values()))


@lru_cache(maxsize=4096)
def latent_mean(mean: float, sd: float, low: int, high: int) -> float:
    """The latent location whose ratings, rounded to whole points and cut to [low, high], have this mean.

    E[rating] = low + sum over k of P(latent > low + k - 1/2); solved by bisection. Means nearer than 0.02 points to an
    end of the scale are taken as 0.02 away, since no finite location reaches the end.
    """
    from scipy.optimize import brentq  # takes 0.7 s to load, which the start of a session need not wait for

    mean = min(max(mean, low + 0.02), high - 0.02)
    if sd == 0.0:
        return mean
    edges = np.arange(low, high) + 0.5

    def excess(place: float) -> float:
        return low + float(ndtr((place - edges) / sd).sum()) - mean

    return float(brentq(excess, low - 12 * sd - 12, high + 12 * sd + 12, xtol=1e-10))


def observers(study: Study, participants: int, seed: int) -> tuple[Observer, ...]:
    """Simulated persons for slots 1..``participants``."""
    return tuple(draw_observer(study, number, seed) for number in range(1, participants + 1))
