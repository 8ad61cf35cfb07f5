"""Photometry: what luminance a display code really gives. Patches, a meter, a curve, a dated record.

Meters: ArgyllCMS ``spotread``, a serial meter that answers a line of text with a number of cd/m2, or values typed in.
The curve L(code) = L0 + (Lmax - L0) (code / 255)^gamma is fitted beside the measured table, which is what counts.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
import serial
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from stimuli.errors import InputError, problem
from studyapp.clock import wall_clock_utc
from studyapp.seams import Display

GREYS = tuple(round(step * 255 / 16) for step in range(17))
PATCH_SHARE = 0.2
"""A patch's side as a share of the display's height."""
SETTLE_REFRESHES = 48

Meter = Callable[[str], float]
"""Told what is shown, returns its luminance in cd/m2."""


@dataclass(frozen=True)
class Patch:
    """One thing to be measured: RGB codes and the place of its centre as shares of width and height."""

    name: str
    rgb: tuple[int, int, int]
    at: tuple[float, float] = (0.5, 0.5)


def patches() -> tuple[Patch, ...]:
    """Black, white, 17 greys, primaries, and white at nine positions."""
    greys = [Patch(f"grey {code}", (code, code, code)) for code in GREYS]
    primaries = [Patch("red", (255, 0, 0)), Patch("green", (0, 255, 0)), Patch("blue", (0, 0, 255))]
    places = [(x, y) for y in (1 / 6, 1 / 2, 5 / 6) for x in (1 / 6, 1 / 2, 5 / 6)]
    nine = [Patch(f"white {n + 1} of 9", (255, 255, 255), place) for n, place in enumerate(places)]
    return (Patch("black", (0, 0, 0)), Patch("white", (255, 255, 255)), *greys, *primaries, *nine)


@dataclass(frozen=True)
class Curve:
    """L(code) = black + (white - black) (code / 255)^gamma; ``rms_share``: RMS of the fit over the white."""

    black_cd_m2: float
    white_cd_m2: float
    gamma: float
    rms_share: float

    def luminance(self, code: np.ndarray) -> np.ndarray:
        """cd/m2 of display codes."""
        return self.black_cd_m2 + (self.white_cd_m2 - self.black_cd_m2) * (np.asarray(code) / 255.0) ** self.gamma


def fit_curve(codes: Sequence[int], luminance_cd_m2: Sequence[float]) -> Curve:
    """Least squares of black, white and gamma. Raises InputError where the values are no display's."""
    code, measured = np.asarray(codes, float), np.asarray(luminance_cd_m2, float)
    if len(code) < 4 or not np.isfinite(measured).all() or (measured < 0).any():
        raise InputError(problem("photometry", "luminances", measured.tolist(), "four or more finite values >= 0"))
    if measured[np.argmax(code)] <= measured[np.argmin(code)]:
        got = f"{measured[np.argmax(code)]:g} for white, {measured[np.argmin(code)]:g} for black"
        raise InputError(problem("photometry", "luminances", got, "white brighter than black"))
    start = [float(measured.min()), float(measured.max()), 2.2]

    def residual(p: np.ndarray) -> np.ndarray:
        return p[0] + (p[1] - p[0]) * (code / 255.0) ** p[2] - measured

    found = least_squares(residual, start, bounds=([0, 0, 0.2], [np.inf, np.inf, 6]), x_scale=[0.1, start[1], 1])
    rms = float(np.sqrt(np.mean(found.fun**2))) / start[1]
    return Curve(float(found.x[0]), float(found.x[1]), float(found.x[2]), rms)


def measured_table(codes: Sequence[int], luminance_cd_m2: Sequence[float]) -> np.ndarray:
    """(256,) cd/m2 of every code: monotone cubic through the measured greys (repeated codes averaged).

    Raises InputError where the greys fall by more than 1 % of the white (a monotone table would hide it).
    """
    code = np.unique(np.asarray(codes))
    measured = np.array([np.mean(np.asarray(luminance_cd_m2, float)[np.asarray(codes) == one]) for one in code])
    falls = -np.diff(measured).min(initial=0.0)
    if falls > 0.01 * measured.max():
        raise InputError(
            problem("photometry", "greys", f"a fall of {falls:.3g} cd/m2", "luminance that rises with code")
        )
    rising = np.asarray(PchipInterpolator(code, np.maximum.accumulate(measured))(np.arange(256)))
    # Equal neighbours (a black floor) are set apart by less than any meter reads: the encoder inverts the table.
    return rising + 1e-9 * measured.max() * np.arange(256)


