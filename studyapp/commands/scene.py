"""``studyapp scene``: what a scene is and requires, a contact sheet along its path, a technique's debug pictures."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

HELP = "what a scene holds and requires, a contact sheet, debug pictures of a technique"
EXAMPLE = "studyapp scene toy_car --preview out.png"
_NAMED = 3  # of the things that require a feature


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``studyapp scene``."""
    parser.add_argument("scene", metavar="SCENE", help="a .glb, .gltf, .obj or .ply file, or a procedural scene's name")
    parser.add_argument("--preview", metavar="OUT", type=Path, help="write 12 pictures along the path (.png or .jpg)")
    parser.add_argument("--requires", action="store_true", help="what its kernels must contain, and what needs it")
    parser.add_argument(
        "--technique", metavar="T", default="temporally_dense", help="whose debug picture --show writes"
    )
    parser.add_argument(
        "--show",
        metavar="WHAT",
        help="a debug picture of the technique (segmentation, class, motion.X, ...), or: decision (Fig. 10)",
    )
    parser.add_argument("--out", metavar="FILE.png", type=Path, help="where --show writes (default: SCENE_WHAT.png)")
    parser.add_argument("--size", metavar="WxH", default="480x270", help="of --show (default 480x270)")
    parser.add_argument("--frames", metavar="N", type=int, default=24, help="--show shows the N-th frame (default 24)")
    parser.add_argument("--start", metavar="S", default="1", help="scene second of frame 0 of --show (default 1)")
    parser.add_argument("--animation", metavar="NAME", help="which of the file's animations (default: the first)")
    parser.add_argument(
        "--path", default="file", metavar="PATH", help="file | still | sway | toycar | interactive | a file of keys"
    )


def run(args: argparse.Namespace) -> int:
    """Print what is in the scene; write the pictures that are asked for."""
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
    if args.requires:
        _print_requirements(scene)
    if args.preview is not None:
        try:
            write_contact_sheet(args.scene, args.preview, args.animation, args.path)
        except RuntimeError as error:
            raise JobFailed(str(error)) from error
        print(f"wrote {args.preview}")
    if args.show is not None:
        _write_debug_picture(args, scene, camera)
    return 0


def _print_requirements(scene: object) -> None:
    """A line a feature: required or not, what it is, and the first things that need it."""
    from renderers.requirements import reasons
    from stimuli.scene import Scene

    assert isinstance(scene, Scene)
    for reason in reasons(scene):
        because = ", ".join(reason.because[:_NAMED])
        if len(reason.because) > _NAMED:
            because += f" and {len(reason.because) - _NAMED} more"
        word = str(len(reason.because)) if reason.feature in ("movers", "lights") and reason.required else "yes"
        print(f"  {reason.feature:<15} {word if reason.required else 'no':<4} {reason.meaning}", end="")
        print(f" <- {because}" if because else "")
    print("  ambient occlusion and probes are asked for by a clip's lighting, not by the scene")


def _write_debug_picture(args: argparse.Namespace, scene: object, camera: object) -> None:
    """Write what --show names."""
    from PIL import Image

    from renderers.debug_pictures import colored, debug_picture, plot_decisions, value_range
    from stimuli.errors import InputError, problem
    from stimuli.scene import CameraPath, Scene
    from studyapp.commands.tradeoff import rational, size

    assert isinstance(scene, Scene)
    out = args.out or Path(f"{scene.name}_{args.show}.png")
    if out.suffix.lower() != ".png":
        raise InputError(problem("--out", "picture file", out, "a name ending in .png"))
    if args.frames < 1:
        raise InputError(problem("--frames", "frames", args.frames, "at least 1"))
    if args.show == "decision":
        plot_decisions(out)
        print(f"wrote {out}")
        return
    path: CameraPath = camera  # type: ignore[assignment]
    shown = debug_picture(
        scene, args.technique, args.show, size(args.size), path,
        start_s=rational(args.start, "--start"), frames=args.frames,
    )  # fmt: skip
    Image.fromarray(colored(shown)).save(out)
    low, high = value_range(shown)
    print(f"wrote {out} ({args.show} of {args.technique}, values {low:g} to {high:g})")
