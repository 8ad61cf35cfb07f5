"""Camera paths that a protocol brings: keyframes in the file itself, or in a file of their own beside it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from protocols.quantity import Model, Name, NonNegative, Positive, wrong

if TYPE_CHECKING:
    from protocols.names import Problem

MOST_KEYS = 700
"""As many as one file holds within the bounds of `protocols.yaml_source`."""
Three = tuple[float, float, float]
Field_deg = Annotated[float, Field(gt=0, lt=180)]


class CameraKey(Model):
    """A keyframe of a camera path: where the camera is, in the scene's units, and what it looks at (``up``: which way
    is up there), or its ``rotation`` as a quaternion x, y, z, w."""

    time_s: NonNegative
    position: Three
    look_at: Three | None = None
    up: Three | None = None
    rotation: tuple[float, float, float, float] | None = None
    yfov_deg: Field_deg | None = None

    @model_validator(mode="after")
    def _aimed(self) -> CameraKey:
        if (self.look_at is None) == (self.rotation is None):
            both = "neither" if self.look_at is None else "both"
            raise wrong(f"{both} of look_at and rotation", "one of them")
        if self.up is not None and self.look_at is None:
            raise wrong("up without look_at", "up beside look_at alone")
        if self.look_at == self.position:
            raise wrong(f"look_at {list(self.position)}, which is position", "another point to look at")
        if self.rotation is not None and not any(self.rotation):
            raise wrong("a rotation of length 0", "a quaternion x, y, z, w")
        return self


class CameraKeys(Model):
    """A camera path through keys. ``closed``: after the last key it comes back to the first, in ``period_s``."""

    keys: Annotated[list[CameraKey], Field(min_length=1, max_length=MOST_KEYS)]
    yfov_deg: Field_deg | None = Field(default=None, description="none: the first key's, else the scene's own")
    interpolation: Literal["spline", "linear"] = "spline"
    closed: bool = False
    period_s: Positive | None = None

    def as_json(self) -> str:
        """What stands for this path in a clip's request: the bare list of keys where nothing else is said."""
        keys = [_written(key) for key in self.keys]
        rest = {k: v for k, v in self.model_dump(mode="json", exclude={"keys"}).items() if v not in (None, False)}
        if rest == {"interpolation": "spline"}:
            return json.dumps(keys)
        return json.dumps({"keys": keys, **rest}, sort_keys=True)


def _written(key: CameraKey) -> dict[str, Any]:
    """The key without what it does not say (``yfov_deg`` excepted)."""
    return {k: v for k, v in key.model_dump(mode="json").items() if v is not None or k == "yfov_deg"}


def _form(value: Any) -> str:
    return "list" if isinstance(value, list) else "table"


def _path(value: list[CameraKey] | CameraKeys) -> CameraKeys:
    return CameraKeys(keys=value) if isinstance(value, list) else value


_Listed = Annotated[list[CameraKey], Field(min_length=1, max_length=MOST_KEYS), Tag("list")]
_Written = Annotated[_Listed | Annotated[CameraKeys, Tag("table")], Discriminator(_form)]
if TYPE_CHECKING:
    Paths = dict[Name, CameraKeys]
else:
    # As a type checker cannot know, the validator leaves nothing but tables.
    Paths = dict[Name, Annotated[_Written, AfterValidator(_path)]]


def path_problems(paths: Mapping[str, CameraKeys]) -> Iterator[Problem]:
    """Keys that go back in time, and closed paths whose period ends before the last key."""
    for name, path in paths.items():
        what = f"paths.{name}"
        for number, (one, other) in enumerate(zip(path.keys, path.keys[1:], strict=False), 1):
            if other.time_s <= one.time_s:
                loc = ("paths", name, "keys", number, "time_s")
                yield loc, f"{what}[{number}].time_s", f"{other.time_s:g}", f"later than {one.time_s:g}"
        length = path.keys[-1].time_s - path.keys[0].time_s
        if path.closed != (path.period_s is not None):
            got = "closed without period_s" if path.closed else "period_s without closed"
            yield ("paths", name), what, got, "both of closed: true and period_s, or neither"
        elif path.period_s is not None and path.period_s <= length:
            yield ("paths", name, "period_s"), f"{what}.period_s", f"{path.period_s:g}", f"more than {length:g}"
