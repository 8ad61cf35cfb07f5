"""Lab Streaming Layer: any vendor's gaze stream in (by the XDF gaze convention), markers out.

Convention: https://github.com/sccn/xdf/wiki/Gaze-Meta-Data. A channel has type (ScreenX, ScreenY, DirectionX/Y/Z,
Diameter, Confidence, ...), eye (left | right | both), unit (pixels | normalized | mm | degrees). Raw stamps are kept;
the sender's clock is mapped through `time_correction`, asked for once a second.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pylsl

from protocols.records import GAZE_DTYPE
from studyapp.clock import now_ns
from studyapp.devices.clock_model import ClockFit, ClockModel
from studyapp.devices.device import Batch, DeviceGone, DeviceSpec, silence_limit_s
from studyapp.gaze.angles import ScreenGeometry

LOOPBACK = "[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n[log]\nlevel = -3\n"
"""liblsl's configuration for streams of this machine only; it must be set before the library is first used."""

_EYES = {"both": 0, "left": 1, "right": 2}


def keep_to_this_machine() -> None:
    """Streams are looked for on loopback only (this process; before any other use of pylsl)."""
    pylsl.set_config_content(LOOPBACK)


@dataclass(frozen=True)
class GazeLayout:
    """Which channels make a gaze sample, -1: none. ``unit`` of x and y: normalized, pixels, degrees, direction (unit
    vectors to the right, up, away from the eye, in x, y and z)."""

    x: int
    y: int
    unit: str
    z: int = -1
    confidence: int = -1
    pupil: int = -1
    pupil_in_metres: bool = False
    eye: int = 0

    def samples(self, values: np.ndarray, screen: ScreenGeometry | None) -> np.ndarray:
        """Channels (N, C) float64 -> (N,) GAZE_DTYPE without stamps; not finite or confidence below 0.6: not valid.

        Degrees need no ``screen``; raises DeviceGone where one is needed and the lab file gives none.
        """
        out = np.zeros(len(values), GAZE_DTYPE)
        x, y = values[:, self.x], values[:, self.y]
        finite = np.isfinite(x) & np.isfinite(y)
        if self.unit == "degrees":
            x_dva, y_dva = x, y
        elif self.unit == "direction":
            z = values[:, self.z]
            finite &= np.isfinite(z) & (z > 0)
            safe = np.where(finite, z, 1.0)
            x_dva = np.degrees(np.arctan2(x, safe))
            y_dva = np.degrees(np.arctan2(y, np.hypot(x, safe)))
        elif screen is None:
            raise DeviceGone(f"gaze in {self.unit}: needs the screen's size and distance (lab file: display)")
        else:
            width, height = screen.size_px if self.unit == "pixels" else (1, 1)
            x_dva, y_dva = screen.to_dva(x / width, y / height)
        valid = finite & (np.abs(x_dva) < 90) & (np.abs(y_dva) < 90)
        if self.confidence >= 0:
            valid &= values[:, self.confidence] >= 0.6
        out["x_dva"], out["y_dva"] = np.where(finite, x_dva, np.nan), np.where(finite, y_dva, np.nan)
        out["pupil_mm"] = values[:, self.pupil] * (1e3 if self.pupil_in_metres else 1) if self.pupil >= 0 else np.nan
        out["valid"], out["eye"] = valid, self.eye
        return out


def gaze_layout(channels: list[dict[str, str]]) -> GazeLayout:
    """The layout of described channels (keys label, type, eye, unit). Both eyes are preferred to one.

    Raises DeviceGone where there is neither a screen position nor a direction.
    """

    def find(kind: str, eye: str) -> int:
        return next(
            (i for i, c in enumerate(channels) if c.get("type") == kind and (c.get("eye") or "both") == eye), -1
        )

    for eye in _EYES:
        extra = (find("Confidence", eye), find("Diameter", eye))
        metres = extra[1] >= 0 and channels[extra[1]].get("unit") in ("m", "meters", "metres")
        x, y = find("ScreenX", eye), find("ScreenY", eye)
        if x >= 0 and y >= 0:
            unit = channels[x].get("unit") or "normalized"
            if unit not in ("normalized", "pixels", "degrees"):
                raise DeviceGone(f"gaze stream: unit of ScreenX: got {unit}, wanted normalized | pixels | degrees")
            return GazeLayout(x, y, unit, -1, extra[0], extra[1], metres, _EYES[eye])
        x, y, z = find("DirectionX", eye), find("DirectionY", eye), find("DirectionZ", eye)
        if min(x, y, z) >= 0:
            return GazeLayout(x, y, "direction", z, extra[0], extra[1], metres, _EYES[eye])
    labels = ", ".join(c.get("type") or c.get("label") or "?" for c in channels)
    raise DeviceGone(f"gaze stream: channels: got {labels}, wanted ScreenX and ScreenY or DirectionX, Y and Z")


