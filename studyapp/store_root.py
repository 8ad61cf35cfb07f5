"""Where a protocol's clips are; nothing heavy is imported here, so that `check` can ask."""

from __future__ import annotations

import os
from pathlib import Path

from protocols.load import library_path


def store_directory(protocol: str | Path, given: str | None = None) -> Path:
    """--store, else $STUDYAPP_STORE, else .clips beside the protocol (for shipped protocols, in the current folder)."""
    if given:
        return Path(given)
    if os.environ.get("STUDYAPP_STORE"):
        return Path(os.environ["STUDYAPP_STORE"])
    file = library_path(protocol)
    shipped = Path(library_path("demo")).parent
    return (Path.cwd() if file.parent == shipped else file.parent) / ".clips"
