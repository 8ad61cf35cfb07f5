"""The temporally deep buffer: at each pixel a queue of at most ``depth`` crosshairs, the newest in front.

Dayal et al. 2005, sections 4 and 6.1. Every change keeps the tiles' sums true.
"""

from __future__ import annotations

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers, Settings
from renderers.adaptive_frameless.compiled import inlined, uncounted
from renderers.adaptive_frameless.tiling import add_entry


@inlined
def new_entry(b: Buffers) -> int:
    """The number of an unused entry. There is one whenever the caller made room in the queue it goes to."""
    b.number[c.FREE] -= 1
    entry = b.free[b.number[c.FREE]]
    b.entry_i[entry, c.PIXEL] = -1
    b.entry_i[entry, c.ASKED] = 0
    b.entry_i[entry, c.OCCLUDED] = 0
    return entry


@inlined
def _forget(b: Buffers, entry: int) -> None:
    b.entry_i[entry, c.PIXEL] = -1
    b.entry_i[entry, c.ASKED] = 0
    b.free[b.number[c.FREE]] = entry
    b.number[c.FREE] += 1


@inlined
def take_out(b: Buffers, s: Settings, entry: int) -> None:
    """Remove ``entry`` from its queue and from its tile's sums; it stays usable."""
    pixel = b.entry_i[entry, c.PIXEL]
    count = b.fill[pixel]
    k = 0
    while b.queue[pixel, k] != entry:
        k += 1
    for j in range(k, count - 1):
        b.queue[pixel, j] = b.queue[pixel, j + 1]
    b.fill[pixel] = count - 1
    add_entry(b, s, entry, -1.0)


@inlined
def remove(b: Buffers, s: Settings, entry: int) -> None:
    """Take ``entry`` out and forget it."""
    take_out(b, s, entry)
    _forget(b, entry)


@inlined
def make_room(b: Buffers, s: Settings, pixel: int) -> None:
    """Drop the entry at the back of a full queue."""
    if b.fill[pixel] == s.depth:
        remove(b, s, b.queue[pixel, s.depth - 1])


@uncounted
def push_front(b: Buffers, s: Settings, entry: int, pixel: int) -> None:
    """Put a new crosshair before the others of ``pixel``; a full queue loses its last. Call `make_room` first where
    ``entry`` itself is yet to be made."""
    make_room(b, s, pixel)
    count = b.fill[pixel]
    for j in range(count, 0, -1):
        b.queue[pixel, j] = b.queue[pixel, j - 1]
    b.queue[pixel, 0] = entry
    b.fill[pixel] = count + 1
    b.entry_i[entry, c.PIXEL] = pixel
    add_entry(b, s, entry, 1.0)


@uncounted
def push_back(b: Buffers, s: Settings, entry: int, pixel: int) -> None:
    """Put a moved crosshair behind the others of ``pixel``. Of a full queue's last and it, the older one is dropped."""
    count = b.fill[pixel]
    if count == s.depth:
        last = b.queue[pixel, count - 1]
        if b.entry_t[last] >= b.entry_t[entry]:
            _forget(b, entry)
            return
        remove(b, s, last)
        count -= 1
    b.queue[pixel, count] = entry
    b.fill[pixel] = count + 1
    b.entry_i[entry, c.PIXEL] = pixel
    add_entry(b, s, entry, 1.0)


@inlined
def put_in_stream(
    b: Buffers, time_s: float, red: float, green: float, blue: float, px: float, py: float, pz: float, mover: int,
    x: float, y: float,
) -> None:  # fmt: skip
    """Append a sample to the reconstructor's stream; the oldest makes room."""
    k = b.number[c.NEXT]
    f = b.stream_f[k]
    f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7] = red, green, blue, px, py, pz, x, y
    b.stream_i[k] = mover
    b.stream_t[k] = time_s
    b.number[c.NEXT] = (k + 1) % len(b.stream_t)
    b.number[c.KEPT] = min(b.number[c.KEPT] + 1, len(b.stream_t))
    b.number[c.PUT] += 1
