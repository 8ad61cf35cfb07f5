"""Gaze calibration: where the targets stand, and the map from raw gaze to the screen for devices that have none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stimuli.errors import InputError, problem

Points = Literal[5, 9, 13]


def target_points(count: Points, margin: float = 0.1) -> np.ndarray:
    """(count, 2) normalised screen positions, the centre first: corners (5), the edges' middles too (9), and the
    middles between centre and corners (13). ``margin``: distance from the edge as a share of the side."""
    if count not in (5, 9, 13):
        raise InputError(problem("gaze", "calibration points", count, "5 | 9 | 13"))
    low, high = margin, 1 - margin
    points = [(0.5, 0.5), (low, low), (high, low), (low, high), (high, high)]
    if count >= 9:
        points += [(0.5, low), (low, 0.5), (high, 0.5), (0.5, high)]
    if count == 13:
        inner = [(0.5 + x) / 2 for x in (low, high)]
        points += [(x, y) for y in inner for x in inner]
    return np.array(points)


@dataclass(frozen=True)
class GazeMap:
    """Raw (x, y) -> calibrated (x, y): polynomials in both. ``coefficients``: (terms, 2); ``terms`` 4: 1, x, y, xy (5
    targets), 6: x^2 and y^2 too (9 or more). ``residual``: RMS distance at the targets, in the targets' units."""

    coefficients: np.ndarray
    residual: float

    def __call__(self, raw: np.ndarray) -> np.ndarray:
        """(N, 2) -> (N, 2)."""
        calibrated: np.ndarray = _terms(raw, len(self.coefficients)) @ self.coefficients
        return calibrated


def fit_map(raw: np.ndarray, targets: np.ndarray) -> GazeMap:
    """The least-squares `GazeMap` from one mean raw position a target. Raises InputError where fewer than 5 targets
    have finite raw gaze, or where they lie on a line."""
    raw, targets = np.asarray(raw, float), np.asarray(targets, float)
    good = np.isfinite(raw).all(axis=1)
    if good.sum() < 5:
        raise InputError(problem("gaze", "calibrated targets", int(good.sum()), "at least 5"))
    design = _terms(raw[good], 6 if good.sum() >= 9 else 4)
    coefficients, _, rank, _ = np.linalg.lstsq(design, targets[good], rcond=1e-9)
    if rank < design.shape[1]:
        raise InputError(
            problem("gaze", "raw gaze at the targets", "positions on a line", "positions that span a plane")
        )
    distance = np.linalg.norm(design @ coefficients - targets[good], axis=1)
    return GazeMap(coefficients, float(np.sqrt(np.mean(distance**2))))


def _terms(raw: np.ndarray, count: int) -> np.ndarray:
    x, y = np.asarray(raw, float).T
    columns = [np.ones_like(x), x, y, x * y]
    if count == 6:
        columns += [x * x, y * y]
    return np.column_stack(columns)


def gazepoint_commands(points: np.ndarray, point_s: float = 1.2) -> Sequence[bytes]:
    """What a Gazepoint server is sent to calibrate by itself at these normalised points (Open Gaze API v2), its own
    window hidden."""
    lines = ['<SET ID="CALIBRATE_CLEAR" />']
    lines += [f'<SET ID="CALIBRATE_ADDPOINT" X="{x:.4f}" Y="{y:.4f}" />' for x, y in points]
    lines += [
        f'<SET ID="CALIBRATE_TIMEOUT" VALUE="{point_s:g}" />',
        '<SET ID="CALIBRATE_SHOW" STATE="0" />',
        '<SET ID="CALIBRATE_START" STATE="1" />',
    ]
    return [line.encode() + b"\r\n" for line in lines]
