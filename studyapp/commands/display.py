"""``studyapp display``: measure the display and write its certificate."""

from __future__ import annotations

import argparse
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.display.certificate import Certificate, certify
from studyapp.display.choose import open_display
from studyapp.gaze.angles import ScreenGeometry
from studyapp.lab_file import Lab, find_lab
from studyapp.present.frame_loop import ask_realtime
from studyapp.seams import Display

HELP = "measure the display: is it locked, at what rate, how well; writes its certificate"
EXAMPLE = "studyapp display --display glfw --monitor 0 --size 1920x1080 --rate 240 --json"


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "--display", choices=("glfw", "offscreen", "virtual"), default=None, help="kind (default: lab's, else glfw)"
    )
    parser.add_argument("--monitor", type=int, default=None, help="fullscreen on this monitor (default: a window)")
    parser.add_argument("--size", default=None, metavar="WxH", help="pixels (default: lab's, else 1280x720)")
    parser.add_argument("--rate", default=None, metavar="HZ", help="refresh rate asked for (default: lab's, else 240)")
    parser.add_argument("--refreshes", type=int, default=960, help="swaps to measure, at least 480 (default 960)")
    parser.add_argument(
        "--lab", default=None, metavar="FILE", help="lab file (default: $STUDYAPP_LAB, else lab.yaml here)"
    )
    parser.add_argument("--out", default=None, metavar="FILE", help="also write the certificate here")
    parser.add_argument(
        "--sensor",
        default=None,
        metavar="PORT",
        help="photodiode logger on the light patch; 'emulated' for the shipped emulator",
    )
    parser.add_argument(
        "--eye",
        default=None,
        metavar="DEVICE",
        help="with --sensor: time from eye to light, by the artificial eye before this tracker: KIND:PORT, a name in "
        "the lab file, or KIND:emulated",
    )
    parser.add_argument(
        "--eye-out", default="eye_to_light.json", metavar="FILE", help="where the time from eye to light goes"
    )
    parser.add_argument("--photometry", nargs="?", const="spotread", default=None, metavar="METER",
                        help="measure luminance: spotread | serial:PORT | typed")  # fmt: skip
    parser.add_argument(
        "--photometry-out", default="photometry.json", metavar="FILE", help="where the measured luminance goes"
    )
    parser.add_argument("--realtime", action="store_true", help="ask the system for real-time priority first")
    parser.add_argument("--json", action="store_true", help="print the certificate as JSON")


def run(args: argparse.Namespace) -> int:
    """0: locked; 1: not locked (the certificate is printed all the same)."""
    lab = find_lab(args.lab, Path.cwd())
    if args.eye is not None and args.sensor is None:
        raise InputError(problem("--eye", "light sensor", "none", "--sensor PORT beside it"))
    kind = args.display or lab.display.kind
    size = parse_size(args.size) if args.size else lab.display.size_px
    rate = parse_rate(args.rate) if args.rate else Fraction(lab.display.rate_hz)
    monitor = args.monitor if args.monitor is not None else lab.display.monitor
    # Before the display is opened: the driver's own threads inherit it.
    priority = ask_realtime() if args.realtime else "normal"
    display = open_display(kind, size, rate, monitor)
    try:
        light = eye_to_light = None
        if args.sensor is not None:
            from studyapp.light_sensor import measure_light

            light = measure_light(display, args.sensor)
        if args.eye is not None:
            eye_to_light = _eye_to_light(display, lab, args.eye, args.sensor)
            Path(args.eye_out).write_text(json.dumps(eye_to_light, indent=2) + "\n", encoding="utf-8")
        photometry = lab.photometry_record()
        if args.photometry is not None:
            from studyapp.photometry import measure_photometry

            photometry = measure_photometry(display, args.photometry)
            Path(args.photometry_out).write_text(json.dumps(photometry, indent=2) + "\n", encoding="utf-8")
        certificate = certify(
            display, args.refreshes, declared=lab.display.declared, encoding=lab.encoding_name(), light=light,
            photometry=photometry, eye_to_light=eye_to_light, priority=priority,
            nominal_hz=None if kind != "glfw" or args.rate is None else rate,
        )  # fmt: skip
    finally:
        display.close()
    if args.out:
        Path(args.out).write_text(certificate.to_json() + "\n", encoding="utf-8")
    print(certificate.to_json() if args.json else describe(certificate, lab))
    return 0 if certificate.locked else 1


