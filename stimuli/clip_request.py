"""What is asked of a renderer for one clip, and its identity: the only thing that is hashed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from typing import Any

ENGINE_VERSION = 5
"""Raised by hand whenever the same request would give other pixels."""

PATH_NAMES = ("file", "still", "sway", "toycar", "interactive")
"""Camera paths that need no keys (`stimuli.camera_path`)."""
CHANNEL_GROUPS: Mapping[str, tuple[str, ...]] = {
    "depth": ("Z",), "motion": ("motion.X", "motion.Y"), "samples": ("samples",),
}  # fmt: skip
"""What a protocol or the command line calls optional channels -> their names in the EXR files."""
CHANNEL_BYTES: Mapping[str, int] = {"Z": 4, "samples": 4, "class": 4}
"""Bytes a pixel of the channels that are not half floats (2)."""


@dataclass(frozen=True)
class ClipRequest:
    """Everything that determines a clip's pixels, and nothing that does not (cost, date, machine).

    ``scene`` is a name or path for people; ``scene_sha256`` is its content. ``rate_hz``, ``start_s``, ``duration_s``
    and ``warm_up_s`` are exact rationals as text ('240', '60000/1001'). ``params`` are complete (defaults filled in).
    ``geometry`` and ``gaze`` are None where the technique does not use them; ``gaze`` 'moving' also puts a target into
    the scene. ``loop``: once | closed.
    """

    scene: str
    scene_sha256: str
    technique: str
    params: Mapping[str, Any]
    size_px: tuple[int, int]
    rate_hz: str
    duration_s: str
    path: str = "file"
    path_sha256: str = ""
    animation: str | None = None
    start_s: str = "0"
    warm_up_s: str = "1"
    seed: int = 0
    exposure: float = 1.0
    tone: str = "none"
    lighting: str = "direct"
    geometry: tuple[float, ...] | None = None
    gaze: tuple[float, float] | str | None = None
    loop: str = "once"
    engine_version: int = ENGINE_VERSION
    external_sha256: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def channels(self) -> tuple[str, ...]:
        """EXR names of what the frames hold beside R G B (``extra``: {"channels": [...]})."""
        return tuple(self.extra.get("channels", ()))

    @property
    def frame_count(self) -> int:
        """round(duration * rate)."""
        return round(Fraction(self.duration_s) * Fraction(self.rate_hz))

    def canonical(self) -> str:
        """JSON with sorted keys without ``scene`` (a label); what `identity` hashes."""
        data = asdict(self)
        del data["scene"]
        return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)

    @property
    def identity(self) -> str:
        """sha256 (hex) of `canonical`: the clip's name in the store."""
        return hashlib.sha256(self.canonical().encode()).hexdigest()
