"""The whole main job on the embedded defaults: render, run one session, simulate the others, analyse, say where.

Every step is the command that a user would type, in a process of its own; the steps' lines are printed as they come.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from ruamel.yaml import YAML

from renderers.catalogue import CATALOGUE, side_by_side
from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.clock import now_ns

PARTICIPANTS = 12


@dataclass(frozen=True)
class DemoRequest:
    """Where to work, and which scene file to show instead of the embedded scenes (None: those)."""

    out: Path
    scene: Path | None = None
    animation: str | None = None
    workers: int = 2


def protocol_text() -> str:
    """The shipped demo protocol."""
    return (files("protocols") / "library" / "demo.yaml").read_text()


def protocol_for(scene: Path, animation: str | None, moves: bool, duration_s: float, deforms: bool = False) -> str:
    """The demo protocol with three stretches of one scene file in place of the embedded scenes.

    A file that does not move is seen from a swaying camera; one that does at three times of its animation. Where
    meshes change their shape (``deforms``), the techniques whose samples have times of their own are left out.
    """
    yaml = YAML()
    study = yaml.load(protocol_text())
    study["study"] = "demo_" + "".join(c if c.isalnum() else "_" for c in scene.stem.lower())
    names = list(study["scenes"])
    replaced = {}
    for k, name in enumerate(names):
        entry: dict[str, object] = {"scene": str(scene.resolve())}
        entry["start_s"] = round(duration_s * (k + 1) / (len(names) + 1), 3) if moves else 1.3 * k
        if not moves:
            entry["path"] = "sway"
        if animation:
            entry["animation"] = animation
        replaced[name] = entry
    study["scenes"] = replaced
    if deforms:
        left_out = {name for name, entry in CATALOGUE.items() if entry.own_times}
        study["techniques"] = [name for name in side_by_side() if name not in left_out]
        for block in study["blocks"]:
            conditions = block.get("factors", {}).get("condition")
            if conditions:
                conditions[:] = [name for name in conditions if name not in left_out]
    text = io.StringIO()
    yaml.dump(study, text)
    renamed = text.getvalue().replace("luminance_limit: 0.25", "luminance_limit: 1.0")  # any scene; the report shows it
    for k, name in enumerate(names):  # the embedded scenes' names would be wrong
        renamed = renamed.replace(f"  {name}:", f"  view_{k + 1}:").replace(f" {name},", f" view_{k + 1},")
        renamed = renamed.replace(f"[{name},", f"[view_{k + 1},").replace(f" {name}]", f" view_{k + 1}]")
        renamed = renamed.replace(f"{{{name}:", f"{{view_{k + 1}:")
    return renamed


def _step(words: str, arguments: list[str]) -> None:
    """Say what comes and run ``studyapp`` with these arguments; JobFailed where it fails."""
    print(f"demo: {words}", flush=True)
    done = subprocess.run([sys.executable, "-m", "studyapp", *arguments], check=False)
    if done.returncode:
        raise JobFailed(f"step failed with exit code {done.returncode}: studyapp {' '.join(arguments)}")


def _display_arguments() -> list[str]:
    """A window locked at 240 Hz where there is one, else off-screen: there the session itself finds whether the
    override is needed, says so, and keeps it in the data."""
    probe = subprocess.run(
        [sys.executable, "-m", "studyapp", "display", "--display", "glfw", "--rate", "240", "--json"],
        text=True, capture_output=True, check=False,
    )  # fmt: skip
    certificate = json.loads(probe.stdout) if probe.stdout.strip().startswith("{") else {}
    if certificate.get("locked"):
        return ["--display", "glfw"]
    reason = certificate.get("reason") or (probe.stderr.strip().splitlines() or ["no display"])[-1]
    print(f"demo: no window is locked at 240 Hz here ({reason}); the session runs off-screen at 240 Hz")
    return ["--display", "offscreen", "--override", "display_lock=the demo goes on off-screen, locked or not"]


def run_demo(request: DemoRequest) -> Path:
    """Do it all; returns the report's path. JobFailed names the step that failed."""
    start_ns = now_ns()
    out = request.out
    out.mkdir(parents=True, exist_ok=True)
    protocol = out / "demo.yaml"
    if request.scene is None:
        protocol.write_text(protocol_text())
    else:
        if not request.scene.is_file():
            raise InputError(problem("--scene", "scene file", request.scene, "a glTF, GLB, OBJ or PLY file"))
        from stimuli import load_scene  # pyrender's types: not needed for the embedded scenes

        scene = load_scene(str(request.scene), animation=request.animation)
        for note in scene.notes:
            print(f"demo: {request.scene.name}: {note}")
        text = protocol_for(request.scene, request.animation, scene.duration_s > 0, scene.duration_s, bool(scene.skins))
        protocol.write_text(text)
    store, data = out / "clips", out / "data"
    for old in data.glob("*.sqlite*"):
        old.unlink()
    _step(
        "rendering the clips that are missing",
        ["render", str(protocol), "--store", str(store), "--workers", str(request.workers)],
    )
    arguments = [
        "run", str(protocol), "--participant", "1", "--observer", "simulated", "--store", str(store),
        "--data", str(data),
    ]  # fmt: skip
    _step("one session, answered over a serial line and looked at over a gaze stream", arguments + _display_arguments())
    others = PARTICIPANTS - 1
    _step(
        f"{others} more, simulated",
        ["simulate", str(protocol), "--participants", str(others), "--first", "2", "--data", str(data)],
    )
    report = out / "report.html"
    _step("statistics", ["analyze", str(data), "--report", str(report), "--json", str(out / "results.json"), "--quiet"])
    print(f"demo: done in {(now_ns() - start_ns) / 1e9:.0f} s; the report: {report}")
    return report
