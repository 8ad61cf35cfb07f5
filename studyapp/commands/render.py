"""``studyapp render``: make the clips that a protocol needs and the store lacks."""

from __future__ import annotations

import argparse

from protocols.load import load_study
from stimuli.clip import ClipStore, estimate_disk
from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.clips import resolve_clips, store_directory

HELP = "render the clips of a protocol that the store lacks"
EXAMPLE = "studyapp render demo --workers 2"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--workers", type=int, default=1, help="processes of one thread each (1: in this process)")
    parser.add_argument("--cluster", metavar="ADDRESS", help="a Dask scheduler that you started, as in tcp://host:8786")
    parser.add_argument("--store", metavar="DIR", help="clip store (default: $STUDYAPP_STORE, else .clips)")
    parser.add_argument("--estimate", action="store_true", help="say what would be made and how much disk it takes")


def run(args: argparse.Namespace) -> int:
    """Render; interrupted, the same command goes on where it was."""
    if args.workers < 1:
        raise InputError(problem("--workers", "processes", args.workers, "at least 1"))
    study = load_study(args.protocol)
    store = ClipStore(store_directory(args.protocol, args.store))
    clips = resolve_clips(study, args.protocol, store)
    for note in clips.notes:
        print(f"note: {note}")
    missing = [request for request in clips.requests.values() if not store.has(request.identity)]
    estimate = estimate_disk(missing)
    print(
        f"{study.study}: {len({r.identity for r in clips.requests.values()})} clips, {estimate.clips} to render "
        f"({estimate.frames} frames); at most {estimate.exr_bytes / 1e6:.0f} MB in {store.root}, "
        f"and {estimate.play_bytes / 1e6:.0f} MB to play them"
    )
    if args.estimate:
        return 0
    from renderers.produce import produce  # the ray engine is loaded only now
    from renderers.worker_pool import ClusterLost

    try:
        outcome = produce(clips.jobs, store, args.workers, args.cluster)
    except ClusterLost as error:
        raise JobFailed(str(error)) from error
    print(f"made {len(outcome.made)}, made again {len(outcome.remade)} damaged, {len(outcome.kept)} were there")
    for unit in outcome.poisoned:
        print(f"failed: {unit.label}: {unit.reason}\n  reproduce: {unit.command}")
    if outcome.poisoned:
        clips_lost = len({unit.identity for unit in outcome.poisoned})
        raise JobFailed(f"{len(outcome.poisoned)} units of {clips_lost} clips failed; the others are made")
    return 0
