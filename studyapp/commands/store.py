"""``studyapp store``: what the clip store holds, whether it is whole, what may go, and frames from other renderers."""

from __future__ import annotations

import argparse
import json
import os
import shutil
from pathlib import Path

from protocols.load import load_study
from stimuli.clip import Clip, ClipStore
from stimuli.errors import InputError, problem
from stimuli.import_frames import TRANSFERS, Import, import_frames
from stimuli.play_cache import PlayCache
from studyapp.cli import JobFailed
from studyapp.clips import resolve_clips

HELP = "list, verify and clear the clip store, or import frames from another renderer"
EXAMPLE = "studyapp store import frames/ --rate 240 --technique ours --scene kitchen --transfer srgb"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command and its four parts."""
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--store", metavar="DIR", help="clip store (default: $STUDYAPP_STORE, else ./.clips)")
    parts = parser.add_subparsers(dest="part", required=True, metavar="ls|verify|gc|import")
    listing = parts.add_parser("ls", parents=[shared], help="every clip")
    listing.add_argument("--json", action="store_true", help="as JSON, whole requests")
    verify = parts.add_parser("verify", parents=[shared], help="compare every file with its checksum")
    verify.add_argument("--quick", action="store_true", help="names and sizes only; no frame is read")
    clear = parts.add_parser("gc", parents=[shared], help="remove leftovers; with --keep also clips that none needs")
    clear.add_argument("--keep", nargs="+", metavar="PROTOCOL", help="keep the clips of these protocols, drop others")
    clear.add_argument("--dry-run", action="store_true", help="only say what would go")
    bring = parts.add_parser("import", parents=[shared], help="take PNG or EXR frames, or lossless video")
    bring.add_argument("frames", help="a folder of numbered frames, or a video")
    bring.add_argument("--rate", required=True, metavar="HZ", help="as in 240 or 60000/1001")
    bring.add_argument("--technique", required=True, metavar="NAME", help="a protocol says imported:NAME")
    bring.add_argument("--scene", required=True, metavar="NAME", help="the protocol's scene")
    bring.add_argument("--transfer", required=True, choices=TRANSFERS, help="what the numbers are")
    bring.add_argument("--exposure", type=float, default=1.0, help="factor on linear light (default: 1)")
    bring.add_argument("--white", type=float, default=100.0, metavar="CD_M2", help="pq: luminance of 1 (default: 100)")


def run(args: argparse.Namespace) -> int:
    """Do one of the four parts."""
    store = ClipStore(Path(args.store or os.environ.get("STUDYAPP_STORE") or Path.cwd() / ".clips"))
    if args.part == "import":
        about = Import(args.rate, args.technique, args.scene, args.transfer, args.exposure, args.white)
        clip = import_frames(Path(args.frames), about, store)
        print(f"{_line(clip)}\nin a protocol: technique: {clip.request.technique}")
        return 0
    if not store.root.is_dir():
        raise InputError(problem(store.root, "store", "nothing", "a clip store (studyapp render makes one)"))
    return {"ls": _list, "verify": _verify, "gc": _clear}[args.part](store, args)


def _line(clip: Clip) -> str:
    request = clip.request
    size = f"{request.size_px[0]}x{request.size_px[1]}"
    return (
        f"{clip.identity[:12]}  {request.scene:<12} {request.technique:<22} {size:>9} {request.rate_hz:>7} Hz "
        f"{clip.frame_count:>5} frames {clip.byte_count / 1e6:>9.1f} MB  {clip.manifest['provenance']}"
        + (f" with {' '.join(request.channels)}" if request.channels else "")
    )


def _list(store: ClipStore, args: argparse.Namespace) -> int:
    clips = list(store.published())
    if args.json:
        rows = [
            {
                "clip": clip.identity,
                "frames": clip.frame_count,
                "bytes": clip.byte_count,
                "provenance": clip.manifest["provenance"],
                "luminance": clip.manifest["luminance"],
                "request": clip.manifest["request"],
            }
            for clip in clips
        ]
        print(json.dumps(rows, indent=1))
        return 0
    for clip in clips:
        print(_line(clip))
    frames, size = sum(clip.frame_count for clip in clips), sum(clip.byte_count for clip in clips)
    unreadable = len(store.identities()) - len(clips)
    damaged = f"; {unreadable} unreadable (studyapp store verify)" if unreadable else ""
    print(f"{len(clips)} clips, {frames} frames, {size / 1e6:.1f} MB in {store.root}{damaged}")
    return 0


def _verify(store: ClipStore, args: argparse.Namespace) -> int:
    problems = [problem(path, "among the clips", "something foreign", "clips only") for path in store.foreign()]
    identities = store.identities()
    bad = 0
    for identity in identities:
        found = store.problems_of(identity, read_bytes=not args.quick)
        bad += bool(found)
        problems += found
    for line in problems:
        print(line)
    if problems:
        raise JobFailed(
            f"{bad} of {len(identities)} clips are damaged, {len(problems)} problems (studyapp render mends)"
        )
    print(f"{len(identities)} clips are whole{' (sizes only)' if args.quick else ''}")
    return 0


def _clear(store: ClipStore, args: argparse.Namespace) -> int:
    needed: set[str] | None = None
    if args.keep:
        needed = set()
        for protocol in args.keep:
            clips = resolve_clips(load_study(protocol), protocol, store)
            needed |= {request.identity for request in clips.requests.values()}
    dropped = [identity for identity in store.identities() if needed is not None and identity not in needed]
    for identity in dropped:
        print(f"clip {identity[:12]}: no kept protocol needs it")
        if not args.dry_run:
            store.discard(identity)
    caches = list(PlayCache(store).unused())
    parts = [
        path
        for path in _part_directories(store)
        if store.has(path.name) or (needed is not None and path.name not in needed)
    ]
    for path in [*caches, *parts]:
        print(f"{path.parent.name}/{path.name[:12]}: belongs to no clip in the making or in the store")
        if not args.dry_run:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    abandoned = 0 if args.dry_run else store.clear_abandoned()
    verb = "would go" if args.dry_run else "gone"
    print(f"{verb}: {len(dropped)} clips, {len(caches)} play caches, {len(parts) + abandoned} unfinished directories")
    return 0


def _part_directories(store: ClipStore) -> list[Path]:
    parts = store.root / "parts"
    return sorted(parts.iterdir()) if parts.is_dir() else []
