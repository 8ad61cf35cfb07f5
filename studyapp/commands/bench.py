"""``studyapp bench``: can this machine hold the rate? Each section measures one part and returns its figures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

HELP = "measure what this machine can do: rays, passes, upload, flip, log"
EXAMPLE = "studyapp bench --section whitted --json"

Figures = Mapping[str, object]


@dataclass(frozen=True)
class Section:
    """One part of the bench: ``measure`` returns its figures, units in their names."""

    name: str
    summary: str
    measure: Callable[[], Figures]


def whitted() -> Figures:
    """Whitted ray tracing at 960x540, one light, against Mitsuba's `direct` at 1 spp; the same with textures."""
    from renderers.bench_whitted import measure_whitted
    from stimuli.load import load_scene

    figures: dict[str, object] = dict(asdict(measure_whitted(load_scene("tunnel_geom"))))
    textured = asdict(measure_whitted(load_scene("tunnel_maps")))
    return {**figures, "tunnel_maps": textured}


def present() -> Figures:
    """Upload, draw, flip of one streamed 512x512 panel, off-screen and on a window; keys under ``present``."""
    from studyapp.present.bench import present_bench

    return {"present": present_bench()}


def dense() -> Figures:
    """Temporally dense against vanilla + TAA at 960x540, and the sizes at which it runs live; keys under ``dense``."""
    from renderers.bench_dense import live_sizes, measure_saving
    from stimuli.load import load_scene

    names = ("tunnel_geom", "toy_car", "bar")
    saving = {name: asdict(measure_saving(load_scene(name))) for name in names}
    live = live_sizes(load_scene("tunnel_geom"))
    holding = [size for size, taken in live.items() if taken["p95_ms"] < 1000 / 240]
    return {"dense": {**saving, "live_tunnel_geom": live, "largest_live_240_hz": holding[-1] if holding else "none"}}


def specialisation() -> Figures:
    """The scene's own kernel of tunnel_maps against the all-features kernel, and each feature added alone."""
    from renderers.specialisation import specialisation_figures
    from stimuli.load import load_scene

    return specialisation_figures(load_scene("tunnel_maps"))


SECTIONS: tuple[Section, ...] = (
    Section("whitted", "Whitted ray tracing against Mitsuba's own direct light, 960x540", whitted),
    Section("dense", "temporally dense against TAA at one resolution, and live at 240 Hz", dense),
    Section("present", "work per refresh of one 512x512 streamed panel", present),
    Section("specialisation", "kernels with only what a scene requires against all features, 640x360", specialisation),
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``studyapp bench``."""
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.add_argument(
        "--section", action="append", choices=[section.name for section in SECTIONS], help="only this part (repeatable)"
    )


def _lines(figures: Figures, indent: str = "  ") -> list[str]:
    lines = []
    for name, value in figures.items():
        if isinstance(value, Mapping):
            lines += [f"{indent}{name}:", *_lines(value, indent + "  ")]
        else:
            lines.append(
                f"{indent}{name:<28} {value:.4g}" if isinstance(value, float) else f"{indent}{name:<28} {value}"
            )
    return lines


def run(args: argparse.Namespace) -> int:
    """Measure the chosen sections and print their figures."""
    chosen = [section for section in SECTIONS if not args.section or section.name in args.section]
    found: dict[str, object] = {}
    for section in chosen:
        figures = section.measure()
        found.update(figures)
        if not args.json:
            print(f"{section.name}: {section.summary}")
            print("\n".join(_lines(figures)))
    if args.json:
        print(json.dumps(found))
    return 0
