"""What a process does with its memory once all that it needs is loaded."""

from __future__ import annotations

import ctypes
import gc


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
