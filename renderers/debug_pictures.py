"""What a technique thinks, as pictures: its debug maps over a frame, and the decision functions of the pixel orders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from renderers.backend import activate, dr, mi
from renderers.catalogue import TECHNIQUES
from renderers.clip_frames import scene_exposure, technique_params, view_at
from renderers.engine import Engine
from stimuli.encode import encode
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath, Scene

_HOURGLASS, _BOWTIE = (0.30, 0.65, 0.95), (0.98, 0.62, 0.20)
_CLASSES = ((0.25, 0.35, 0.75), (0.80, 0.30, 0.25), (0.45, 0.75, 1.00), (1.00, 0.75, 0.40))
"""static, dynamic; and as they look where this frame traced the pixel."""


@dataclass(frozen=True)
class Shown:
    """A frame and a map of it: ``codes`` (H, W, 3) uint8 of the picture, ``values`` (H, W) or (H, W, 3)."""

    codes: np.ndarray
    values: np.ndarray
    name: str


def debug_picture(
    scene: Scene,
    technique: str,
    show: str,
    size_px: tuple[int, int],
    camera: CameraPath,
    rate_hz: Fraction = Fraction(240),
    start_s: Fraction = Fraction(1),
    frames: int = 24,
    params: Mapping[str, Any] | None = None,
) -> Shown:
    """The map ``show`` of the last of ``frames`` frames. Raises InputError for a technique without maps, or another
    name than it has.
    """
    checked = technique_params(technique, params or {})
    kind = TECHNIQUES[technique]
    require_maps(technique)
    engine = Engine(scene)
    exposure = scene_exposure(engine, camera, start_s)
    made: Any = kind(engine, size_px, checked, 0, "total")
    for k in range(frames):
        view = view_at(k, rate_hz, start_s, size_px, camera, exposure=exposure, cut=k == 0)
        frame = made.render(view)
    maps = made.show(view)
    if show not in maps:
        raise InputError(problem("--show", f"debug picture of {technique}", repr(show), " | ".join(maps)))
    return Shown(encode(np.array(frame.color), exposure)[..., :3], np.asarray(maps[show]), show)


def require_maps(technique: str) -> None:
    """Raise InputError for a technique without debug maps."""
    if not hasattr(TECHNIQUES[technique], "show"):
        having = [name for name, known in TECHNIQUES.items() if hasattr(known, "show")]
        raise InputError(problem("--show", "technique without debug pictures", technique, " | ".join(having)))


def colored(shown: Shown, limits: tuple[float, float] | None = None) -> np.ndarray:
    """(H, W, 3) uint8: orders and classes as colours over the grey picture, everything else as a colour scale between
    ``limits`` (None: `value_range`)."""
    from matplotlib import colormaps

    values = shown.values
    if values.ndim == 3:
        return np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)
    palette: tuple[tuple[float, ...], ...] = ()
    if shown.name == "segmentation":
        palette = (_BOWTIE, _HOURGLASS)
    elif shown.name == "class":
        palette = _CLASSES
    if palette:
        grey = shown.codes.mean(axis=2, keepdims=True) / 255
        color = np.array(palette)[values.astype(int)] * (0.35 + 0.65 * grey)
    else:
        low, high = value_range(shown) if limits is None else limits
        color = colormaps["coolwarm" if low < 0 else "viridis"]((values - low) / max(high - low, 1e-12))[..., :3]
    return np.rint(color * 255).astype(np.uint8)


def value_range(shown: Shown) -> tuple[float, float]:
    """The values at the ends of the colour scale: 0 in the middle where some are negative."""
    finite = shown.values[np.isfinite(shown.values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    return (-max(-low, high), max(-low, high)) if low < 0 else (low, high)


def decision_map(decision: str, cells: int = 200, device: str = "auto") -> np.ndarray:
    """(cells, cells) bool: hourglass (True) or bowtie over alpha, 0 to 90 degrees (rows), and the fraction l_f of the
    motion's length, 0 to 1 (columns); Andersson et al. 2019, Fig. 10. Coins are seeded.
    """
    from renderers.temporally_dense.pixel_order import decide

    activate(device)
    alpha, l_f = np.meshgrid(
        (np.arange(cells) + 0.5) / cells * np.pi / 2, (np.arange(cells) + 0.5) / cells, indexing="ij"
    )
    length = 2 + l_f  # away from length 0, which has no direction
    coin = np.random.default_rng(0).random(alpha.shape) < 0.5
    chosen = decide(
        decision,
        mi.Float((length * np.cos(alpha)).ravel().astype(np.float32)),
        mi.Float((length * np.sin(alpha)).ravel().astype(np.float32)),
        mi.Bool(coin.ravel()),
    )
    return np.array(dr.select(chosen, mi.UInt32(1), mi.UInt32(0)).numpy()).reshape(cells, cells) == 1


def plot_decisions(path: Path, device: str = "auto") -> None:
    """The four functions of Fig. 10 side by side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(11, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    for k, decision in enumerate(("dominant", "up", "down", "combined")):
        axes = figure.add_subplot(1, 4, k + 1)
        axes.imshow(
            decision_map(decision, device=device), origin="lower", extent=(0, 1, 0, 90), aspect="auto",
            cmap=ListedColormap([_BOWTIE, _HOURGLASS]), interpolation="nearest", vmin=0, vmax=1,
        )  # fmt: skip
        axes.set_title(decision)
        axes.set_xlabel("fraction of |m| (px a frame)")
        axes.set_yticks((0, 45, 90))
        if k == 0:
            axes.set_ylabel("angle of m to the rows (degrees)")
    figure.legend(
        handles=[Patch(color=_HOURGLASS, label="hourglass"), Patch(color=_BOWTIE, label="bowtie")],
        loc="outside lower center", ncols=2, frameon=False,
    )  # fmt: skip
    figure.savefig(path, dpi=110)