def record_of(shown: Sequence[Patch], luminance_cd_m2: Sequence[float], meter: str, date: str) -> dict[str, Any]:
    """The record that stands in the certificate and in the lab's photometry file."""
    value = {patch.name: float(light) for patch, light in zip(shown, luminance_cd_m2, strict=True)}
    greys = [value[f"grey {code}"] for code in GREYS]
    curve = fit_curve(GREYS, greys)
    table = measured_table(GREYS, greys)
    nine = np.array([value[f"white {n} of 9"] for n in range(1, 10)])
    uniformity = float(nine.min() / nine.max())
    parts = value["red"] + value["green"] + value["blue"] - 2 * value["black"]
    return {
        "date": date,
        "meter": meter,
        "codes": list(range(256)),
        "luminance_cd_m2": table.tolist(),
        "measured": value,
        "curve": {
            "black_cd_m2": curve.black_cd_m2,
            "white_cd_m2": curve.white_cd_m2,
            "gamma": curve.gamma,
            "rms_share": curve.rms_share,
        },
        "contrast": value["white"] / value["black"] if value["black"] > 0 else None,
        "uniformity": uniformity,
        "additivity": parts / value["white"],
        "summary": f"{curve.white_cd_m2:.1f} cd/m2 white, gamma {curve.gamma:.3f} (RMS {curve.rms_share:.2%}), "
        f"uniformity {uniformity:.1%}, {date[:10]}, {meter}",
    }


def spotread_meter() -> Meter:
    """ArgyllCMS ``spotread``: one emissive reading a call, its Y in cd/m2."""
    program = shutil.which("spotread")
    if program is None:
        wanted = "ArgyllCMS (apt install argyll), or --photometry serial:PORT, or --photometry typed"
        raise InputError(problem("photometry", "spotread", "not installed", wanted))

    def read(name: str) -> float:
        done = subprocess.run([program, "-e", "-O", "-x"], capture_output=True, text=True, check=False)
        return parse_spotread(done.stdout, name)

    return read


def parse_spotread(said: str, name: str) -> float:
    """Y of ``Result is XYZ: X Y Z`` in cd/m2."""
    found = re.search(r"Result is XYZ:\s*(\S+)\s+(\S+)\s+(\S+)", said)
    number = None if found is None else _number(found.group(2).rstrip(","))
    if number is None:
        last = said.strip().splitlines()[-1] if said.strip() else "nothing"
        raise InputError(problem("photometry", f"spotread at {name}", repr(last[:80]), "Result is XYZ: X Y Z"))
    return number


def serial_meter(port: str, timeout_s: float = 20.0) -> Meter:
    """A meter that answers ``M`` and a line end with a line whose first number is cd/m2."""
    try:
        line = serial.Serial(port, 9600, timeout=timeout_s)
    except serial.SerialException as error:
        raise InputError(
            problem("photometry", "port", f"{port} ({str(error).split(':')[0]})", "a serial port")
        ) from None

    def read(name: str) -> float:
        line.reset_input_buffer()
        line.write(b"M\r\n")
        said = line.readline().decode("ascii", "replace")
        found = re.search(r"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?", said)
        number = None if found is None else _number(found.group(0))
        if number is None:
            raise InputError(problem("photometry", f"meter at {name}", repr(said[:60]), "a number of cd/m2"))
        return number

    return read


def typed_meter(ask: Callable[[str], str] = input) -> Meter:
    """Somebody reads the meter and types the number."""

    def read(name: str) -> float:
        while True:
            number = _number(ask(f"cd/m2 of {name}: ").strip().replace(",", "."))
            if number is not None and number >= 0:
                return number

    return read


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def open_meter(kind: str) -> tuple[Meter, str]:
    """'spotread', 'serial:PORT' or 'typed' -> meter and its name."""
    if kind == "spotread":
        return spotread_meter(), "ArgyllCMS spotread"
    if kind == "typed":
        return typed_meter(), "typed values"
    if kind.startswith("serial:") and len(kind) > 7:
        return serial_meter(kind[7:]), f"serial meter on {kind[7:]}"
    raise InputError(problem("--photometry", "meter", kind, "spotread | serial:PORT | typed"))


def measure_photometry(display: Display, kind: str, meter: Meter | None = None) -> dict[str, Any]:
    """Show every patch on black, read the meter, return the record. ``meter`` stands in for the one of ``kind``."""
    gl = display.context()
    if not isinstance(gl, moderngl.Context):
        raise InputError(problem("photometry", "display", display.description, "one with light: glfw"))
    read, name = open_meter(kind) if meter is None else (meter, kind)
    shown = patches()
    values = []
    for patch in shown:
        for _ in range(SETTLE_REFRESHES):
            draw_patch(gl, display.size_px, patch)
            display.flip()
        values.append(read(patch.name))
    return record_of(shown, values, name, wall_clock_utc())


def draw_patch(gl: moderngl.Context, size_px: tuple[int, int], patch: Patch) -> None:
    """A square patch on black."""
    width, height = size_px
    side = max(1, round(PATCH_SHARE * height))
    left = min(max(0, round(patch.at[0] * width - side / 2)), width - side)
    top = min(max(0, round(patch.at[1] * height - side / 2)), height - side)
    gl.clear(0.0, 0.0, 0.0, 1.0)
    gl.scissor = (left, height - top - side, side, side)
    red, green, blue = (code / 255 for code in patch.rgb)
    gl.clear(red, green, blue, 1.0)
    gl.scissor = None
