"""How kernels are compiled that other kernels call in their loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

Kernel = Callable[..., Any]


def borrows(kernel: Kernel, **options: Any) -> Kernel:
    """Compile a kernel that makes no array. It counts no references to its array arguments: otherwise each call would
    count all of them up and down, in memory that all cores share."""
    compiled: Kernel = njit(cache=True, _nrt=False, **options)(kernel)  # type: ignore[call-overload]
    return compiled


def inlined(kernel: Kernel) -> Kernel:
    """The same, copied to where it is called: there its arguments may be known, and loops are unrolled."""
    return borrows(kernel, forceinline=True)
