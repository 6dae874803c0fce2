"""A binary heap in three arrays for the search kernels.

Its arrays grow in a loop of their own, around the one that pushes and pops: an array that may be another one in the
next round of a loop has its references counted in each, which took more than half of a search's time.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numba import njit

NONE, ZERO = (cast("int", np.int64(number)) for number in (-1, 0))
"""Numbers to begin with: a kernel that is called with a number written out is compiled for this number alone."""


@njit(cache=True)
def push(f: np.ndarray, s: np.ndarray, e: np.ndarray, n: int, nf: float, ns: int | np.int64, ne: int) -> int:
    """Add (nf, ns, ne) to a binary heap ordered by f, then s; returns the new size."""
    i = n
    while i > 0:
        p = (i - 1) >> 1
        if f[p] < nf or (f[p] == nf and s[p] <= ns):
            break
        f[i], s[i], e[i] = f[p], s[p], e[p]
        i = p
    f[i], s[i], e[i] = nf, ns, ne
    return n + 1


@njit(cache=True)
def pop(f: np.ndarray, s: np.ndarray, e: np.ndarray, n: int) -> int:
    """Remove the root (the caller has read it); returns the new size."""
    n -= 1
    nf, ns, ne = f[n], s[n], e[n]
    i = 0
    while True:
        c = 2 * i + 1
        if c >= n:
            break
        r = c + 1
        if r < n and (f[r] < f[c] or (f[r] == f[c] and s[r] < s[c])):
            c = r
        if nf < f[c] or (nf == f[c] and ns <= s[c]):
            break
        f[i], s[i], e[i] = f[c], s[c], e[c]
        i = c
    f[i], s[i], e[i] = nf, ns, ne
    return n


@njit(cache=True)
def grown(a: np.ndarray) -> np.ndarray:
    """`a` with room for twice as many."""
    out = np.empty(2 * a.size, a.dtype)
    for k in range(a.size):
        out[k] = a[k]
    return out


@njit(cache=True)
def most_out(indptr: np.ndarray) -> int:
    """Edges out of one node at most: a search pushes no more of them between two looks at the size of its heap."""
    most = 0
    for i in range(indptr.size - 1):
        most = max(most, indptr[i + 1] - indptr[i])
    return most
