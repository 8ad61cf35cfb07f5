"""Compiled code that is older than a source it may call does not survive."""

from __future__ import annotations

import os
from pathlib import Path

from renderers.adaptive_frameless.compiled import SOURCES, drop_stale_code


def test_code_older_than_a_source_is_dropped_and_newer_code_stays(tmp_path: Path) -> None:
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    for k, name in enumerate(("tiling.py", "sampler.py", "technique.py")):
        (tmp_path / name).write_text("")
        os.utime(tmp_path / name, (100 + 100 * k, 100 + 100 * k))  # technique.py is no compiled source
    for name, time_s in (("old.nbi", 150), ("old.1.nbc", 150), ("new.nbi", 250), ("sampler.pyc", 50)):
        (cache / name).write_text("")
        os.utime(cache / name, (time_s, time_s))
    assert drop_stale_code(tmp_path) == 2
    assert sorted(path.name for path in cache.iterdir()) == ["new.nbi", "sampler.pyc"]
    assert drop_stale_code(tmp_path) == 0


def test_every_module_with_compiled_functions_is_a_source() -> None:
    folder = Path(__file__).parents[3] / "renderers" / "adaptive_frameless"
    for path in folder.glob("*.py"):
        if any(f"@{name}" in path.read_text() for name in ("njit", "uncounted", "inlined")):
            assert path.stem in SOURCES, path.name
