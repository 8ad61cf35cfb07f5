"""Writes a report's files: the page, its JSON, its tables, and the lock of a blind analysis; whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from analysis.blocks import words_block
from analysis.exclusions import compare_with_lock
from analysis.registration import read_registration
from analysis.report import analyse, render_html
from stimuli.errors import InputError, problem

LOCK_NAME = "exclusions.lock.json"


def write_report(
    data: Iterable[str | Path],
    report: Path,
    *,
    json_path: str | Path | None = None,
    tables: str | Path | None = None,
    blind: bool = False,
    registration: str | Path | None = None,
    show_progress: bool = False,
) -> list[Path]:
    """Analyse ``data`` and write the page (and what else is asked for); returns the paths written.

    Blind: writes ``exclusions.lock.json`` beside the page, and refuses to replace one. Later, not blind, the report
    beside a lock says whether its exclusions are those that were locked.
    """
    data = list(data)
    lock_path = report.parent / LOCK_NAME
    if report.parent != Path() and not report.parent.is_dir():
        raise InputError(problem("--report", "folder", report.parent, "a folder that exists"))
    with tqdm(total=5, desc="analyse", disable=None if show_progress else True, leave=False) as bar:
        frozen = read_registration(Path(registration)) if registration is not None else None
        results = analyse(data, blind=blind, progress=lambda step: _step(bar, step), registration=frozen)
        locked = json.dumps(results["exclusion_lock"], indent=1) + "\n"
        if blind and lock_path.exists() and lock_path.read_text(encoding="utf-8") != locked:
            raise InputError(
                problem(lock_path, "locked exclusions", "other exclusions now", "the same, or no lock file")
            )
        if not blind and lock_path.exists():
            _say_lock(results, lock_path)
        _step(bar, "figures")
        page = render_html(results)
    written = [_write(report, page)]
    if json_path is not None:
        written.append(
            _write(Path(json_path), json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
        )
    if tables is not None:
        from analysis.tables import write_tables

        written += write_tables(results, Path(tables))
    if blind:
        written.append(_write(lock_path, locked))
    return written


def _step(bar: Any, step: str) -> None:
    bar.set_postfix_str(step)
    bar.update(bar.n < bar.total)


def _say_lock(results: dict[str, Any], lock_path: Path) -> None:
    """A paragraph in the participants section: do the exclusions agree with the lock beside the report?"""
    try:
        lock = json.loads(lock_path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(problem(lock_path, "lock file", str(error), "as --blind wrote it")) from error
    differences = compare_with_lock(lock, results["exclusion_lock"])
    if differences:
        block = words_block(*[f"{one[0].upper()}{one[1:]}." for one in differences], kind="warning")
    else:
        block = words_block("The exclusions are those that were locked before condition names were shown.")
    results["sections"][0]["blocks"].insert(1, block)


def _write(path: Path, text: str) -> Path:
    """Write beside and move into place, so that an interrupted run leaves no half file."""
    beside = path.with_name(path.name + ".part")
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, path)
    return path
