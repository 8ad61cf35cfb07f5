"""The parameters of every technique: pydantic models with units, ranges and defaults. No engine is imported here."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Parameters(BaseModel):
    """Base of all parameter models: unknown names are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)
