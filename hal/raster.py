"""Which cell of a raster a place lies in. Along one axis; `origin` [m] is the CENTRE of cell 0."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hal.kernels import inlined


@inlined
def cell_of(at, origin, size):
    """Number of the cell whose centre is nearest to the coordinate `at` [m]; halves round up. For kernels."""
    return math.floor((at - origin) / size + 0.5)


def cells_of(at: NDArray[np.float64], origin: float, size: float) -> NDArray[np.int64]:
    """The same for an array."""
    return np.floor((at - origin) / size + 0.5).astype(np.int64)
