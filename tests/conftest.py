"""Shared fixtures: where the real scenes are, if they are beside this checkout."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder of real scenes; tests that need it are skipped, with the reason, where it is absent."""
    folder = Path(os.environ.get("STUDYAPP_ASSETS", Path(__file__).parents[2] / "shared" / "assets"))
    if not folder.is_dir():
        pytest.skip(f"no real scenes: {folder.name} is not beside this checkout (set STUDYAPP_ASSETS)")
    return folder


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """The folder of statistics with known answers; skipped, with the reason, where it is absent."""
    folder = Path(os.environ.get("STUDYAPP_REFERENCE", Path(__file__).parents[2] / "shared" / "reference"))
    if not folder.is_dir():
        pytest.skip(f"no reference data: {folder.name} is not beside this checkout (set STUDYAPP_REFERENCE)")
    return folder
