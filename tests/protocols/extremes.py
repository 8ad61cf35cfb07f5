"""The table of extremes of protocols: each row is a file, and what it amounts to or the line that refuses it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

from protocols.check import summarise
from protocols.design import plan
from protocols.requests import clip_specs
from protocols.study import Study
from tests.protocols.tiny import TEXT

Holds = Callable[[Study], None]


@dataclass(frozen=True)
class Extreme:
    """``text``: the whole protocol. ``holds`` asserts on the study; ``refused``: words of the problem instead, which
    stands at line ``line``."""

    name: str
    text: str
    holds: Holds | None = None
    refused: str = ""
    line: int = 0


def with_defaults(more: str, display: str = "{}") -> str:
    return TEXT + f"defaults: {{{more}}}\ndisplay: {display}\n"


LINES = len(TEXT.splitlines())


def sized(width: int, height: int) -> Extreme:
    """One panel fills the display; disk and upload are counted in whole numbers."""

    def holds(study: Study) -> None:
        summary = summarise(study, (1,))
        assert {spec.size_px for spec in summary.clips} == {(width, height)}
        assert summary.upload_bytes == 3 * width * height * 4  # two candidates and the reference
        assert summary.play_bytes == sum(spec.frame_count for spec in summary.clips) * width * height * 4

    screen = f"{{size_px: [{min(16384, 3 * width + 32)}, {height}]}}"
    return Extreme(f"panels of {width}x{height}", with_defaults(f"size_px: [{width}, {height}]", screen), holds)


def rated(refresh: str, content: str, frames: int) -> Extreme:
    """A display and a content rate, for a second (exact: no frame is lost to rounding)."""

    def holds(study: Study) -> None:
        counts = {spec.frame_count for spec in clip_specs(study) if spec.technique == "temporally_dense"}
        assert counts == {frames}
        assert {spec.rate_hz for spec in clip_specs(study) if spec.technique == "temporally_dense"} == {
            str(Fraction(content))
        }

    text = TEXT.replace("half: {technique: vanilla, rate_hz: 120}", "half: {technique: checkerboard}")
    text = text.replace("dense: temporally_dense", f"dense: {{technique: temporally_dense, rate_hz: {content}}}")
    return Extreme(
        f"{content} Hz on {refresh} Hz",
        text + f"defaults: {{duration_s: 1}}\ndisplay: {{refresh_hz: {refresh}}}\n",
        holds,
    )


def timed(duration: str, start: str, frames: int) -> Extreme:
    """Clips of this length from this scene second."""

    def holds(study: Study) -> None:
        specs = [spec for spec in clip_specs(study) if spec.rate_hz == "240"]
        assert {spec.frame_count for spec in specs} == {frames}
        assert {Fraction(spec.start_s) for spec in specs} == {Fraction(start)}

    return Extreme(f"{duration} s from {start} s", with_defaults(f"duration_s: {duration}, start_s: {start}"), holds)


def seen_from(width_m: float, distance_m: float) -> Extreme:
    """A display of another size in another distance: finite angles, panels in proportion."""

    def holds(study: Study) -> None:
        per_degree = study.display.pixels_per_degree
        assert 0 < per_degree < float("inf")
        wide, high = study.display.panel_m((192, 108))
        assert abs(wide / width_m - 0.1) < 1e-12
        assert abs(high / wide - 108 / 192) < 1e-12
        assert summarise(study, (1,)).trials > 0

    screen = f"{{width_m: {width_m!r}, distance_m: {distance_m!r}, geometry: screen}}"
    return Extreme(f"{width_m:g} m wide in {distance_m:g} m", with_defaults("size_px: [192, 108]", screen), holds)


def keyed(yfov_deg: float) -> Extreme:
    """A path whose camera has this field."""

    def holds(study: Study) -> None:
        assert study.paths["p"].keys[0].yfov_deg == yfov_deg
        assert all(f'"yfov_deg": {yfov_deg}' in spec.path_keys for spec in clip_specs(study))

    key = f"{{time_s: 0, position: [0, 0, 1], look_at: [0, 0, 0], yfov_deg: {yfov_deg}}}"
    return Extreme(f"field of {yfov_deg:g} degrees", with_defaults("path: p") + f"paths: {{p: [{key}]}}\n", holds)


def repeated(repetitions: int) -> Extreme:
    """A rating block of six cells, so often."""

    def holds(study: Study) -> None:
        trials = [trial for trial in plan(study, 1) if trial.block == "rating"]
        assert len(trials) == 6 * repetitions
        assert {sum(t.factors["condition"] == c for t in trials) for c in ("full", "half", "dense")} == {
            2 * repetitions
        }

    return Extreme(f"{6 * repetitions} ratings", TEXT.replace("repetitions: 2", f"repetitions: {repetitions}"), holds)


def _one_trial(study: Study) -> None:
    for participant in (1, 2, 10**6):
        (trial,) = plan(study, participant)
        assert trial.index == 0
    assert summarise(study).trials == 1


def _seeds(study: Study) -> None:
    """The largest seed and a far participant: an order, and the same one again."""
    assert plan(study, 10**9) == plan(study, 10**9)
    assert plan(study, 1) != plan(study, 1, seed=0)


def _conditions(study: Study) -> None:
    assert len(clip_specs(study)) == 2 * 100
    assert len([t for t in plan(study, 1) if t.panels]) == 200


ONE = "study: one\nscenes: {a: bar}\nconditions: {c: vanilla}\nquestions: {q: {kind: likert, text: How was it?}}\n"
ONE += "blocks: [{name: b, kind: likert, questions: [q], factors: {condition: [c]}}]\n"
MANY = "study: many\nscenes: {a: bar, b: hairball}\nconditions:\n" + "".join(
    f"  c{k}: {{technique: framed_low_resolution, params: {{samples_per_s: {10 + k}}}}}\n" for k in range(100)
)
MANY += (
    "questions: {q: {kind: likert, text: How was it?}}\nblocks:\n  - {name: b, kind: likert, questions: [q], factors: "
)
MANY += "{scene: [a, b], condition: [" + ", ".join(f"c{k}" for k in range(100)) + "]}}\n"
_SIZE = LINES + 1

TABLE: tuple[Extreme, ...] = (
    *(sized(w, h) for w, h in ((1, 1), (1, 31), (31, 1), (33, 17), (5450, 4320))),
    rated("240", "24", 24), rated("24", "24", 24), rated("1000", "1000", 1000), rated("240", "240", 240),
    rated("60000/1001", "60000/1001", 60), rated("120000/1001", "24000/1001", 24),
    timed("1/240", "0", 1), timed("8", "1000000", 1920), timed("3600", "999999999", 864000),
    *(seen_from(w, d) for w, d in ((1e-6, 1e-6), (1e-6, 1e6), (1e6, 1e-6), (1e6, 1e6))),
    *(keyed(degrees) for degrees in (0.01, 90.0, 179.0)),
    repeated(1), repeated(499),
    Extreme("one trial", ONE, _one_trial),
    Extreme("the largest seed", TEXT + f"seed: {10**18 - 1}\n", _seeds),
    Extreme("a hundred conditions", MANY, _conditions),
    Extreme("a panel of no pixel", with_defaults("size_px: [0, 1]"), refused="greater than or equal to 1", line=_SIZE),
    Extreme("a panel of 20000", with_defaults("size_px: [20000, 1]"), refused="less than or equal to", line=_SIZE),
    Extreme("no frame", with_defaults("duration_s: 0"), refused="more than 0", line=_SIZE),
    Extreme("minus a second", with_defaults("duration_s: -1"), refused="a number or a fraction", line=_SIZE),
    Extreme("1/0 s", with_defaults("duration_s: 1/0"), refused="a denominator that is not 0", line=_SIZE),
    Extreme("7 Hz on 240 Hz", TEXT.replace("rate_hz: 120", "rate_hz: 7"), refused="divided by a whole number", line=6),
    Extreme("0 Hz", TEXT.replace("rate_hz: 120", "rate_hz: 0"), refused="more than 0", line=6),
    Extreme("1e999 Hz", TEXT.replace("rate_hz: 120", "rate_hz: 1e999"), refused="finite", line=6),
    Extreme("more trials than anybody sits through", TEXT.replace("repetitions: 2", "repetitions: 501"),
            refused="at most 3000", line=18),
    Extreme("a negative seed", TEXT + "seed: -1\n", refused="greater than or equal to 0", line=_SIZE),
    Extreme("a seed of 20 digits", TEXT + "seed: 99999999999999999999\n", refused="at most 18 digits", line=_SIZE),
    Extreme("no scene", TEXT.replace("{a: tunnel_geom, b: bar}", "{}"), refused="at least 1", line=2),
    Extreme("no block", TEXT[: TEXT.index("blocks:")] + "blocks: []\n", refused="at least 1", line=11),
    Extreme("a display of no size", TEXT + "display: {width_m: 0}\n", refused="greater than 0", line=_SIZE),
    Extreme("a field of 180 degrees",
            TEXT + "paths: {p: [{time_s: 0, position: [0, 0, 1], look_at: [0, 0, 0], yfov_deg: 180}]}\n",
            refused="less than 180", line=_SIZE),
)  # fmt: skip
