"""The lab file: what belongs to a room. Display, what the system cannot tell of it, photometry, devices, ports.

YAML; unknown keys are errors at file:line:column. A protocol runs unchanged in another lab; both are hashed into the
session. Found as ``--lab FILE``, else ``$STUDYAPP_LAB``, else ``lab.yaml`` in the given folder; with none of them the
room is undeclared, and the certificate says so.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from protocols.quantity import Model, Name, Positive, Rate, Size
from protocols.yaml_source import read_yaml
from renderers.technique import ViewGeometry
from stimuli.encode import DisplayTable, table_from_samples
from stimuli.errors import InputError, problem

DisplayKind = Literal["glfw", "offscreen", "virtual"]


class Declared(Model):
    """What the system does not tell about a display; free words ('8 bit + FRC', 'off', 'fast')."""

    bit_depth: str | None = None
    dithering: str | None = None
    scaling: str | None = None
    vrr: str | None = None
    strobing: str | None = None
    overdrive: str | None = None


class LabDisplay(Model):
    """The room's display and where the observer sits. ``monitor``: number for fullscreen, absent: a window."""

    kind: DisplayKind = "glfw"
    monitor: int | None = Field(default=None, ge=0, le=15)
    size_px: Size = (1280, 720)
    rate_hz: Rate = "240"
    width_m: Positive = 0.5313
    height_m: Positive = 0.2989
    distance_m: Positive = 0.6
    settings: Declared = Declared()

    @property
    def declared(self) -> dict[str, str]:
        """The settings that were declared."""
        return {name: value for name, value in self.settings.model_dump().items() if value is not None}

    @property
    def geometry(self) -> ViewGeometry:
        """The screen as the observer sees it."""
        return ViewGeometry(self.width_m, self.height_m, self.distance_m)


class LabPhotometry(Model):
    """Where the measured luminance stands (a file written by ``studyapp display --photometry``) and its age limit."""

    file: str
    max_age_days: Positive = 90.0


class LabGazeLatency(Model):
    """Where the measured time from eye to light stands (written by ``studyapp display --sensor --eye``), and its age
    limit."""

    file: str
    max_age_days: Positive = 180.0


class LabDevice(Model):
    """One device: ``kind`` and ``port`` as `studyapp.devices` names them; ``keys``: device key -> protocol key."""

    name: Name
    kind: str
    port: str = ""
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)
    keys: dict[str, str] = Field(default_factory=dict)


class LabSensor(Model):
    """The photodiode on the light patch."""

    port: str
    patch_corner: Literal["upper_left", "upper_right", "lower_left", "lower_right"] = "lower_left"


class LabModel(Model):
    """The lab file's keys."""

    name: str = "undeclared"
    display: LabDisplay = LabDisplay()
    photometry: LabPhotometry | None = None
    sensor: LabSensor | None = None
    gaze_latency: LabGazeLatency | None = None
    devices: tuple[LabDevice, ...] = ()


class Lab(LabModel):
    """A lab as read: its text and hash go into every session's header. ``path`` None: no file, all defaults."""

    path: Path | None = None
    text: str = ""

    @property
    def sha256(self) -> str:
        """Hash of the file's text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def photometry_record(self) -> dict[str, Any] | None:
        """The measured luminance that the lab file names; None where it names none. InputError: unreadable."""
        if self.photometry is None:
            return None
        keys = {"date", "codes", "luminance_cd_m2"}
        return self._record("photometry", self.photometry.file, "studyapp display --photometry", keys)

    def gaze_latency_record(self) -> dict[str, Any] | None:
        """The measured time from eye to light; None where the lab file names none. InputError: unreadable."""
        if self.gaze_latency is None:
            return None
        made_by = "studyapp display --sensor PORT --eye DEVICE"
        return self._record("gaze_latency", self.gaze_latency.file, made_by, {"date", "p95_ms", "steps"})

    def _record(self, key: str, name: str, made_by: str, keys: set[str]) -> dict[str, Any]:
        """A measurement that the lab file names under ``key``."""
        file = Path(name)
        if self.path is not None and not file.is_absolute():
            file = self.path.parent / file
        try:
            record = json.loads(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(problem(self.path, f"{key}.file", f"{file.name}, which is not there", "a file")) from None
        except (json.JSONDecodeError, UnicodeDecodeError):
            raise InputError(problem(file, key, "no JSON", f"a file of {made_by}")) from None
        if not isinstance(record, dict) or not keys <= record.keys():
            raise InputError(problem(file, key, "another kind of file", f"keys {', '.join(sorted(keys))}"))
        return record

    def display_table(self) -> DisplayTable | None:
        """The measured table that pictures are encoded with; None: sRGB."""
        return table_of(self.photometry_record())

    def encoding_name(self) -> str:
        """How code becomes luminance: 'measured table (sha256 ...)' or 'sRGB (assumed)'."""
        record = self.photometry_record()
        if record is None:
            return "sRGB (assumed)"
        digest = hashlib.sha256(json.dumps(record["luminance_cd_m2"]).encode()).hexdigest()
        return f"measured table (sha256 {digest[:12]})"


def table_of(photometry: Mapping[str, Any] | None) -> DisplayTable | None:
    """The display table of a photometry record (a lab's, or that of a session's certificate); None where there is
    none. Raises InputError where its luminances do not rise."""
    if photometry is None:
        return None
    return table_from_samples(photometry["codes"], photometry["luminance_cd_m2"])


def find_lab(named: str | Path | None, folder: Path) -> Lab:
    """The lab file by its rule (see the module). InputError where a named one is not there."""
    chosen = named or os.environ.get("STUDYAPP_LAB")
    if chosen:
        return load_lab(Path(chosen))
    beside = folder / "lab.yaml"
    return load_lab(beside) if beside.is_file() else Lab()


def load_lab(path: Path) -> Lab:
    """Read and check one lab file; all problems at once."""
    if not path.is_file():
        raise InputError(problem(path, "lab file", "nothing there", "a lab file"))
    root = read_yaml(path)
    try:
        model = LabModel.model_validate_json(json.dumps(root.plain()))
    except ValidationError as error:
        lines = []
        for detail in error.errors(include_url=False):
            steps = detail["loc"]
            what = ".".join(str(step) for step in steps) or "lab"
            unknown = detail["type"] == "extra_forbidden"
            context = detail.get("ctx", {})
            got = (
                f"unknown key {str(steps[-1])!r}"
                if unknown
                else str(context.get("got", repr(detail.get("input"))[:60]))
            )
            wanted = "no such key here" if unknown else str(context.get("wanted", detail["msg"]))
            lines.append(problem(root.find(steps), what, got, wanted[0].lower() + wanted[1:]))
        raise InputError(*lines) from None
    return Lab(path=path.resolve(), text=path.read_text(encoding="utf-8"), **model.model_dump())


def photometry_age_warning(record: dict[str, Any] | None, max_age_days: float, today: date) -> str | None:
    """A warning where the display was measured too long ago, or never; None where all is well."""
    if record is None:
        return "luminance was never measured (studyapp display --photometry)"
    return age_warning("luminance", record, max_age_days, today)


def age_warning(what: str, record: Mapping[str, Any], max_age_days: float, today: date) -> str | None:
    """A warning where a dated measurement is older than its limit; None where it is not."""
    age = (today - date.fromisoformat(str(record["date"])[:10])).days
    return f"{what} was measured {age} days ago, the limit is {max_age_days:g}" if age > max_age_days else None
