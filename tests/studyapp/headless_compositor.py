"""A real vblank without a monitor: sway on the wlroots headless backend, started as an ordinary user.

It announces the refresh rate that its configuration asks for, and paces clients by real frame callbacks.
"""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

START_LIMIT_S = 10.0


class CompositorMissing(RuntimeError):
    """It cannot be started here; the text says why (tests skip with it)."""


@contextmanager
def headless_compositor(
    announced_hz: int, size_px: tuple[int, int] = (1280, 720), realtime: bool = False
) -> Iterator[dict[str, str]]:
    """The environment in which a client finds it; ``realtime``: at real-time priority. Raises CompositorMissing."""
    sway = shutil.which("sway")
    if sway is None:
        raise CompositorMissing("sway is not installed")
    root = os.geteuid() == 0
    if root and shutil.which("runuser") is None:
        raise CompositorMissing("sway refuses to run as root, and runuser is not installed")
    folder = Path(tempfile.mkdtemp(prefix="sway-"))
    try:
        (folder / "config").write_text(
            f"output HEADLESS-1 mode --custom {size_px[0]}x{size_px[1]}@{announced_hz}Hz\n"
            "output * bg #808080 solid_color\ndefault_border none\nfocus_follows_mouse no\n"
        )
        folder.chmod(0o700)
        if root:
            nobody = pwd.getpwnam("nobody")
            for path in (folder, folder / "config"):
                os.chown(path, nobody.pw_uid, nobody.pw_gid)
        environment = {
            "PATH": os.environ.get("PATH", "/usr/bin:/bin"),
            "HOME": str(folder),
            "XDG_RUNTIME_DIR": str(folder),
            "WLR_BACKENDS": "headless",
            "WLR_LIBINPUT_NO_DEVICES": "1",
            "WLR_RENDERER": "pixman",
        }
        command = [sway, "-c", str(folder / "config")]
        if root:
            command = ["runuser", "-u", "nobody", "--", *command]
            if realtime and shutil.which("chrt"):
                command = ["chrt", "-f", "10", *command]
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        try:
            socket = _socket(folder, process)
            client = {**os.environ, "WAYLAND_DISPLAY": str(socket), "XDG_RUNTIME_DIR": str(folder)}
            client["PYGLFW_LIBRARY_VARIANT"] = "wayland"
            client.pop("DISPLAY", None)
            yield client
        finally:
            # Only the process group that was started here.
            os.killpg(process.pid, signal.SIGTERM)
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _socket(folder: Path, process: subprocess.Popen[bytes]) -> Path:
    """Wait until the compositor's socket is there."""
    until = time.monotonic() + START_LIMIT_S
    while time.monotonic() < until:
        found = [path for path in folder.glob("wayland-*") if path.suffix != ".lock"]
        if found:
            return found[0]
        if process.poll() is not None:
            break
        time.sleep(0.05)
    said = (folder / "log").read_text(errors="replace").strip().splitlines()
    raise CompositorMissing("sway did not start: " + (said[-1] if said else "it said nothing"))
