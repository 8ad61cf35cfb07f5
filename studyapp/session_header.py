"""The header of a session file: everything that must be known to read it in ten years (keys: `protocols.records`)."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil

from protocols.design import group_of
from protocols.records import SCHEMA_VERSION
from protocols.study import Study
from protocols.trial import Trial
from studyapp.clock import now_ns, wall_clock_utc
from studyapp.display.certificate import Certificate
from studyapp.lab_file import Lab

PACKAGES = (
    "studyapp", "numpy", "pydantic", "moderngl", "glfw", "pyserial", "pylsl", "drjit", "mitsuba", "numba",
)  # fmt: skip


def sha256_text(text: str) -> str:
    """sha256 (hex) of a text's UTF-8 bytes."""
    return hashlib.sha256(text.encode()).hexdigest()


def software_versions() -> dict[str, str]:
    """Package -> version of what may matter; absent packages are left out."""
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions


def machine_description() -> dict[str, Any]:
    """The machine without anything that names it or its user."""
    return {
        "system": f"{platform.system()} {platform.release()}",
        "architecture": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_bytes": psutil.virtual_memory().total,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def git_commit() -> str | None:
    """The commit of this source tree, '+' after it where files differ; None outside a checkout or without git."""
    here = Path(__file__).parent
    try:
        head = subprocess.run(
            ["git", "-C", str(here), "rev-parse", "HEAD"], capture_output=True, text=True, check=True, timeout=10
        ).stdout.strip()
        changed = subprocess.run(
            ["git", "-C", str(here), "status", "--porcelain", "-uno"], capture_output=True, text=True, check=True,
            timeout=10,
        ).stdout.strip()  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return head + ("+" if changed else "")


def session_header(
    study: Study, protocol_text: str, slot: int, code: str, run: int, plan: Sequence[Trial], seed: int, *,
    observer_kind: str, observer: str, certificate: Certificate, lab: Lab, overrides: Sequence[Mapping[str, str]] = (),
    provenance: Mapping[str, Any] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """All keys of a new session. ``code``: the person's, ``run`` the number of their session. ``provenance``: software,
    machine and git_commit, where they are known already."""
    known = provenance or here_and_now()
    return {
        "schema_version": SCHEMA_VERSION,
        "study": study.study,
        "protocol_text": protocol_text,
        "protocol_sha256": sha256_text(protocol_text),
        "lab_text": lab.text,
        "lab_sha256": lab.sha256,
        "participant": code,
        "slot": slot,
        "run": run,
        "observer_kind": observer_kind,
        "observer": observer,
        "seed": seed,
        "started_utc": wall_clock_utc(),
        "started_ns": now_ns(),
        "certificate": certificate.as_dict(),
        "stamp_class": certificate.stamp_class,
        "refresh_hz": str(study.display.refresh_hz),
        "overrides": [dict(override) for override in overrides],
        "analysis_plan": study.analysis_plan(),
        "conditions": {name: c.model_dump(mode="json") for name, c in study.all_conditions().items()},
        "plan": [trial.as_dict() for trial in plan],
        "recruitment": {
            "target": study.participants.target,
            "replace_excluded": study.participants.replace_excluded,
        },
        "group": group_of(study, slot),
        "match": [match.model_dump(mode="json") for match in study.match],
        **known,
    }


def here_and_now() -> dict[str, Any]:
    """software, machine and git_commit: the part of a header that is the same for every session of a run."""
    return {"software": software_versions(), "machine": machine_description(), "git_commit": git_commit()}
