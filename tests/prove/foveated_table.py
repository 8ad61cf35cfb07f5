"""The paper's Table 1 beside ours: four scenes, three light settings, 1182x1464, medium, 30 frames a cell.

Sponza is taken where the assets are (``$STUDYAPP_ASSETS``), on its sway path. Asked: 79 % fewer samples on average;
tracing alone 3.2 / 3.5 / 4 times faster (point, area, ambient occlusion); whole frames on two cores 2.0 on average and
3.5 at best. ``python -m tests.prove.foveated_table [FRAMES [SCENE,SCENE]]``; ``studyapp tradeoff --table weier2016``.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from renderers.foveated.table import SCENES, SETTINGS, Conditions, measure_cell, summary
from renderers.foveated.table_report import rings, table
from stimuli import load_scene
from stimuli.camera_path import camera_path


def main(frames: int = 30, names: tuple[str, ...] = ()) -> int:
    """Measure and print every cell, write evidence/foveated_table.json; 0 where what is asked is reached."""
    folder = Path(os.environ.get("STUDYAPP_ASSETS", "assets"))
    sponza = next(iter(folder.rglob("sponza.glb")), None) if folder.is_dir() else None
    wanted = names or tuple(SCENES)
    cells = []
    for name in wanted:
        if name == "sponza" and sponza is None:
            print("sponza: no sponza.glb below $STUDYAPP_ASSETS, left out")
            continue
        scene = load_scene(sponza if name == "sponza" else name)
        path = camera_path(scene, "sway") if name == "sponza" else None
        for setting in SETTINGS:
            cells.append(measure_cell(scene, setting, Conditions(frames), camera=path))
            print(cells[-1], flush=True)
    found = summary(cells)
    print(table(cells), rings(cells), sep="\n\n")
    out = Path("evidence/foveated_table.json")
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(found, indent=1))
    trace: dict[str, float] = found["trace_speedup"]
    asked = {"point": 3.2, "area": 3.5, "ambient_occlusion": 4.0}
    held = found["fewer_samples_percent"] >= 79 and found["speedup_mean"] >= 2.0 and found["speedup_best"] >= 3.5
    return 0 if held and all(trace[s] >= asked[s] for s in trace) else 1


if __name__ == "__main__":
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 30
    sys.exit(main(frames, tuple(sys.argv[2].split(",")) if len(sys.argv) > 2 else ()))
