"""What a process does with its memory once all that it needs is loaded."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager

COLLECT_AFTER = 200_000
"""New objects after which Python looks for garbage while kernels compile; as a rule 700."""


@contextmanager
def seldom_collecting() -> Iterator[None]:
    """Compiling keeps most objects that it makes: to look through them again and again finds nothing."""
    before = gc.get_threshold()
    gc.set_threshold(COLLECT_AFTER, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def keep_what_is_loaded() -> None:
    """Look through all objects for what nobody needs once more and never again: 200,000 of modules and kernels take 0.1
    s, in the middle of an answer."""
    gc.collect()
    gc.freeze()
    give_back()


def give_back() -> None:
    """What the making of models and kernels took on the way goes back to the system (malloc_trim(3) of glibc)."""
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)
