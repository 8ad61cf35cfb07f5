"""The clips of a study: which requests its trials need, where they are, and what plays them.

Scenes come from a file or a procedural name; exposures from the protocol, the scene or a small reference (kept in the
store, so that `run` needs no renderer).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from protocols.load import library_path
from protocols.requests import ClipSpec, clip_spec, clip_specs
from protocols.study import Study
from protocols.trial import Trial
from renderers.catalogue import CATALOGUE
from stimuli.clip import Clip, ClipStore, write_json
from stimuli.clip_job import ClipJob
from stimuli.clip_request import ENGINE_VERSION, PATH_NAMES, ClipRequest
from stimuli.encode import DisplayTable
from stimuli.errors import InputError, problem
from stimuli.play_cache import PlayCache, PlayedClip
from studyapp.clock import now_ns
from studyapp.commands.check import find_scene
from studyapp.settled_samples import settled_samples

if TYPE_CHECKING:
    from stimuli.scene import Scene

IMPORTED = "imported:"


@dataclass(frozen=True)
class StudyClips:
    """Every stored clip of a study. ``requests``: what each panel's specification means in the store; ``jobs``: those
    that can be rendered here (imported ones cannot); ``scenes``: study name -> where the scene came from; ``notes``:
    lines the user should hear (what stands in for what)."""

    requests: Mapping[ClipSpec, ClipRequest]
    jobs: tuple[ClipJob, ...]
    scenes: Mapping[str, str]
    notes: tuple[str, ...]


def resolve_clips(study: Study, protocol: str | Path, store: ClipStore) -> StudyClips:
    """Load the study's scenes, settle their exposures, and form every request.

    InputError, all problems at once: scenes that are nowhere, imported clips that the store does not hold.
    """
    beside = library_path(protocol).parent
    notes: list[str] = []
    problems: list[str] = []
    requests: dict[ClipSpec, ClipRequest] = {}
    jobs: list[ClipJob] = []
    sources: dict[str, str] = {}
    known: dict[tuple[str, str | None], Scene] = {}
    exposures: dict[str, float] = {}
    externals: Sequence[Clip] | None = None
    for spec in clip_specs(study):
        if spec.live:
            continue
        if spec.technique.startswith(IMPORTED):
            externals = store.externals() if externals is None else externals
            try:
                requests[spec] = imported_clip(spec, externals).request
            except InputError as error:
                problems += error.problems
            continue
        if spec.scene not in sources:
            found = find_scene(spec.source, beside)
            if found is None and spec.instead is None:
                wanted = "a procedural scene, or a file beside the protocol, here or below $STUDYAPP_ASSETS"
                problems.append(problem(f"scene {spec.scene}", "source", repr(spec.source), wanted))
                found = ""
            elif found is None:
                notes.append(f"scene {spec.scene}: {spec.source} is not there, {spec.instead} stands in")
                found = str(spec.instead)
            sources[spec.scene] = str(found)
        source = sources[spec.scene]
        if not source:
            continue
        scene = _load(source, spec.animation, known)
        path_file = str(beside / spec.path) if spec.path not in PATH_NAMES and not spec.path_keys else ""
        draft = ClipJob(spec.request(scene.sha256, 1.0), source, path_file, spec.path_keys)
        if spec.exposure is None and spec.scene not in exposures:
            exposures[spec.scene] = settled_exposure(draft, scene, store)
        request = spec.request(scene.sha256, exposures.get(spec.scene, 1.0), _technique_sha256(spec.technique))
        known_technique = CATALOGUE.get(spec.technique)
        if known_technique is not None and known_technique.stateless:
            request = replace(request, warm_up_s="0")  # it does nothing there, and clips are made once
        if spec.reference_error is not None:
            try:
                samples = settled_samples(replace(draft, request=request), spec.reference_error, store)
            except InputError as error:
                problems += error.problems
                continue
            request = replace(request, params={**request.params, "spp": samples})
        requests[spec] = request
        jobs.append(replace(draft, request=request))
    if problems:
        raise InputError(*dict.fromkeys(problems))
    return StudyClips(requests, tuple(jobs), sources, tuple(dict.fromkeys(notes)))


def _load(source: str, animation: str | None, known: dict[tuple[str, str | None], Scene]) -> Scene:
    from stimuli.load import load_scene

    if (source, animation) not in known:
        known[source, animation] = load_scene(source, animation=animation)
    return known[source, animation]


def _technique_sha256(technique: str) -> str:
    """The hash of the file that holds a technique from outside the tree ('module:Class'); '' for our own."""
    if ":" not in technique:
        return ""
    from importlib.util import find_spec

    found = find_spec(technique.partition(":")[0])
    if found is None or found.origin is None:
        raise InputError(problem("technique", "module", repr(technique), "one that Python can import"))
    return hashlib.sha256(Path(found.origin).read_bytes()).hexdigest()


def settled_exposure(job: ClipJob, scene: Scene, store: ClipStore) -> float:
    """The scene's own exposure, or that of a 64x64 reference at the clip's start (rendered once, kept in the store)."""
    if scene.default_exposure is not None:
        return scene.default_exposure
    request = job.request
    asked = [
        scene.sha256,
        request.path,
        request.path_sha256,
        job.path_keys,
        request.start_s,
        request.lighting,
        ENGINE_VERSION,
    ]
    name = hashlib.sha256(json.dumps(asked).encode()).hexdigest()[:40]
    path = store.root / "exposure" / f"{name}.json"
    if path.is_file():
        try:
            return float(json.loads(path.read_text())["exposure"])
        except (ValueError, KeyError, TypeError):
            path.unlink()  # damaged: measured again
    from renderers.clip_frames import scene_exposure
    from renderers.clip_renderer import scene_and_camera
    from renderers.engine import Engine

    loaded, camera = scene_and_camera(job)
    exposure = scene_exposure(Engine(loaded, lighting=request.lighting), camera, Fraction(request.start_s))  # type: ignore[arg-type]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {"scene": request.scene, "exposure": exposure})
    return exposure


def imported_clip(spec: ClipSpec, externals: Sequence[Clip]) -> Clip:
    """The imported clip that fits the specification; the newest import where there are several.

    InputError where there is none, naming what there is of that technique.
    """
    of_name = [clip for clip in externals if clip.request.technique == spec.technique]
    names = {spec.scene, spec.source, Path(spec.source).stem}
    wanted = (spec.size_px, Fraction(spec.rate_hz), spec.frame_count)
    fitting = [
        clip
        for clip in of_name
        if clip.request.scene in names
        and (clip.request.size_px, Fraction(clip.request.rate_hz), clip.frame_count) == wanted
    ]
    if fitting:
        return max(fitting, key=lambda clip: (clip.directory.stat().st_mtime_ns, clip.identity))
    has = [
        f"{c.request.scene} {c.request.size_px[0]}x{c.request.size_px[1]} {c.request.rate_hz} Hz {c.frame_count} frames"
        for c in of_name
    ]
    size = f"{spec.size_px[0]}x{spec.size_px[1]}"
    text = f"{spec.scene} {size}, {spec.rate_hz} Hz, {spec.frame_count} frames (studyapp store import)"
    raise InputError(problem(spec.technique, "imported clip", "; ".join(has) or "none in the store", text))


def with_clips(study: Study, trial: Trial, clips: StudyClips) -> Trial:
    """The trial, each stored panel with the identity of its clip."""
    panels = tuple(
        panel if panel.live else replace(panel, clip=clips.requests[clip_spec(study, trial, panel)].identity)
        for panel in trial.panels
    )
    return replace(trial, panels=panels)


def store_problems(clips: StudyClips, store: ClipStore, read_bytes: bool = True) -> list[str]:
    """What `run` must refuse: clips that are not there or not as published, one line each."""
    identities = dict.fromkeys(request.identity for request in clips.requests.values())
    return [line for identity in identities for line in store.problems_of(identity, read_bytes)]


def sources_for(trial: Trial, store: ClipStore, table: DisplayTable | None = None) -> dict[str, PlayedClip]:
    """slot -> the frames of each stored panel, display-encoded (made now where they were not), touched into memory.

    InputError where a clip is missing or damaged, or where the trial's clips together do not fit into memory.
    """
    clips = {panel.slot: store.open(panel.clip) for panel in trial.panels if not panel.live}
    cache = PlayCache(store, table)
    played: dict[str, PlayedClip] = {}
    for slot, clip in clips.items():
        if not cache.path(clip).is_file():
            store.open_verified(clip.identity)  # what is encoded was checked byte by byte
        played[slot] = cache.played(clip)
    problems = memory_problems(list(played.values()))
    if problems and not disk_is_fast_enough(list(played.values())):
        raise InputError(*problems)
    for source in [] if problems else played.values():
        source.touch()
    return played


def disk_is_fast_enough(sources: Sequence[PlayedClip], sample_bytes: int = 1 << 28) -> bool:
    """Whether the disk, measured now on the largest of the files, reads at twice the rate that playing all needs."""
    needed = sum(s.byte_count / s.frame_count * float(s.rate_hz) for s in sources)
    largest = max(sources, key=lambda source: source.byte_count)
    return measured_read_rate(largest.path, sample_bytes) >= 2 * needed


def measured_read_rate(path: Path, sample_bytes: int) -> float:
    """Bytes a second that the disk gives, read from the end of ``path`` after the system was told to forget it."""
    with open(path, "rb", buffering=0) as file:
        size = min(sample_bytes, os.fstat(file.fileno()).st_size)
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        file.seek(-size, os.SEEK_END)
        began, left = now_ns(), size
        while left > 0 and (data := file.read(min(left, 1 << 24))):
            left -= len(data)
        return (size - left) / max(now_ns() - began, 1) * 1e9


def memory_problems(sources: Sequence[PlayedClip], available_bytes: int | None = None) -> list[str]:
    """A line where the clips of one trial do not fit into free memory together (each file counted once)."""
    needed = sum({source.path: source.byte_count for source in sources}.values())
    free = psutil.virtual_memory().available if available_bytes is None else available_bytes
    if needed <= free:
        return []
    return [
        problem(
            "playback", "clips of one trial", f"{needed / 1e9:.2f} GB", f"at most {free / 1e9:.2f} GB of free memory"
        )
    ]


def luminance_problems(study: Study, trial: Trial, store: ClipStore) -> list[str]:
    """Compared clips of one trial whose mean displayed luminance differs by more than the protocol's limit."""
    limit = float(study.timing.luminance_limit)
    means = {
        panel.slot: float(store.open(panel.clip).manifest["luminance"]["mean"])
        for panel in trial.panels
        if panel.clip and not panel.live and store.has(panel.clip)
    }
    if len(means) < 2:
        return []
    low, high = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
    share = (means[high] - means[low]) / means[high] if means[high] > 0 else 0.0
    if share <= limit:
        return []
    where = f"trial {trial.index} ({trial.block}, {trial.scene})"
    return [
        problem(where, f"luminance of {low} and {high}", f"{100 * share:.2f} % apart", f"at most {100 * limit:g} %")
    ]


def clip_record(clip: Clip) -> dict[str, object]:
    """What a session file keeps of a clip (its table ``clips``): clip, manifest, cost."""
    return {
        "clip": clip.identity,
        "manifest": dict(clip.manifest),
        "cost": clip.cost(),
        "request": asdict(clip.request),
    }
