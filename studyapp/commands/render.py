"""``studyapp render``: make the clips that a protocol needs and the store lacks."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from protocols.condition_references import channel_problems
from protocols.load import load_study
from protocols.study import Study
from stimuli.clip import ClipStore, estimate_disk
from stimuli.clip_request import CHANNEL_GROUPS
from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.clips import StudyClips, resolve_clips
from studyapp.store_root import store_directory

HELP = "render the clips of a protocol that the store lacks"
EXAMPLE = "studyapp render demo --workers 2"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--workers", type=int, default=1, help="processes of one thread each (1: in this process)")
    parser.add_argument("--cluster", metavar="ADDRESS", help="a Dask scheduler that you started, as in tcp://host:8786")
    parser.add_argument("--store", metavar="DIR", help="clip store (default: $STUDYAPP_STORE, else .clips)")
    parser.add_argument(
        "--reference-error", type=float, metavar="E", help="say how many samples a reference needs for this standard "
        "error of display values (0.002 is half a code of 255), and end with 1 where one has too few; renders no clip",
    )  # fmt: skip
    parser.add_argument(
        "--channels", metavar="LIST", help="render clips with these channels too: depth,motion,samples (clips of their "
        "own for other programs; the protocol's own clips have those of its channels: key)",
    )  # fmt: skip
    parser.add_argument("--estimate", action="store_true", help="say what would be made and how much disk it takes")


def run(args: argparse.Namespace) -> int:
    """Render; interrupted, the same command goes on where it was."""
    if args.workers < 1:
        raise InputError(problem("--workers", "processes", args.workers, "at least 1"))
    study = load_study(args.protocol)
    if args.channels is not None:
        study = with_channels(study, args.channels)
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
    free = free_disk_bytes(store.root)
    if estimate.exr_bytes + estimate.play_bytes > free:
        print(f"note: {free / 1e6:.0f} MB are free there; lossless compression may or may not make it fit")
    if args.estimate:
        return 0
    if args.reference_error is not None:
        return _convergence(clips, args.reference_error)
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


def free_disk_bytes(folder: Path) -> int:
    """Free bytes where ``folder`` is or will be."""
    there = next(parent for parent in [folder, *folder.absolute().parents] if parent.is_dir())
    return shutil.disk_usage(there).free


def with_channels(study: Study, text: str) -> Study:
    """``study`` with the channels of ``text`` ('depth,motion') by default. InputError, all problems at once."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names or (unknown := [name for name in names if name not in CHANNEL_GROUPS]):
        got = ", ".join(unknown) if names else "nothing"
        raise InputError(problem("--channels", "channels", got, " | ".join(CHANNEL_GROUPS)))
    asked = study.model_copy(update={"defaults": study.defaults.model_copy(update={"channels": names})})
    if found := [problem(*rest) for _, *rest in channel_problems(asked)]:
        raise InputError(*found)
    return asked


def _convergence(clips: StudyClips, target: float) -> int:
    """A line for each reference clip: the samples it has, and those it needs for ``target``."""
    from renderers.clip_renderer import ClipRenderer
    from renderers.convergence import reference_error, samples_for_error
    from renderers.produce import samples_per_pixel

    renderer = ClipRenderer(None)
    short = 0
    jobs = {job.request.identity: job for job in clips.jobs if samples_per_pixel(job.request) is not None}
    for job in jobs.values():
        spp = samples_per_pixel(job.request)
        assert spp is not None
        found = samples_for_error(job, target, renderer)
        has = found.errors.get(spp)
        error = reference_error(job, spp, renderer) if has is None else has
        short += error > target
        needed = f"{found.spp} spp" if found.spp else f"more than {max(found.errors)} spp"
        print(f"{job.request.scene}: reference of {spp} spp: error {error:.5f}; {target:g} needs {needed}")
    if short:
        raise JobFailed(
            f"{short} of {len(jobs)} references are not converged to {target:g}: raise their spp in the protocol"
        )
    return 0
