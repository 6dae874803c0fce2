"""How kernels are compiled that other kernels call in their loops, and one of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Kernel = Callable[..., Any]


def for_reading(values: NDArray[Any]) -> NDArray[np.float32]:
    """`values` as contiguous float32 that nobody writes to. A kernel is compiled anew for arrays that are read-only, as
    those out of messages are: so it gets all of them so."""
    out = np.ascontiguousarray(values, np.float32).view()
    out.flags.writeable = False
    return out


def borrows(kernel: Kernel, **options: Any) -> Kernel:
    """Compile a kernel that makes no array. It counts no references to its array arguments: otherwise each call would
    count all of them up and down, in memory that all cores share."""
    compiled: Kernel = njit(cache=True, _nrt=False, **options)(kernel)  # type: ignore[call-overload]
    return compiled


def inlined(kernel: Kernel) -> Kernel:
    """The same, copied to where it is called: there its arguments may be known, and loops are unrolled."""
    return borrows(kernel, forceinline=True)


@njit(cache=True)
def select(values, n, k):
    """The k-th smallest of values[:n] (Hoare's quickselect; reorders `values`)."""
    left = 0
    right = n - 1
    while left < right:
        pivot = values[(left + right) >> 1]
        i = left
        j = right
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                t = values[i]
                values[i] = values[j]
                values[j] = t
                i += 1
                j -= 1
        if k <= j:
            right = j
        elif k >= i:
            left = i
        else:
            return values[k]
    return values[k]
