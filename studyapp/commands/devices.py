"""``studyapp devices``: what is attached, and a live test of one."""

from __future__ import annotations

import argparse
import json
import select
from pathlib import Path
from typing import Any

from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.clock import now_ns
from studyapp.devices.decoders import BOX_KINDS
from studyapp.devices.device import DeviceSpec
from studyapp.devices.device_reader import TRACKER_KINDS, DeviceReader
from studyapp.gaze.angles import ScreenGeometry
from studyapp.lab_file import find_lab

HELP = "response boxes and eye trackers: what is attached; live test of one"
EXAMPLE = "studyapp devices --test xid:/dev/ttyUSB0 --seconds 20"
KINDS = (*BOX_KINDS, *TRACKER_KINDS)
VENDOR_EXTRAS = {"tobii": "tobii_research", "eyelink": "pylink"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--json", action="store_true", help="one JSON object")
    parser.add_argument(
        "--test",
        default=None,
        metavar="KIND:PORT",
        help=f"show what one sends; KIND: {', '.join(KINDS)}; port 'emulated': an emulator",
    )
    parser.add_argument(
        "--watch",
        type=Path,
        default=None,
        metavar="SESSION",
        help="for the experimenter, in another terminal: gaze and progress of the running session with this file",
    )
    parser.add_argument("--seconds", type=float, default=None, help="how long to test (default 10) or watch (its end)")
    parser.add_argument("--lab", default=None, metavar="FILE", help="lab file (default: $STUDYAPP_LAB, else lab.yaml)")
    parser.add_argument("--no-lsl", action="store_true", help="do not look for streams on the network")


def run(args: argparse.Namespace) -> int:
    """List, or test one. 1 where the tested device cannot be reached."""
    if args.seconds is not None and not 0 < args.seconds <= 86400:
        raise InputError(problem("--seconds", "duration", args.seconds, "more than 0, at most 86400"))
    if args.watch is not None:
        return _watch_session(args.watch, args.seconds)
    if args.test is not None:
        return _test(args)
    found = attached(look_for_streams=not args.no_lsl)
    if args.json:
        print(json.dumps(found, indent=1))
        return 0
    for port in found["serial"]:
        line = f"serial  {port['port']}  {port['description']}"
        print(line + (f"  Cedrus XID {port['xid']} at {port['baud']}" if port.get("xid") else ""))
        for warning in port["warnings"]:
            print(f"        warning: {warning}")
    for stream in found["lsl"]:
        print(
            f"lsl     {stream['source_id']}  {stream['name']}, {stream['channels']} channels at {stream['rate_hz']:g}"
        )
    for name, state in found["extras"].items():
        print(f"{name:<7} {state}")
    if not found["serial"] and not found["lsl"]:
        print("nothing is attached (serial ports, LSL gaze streams); the keyboard always is")
    return 0


def attached(look_for_streams: bool = True) -> dict[str, Any]:
    """Serial ports (with Cedrus boxes found by asking), LSL gaze streams, which vendors' libraries are installed."""
    from importlib.util import find_spec

    from studyapp.devices import cedrus_xid
    from studyapp.devices.serial_box import attached_ports, latency_warning

    ports = attached_ports()
    boxes = {port: (baud, identity.text) for port, baud, identity in cedrus_xid.find([name for name, _ in ports])}
    serial = []
    for name, description in ports:
        baud, text = boxes.get(name, (None, None))
        serial.append(
            {
                "port": name,
                "description": description,
                "xid": text,
                "baud": baud,
                "warnings": list(latency_warning(name)),
            }
        )
    streams = []
    if look_for_streams:
        import pylsl

        # The library greets on stderr at its default log level.
        pylsl.set_config_content("[log]\nlevel = -3\n")
        for info in pylsl.resolve_byprop("type", "Gaze", 0, 1.0):
            streams.append(
                {
                    "source_id": info.source_id(),
                    "name": info.name(),
                    "channels": info.channel_count(),
                    "rate_hz": info.nominal_srate(),
                }
            )
    extras = {
        name: "library installed" if find_spec(module) else f"library not installed (studyapp[{name}]); or use LSL"
        for name, module in VENDOR_EXTRAS.items()
    }
    return {"serial": serial, "lsl": streams, "extras": extras}


def _test(args: argparse.Namespace) -> int:
    kind, colon, port = args.test.partition(":")
    if not colon or kind not in KINDS:
        raise InputError(problem("--test", "device", repr(args.test), f"KIND:PORT with KIND of {' | '.join(KINDS)}"))
    lab = find_lab(args.lab, Path.cwd())
    view = lab.display.geometry
    screen = ScreenGeometry(view.width_m, view.height_m, view.distance_m, lab.display.size_px)
    emulator = None
    if port == "emulated":
        emulator = emulate(kind, screen)
        port = emulator.port
    reader = DeviceReader([DeviceSpec("device", kind, port, {"loopback": emulator is not None}, screen=screen)])
    try:
        missing = reader.wait_until_there(10.0)
        if missing:
            raise JobFailed("; ".join(missing))
        if emulator is not None and kind in BOX_KINDS:
            for n in range(3):
                emulator.tell("press", str(n + 1), now_ns() + int((n + 1) * 0.2e9))
        _watch(reader, kind, 10.0 if args.seconds is None else args.seconds)
        missing = reader.missing()
        if missing:
            raise JobFailed("; ".join(missing))
    finally:
        reader.close()
        if emulator is not None:
            emulator.close()
    return 0


def emulate(kind: str, screen: ScreenGeometry) -> Any:
    """The shipped emulator of a kind."""
    from studyapp.devices import emulators, tracker_emulators

    if kind == "lsl":
        return emulators.gaze_emulator("studyapp-test", 120.0, screen)
    if kind == "gazepoint":
        return tracker_emulators.gazepoint_emulator(150.0, screen)
    if kind == "pupil":
        return tracker_emulators.pupil_emulator(120.0, screen)
    if kind in VENDOR_EXTRAS:
        raise InputError(problem("--test", "port", "emulated", f"a real one: {kind} has no emulator"))
    return emulators.box_emulator(kind)


def _watch_session(path: Path, seconds: float | None) -> int:
    """A line twice a second until the session is complete, or ``seconds`` are over."""
    from studyapp.session_watch import look

    until_ns = None if seconds is None else now_ns() + int(seconds * 1e9)
    while True:
        state = look(path)
        print(state.line(), flush=True)
        if state.complete:
            print("the session is complete")
        if state.complete or (until_ns is not None and now_ns() >= until_ns):
            return 0
        select.select([], [], [], 0.5)


def _watch(reader: DeviceReader, kind: str, seconds: float) -> None:
    """Print presses, or gaze twice a second, for a while."""
    until_ns, next_ns, count = now_ns() + int(seconds * 1e9), 0, 0
    while now_ns() < until_ns:
        for press in reader.presses():
            late_ms = (press.host_ns - press.mapped_ns) * 1e-6
            print(f"press {press.key}  bytes {press.raw.hex(' ')}  read {late_ms:.2f} ms after the device's stamp")
        if kind not in BOX_KINDS and reader.streams.gaze is not None:
            count += len(reader.streams.gaze.take())
            newest = reader.gaze("device").newest()
            if now_ns() >= next_ns and newest is not None:
                next_ns = now_ns() + 500_000_000
                state = "valid" if newest[3] else "not valid"
                print(f"gaze {newest[0]:+.2f} {newest[1]:+.2f} degrees, {state}; {count} samples so far")
        select.select([], [], [], 0.01)
