"""The reader process against emulators on real lines: right presses and gaze, right times, and cut lines noticed."""

from __future__ import annotations

import os
import signal
import time
import uuid
from collections.abc import Callable, Iterator
from multiprocessing import Pipe, get_context

import numpy as np
import pytest

from protocols.records import GAZE_DTYPE
from studyapp.clock import now_ns
from studyapp.devices import reader_process
from studyapp.devices.decoders import BOX_KINDS, BYTE_BOXES, byte_ns
from studyapp.devices.device import DeviceSpec
from studyapp.devices.device_reader import DeviceReader
from studyapp.devices.emulators import Emulator, box_emulator, gaze_emulator
from studyapp.devices.reader_process import read_devices
from studyapp.devices.records import PRESS_RING_DTYPE, events_from_ring
from studyapp.devices.status_board import ALIVE, GONE, StatusBoard
from studyapp.gaze.angles import ScreenGeometry
from studyapp.ring import RecordRing
from studyapp.seams import Press
from studyapp.session_writer import StreamRings

SCREEN = ScreenGeometry(0.53, 0.30, 0.6)


def wait_for(condition: Callable[[], bool], limit_s: float = 10.0) -> bool:
    deadline = now_ns() + int(limit_s * 1e9)
    while not condition():
        if now_ns() > deadline:
            return False
        time.sleep(0.002)
    return True


def events(reader: DeviceReader) -> list[tuple[str, str]]:
    assert reader.streams.events is not None
    return [(row.kind, row.payload) for row in events_from_ring(reader.streams.events.take(), reader.names)]


@pytest.fixture
def running() -> Iterator[list[Emulator | DeviceReader]]:
    things: list[Emulator | DeviceReader] = []
    yield things
    for thing in reversed(things):
        thing.close()


@pytest.mark.parametrize("kind", BOX_KINDS)
def test_every_box_is_read_through_a_pseudo_terminal(kind: str, running: list[Emulator | DeviceReader]) -> None:
    box = box_emulator(kind)
    reader = DeviceReader([DeviceSpec("box", kind, box.port, keys={"1": "left", "2": "right"})])
    running += [box, reader]
    assert reader.wait_until_there(20) == []
    responder = reader.responder()
    assert responder.name == "box"
    assert responder.alive()
    got: list[Press] = []
    for n, key in enumerate(("1", "2", "3", "1")):
        box.tell("press", key, now_ns())
        assert wait_for(lambda n=n: got.extend(responder.poll()) is None and len(got) > n)
        time.sleep(0.08)
    assert [press.key for press in got] == ["left", "right", "3", "left"]
    truth = [message[2] for message in box.heard() if message[0] == "pressed"]
    errors_ms = [(press.mapped_ns - at) * 1e-6 for press, at in zip(got, truth, strict=True)]
    assert all(press.raw and press.host_ns >= press.mapped_ns for press in got)
    if kind in BYTE_BOXES:
        late_ns = {press.host_ns - press.mapped_ns for press in got}
        assert late_ns == {byte_ns(BYTE_BOXES[kind].baud)}
    # On a machine shared with other work a read may be late; the box's own clock may not.
    assert np.median(errors_ms) < 5.0
    assert [kind for kind, _ in events(reader)].count("press") == 4


def test_a_cut_line_is_noticed_logged_and_a_new_box_taken_on(
    running: list[Emulator | DeviceReader], tmp_path: object
) -> None:
    link = f"{tmp_path}/box"
    box = box_emulator("xid")
    os.symlink(box.port, link)
    reader = DeviceReader([DeviceSpec("box", "xid", link)])
    running += [box, reader]
    assert reader.wait_until_there(20) == []
    os.kill(box.pid, signal.SIGKILL)
    cut_ns = now_ns()
    assert wait_for(lambda: reader.board.state(0) == GONE, 2.0)
    assert (now_ns() - cut_ns) * 1e-6 < 1000
    assert not reader.responder().alive()
    assert "box" in reader.missing()[0]
    again = box_emulator("xid")
    running.append(again)
    os.unlink(link)
    os.symlink(again.port, link)
    assert wait_for(lambda: reader.board.state(0) == ALIVE, 5.0)
    kinds = [kind for kind, _ in events(reader)]
    assert "vanished" in kinds
    assert "reconnected" in kinds


class _WatchedBoard(StatusBoard):
    """Notes how many events lay in the ring when a device was marked."""

    def __init__(self, n_devices: int, streams: StreamRings) -> None:
        super().__init__(n_devices)
        self.streams, self.events_at_mark = streams, list[int]()

    def mark(self, device: int, state: int, reason: str = "") -> None:
        assert self.streams.events is not None
        self.events_at_mark.append(self.streams.events.written)
        super().mark(device, state, reason)


