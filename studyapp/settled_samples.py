"""How many samples a reference gets whose condition states an error (``reference_error``) instead of a number.

Measured once (`renderers.convergence`) and kept in the store, so that `run` needs no renderer.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

from stimuli.clip import ClipStore, write_json
from stimuli.clip_job import ClipJob
from stimuli.errors import InputError, problem


def settled_samples(job: ClipJob, target: float, store: ClipStore) -> int:
    """The smallest power of two, at most the request's ``spp``, whose measured standard error of display values is
    within ``target`` in the first, middle and last frame. InputError, with the error found, where none is."""
    most = int(job.request.params["spp"])
    asked = replace(job.request, params={**job.request.params, "spp": 0})
    name = hashlib.sha256(f"{asked.identity} {target!r} {most}".encode()).hexdigest()[:40]
    path = store.root / "convergence" / f"{name}.json"
    errors: dict[int, float] = {}
    if path.is_file():
        try:
            errors = {int(spp): float(error) for spp, error in json.loads(path.read_text())["errors"].items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            path.unlink()  # damaged: measured again
    if not errors:
        from renderers.clip_renderer import ClipRenderer
        from renderers.convergence import samples_for_error

        errors = dict(samples_for_error(job, target, ClipRenderer(None), most=most).errors)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {"scene": job.request.scene, "target": target, "errors": errors})
    last = max(errors)
    if errors[last] > target:
        got = f"{errors[last]:.5f} at {last} spp"
        raise InputError(problem(f"scene {job.request.scene}", "reference error", got, f"{target:g} within {most} spp"))
    return last
