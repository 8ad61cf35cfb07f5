"""What a session file holds: the contract between `studyapp` (writes) and `analysis` (reads).

One SQLite database (WAL). A table exists only if it has rows: readers use `has_table`. All ``*_ns`` are nanoseconds of
`studyapp.clock`, the machine's monotonic clock as it is (its zero is the machine's: the header's ``started_ns`` is the
session's start on it); on the virtual display, trials, presses and flips are on that display's own clock.
Streams are packed: a chunk is the bytes of a numpy structured array with the dtype given here, little endian.
"""

from __future__ import annotations

import sqlite3

import numpy as np

SCHEMA_VERSION = 1

# Every statement creates one table; the writer runs it just before the table's first row.
TABLES: dict[str, str] = {
    # key -> JSON value. Keys: schema_version, study, protocol_text, protocol_sha256, lab_text, lab_sha256, participant,
    # run, observer_kind ('person' | 'simulated'), observer (name of the answering device or model), seed, started_utc,
    # started_ns (the session's start on the clock of all *_ns), completed_utc, software {package: version},
    # machine {...}, certificate {...}, stamp_class, refresh_hz, overrides [{check, reason}], analysis_plan {...},
    # conditions {name: {...}}, plan [Trial.as_dict(), ...], group, git_commit,
    # checksums {table: sha256 of its rows} (written last, when the session is sealed)
    "header": "CREATE TABLE header (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    # One row a presentation. trial: running number of presentations (0, 1, ...); planned: index in the plan; attempt:
    # 0 first, 1 re-queued ...; status: ok | timing_failed | device_lost | aborted; panels, factors: JSON of the plan
    "trials": (
        "CREATE TABLE trials (trial INTEGER PRIMARY KEY, planned INTEGER NOT NULL, attempt INTEGER NOT NULL, "
        "block TEXT NOT NULL, kind TEXT NOT NULL, scene TEXT NOT NULL, practice INTEGER NOT NULL, "
        "catch INTEGER NOT NULL, correct TEXT, panels TEXT NOT NULL, factors TEXT NOT NULL, "
        "onset_ns INTEGER NOT NULL, offset_ns INTEGER NOT NULL, refreshes INTEGER NOT NULL, missed INTEGER NOT NULL, "
        "replays INTEGER NOT NULL DEFAULT 0, status TEXT NOT NULL, observer_kind TEXT NOT NULL)"
    ),
    # One row an answer. answer: the slot chosen (choice), the rating as text (likert); rating: number or null; chosen:
    # condition chosen, null unless choice; rt_ns: from stimulus onset; press_ns: on the session clock (mapped);
    # device_stamp: the device's own; raw: the bytes from which the answer was decoded; timed_out: no answer in time
    "responses": (
        "CREATE TABLE responses (trial INTEGER NOT NULL, question TEXT NOT NULL, kind TEXT NOT NULL, answer TEXT, "
        "rating REAL, chosen TEXT, rt_ns INTEGER, press_ns INTEGER, device TEXT NOT NULL, device_stamp REAL, raw BLOB, "
        "timed_out INTEGER NOT NULL DEFAULT 0, PRIMARY KEY (trial, question))"
    ),
    "flips": (
        "CREATE TABLE flips (trial INTEGER NOT NULL, chunk INTEGER NOT NULL, data BLOB NOT NULL, PRIMARY KEY "
        "(trial, chunk))"
    ),
    "gaze": (
        "CREATE TABLE gaze (device TEXT NOT NULL, chunk INTEGER NOT NULL, data BLOB NOT NULL, PRIMARY KEY "
        "(device, chunk))"
    ),
    # device, kind: a device's connected | absent | vanished | reconnected | malformed | marker; session resumed; eyes
    # validation | calibration | fixation; live frames (raw: LIVE_DTYPE of studyapp.present.live); target path (payload:
    # trial, panels [{slot, frames}] in the order of the flips' ``source``; raw: TARGET_DTYPE of each panel's frames,
    # one panel after the other). payload: JSON
    "events": (
        "CREATE TABLE events (t_ns INTEGER NOT NULL, device TEXT NOT NULL, kind TEXT NOT NULL, payload TEXT "
        "NOT NULL, raw BLOB)"
    ),
    # offset_ns and drift: session_ns = device_s * 1e9 * (1 + drift_ppm * 1e-6) + offset_ns
    "clock_fits": (
        "CREATE TABLE clock_fits (t_ns INTEGER NOT NULL, device TEXT NOT NULL, offset_ns REAL NOT NULL, "
        "drift_ppm REAL NOT NULL, uncertainty_ns REAL NOT NULL, n INTEGER NOT NULL)"
    ),
    # manifest, cost, luminance: JSON as in the clip store
    "clips": "CREATE TABLE clips (clip TEXT PRIMARY KEY, manifest TEXT NOT NULL, cost TEXT NOT NULL)",
    "notes": "CREATE TABLE notes (t_ns INTEGER NOT NULL, text TEXT NOT NULL)",
    # name: acuity, colour_vision, consent ... never anything that identifies a person
    "answers_about_self": "CREATE TABLE answers_about_self (name TEXT PRIMARY KEY, value TEXT NOT NULL)",
}

MAX_PANELS = 4

TARGET_DTYPE = np.dtype([("x_dva", "<f4"), ("y_dva", "<f4")])
"""Where a moving fixation target stands on the screen in one frame of a clip: degrees right of the screen's centre and
up, as in GAZE_DTYPE; nan where it is behind the eye."""

FLIP_DTYPE = np.dtype(
    [
        ("refresh", "<i8"),  # index on the display's grid since the session's start
        ("due_ns", "<i8"),  # when the grid says it should be shown
        ("submitted_ns", "<i8"),  # swap requested
        ("shown_ns", "<i8"),  # stamp of the display's own class
        ("missed", "<i4"),  # refreshes lost just before this one
        ("flags", "<i4"),  # FLIP_* bits
        ("source", "<i4", (MAX_PANELS,)),  # frame of each panel's clip, -1: none
        ("upload_ns", "<i8"),
        ("draw_ns", "<i8"),
        ("gaze_age_ns", "<i8"),  # age of the newest gaze sample at submission, -1: none
    ]
)
FLIP_EARLY, FLIP_PHASE_SLIP, FLIP_LIGHT_PATCH, FLIP_ONSET, FLIP_OFFSET = 1, 2, 4, 8, 16
FLIP_LATE = 32  # past the deadline (1.05 or 1.2 periods) and yet nearer to this refresh than to the next

GAZE_DTYPE = np.dtype(
    [
        ("device_s", "<f8"),  # the device's own stamp
        ("host_ns", "<i8"),  # when our process got it
        ("mapped_ns", "<i8"),  # device stamp through the clock model
        ("x_dva", "<f4"),  # degrees of visual angle right of the screen's centre
        ("y_dva", "<f4"),  # degrees up
        ("pupil_mm", "<f4"),
        ("valid", "<u1"),
        ("eye", "<u1"),  # 0 both, 1 left, 2 right
    ]
)


def has_table(connection: sqlite3.Connection, table: str) -> bool:
    """True where the session file holds at least one row of ``table``."""
    found = connection.execute("SELECT 1 FROM sqlite_master WHERE type='table' AND name=?", (table,)).fetchone()
    return found is not None