def test_whoever_sees_a_device_come_or_go_finds_it_logged(
    running: list[Emulator | DeviceReader], monkeypatch: pytest.MonkeyPatch
) -> None:
    box = box_emulator("xid")
    running.append(box)
    specs = [DeviceSpec("box", "xid", box.port), DeviceSpec("other", "xid", "/dev/nowhere")]
    streams = StreamRings.create(["box", "other"])
    board = _WatchedBoard(2, streams)
    ours, theirs = Pipe()
    ours.send("end")
    monkeypatch.setattr(reader_process, "leave_interrupts_to_the_session", lambda: None)
    read_devices(theirs, specs, streams, RecordRing(PRESS_RING_DTYPE, 8), board)
    assert [board.state(0), board.state(1)] == [ALIVE, GONE]
    assert "/dev/nowhere" in board.reason(1)
    assert board.events_at_mark == [1, 2]
    assert streams.events is not None
    kinds = [row.kind for row in events_from_ring(streams.events.take(), streams.devices)]
    assert kinds[:2] == ["connected", "absent"]  # then what the box says of itself


def test_a_killed_reader_is_noticed_and_can_be_started_again(running: list[Emulator | DeviceReader]) -> None:
    box = box_emulator("rb-820")
    reader = DeviceReader([DeviceSpec("box", "rb-820", box.port)])
    running += [box, reader]
    assert reader.wait_until_there(20) == []
    os.kill(reader.pid, signal.SIGKILL)
    assert wait_for(lambda: not reader.responder().alive(), 2.0)
    assert reader.wait_until_there(20) == []
    box.tell("press", "2", now_ns())
    got: list[Press] = []
    assert wait_for(lambda: got.extend(reader.presses()) is None and len(got) == 1)


def test_a_port_that_is_not_there_is_one_clear_line(running: list[Emulator | DeviceReader]) -> None:
    reader = DeviceReader([DeviceSpec("box", "xid", "/dev/nowhere")])
    running.append(reader)
    (line,) = reader.wait_until_there(2.0)
    assert line.startswith("box: /dev/nowhere: cannot be opened")


def test_gaze_arrives_through_a_real_stream_in_degrees_and_its_loss_is_noticed(
    running: list[Emulator | DeviceReader],
) -> None:
    tracker = gaze_emulator(f"test-{uuid.uuid4()}", 500.0, SCREEN, seed=1)
    reader = DeviceReader([DeviceSpec("eyes", "lsl", tracker.port, {"loopback": True}, screen=SCREEN)])
    running += [tracker, reader]
    assert reader.wait_until_there(30) == []
    gaze = reader.gaze("eyes")
    assert gaze.alive()
    tracker.tell("look", 5.0, -3.0)
    assert wait_for(lambda: (s := gaze.newest()) is not None and abs(s[0] - 5) < 0.6 and abs(s[1] + 3) < 0.6)
    time.sleep(0.3)
    assert reader.streams.gaze is not None
    samples = reader.streams.gaze.take()["sample"]
    assert len(samples) > 50
    assert samples["valid"].all()
    assert np.all(np.diff(samples["device_s"]) > 0)
    # The first samples had waited for the inlet to open; on loopback a stamp precedes its arrival by little.
    delay_ms = (samples["host_ns"] - samples["mapped_ns"])[-100:] * 1e-6
    assert np.all(delay_ms >= 0)
    assert np.median(delay_ms) < 50
    tracker.tell("blink", 5.0)
    assert wait_for(lambda: (s := gaze.newest()) is not None and not s[3])
    os.kill(tracker.pid, signal.SIGKILL)
    assert wait_for(lambda: not gaze.alive(), 3.0)
    assert "eyes" in reader.missing()[0]


def test_the_board_gives_none_before_the_first_sample() -> None:
    board = StatusBoard(1)
    assert board.newest(0) is None


def write_for_ever(board: StatusBoard) -> None:
    """Samples whose fields all hold the same number."""
    sample = np.ones((), GAZE_DTYPE)
    for n in range(1, 1 << 40):
        sample["x_dva"] = sample["y_dva"] = sample["mapped_ns"] = n
        board.look(0, sample)


def test_a_writer_stopped_at_any_moment_leaves_a_whole_sample() -> None:
    board = StatusBoard(1)
    writer = get_context("spawn").Process(target=write_for_ever, args=(board,), daemon=True)
    writer.start()
    assert wait_for(lambda: board.newest(0) is not None)
    try:
        for _ in range(100):
            os.kill(writer.pid or 0, signal.SIGSTOP)
            found = board.newest(0)
            assert found is not None
            assert found[0] == found[1] == found[2]
            assert found[3]
            os.kill(writer.pid or 0, signal.SIGCONT)
            time.sleep(0.001)
    finally:
        writer.kill()
