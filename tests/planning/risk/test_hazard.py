"""Prices of crossings on ground whose height is uncertain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.envelope import FALL_COST, MAX_RISK, Axis, Envelope, Table
from planning.risk.hazard import HEIGHT_STEP, HazardTable, hazards, risk

# Faces up that the hybrid controller was driven over: height [m], angle [deg], trials, failures.
TRIALS = [
    *[(0.20, a, 8, 0) for a in (0, 10, 20, 30, 40, 45)],
    *[(0.20, 48, 16, 1), (0.20, 51, 16, 2), (0.20, 55, 12, 10)],
    *[(0.16, a, 8, 0) for a in (0, 10, 20, 30, 40, 45)],
    *[(0.16, 55, 12, 1), (0.16, 60, 12, 4)],
    *[(0.12, a, 9, 0) for a in (0, 10, 20, 30, 40, 45, 50, 60)],
]


@pytest.fixture(scope="module")
def envelope() -> Envelope:
    axes = (
        Axis(name="height", unit="m", values=tuple(sorted({t[0] for t in TRIALS}))),
        Axis(name="angle", unit="deg", values=tuple(sorted({float(t[1]) for t in TRIALS}))),
        Axis(name="slope", unit="deg", values=(0, 10)),
    )
    cells = tuple(
        (h, float(a), s, float(n), float(k), 0.0, 0.0, 0.0) for h, a, n, k in TRIALS for s in (0.0,)
    )
    cells += ((0.12, 0.0, 10.0, 9.0, 0.0, 0.0, 0.0, 0.0),)
    return Envelope(
        robot="go2w",
        controller="hybrid",
        physics="bench",
        date="2026-01-01",
        commit="",
        manoeuvres={"up": Table(per="crossing", axes=axes, cells=cells)},
    )


@pytest.fixture(scope="module")
def faces(envelope: Envelope) -> HazardTable:
    return HazardTable.of(envelope, "up")


@pytest.mark.parametrize(
    ("height", "angle", "least", "most"),
    [
        # What the trial of the model gave, at 100 m a failure: 0.00, 0.03, 2.2 m, no way; 0.00, 0.2 m, no way; 0.00, 0.02, 1.3 m.
        (0.20, 0, 0.0, 0.05),
        (0.20, 30, 0.0, 0.1),
        (0.20, 45, 1.0, 4.0),
        (0.20, 55, np.inf, np.inf),
        (0.16, 0, 0.0, 0.05),
        (0.16, 45, 0.05, 1.0),
        (0.16, 55, 4.0, 15.0),
        (0.16, 60, np.inf, np.inf),
        (0.12, 0, 0.0, 0.05),
        (0.12, 45, 0.0, 0.1),
        (0.12, 60, 0.5, 6.0),
    ],
)
def test_faces_have_the_prices_that_were_measured(faces, height, angle, least, most) -> None:
    assert least <= faces.price(height, 0.0, np.radians(angle), 0.0) <= most


def test_a_face_that_may_be_higher_than_it_seems_costs_more(faces) -> None:
    at = (np.radians(50), 0.0)
    prices = [faces.price(0.16, sigma, *at) for sigma in (0.0, 0.01, 0.02)]
    assert prices[0] < prices[1] < prices[2] < np.inf
    assert prices[2] > 1.5 * prices[0]
    assert faces.price(0.16, 0.05, *at) > -100.0 * np.log(5 / 6), (
        "a chance in six to be beyond what was tried"
    )


def test_flat_ground_costs_nothing_however_it_is_met(faces) -> None:
    for angle in (0, 60, 89):
        assert faces.price(0.0, 0.0, np.radians(angle), np.radians(10)) == 0.0


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 0.25), st.floats(0.0, 0.06), st.floats(0.0, 1.2), st.floats(0.0, 0.2))
def test_the_kernel_is_the_mean_of_three_heights(faces, envelope, height, sigma, angle, slope) -> None:
    points = height + np.sqrt(3.0) * sigma * np.array([-1.0, 0.0, 1.0])

    def linear(table, at):
        out = 0.0
        index = [min(max(v / s, 0.0), n - 1.0) for v, s, n in zip(at, faces.steps, table.shape, strict=True)]
        low = [min(int(v), n - 2) for v, n in zip(index, table.shape, strict=True)]
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod([v - k if c else 1 - v + k for v, k, c in zip(index, low, corner, strict=True)])
            out += weight * table[tuple(k + c for k, c in zip(low, corner, strict=True))]
        return out

    expected = sum(
        w * linear(faces.mean, (max(h, 0.0), angle, slope))
        for w, h in zip((1 / 6, 2 / 3, 1 / 6), points, strict=True)
    )
    assert risk(faces.mean, faces.steps, height, sigma, angle, slope) == pytest.approx(expected, abs=1e-12)
    assert faces.mean.shape[0] * HEIGHT_STEP > 0.20


def test_the_table_holds_the_envelope_between_its_values_too(faces, envelope) -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        h, a = rng.uniform(0.0, 0.19), rng.uniform(0.0, np.radians(50))
        exact = float(envelope.mean("up", h, a, 0.0))
        assert risk(faces.mean, faces.steps, h, 0.0, a, 0.0) == pytest.approx(exact, abs=0.02 + 0.2 * exact)


def test_the_price_is_the_hazard_of_the_envelope_where_the_height_is_sure(faces, envelope) -> None:
    for h, a in ((0.12, 45), (0.16, 50), (0.20, 40)):
        wanted = FALL_COST * float(envelope.hazard("up", h, np.radians(a), 0.0))
        assert faces.price(h, 0.0, np.radians(a), 0.0) == pytest.approx(wanted, rel=1e-6)
    assert float(envelope.bound("up", 0.2, np.radians(55), 0.0)) > MAX_RISK


def test_the_hazards_of_a_drive_are_those_of_the_kernel(faces, envelope) -> None:
    """The chance of what is driven, in numpy, and the price in the search tell the same where the table has its values."""
    height, angle = np.meshgrid([0.04, 0.10, 0.16], np.radians([0, 30, 50]))
    for sigma in (0.0, HEIGHT_STEP / np.sqrt(3.0)):
        told = hazards(envelope, "up", sigma, height, angle, 0.0)
        for h, a, each in zip(height.ravel(), angle.ravel(), told.ravel(), strict=True):
            p = risk(faces.mean, faces.steps, h, sigma, a, 0.0)
            assert each == pytest.approx(-np.log1p(-p), rel=1e-6)
    half = hazards(envelope, "up", 0.0, 0.2, np.radians(50), 0.0, share=0.5)
    assert np.expm1(-half) == pytest.approx(
        0.5 * np.expm1(-hazards(envelope, "up", 0.0, 0.2, np.radians(50), 0.0))
    )
