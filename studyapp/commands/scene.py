"""``studyapp scene``: what a scene is and requires, a contact sheet along its path, a technique's pictures on a monitor
or in a headset, its debug pictures, and camera paths flown by hand."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stimuli.scene import CameraPath, Scene

HELP = "what a scene holds and requires, a contact sheet, (debug) pictures of a technique; record a camera path"
EXAMPLE = "studyapp scene toy_car --preview out.png"
_NAMED = 3  # of the things that require a feature


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``studyapp scene``."""
    parser.add_argument("scene", metavar="SCENE", help="a .glb, .gltf, .obj or .ply file, or a procedural scene's name")
    parser.add_argument("--preview", metavar="OUT", type=Path, help="write 12 pictures along the path (.png or .jpg)")
    parser.add_argument("--requires", action="store_true", help="what its kernels must contain, and what needs it")
    parser.add_argument(
        "--technique", metavar="T", default="temporally_dense", help="whose picture --view or --show writes"
    )
    parser.add_argument(
        "--view", choices=("monitor", "headset"), help="write what the technique shows on a monitor, or in the headset "
        "of its paper, all viewports on one sheet (foveated: 1182x1464 px an eye, 94 x 106 degrees; polar: for each "
        "eye 40 degrees at 60 px a degree and 90 degrees at 22)",
    )  # fmt: skip
    parser.add_argument(
        "--scale", metavar="S", help="of the headset's pixels along each side (default: foveated 1, polar 1/4)"
    )
    parser.add_argument("--gaze", metavar="X,Y", help="of --view: degrees to the right and up (default: the centre)")
    parser.add_argument(
        "--show",
        metavar="WHAT",
        help="a debug picture of the technique (segmentation, class, motion.X, ...), or: decision (Fig. 10)",
    )
    parser.add_argument("--out", metavar="FILE.png", type=Path, help="where --view and --show write (SCENE_WHAT.png)")
    parser.add_argument(
        "--size", metavar="WxH", default="480x270", help="of --show and a monitor's --view (default 480x270)"
    )
    parser.add_argument("--frames", metavar="N", type=int, default=24, help="the N-th frame is shown (default 24)")
    parser.add_argument(
        "--start",
        metavar="S",
        default=None,
        help="scene second of frame 0 of --view and --show (default 1) or of --record-path (0)",
    )
    parser.add_argument("--animation", metavar="NAME", help="which of the file's animations (default: the first)")
    parser.add_argument(
        "--path", default="file", metavar="PATH", help="file | still | sway | toycar | interactive | a file of keys"
    )
    parser.add_argument(
        "--record-path", metavar="FILE.yaml", type=Path, help="fly through the scene in a window and write the path's "
        "keys: W A S D E Q and the mouse steer, Space begins, Escape ends",
    )  # fmt: skip
    parser.add_argument("--keys-a-second", metavar="HZ", type=float, default=20.0, help="of --record-path (default 20)")


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
    if args.view is not None:
        _write_view(args, scene, camera)
    elif args.show is not None:
        _write_debug_picture(args, scene, camera)
    if args.record_path is not None:
        _record(args, scene, camera)
    return 0


def _print_requirements(scene: Scene) -> None:
    """A line a feature: required or not, what it is, and the first things that need it."""
    from renderers.requirements import reasons

    for reason in reasons(scene):
        because = ", ".join(reason.because[:_NAMED])
        if len(reason.because) > _NAMED:
            because += f" and {len(reason.because) - _NAMED} more"
        word = str(len(reason.because)) if reason.feature in ("movers", "lights") and reason.required else "yes"
        print(f"  {reason.feature:<15} {word if reason.required else 'no':<4} {reason.meaning}", end="")
        print(f" <- {because}" if because else "")
    print("  ambient occlusion and probes are asked for by a clip's lighting, not by the scene")


def _picture_file(args: argparse.Namespace, scene: Scene, what: str) -> Path:
    """Where a picture goes. Raises InputError for another kind of file, and for fewer than 1 frame."""
    from stimuli.errors import InputError, problem

    out: Path = args.out or Path(f"{scene.name}_{what}.png")
    if out.suffix.lower() != ".png" or not out.parent.is_dir():
        raise InputError(problem("--out", "picture file", out, "a name ending in .png, in a folder that exists"))
    if args.frames < 1:
        raise InputError(problem("--frames", "frames", args.frames, "at least 1"))
    return out


def _write_view(args: argparse.Namespace, scene: Scene, camera: CameraPath) -> None:
    """Write what --view names, or of it what --show names."""
    from renderers.view_pictures import view_sheet
    from studyapp.commands.tradeoff import gaze, rational, size

    out = _picture_file(args, scene, args.show or args.view)
    sheet = view_sheet(
        scene, args.technique, args.view, camera, size_px=size(args.size), gaze=gaze(args.gaze), show=args.show,
        scale=None if args.scale is None else float(rational(args.scale, "--scale")),
        start_s=rational(args.start or "1", "--start"), frames=args.frames,
    )  # fmt: skip
    sheet.image().save(out)
    shown = "; ".join(f"{name} {words}" for name, words in sheet.words.items())
    print(f"wrote {out} ({args.show or 'pictures'} of {args.technique}: {shown})")


def _write_debug_picture(args: argparse.Namespace, scene: Scene, camera: CameraPath) -> None:
    """Write what --show names."""
    from PIL import Image

    from renderers.debug_pictures import colored, debug_picture, plot_decisions, value_range
    from studyapp.commands.tradeoff import rational, size

    out = _picture_file(args, scene, args.show)
    if args.show == "decision":
        plot_decisions(out)
        print(f"wrote {out}")
        return
    shown = debug_picture(
        scene, args.technique, args.show, size(args.size), camera,
        start_s=rational(args.start or "1", "--start"), frames=args.frames,
    )  # fmt: skip
    Image.fromarray(colored(shown)).save(out)
    low, high = value_range(shown)
    print(f"wrote {out} ({args.show} of {args.technique}, values {low:g} to {high:g})")


def _record(args: argparse.Namespace, scene: Scene, camera: CameraPath) -> None:
    """Fly in a window; what was flown goes to --record-path."""
    from stimuli.errors import InputError, problem
    from stimuli.path_recording import fly, write_path_keys
    from studyapp.commands.tradeoff import rational
    from studyapp.flight_window import HELP as KEYS
    from studyapp.flight_window import GlfwFlight

    out: Path = args.record_path
    if out.suffix not in (".yaml", ".yml") or not out.parent.is_dir():
        raise InputError(problem("--record-path", "file", out, "a name ending in .yaml, in a folder that exists"))
    start_s = float(rational(args.start or "0", "--start"))
    window = GlfwFlight(scene, camera.yfov_rad)
    print(KEYS)
    try:
        keys = fly(scene, camera, window, args.keys_a_second, start_s)
    finally:
        window.close()
    about = f"Flown by hand in {scene.name} (studyapp scene --record-path); edit, add and remove keys as you like."
    write_path_keys(out, keys, camera.yfov_rad, about)
    print(f"wrote {out}: {len(keys)} keys, {keys[-1].time_s - keys[0].time_s:g} s from second {start_s:g} of the scene")