def _eye_to_light(display: Display, lab: Lab, device: str, sensor: str) -> dict[str, Any]:
    """Open the tracker and measure; JobFailed where it cannot be reached."""
    from studyapp.commands.devices import emulate
    from studyapp.devices.device import DeviceSpec
    from studyapp.devices.device_reader import TRACKER_KINDS, DeviceReader
    from studyapp.gaze.eye_to_light import measure_eye_to_light

    view = lab.display.geometry
    screen = ScreenGeometry(view.width_m, view.height_m, view.distance_m, display.size_px)
    named = next((entry for entry in lab.devices if entry.name == device), None)
    kind, _, port = device.partition(":") if named is None else (named.kind, "", named.port)
    if kind not in TRACKER_KINDS:
        wanted = f"KIND:PORT with KIND of {' | '.join(TRACKER_KINDS)}, or a tracker of the lab file"
        raise InputError(problem("--eye", "device", repr(device), wanted))
    emulator = emulate(kind, screen) if port == "emulated" else None
    options = {} if named is None else dict(named.options)
    if emulator is not None:
        port, options = emulator.port, {"loopback": True}
    reader = DeviceReader([DeviceSpec("eyes", kind, port, options, screen=screen)])
    try:
        missing = reader.wait_until_there(10.0)
        if missing:
            raise JobFailed("; ".join(missing))
        move = None if emulator is None else emulator.step_to
        return measure_eye_to_light(display, reader.gaze("eyes"), sensor, move)
    finally:
        reader.close()
        if emulator is not None:
            emulator.close()


def describe(certificate: Certificate, lab: Lab) -> str:
    """The certificate for a person."""
    residual = "none" if certificate.residual_sd_ms is None else f"{certificate.residual_sd_ms:.4f} ms"
    lines = [
        certificate.display,
        f"  {'LOCKED' if certificate.locked else 'NOT LOCKED: ' + certificate.reason}",
        f"  nominal {certificate.nominal_hz:g} Hz, measured {certificate.measured_hz:.4f} Hz",
        f"  residual SD {residual}, interval SD {certificate.interval_sd_ms:.4f} ms, lost {certificate.lost} "
        f"of {certificate.refreshes}",
        f"  stamps: {certificate.stamp_class} ({certificate.stamp_source}); {certificate.onset}",
        f"  luminance encoding: {certificate.encoding}; background code {certificate.background_code}",
        "  " + ", ".join(f"{name} {value}" for name, value in certificate.settings.items()),
    ]
    if certificate.light:
        light = certificate.light
        lines.append(
            f"  flip to light {light['mean_ms']:.3f} ms, SD {light['sd_ms']:.3f} ms over {light['edges']} edges; "
            f"misses by light {light['light_missed']}, recorded {light['recorded_missed']}"
        )
    if certificate.eye_to_light:
        eye = certificate.eye_to_light
        lines.append(
            f"  eye to light {eye['median_ms']:.1f} ms (median), p95 {eye['p95_ms']:.1f} ms, worst "
            f"{eye['worst_ms']:.1f} ms over {eye['steps']} steps of the eye, {eye['unseen']} not followed"
        )
    if certificate.photometry:
        lines.append(f"  photometry: {certificate.photometry.get('summary', 'from the lab file')}")
    lines += [f"  warning: {warning}" for warning in certificate.warnings]
    if lab.path is None:
        lines.append("  no lab file: settings of this room are not declared")
    return "\n".join(lines)


def parse_size(text: str) -> tuple[int, int]:
    """'1920x1080' -> (1920, 1080)."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() for part in parts):
        raise InputError(problem("--size", "size", repr(text), "WIDTHxHEIGHT, as in 1920x1080"))
    return int(parts[0]), int(parts[1])


def parse_rate(text: str) -> Fraction:
    """'240', '60000/1001' or '59.94' -> Fraction."""
    try:
        rate = Fraction(text)
    except (ValueError, ZeroDivisionError):
        raise InputError(problem("--rate", "rate", repr(text), "a number of Hz, as in 240 or 60000/1001")) from None
    return rate