def described_channels(info: Any) -> list[dict[str, str]]:
    """The channels' descriptions in a stream's XML."""
    channels = []
    node = info.desc().child("channels").child("channel")
    while not node.empty():
        channels.append({key: node.child_value(key) for key in ("label", "type", "eye", "unit")})
        node = node.next_sibling("channel")
    return channels


class LslGaze:
    """A gaze stream as a `Device`. ``spec.port``: its source_id; options: ``loopback`` (True: this machine only),
    ``resolve_s`` (how long one look for it takes, default 0.5)."""

    descriptor: int | None = None

    def __init__(self, spec: DeviceSpec) -> None:
        self._spec = spec
        if spec.options.get("loopback"):
            with contextlib.suppress(RuntimeError):
                keep_to_this_machine()
        found = pylsl.resolve_byprop("source_id", spec.port, 1, float(spec.options.get("resolve_s", 0.5)))
        if not found:
            raise DeviceGone(f"no LSL stream with source id {spec.port}")
        # Recovery is ours: a stream that went away must be seen to be away.
        self._inlet = pylsl.StreamInlet(found[0], max_buflen=10, recover=False)
        try:
            info = self._inlet.info(2.0)
            self._inlet.open_stream(2.0)
            self._correction = float(self._inlet.time_correction(2.0))
        except (pylsl.util.LostError, TimeoutError, RuntimeError) as error:
            raise DeviceGone(f"LSL stream {spec.port}: does not answer ({error})") from error
        self._layout = gaze_layout(described_channels(info))
        self._silence_s = silence_limit_s(spec)
        self._rate_hz = float(info.nominal_srate())
        self._channels = int(info.channel_count())
        self._clock = ClockModel("symmetric")
        self._fit: ClockFit | None = None
        self._last_ns = now_ns()
        self._corrected_ns = 0
        self._map_clock()

    def _map_clock(self) -> None:
        """One pair of clocks: the sender's time now, by liblsl's own round trips."""
        self._correction = float(self._inlet.time_correction(0.2))
        before_ns = now_ns()
        local_s = float(pylsl.local_clock())
        after_ns = now_ns()
        self._clock.arrival(local_s - self._correction, (before_ns + after_ns) // 2)
        self._fit = self._clock.fit()
        self._corrected_ns = after_ns

    def poll(self) -> Batch:
        try:
            values, stamps = self._inlet.pull_chunk(timeout=0.0, max_samples=4096, as_numpy=True)
            host_ns = now_ns()
            if host_ns - self._corrected_ns > 1e9:
                self._map_clock()
        except (pylsl.util.LostError, TimeoutError, RuntimeError) as error:
            raise DeviceGone(f"LSL stream {self._spec.port}: lost ({error or 'closed by its sender'})") from error
        if not len(stamps):
            silent_s = (host_ns - self._last_ns) * 1e-9
            if self._rate_hz >= 20 and silent_s > self._silence_s:
                raise DeviceGone(f"LSL stream {self._spec.port}: silent for {silent_s:.2f} s at {self._rate_hz:g} Hz")
            return Batch()
        self._last_ns = host_ns
        gaze = self._layout.samples(np.asarray(values, float).reshape(len(stamps), self._channels), self._spec.screen)
        gaze["device_s"], gaze["host_ns"] = stamps, host_ns
        if self._fit is not None:
            gaze["mapped_ns"] = np.minimum(self._fit.session_ns_many(np.asarray(stamps)), host_ns)
        return Batch(gaze=gaze)

    def fit(self) -> ClockFit | None:
        return self._fit

    def close(self) -> None:
        self._inlet.close_stream()


class MarkerOutlet:
    """Our events for other recorders: a stream of type Markers, one string channel, irregular rate."""

    def __init__(self, name: str, source_id: str) -> None:
        info = pylsl.StreamInfo(name, "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, source_id)
        self._outlet = pylsl.StreamOutlet(info)
        # liblsl's clock is the steady clock that ours is; the offset is measured all the same.
        self._offset_s = pylsl.local_clock() - now_ns() * 1e-9

    def send(self, text: str, t_ns: int) -> None:
        """A marker that happened at session time ``t_ns``."""
        self._outlet.push_sample([text], t_ns * 1e-9 + self._offset_s)


def outlet_of_gaze(source_id: str, rate_hz: float, extra: Callable[[Any], None] | None = None) -> Any:
    """A gaze outlet by the convention: normalised screen position, confidence, pupil diameter."""
    info = pylsl.StreamInfo("emulated gaze", "Gaze", 4, rate_hz, pylsl.cf_double64, source_id)
    channels = info.desc().append_child("channels")
    rows = [("x", "ScreenX", "normalized"), ("y", "ScreenY", "normalized"), ("c", "Confidence", "normalized")]
    for label, kind, unit in [*rows, ("d", "Diameter", "mm")]:
        channel = channels.append_child("channel")
        for key, value in (("label", label), ("type", kind), ("eye", "both"), ("unit", unit)):
            channel.append_child_value(key, value)
    if extra is not None:
        extra(info)
    return pylsl.StreamOutlet(info, chunk_size=0, max_buffered=10)
