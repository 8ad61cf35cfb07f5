"""Which LLVM is taken, and that the variant is set once."""

from __future__ import annotations

import pytest

from renderers.backend import activate, newest_llvm
from stimuli.errors import InputError

LISTING = """1234 libs found in cache
\tlibLLVM.so.19.1 (libc6,x86-64) => /lib/x86_64-linux-gnu/libLLVM.so.19.1
\tlibLLVM-15.so.1 (libc6,x86-64) => /lib/x86_64-linux-gnu/libLLVM-15.so.1
\tlibLLVM-14.so (libc6,x86-64) => /lib/x86_64-linux-gnu/libLLVM-14.so
\tlibz.so.1 (libc6,x86-64) => /lib/x86_64-linux-gnu/libz.so.1
"""


def test_the_newest_llvm_is_taken() -> None:
    assert newest_llvm(LISTING) == "/lib/x86_64-linux-gnu/libLLVM.so.19.1"


def test_an_llvm_before_15_is_refused() -> None:
    assert newest_llvm("\tlibLLVM-14.so.1 (libc6,x86-64) => /lib/libLLVM-14.so.1\n") is None
    assert newest_llvm("") is None


def test_one_device_a_process() -> None:
    variant = activate("auto")
    assert activate("auto") == variant
    other = "cuda" if variant.startswith("llvm") else "llvm"
    with pytest.raises(InputError, match="one device a process"):
        activate(other)
    with pytest.raises(InputError, match=r"unknown device: got 'tpu', wanted auto \| cuda \| llvm"):
        activate("tpu")
