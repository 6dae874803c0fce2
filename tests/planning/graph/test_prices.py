"""Prices of crossings on ground whose height is uncertain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.envelope import FALL_COST, Axis, Counted, Envelope, Table, stored
from planning.graph.params import GraphParams
from planning.graph.prices import ANGLE_COUNT, SIZE_COUNT, angle_at, ending, free, hazards, prices_of, size_at

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


@pytest.mark.parametrize(
    ("height", "angle", "least", "most"),
    [
        # What the trial of the model gave, at 100 m a failure: 0.00, 0.03, 2.2 m, no way; 0.00, 0.2 m, no way; 0.00,
        # 0.02, 1.3 m.
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
def test_faces_have_the_prices_that_were_measured(envelope, height, angle, least, most) -> None:
    assert least <= FALL_COST * float(envelope.hazard("up", height, np.radians(angle), 0.0)) <= most


def test_a_face_that_may_be_higher_than_it_seems_is_a_larger_hazard(envelope) -> None:
    told = [float(hazards(envelope, "up", sigma, 0.16, np.radians(50), 0.0)) for sigma in (0.0, 0.01, 0.02)]
    assert told[0] < told[1] < told[2]
    assert told[2] > 1.5 * told[0]


def test_flat_ground_is_no_hazard_however_it_is_met(envelope) -> None:
    angles = np.radians([0, 60, 89])
    assert (hazards(envelope, "up", 0.0, 0.0, angles, np.radians(10)) == 0.0).all()


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 0.25), st.floats(0.0, 0.06), st.floats(0.0, 1.2), st.floats(0.0, 0.2))
def test_a_hazard_is_the_mean_of_three_heights_in_the_worst_model(
    envelope, height, sigma, angle, slope
) -> None:
    points = np.maximum(height + np.sqrt(3.0) * sigma * np.array([-1.0, 0.0, 1.0]), 0.0)
    ends = [
        max(
            ending("up", model.manoeuvres["up"]) * float(Counted.mean(model, "up", h, angle, slope))
            for model in (envelope, *envelope.elsewhere.values())
        )
        for h in points
    ]
    p = np.array([1, 4, 1]) / 6 @ ends
    assert float(hazards(envelope, "up", sigma, height, angle, slope)) == pytest.approx(
        -np.log1p(-min(p, 1 - 1e-9)), rel=1e-9, abs=1e-12
    )


@pytest.mark.parametrize("controller", ["hybrid", "vmc", "policy", "sport"])
def test_the_tables_hold_what_the_envelope_says_and_rise_with_size(controller: str) -> None:
    envelope, prices = stored(controller), prices_of(GraphParams(controller=controller))

    def hazard(name: str, *values: float) -> float:
        return 100.0 * float(hazards(envelope, name, 0.01, *values))

    i, j = size_at(0.152), angle_at(np.radians(-31.0))
    assert prices.face[0, 0, i, j] == pytest.approx(0.25 * hazard("up", 0.15, np.radians(30), 0.0))
    assert prices.face[1, 1, i, j] == pytest.approx(0.25 * hazard("back_down", 0.15, np.radians(30), 0.0))
    assert prices.turn[0, i, 2] == pytest.approx(hazard("bend", 0.15, np.radians(10), 1.0))
    assert prices.turn[1, i, 0] == pytest.approx(hazard("spin", 0.15, 0.0, 1.0))
    assert prices.posts[size_at(0.1)] == pytest.approx(hazard("posts", 0.10, 0.5))
    assert prices.gap[size_at(0.08)] == pytest.approx(0.25 * hazard("gap", 0.08))
    for table in (*prices.face.reshape(4, SIZE_COUNT, ANGLE_COUNT), *prices.turn):
        assert (np.diff(table, axis=0) >= -1e-12).all(), "the higher the dearer"
    half = prices.face[..., : (ANGLE_COUNT + 1) // 2]
    assert (np.diff(half, axis=-1) >= -1e-12).all(), "the more askew the dearer"
    np.testing.assert_allclose(prices.face, prices.face[..., ::-1], err_msg="from either side")
    for name, table in prices._asdict().items():
        assert (np.asarray(table) >= 0.0).all()
        assert np.isfinite(table).all() or name == "stairs"
    assert prices.face[0, 0, 0, 0] == prices.posts[0] == prices.gap[0] == 0.0


def test_without_a_controller_or_at_no_cost_of_a_failure_nothing_has_a_price() -> None:
    for prices in (prices_of(GraphParams()), prices_of(GraphParams(controller="hybrid", fall_cost=0.0))):
        for table, zero in zip(prices, free(0.21, 0.1928, 0.086), strict=True):
            np.testing.assert_array_equal(table, zero)
    double, single = (prices_of(GraphParams(controller="hybrid", fall_cost=cost)) for cost in (200.0, 100.0))
    np.testing.assert_allclose(double.face, 2.0 * single.face)
