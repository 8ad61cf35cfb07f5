"""A clip to be made: its request, and from where its scene and camera keys are loaded (no part of its identity)."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from stimuli.clip import ClipStore, request_from_dict, write_json
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError, problem

_JOB = "job.json"


@dataclass(frozen=True)
class ClipJob:
    """``scene_file``: what `load_scene` takes; ``path_file``: a camera path file where ``request.path`` is no name of
    its own; ``path_keys``: JSON of keyframes that the protocol holds ('' where there are none)."""

    request: ClipRequest
    scene_file: str
    path_file: str = ""
    path_keys: str = ""


def _path(store: ClipStore, identity: str) -> Path:
    return store.root / "parts" / identity / _JOB


def write_job(store: ClipStore, job: ClipJob) -> None:
    """Leave the job with the clip's parts, for any worker, and for whoever makes one unit by hand."""
    path = _path(store, job.request.identity)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, asdict(job))


def read_job(store: ClipStore, identity: str) -> ClipJob:
    """The job of a clip in the making; InputError where there is none."""
    path = _path(store, identity)
    if not path.is_file():
        raise InputError(problem(path, "clip in the making", "nothing", "one that studyapp render has begun"))
    data = json.loads(path.read_text())
    return ClipJob(**{**data, "request": request_from_dict(data["request"])})
