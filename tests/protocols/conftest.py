"""A catalogue that is complete: techniques that are not built yet are stood in for by their parameters alone."""

from __future__ import annotations

from typing import Literal

import pytest
from pydantic import Field

from renderers import catalogue
from renderers.parameters import Parameters


class FoveatedParameters(Parameters):
    configuration: Literal["small", "medium", "large", "full"] = "medium"


class PolarParameters(Parameters):
    width: int = Field(788, ge=1)
    height: int = Field(768, ge=2)


class SampleRate(Parameters):
    samples_per_s: float = Field(400_000.0, gt=0)


_AWAITED = {
    "foveated": (FoveatedParameters, True),
    "polar": (PolarParameters, True),
    "adaptive_frameless": (SampleRate, False),
    "traditional_frameless": (SampleRate, False),
}


@pytest.fixture(autouse=True)
def complete_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    """Techniques named in interfaces.md whose entries have not landed; nothing is replaced that is there."""
    for name, (params, gaze_contingent) in _AWAITED.items():
        if name not in catalogue.CATALOGUE:
            made = catalogue.Entry(name, "awaited", params, "none", "None", {}, gaze_contingent=gaze_contingent)
            monkeypatch.setitem(catalogue.CATALOGUE, name, made)  # type: ignore[arg-type]
