"""The streams of a session file: refreshes, gaze, device events, and what the participant said about themselves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from analysis.sessions import Session, connect, read_rows
from protocols.records import FLIP_DTYPE, GAZE_DTYPE, has_table
from stimuli.errors import InputError, problem


def read_flips(session: Session) -> dict[int, np.ndarray]:
    """trial -> its refreshes (FLIP_DTYPE, in order); trials without a record are absent."""
    return _chunks(session.path, "flips", "trial", FLIP_DTYPE)


def read_gaze(session: Session) -> dict[str, np.ndarray]:
    """device -> its gaze samples (GAZE_DTYPE, in order of arrival); empty where none were recorded."""
    return _chunks(session.path, "gaze", "device", GAZE_DTYPE)


def _chunks(path: Path, table: str, key: str, dtype: np.dtype) -> dict[Any, np.ndarray]:
    connection = connect(path)
    try:
        if not has_table(connection, table):
            return {}
        parts: dict[Any, list[bytes]] = {}
        for name, data in connection.execute(f"SELECT {key}, data FROM {table} ORDER BY {key}, chunk"):
            parts.setdefault(name, []).append(data)
    finally:
        connection.close()
    for name, blobs in parts.items():
        if any(len(blob) % dtype.itemsize for blob in blobs):
            wanted = f"a multiple of {dtype.itemsize} bytes"
            raise InputError(problem(f"{path}: {table} of {name}", "chunk", f"{len(blobs[0])} bytes", wanted))
    return {name: np.frombuffer(b"".join(blobs), dtype=dtype) for name, blobs in parts.items()}


def read_events(session: Session) -> list[dict[str, Any]]:
    """Device events in order of time: t_ns, device, kind, payload (parsed), raw (bytes or None)."""
    connection = connect(session.path)
    try:
        rows = read_rows(connection, "events")
    finally:
        connection.close()
    return [{**row, "payload": json.loads(row["payload"])} for row in rows]


def read_self_answers(session: Session) -> dict[str, str]:
    """What the participant said about themselves (acuity, colour vision ...): name -> value."""
    connection = connect(session.path)
    try:
        return {row["name"]: row["value"] for row in read_rows(connection, "answers_about_self")}
    finally:
        connection.close()
