"""What a technique shows in a view by name: one picture on a monitor, several in a headset, labelled on one sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from PIL import Image, ImageDraw

from renderers.admission import admit
from renderers.catalogue import TECHNIQUES
from renderers.clip_frames import scene_exposure, technique_params, view_at
from renderers.debug_pictures import Shown, colored, require_maps, value_range
from renderers.engine import Engine
from renderers.stereo import DEFAULT_SCALE, field_words, headset_viewports
from renderers.technique import Gaze, Viewport
from stimuli.encode import encode
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath, Scene

ViewName = Literal["monitor", "headset"]
MONITOR = "monitor"
_LABEL_PX, _GAP_PX = 18, 4
_PAPER, _INK = (32, 32, 32), (235, 235, 235)


@dataclass(frozen=True)
class Sheet:
    """The pictures of one frame by name, (H, W, 3) uint8 each, in rows, and what each label says beside the name."""

    rows: tuple[tuple[str, ...], ...]
    codes: Mapping[str, np.ndarray]
    words: Mapping[str, str]

    def image(self) -> Image.Image:
        """All pictures with their labels above them."""
        sizes = [[self.codes[name].shape[1::-1] for name in row] for row in self.rows]
        width = max(sum(w for w, _ in row) + _GAP_PX * (len(row) - 1) for row in sizes)
        heights = [max(h for _, h in row) + _LABEL_PX for row in sizes]
        sheet = Image.new("RGB", (width, sum(heights) + _GAP_PX * (len(heights) - 1)), _PAPER)
        draw = ImageDraw.Draw(sheet)
        y = 0
        for row, row_sizes, height in zip(self.rows, sizes, heights, strict=True):
            x = 0
            for name, (picture_width, _) in zip(row, row_sizes, strict=True):
                draw.text((x + 2, y + 3), f"{name}: {self.words[name]}", fill=_INK)
                sheet.paste(Image.fromarray(self.codes[name]), (x, y + _LABEL_PX))
                x += picture_width + _GAP_PX
            y += height + _GAP_PX
        return sheet


def view_sheet(
    scene: Scene, technique: str, view: ViewName, camera: CameraPath, *, size_px: tuple[int, int] = (480, 270),
    scale: float | None = None, gaze: Gaze | None = None, show: str | None = None, rate_hz: Fraction = Fraction(240),
    start_s: Fraction = Fraction(1), frames: int = 24, params: Mapping[str, Any] | None = None,
) -> Sheet:  # fmt: skip
    """The last of ``frames`` frames of ``technique``, or its debug map ``show``, in every picture of ``view``.

    monitor: one picture of ``size_px`` with the camera's own field. headset: `renderers.stereo.headset_viewports` at
    ``scale`` (None: the technique's in `DEFAULT_SCALE`), eyes side by side. Raises InputError for a technique without a
    headset, or without such a map.
    """
    checked = technique_params(technique, params or {})
    viewports: tuple[Viewport, ...] = ()
    if view == "headset":
        viewports = headset_viewports(technique, DEFAULT_SCALE.get(technique, 1.0) if scale is None else scale)
        size_px = viewports[0].size_px
        admit(technique, (sum(v.size_px[0] for v in viewports), max(v.size_px[1] for v in viewports)))
    elif scale is not None:
        raise InputError(problem("--scale", "view", "monitor", "headset (a monitor's picture has --size)"))
    else:
        admit(technique, size_px)
    if show is not None:
        require_maps(technique)
    engine = Engine(scene)
    exposure = scene_exposure(engine, camera, start_s)
    made: Any = TECHNIQUES[technique](engine, size_px, checked, 0, "total")
    for k in range(frames):
        seen = view_at(k, rate_hz, start_s, size_px, camera, gaze, exposure=exposure, cut=k == 0)
        seen = replace(seen, viewports=viewports)
        frame = made.render(seen)
    pictures = frame.viewports if viewports else {MONITOR: frame.color}
    codes = {name: encode(np.array(picture), exposure)[..., :3] for name, picture in pictures.items()}
    if show is not None:
        maps = _maps(made.show(seen), technique, show, viewports)
        ranges = [value_range(Shown(codes[name], values, show)) for name, values in maps.items()]
        limits = (min(low for low, _ in ranges), max(high for _, high in ranges))
        codes = {name: colored(Shown(codes[name], values, show), limits) for name, values in maps.items()}
    if not viewports:
        return Sheet(((MONITOR,),), codes, {MONITOR: f"{size_px[0]}x{size_px[1]}"})
    offsets = sorted({v.eye_offset_m for v in viewports})
    by_eye = [[v.name for v in viewports if v.eye_offset_m == offset] for offset in offsets]
    return Sheet(tuple(zip(*by_eye, strict=True)), codes, {v.name: _words(v) for v in viewports})


def _words(v: Viewport) -> str:
    """Size and field."""
    return f"{v.size_px[0]}x{v.size_px[1]}, {field_words(v.yfov_rad, v.size_px)}"


def _maps(
    maps: Mapping[str, np.ndarray], technique: str, show: str, viewports: Sequence[Viewport]
) -> dict[str, np.ndarray]:
    """The map ``show`` of every picture. Of a viewport a map is called VIEWPORT.MAP; where a view's own is 'main' or
    'main.MAP' (polar), a viewport's is VIEWPORT or VIEWPORT.MAP."""
    if not viewports:
        by_name = {name: {MONITOR: values} for name, values in maps.items()}
    else:
        by_name = {}
        has_main = any(v.name in maps for v in viewports)
        for v in viewports:
            for name, values in maps.items():
                if name == v.name:
                    by_name.setdefault("main", {})[v.name] = values
                elif name.startswith(f"{v.name}."):
                    short = name.removeprefix(f"{v.name}.")
                    by_name.setdefault(f"main.{short}" if has_main else short, {})[v.name] = values
    if show not in by_name:
        raise InputError(problem("--show", f"debug picture of {technique}", repr(show), " | ".join(by_name)))
    return {name: np.asarray(values) for name, values in by_name[show].items()}
