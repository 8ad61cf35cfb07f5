"""HERR's table at a quarter of the headset's pixels along each side (or ``SCALE``), and what issue 5 asks of it.

``python -m tests.prove.polar_table [SCALE]``; beside the paper's figures: ``studyapp tradeoff --table herr2021``.
"""

from __future__ import annotations

import json
import sys
from fractions import Fraction
from pathlib import Path

from renderers.polar.table import (
    LIGHT_SAMPLES,
    MAPPINGS,
    SCENE,
    Conditions,
    measure_errors,
    measure_times,
    summary,
)
from renderers.polar.table_report import errors, times
from stimuli.load import load_scene


def main(scale: Fraction) -> int:
    """Measure, print, write evidence/polar_table.json; 0 where what is asked is reached."""
    scene, c = load_scene(SCENE), Conditions(scale=scale)
    rows = [measure_times(scene, scene.camera, samples, c) for samples in LIGHT_SAMPLES]
    rows += [measure_errors(scene, scene.camera, mapping, c) for mapping in MAPPINGS]
    found = summary(rows, scene, c)
    print(times(found), errors(found), sep="\n\n")
    Path("evidence").mkdir(exist_ok=True)
    Path("evidence/polar_table.json").write_text(json.dumps(found, indent=1))
    fewer = all(row["fewer_rays"] >= 5 for row in found["times"])
    faster = all(row["faster"] >= 5 for row in found["times"])
    nearer = all(row["polar"]["near"] < row["uniform"]["near"] for row in found["errors"])
    print(f"fewer rays {fewer}, 5 times faster {faster}, better near the gaze {nearer}")
    return 0 if fewer and faster and nearer else 1


if __name__ == "__main__":
    sys.exit(main(Fraction(sys.argv[1]) if len(sys.argv) > 1 else Conditions().scale))
