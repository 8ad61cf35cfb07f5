"""The keyboard as a response device: presses that the display's window collects."""

from __future__ import annotations

from protocols.trial import Question
from studyapp.seams import Display, Press


class Keyboard:
    """A `Responder` over `Display.keys`. Key names are GLFW's, lower case ('left', 'space', '1', 'minus')."""

    name = "keyboard"

    def __init__(self, display: Display) -> None:
        self._display = display

    def expect(self, question: Question | None) -> None:
        """Presses made before this screen do not count for it."""
        self._display.keys()

    def poll(self) -> list[Press]:
        pressed = self._display.keys()
        return [Press(key, at_ns, at_ns, self.name, None, key.encode()) for key, at_ns in pressed]

    def alive(self) -> bool:
        return True
