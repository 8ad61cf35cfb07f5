"""``studyapp scene``: what a scene is, and a contact sheet of it along its camera path."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

HELP = "what a scene holds, and a contact sheet along its camera path"
EXAMPLE = "studyapp scene toy_car --preview out.png"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``studyapp scene``."""
    parser.add_argument("scene", metavar="SCENE", help="a .glb, .gltf, .obj or .ply file, or a procedural scene's name")
    parser.add_argument("--preview", metavar="OUT", type=Path, help="write 12 pictures along the path (.png or .jpg)")
    parser.add_argument("--animation", metavar="NAME", help="which of the file's animations (default: the first)")
    parser.add_argument(
        "--path", default="file", metavar="PATH", help="file | still | sway | toycar | interactive | a file of keys"
    )


def run(args: argparse.Namespace) -> int:
    """Print what is in the scene; with ``--preview`` write the picture too."""
    from stimuli.camera_path import camera_path
    from stimuli.load import load_scene
    from stimuli.preview import write_contact_sheet
    from studyapp.cli import JobFailed

    scene = load_scene(args.scene, args.animation)
    camera = camera_path(scene, args.path)
    bodies = sum(len(mover.parts) for mover in scene.movers)
    print(f"{scene.name}: {scene.triangle_count:,} triangles in {len(scene.static)} static parts", end="")
    print(f" and {len(scene.movers)} movers ({bodies} parts), {len(scene.lights)} lights, {scene.duration_s:g} s")
    print(f"camera path {camera.name!r}; sha256 {scene.sha256[:16]}")
    for note in scene.notes:
        print(f"note: {note}", file=sys.stderr)
    if args.preview is not None:
        try:
            write_contact_sheet(args.scene, args.preview, args.animation, args.path)
        except RuntimeError as error:
            raise JobFailed(str(error)) from error
        print(f"wrote {args.preview}")
    return 0
