"""The types that protocol models share: exact rationals, names, and the base that refuses unknown keys."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints, WithJsonSchema
from pydantic_core import PydanticCustomError

_RATIONAL = re.compile(r"[0-9]{1,9}(\.[0-9]{0,9})?([eE]-?[0-9])?|[0-9]{1,9}/[0-9]{1,9}")


class Model(BaseModel):
    """Base of all protocol models: unknown keys are errors, nothing is converted silently, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def wrong(got: object, wanted: str) -> PydanticCustomError:
    """The error that `load` prints as ``got X, wanted Y``."""
    return PydanticCustomError("protocol", "{wanted}", {"got": str(got), "wanted": wanted})


def _rational(value: Any) -> str:
    """240, 0.5, '60000/1001' -> the reduced fraction as text ('240', '1/2', '60000/1001')."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)) or not _RATIONAL.fullmatch(str(value)):
        raise wrong(repr(value), "a number or a fraction such as 240, 0.5 or 60000/1001")
    if "/" in str(value) and not int(str(value).split("/")[1]):
        raise wrong(repr(value), "a denominator that is not 0")
    return str(Fraction(str(value)))


def _positive(text: str) -> str:
    if Fraction(text) <= 0:
        raise wrong(text, "more than 0")
    return text


_NUMBER_OR_TEXT = WithJsonSchema(
    {"anyOf": [{"type": "number", "minimum": 0}, {"type": "string", "pattern": "^[0-9./]+$"}]}
)
Exact = Annotated[str, BeforeValidator(_rational), _NUMBER_OR_TEXT]
"""A rational >= 0, kept as text so that no digit is lost ('1/2')."""
PositiveExact = Annotated[str, BeforeValidator(_rational), AfterValidator(_positive), _NUMBER_OR_TEXT]
"""A rational > 0 as text."""
Rate = Annotated[PositiveExact, Field(description="frames a second")]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_.+-]{0,63}$")]
"""A name that may stand in column names and file names."""
Text = Annotated[str, StringConstraints(min_length=1, max_length=4000)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
Share = Annotated[float, Field(ge=0, le=1)]
_Side = Annotated[int, Field(ge=1, le=16384)]
# A shorthand further out (a scene as one word, levels as a list) hands over plain lists, which strict tuples refuse.
Size = Annotated[tuple[_Side, _Side], BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)]
"""Width and height in pixels."""


def seconds(text: str) -> float:
    """An `Exact` as a float."""
    return float(Fraction(text))
