"""Decoders: right presses from right bytes in any portions; noise invents nothing and does not hide the next packet."""

from __future__ import annotations

import re

import numpy as np
import pytest

from studyapp.devices.decoders import (
    BYTE_BOXES,
    LINE_BOXES,
    XID_MODELS,
    ByteDecoder,
    LineDecoder,
    XidDecoder,
    decoder_for,
    xid_packet,
)
from tests.prove.fuzz_decoders import fuzz_byte_box, fuzz_line_box, fuzz_xid


@pytest.mark.parametrize("model", XID_MODELS)
def test_xid_decodes_the_bytes_of_every_key_in_any_portions(model: str) -> None:
    decoder = XidDecoder(model)
    keys = [key for key in "12345678" if key in set(decoder._keys.values())]
    stream = b"".join(xid_packet(k, p, 1.5 + i, model) for i, k in enumerate(keys) for p in (True, False))
    changes = [change for value in stream for change in decoder.feed(bytes([value]), 0.0)]
    assert [(c.key, c.pressed, c.device_s) for c in changes] == [
        (k, p, 1.5 + i) for i, k in enumerate(keys) for p in (True, False)
    ]
    assert b"".join(c.raw for c in changes) == stream
    assert decoder.malformed == 0


def test_xid_packet_is_the_one_of_the_protocol() -> None:
    # key 3 pressed, 0x01020304 ms: 'k', 3 << 5 | 0x10, little endian
    assert xid_packet("3", True, 0x01020304 / 1000) == b"k\x70\x04\x03\x02\x01"
    assert xid_packet("8", False, 0.0)[1] == 0


def test_xid_slides_one_byte_and_keeps_the_press_behind_a_broken_packet() -> None:
    decoder = XidDecoder()
    changes = decoder.feed(b"k\x70\x00" + xid_packet("2", True, 3.0), 0.0)
    assert [(c.key, c.device_s) for c in changes][-1:] == [("2", 3.0)] or changes[0].raw[:3] == b"k\x70\x00"
    decoder = XidDecoder()
    decoder.timer_reset(0.0)
    changes = decoder.feed(b"k\x70\x00" + xid_packet("2", True, 3.0), 3.0)
    assert [(c.key, c.device_s) for c in changes] == [("2", 3.0)]
    assert decoder.malformed == 3


def test_xid_stamp_is_checked_across_the_wrap_of_its_32_bits() -> None:
    decoder = XidDecoder()
    decoder.timer_reset(0.0)
    days_s = 2**32 / 1000
    assert [c.key for c in decoder.feed(xid_packet("1", True, 0.5), days_s + 0.5)] == ["1"]


def test_xid_timer_answers_count_only_when_asked() -> None:
    decoder = XidDecoder()
    answer = b"_e5" + (2500).to_bytes(4, "little")
    assert decoder.feed(answer, 2.5) == []
    assert decoder.timer_answers == []
    decoder.timer_queried()
    decoder.feed(answer[:2], 2.5)
    decoder.feed(answer[2:] + xid_packet("1", True, 2.6), 2.6)
    assert decoder.timer_answers == [(2.5, 2.6)]


@pytest.mark.parametrize("name", ["pst", "rb-820"])
def test_state_bytes_give_edges(name: str) -> None:
    decoder = ByteDecoder(BYTE_BOXES[name])
    changes = decoder.feed(bytes([1, 1, 3, 2, 0, 0]), 0.0)
    assert [(c.key, c.pressed) for c in changes] == [("1", True), ("2", True), ("1", False), ("2", False)]


def test_a_forp_byte_is_a_press_each_and_undefined_bits_are_noise() -> None:
    decoder = ByteDecoder(BYTE_BOXES["forp"])
    assert [c.key for c in decoder.feed(bytes([1, 1, 0x80, 0x21, 8, 16]), 0.0)] == ["1", "1", "4", "trigger"]
    assert decoder.malformed == 2


def test_lines_are_decoded_whole_or_not_at_all() -> None:
    decoder = LineDecoder(LINE_BOXES["lines"])
    assert decoder.feed(b"1500000:", 0.0) == []
    (press,) = decoder.feed(b"3\r\n", 1.0)
    assert (press.key, press.pressed, press.device_s, press.raw) == ("3", True, 1.5, b"1500000:3")
    assert decoder.feed(b"junk 1600000:3\n1600000:9\n-1:3\n1600000:3 \n", 1.1) == []
    (release,) = decoder.feed(b"1600000:3-\n", 1.1)
    assert not release.pressed
    tpad = LineDecoder(LINE_BOXES["tpad"])
    changes = tpad.feed(b"A P 1 1000\r\nC P 1 1001\r\nA R 1 1100\r\n", 1.0)
    assert [(c.key, c.pressed, c.device_s) for c in changes] == [("1", True, 1.0), ("1", False, 1.1)]


def test_a_restarted_line_box_is_believed_once_two_lines_tell_the_same_clock() -> None:
    decoder = LineDecoder(LINE_BOXES["lines"])
    assert len(decoder.feed(b"900000000:1\n", 900.0)) == 1
    assert decoder.feed(b"1000000:1\n1100000:1\n", 901.0) == []
    assert len(decoder.feed(b"2100000:1\n", 902.0)) == 1
    assert len(decoder.feed(b"2200000:1\n", 902.1)) == 1


def test_an_unknown_kind_is_a_key_error() -> None:
    with pytest.raises(KeyError):
        decoder_for("abacus")


@pytest.mark.parametrize("seed", range(2))
def test_100_000_fuzzed_bytes_invent_no_press_and_the_next_packet_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for result in (
        fuzz_xid(20_000, rng),
        *(fuzz_byte_box(name, 20_000, rng) for name in BYTE_BOXES),
        *(fuzz_line_box(name, 20_000, rng) for name in LINE_BOXES),
    ):
        assert result.invented == 0, result
        assert result.recovered == result.probes > 0, result


def test_the_line_grammars_are_valid_patterns_with_the_groups_needed() -> None:
    for box in LINE_BOXES.values():
        assert {"stamp", "key"} <= set(re.compile(box.pattern).groupindex)
