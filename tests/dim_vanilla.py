"""A technique from outside the tree, as a lab would bring one: vanilla, at a share of its brightness."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from renderers.technique import Frame, View
from renderers.vanilla import Vanilla


class Dimmed(Vanilla):
    """Half as bright."""

    name: ClassVar[str] = "dimmed"

    def render(self, view: View) -> Frame:
        frame = super().render(view)
        return replace(frame, color=np.array(frame.color) * np.float32(0.5))
