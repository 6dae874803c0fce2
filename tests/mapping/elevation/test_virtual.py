"""Virtual ground: what a low ray passed over, and nothing that a wall or the dark may fill."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mapping.elevation.virtual import LOW_RAY, SLIT_WIDTH, virtual_ground
from mapping.filling import fill_unknown

RES = 0.04


def oracle(filled, trusted, upper):
    """Line by line, as the docstring has it."""
    out = ~trusted & (upper <= filled + LOW_RAY)
    believed, dark = out | trusted, np.isnan(upper) & ~out & ~trusted
    slit = int(SLIT_WIDTH / RES + 1e-6)
    found = out.copy()
    for turned in (False, True):
        b, d, f = (a.T if turned else a for a in (believed, dark, found))
        for r in range(b.shape[0]):
            ends = np.flatnonzero(b[r])
            for i, j in pairwise(ends):
                if j - i - 1 <= slit and d[r, i + 1 : j].all():
                    f[r, i + 1 : j] = True
    return found


def test_the_kernel_does_what_the_plain_version_does():
    rng = np.random.default_rng(0)
    for share in (0.1, 0.5, 0.9):
        trusted = rng.random((40, 50)) < share
        height = np.where(trusted, 0.05 * rng.standard_normal(trusted.shape), np.nan).astype(np.float32)
        upper = np.where(rng.random(trusted.shape) < 0.5, rng.uniform(-0.5, 1.0, trusted.shape), np.nan)
        upper = np.where(trusted, height, upper).astype(np.float32)
        filled = fill_unknown(height, upper)
        np.testing.assert_array_equal(
            virtual_ground(filled, trusted, upper, RES), oracle(filled, trusted, upper)
        )


def test_behind_a_crest_it_begins_at_the_crest_and_ends_where_rays_pass_too_high():
    trusted = np.zeros((5, 100), bool)
    trusted[:, :20] = True
    height = np.where(trusted, 0.15, np.nan).astype(np.float32)
    upper = np.full(trusted.shape, np.nan, np.float32)
    upper[:, 24:60] = 0.14 - 0.004 * np.arange(36)  # rays graze the crest and fall
    upper[:, 60:80] = 0.9
    upper[:, :20] = 0.15
    found = virtual_ground(fill_unknown(height, upper), trusted, upper, RES)
    assert not found[:, :20].any(), "what was measured"
    assert found[:, 20:60].all()
    assert not found[:, 60:].any(), "a wall may stand there, and nobody looked behind"
