"""Presses of a simulated observer: given directly (`simulate`), or through a real serial line (`run`)."""

from __future__ import annotations

import select
from collections.abc import Callable, Sequence
from dataclasses import replace

from protocols.trial import Question
from studyapp.clock import now_ns
from studyapp.devices.buttons import button_for, button_map
from studyapp.devices.device_reader import DeviceReader
from studyapp.devices.emulators import Emulator
from studyapp.seams import Press

LINE_LIMIT_S = 10.0  # a press that has not come through the line after so long never will


class DirectPresses:
    """Presses that happen when the display's clock reaches them; no device, no bytes."""

    def __init__(self, clock_ns: Callable[[], int], name: str = "simulated") -> None:
        self.name = name
        self._clock_ns = clock_ns
        self._planned: list[tuple[int, str]] = []

    def expect(self, question: Question | None) -> None:
        """Whatever was planned before is forgotten: a new screen begins."""
        self._planned.clear()

    def press(self, key: str, at_ns: int) -> None:
        """A press of ``key`` at ``at_ns`` on the display's clock."""
        self._planned.append((at_ns, key))
        self._planned.sort()

    def next_press_ns(self) -> int | None:
        """When the next press is due (the virtual display leaps there)."""
        return self._planned[0][0] if self._planned else None

    def poll(self) -> list[Press]:
        due = []
        while self._planned and self._planned[0][0] <= self._clock_ns():
            at_ns, key = self._planned.pop(0)
            due.append(Press(key, at_ns, at_ns, self.name))
        return due

    def alive(self) -> bool:
        return True


class BoxAnswers:
    """A box read by the reader process, its buttons named as the question in hand needs them (persons and emulators).

    ``others`` must be alive too (eye tracker): a trial without its streams is no trial.
    """

    def __init__(self, reader: DeviceReader, buttons: Sequence[str], others: Sequence[Callable[[], bool]] = ()) -> None:
        self._reader, self._responder = reader, reader.responder()
        self._buttons, self._others = tuple(buttons), tuple(others)
        self._map: dict[str, str] = {}
        self.name = self._responder.name

    def expect(self, question: Question | None) -> None:
        """Buttons mean the keys of ``question`` from now on; earlier presses are dropped."""
        self._map = button_map(question, self._buttons)
        self._reader.presses()

    def poll(self) -> list[Press]:
        return [replace(press, key=self._map.get(press.key, press.key)) for press in self._responder.poll()]

    def alive(self) -> bool:
        return self._responder.alive() and all(alive() for alive in self._others)


class EmulatedPresses(BoxAnswers):
    """A simulated finger on an emulated box: what comes out was decoded from bytes that went through the line."""

    def __init__(
        self,
        reader: DeviceReader,
        emulator: Emulator,
        buttons: Sequence[str],
        others: Sequence[Callable[[], bool]] = (),
    ) -> None:
        super().__init__(reader, buttons, others)
        self._emulator = emulator

    def expect(self, question: Question | None) -> None:
        self._emulator.tell("forget")
        self._emulator.heard()
        super().expect(question)

    def press(self, key: str, at_ns: int) -> None:
        """The finger goes down on ``key``'s button at session time ``at_ns``."""
        button = button_for(self._map, key)
        # Where any key goes on, the finger takes the first button.
        self._emulator.tell("press", button if button in self._buttons else self._buttons[0], at_ns)


class LeapingPresses(EmulatedPresses):
    """The same for the virtual display, whose clock is its own: at the planned virtual time the finger goes down, and
    the display waits until the bytes have come through the line."""

    def __init__(
        self,
        clock_ns: Callable[[], int],
        reader: DeviceReader,
        emulator: Emulator,
        buttons: Sequence[str],
        others: Sequence[Callable[[], bool]] = (),
    ) -> None:
        super().__init__(reader, emulator, buttons, others)
        self._clock_ns = clock_ns
        self._planned: list[tuple[int, str]] = []
        self._lost = False

    def expect(self, question: Question | None) -> None:
        super().expect(question)
        self._planned.clear()
        self._lost = False

    def press(self, key: str, at_ns: int) -> None:
        self._planned.append((at_ns, key))
        self._planned.sort()

    def next_press_ns(self) -> int | None:
        """When the next press is due (the virtual display leaps there)."""
        return self._planned[0][0] if self._planned else None

    def poll(self) -> list[Press]:
        decoded = []
        while self._planned and self._planned[0][0] <= self._clock_ns():
            at_ns, key = self._planned.pop(0)
            super().press(key, now_ns())
            press = self._next_decoded()
            if press is not None:
                decoded.append(replace(press, mapped_ns=at_ns))
        return decoded

    def _next_decoded(self) -> Press | None:
        deadline_ns = now_ns() + int(LINE_LIMIT_S * 1e9)
        while now_ns() < deadline_ns:
            presses = super().poll()
            if presses:
                return presses[0]
            if not super().alive():
                break
            select.select([], [], [], 0.0005)
        self._lost = True
        return None

    def alive(self) -> bool:
        return not self._lost and super().alive()
