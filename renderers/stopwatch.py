"""What a stage of rendering costs. The clock and the device's synchronisation are handed in; tests set them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from renderers.technique import Measure

_STAGES_WANTED: ContextVar[bool] = ContextVar("stages_wanted", default=False)


@contextmanager
def by_stages() -> Iterator[None]:
    """Every frame rendered inside is measured by stage, also by techniques that were built with ``measure='total'``:
    so that the same recorded kernels are timed both ways."""
    token = _STAGES_WANTED.set(True)
    try:
        yield
    finally:
        _STAGES_WANTED.reset(token)


class Stopwatch:
    """Seconds of one frame: ``total``, and one entry a stage where ``measure`` is 'stages'.

    ``synchronize`` must return only when the device has finished; it is called at the end of the frame, and after each
    stage only with ``measure='stages'`` (so that 'total' leaves the device busy between stages).
    """

    def __init__(
        self,
        measure: Measure,
        synchronize: Callable[[], None],
        clock_s: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.by_stage = measure == "stages"
        self._synchronize = synchronize
        self._clock_s = clock_s
        self.seconds: dict[str, float] = {}

    @contextmanager
    def frame(self) -> Iterator[None]:
        """The whole of one render call; forgets the stages of the frame before."""
        self.seconds = {}
        start_s = self._clock_s()
        yield
        self._synchronize()
        self.seconds["total"] = self._clock_s() - start_s

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One named stage; entering a name again within a frame adds to it."""
        if not (self.by_stage or _STAGES_WANTED.get()):
            yield
            return
        start_s = self._clock_s()
        yield
        self._synchronize()
        self.seconds[name] = self.seconds.get(name, 0.0) + self._clock_s() - start_s
