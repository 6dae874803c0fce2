"""The envelope: counts in, probabilities of failure out, and a file that says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.envelope import (
    MAX_RISK,
    PARTS,
    ROUTINE_RISK,
    SPORT,
    Axis,
    Envelope,
    EnvelopeError,
    Fit,
    Table,
    limits,
    read,
    stored,
)
from hal.robots import describe, envelope_file

HEIGHT = Axis(name="height", unit="m", values=(0.05, 0.10, 0.15, 0.20))
ANGLE = Axis(name="angle", unit="deg", values=(0, 30, 60))
SLOPE = Axis(name="slope", unit="deg", values=(0, 20))


def table(rng: np.random.Generator, most: int = 12, hard: float = 1.0) -> Table:
    """Random counts that tell of harm growing with height and angle, `hard` times as fast."""
    cells = []
    for h in HEIGHT.values:
        for a in ANGLE.values:
            for s in SLOPE.values:
                n = int(rng.integers(0, most + 1))
                if n:
                    z = -6.0 + hard * (20.0 * h * (1.0 + np.sin(np.radians(a))) + s / 20.0)
                    fell = int(rng.binomial(n, 1.0 / (1.0 + np.exp(-z))))
                    cells.append((h, float(a), float(s), float(n), float(fell), 0.0, 0.0, 0.0))
    return Table(per="crossing", axes=(HEIGHT, ANGLE, SLOPE), cells=tuple(cells))


def envelope(**tables: Table) -> Envelope:
    return Envelope(
        robot="go2w",
        controller="test",
        physics="dice",
        date="2026-01-01",
        commit="abc",
        manoeuvres=tables,
    )


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.2, 3.0))
def test_harm_grows_with_height_angle_and_slope_and_there_is_none_on_flat_ground(seed, hard) -> None:
    e = envelope(up=table(np.random.default_rng(seed), hard=hard))
    h, a, s = np.meshgrid(
        np.linspace(0.0, 0.2, 9), np.radians([0, 20, 40, 60]), np.radians([0, 10, 20]), indexing="ij"
    )
    for p in (e.mean("up", h, a, s), e._probability("up", (h, a, s), bound=True)):
        assert np.all((p >= 0.0) & (p <= 1.0))
        assert np.all(p[0] == 0.0)
        assert all(np.all(np.diff(p, axis=axis) >= -1e-12) for axis in range(3))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_the_bound_is_never_below_the_mean(seed) -> None:
    e = envelope(up=table(np.random.default_rng(seed)))
    h, a = np.meshgrid(np.linspace(0.0, 0.2, 9), np.radians([0, 30, 60]))
    assert np.all(e.bound("up", h, a, 0.0) >= e.mean("up", h, a, 0.0))


@pytest.mark.parametrize("seed", range(5))
def test_more_trials_bring_the_bound_nearer(seed) -> None:
    few = table(np.random.default_rng(seed))
    many = Table(
        per="crossing",
        axes=few.axes,
        cells=tuple((*row[:3], *(16.0 * v for v in row[3:])) for row in few.cells),
    )
    h = np.array([0.10, 0.15, 0.20])
    gaps = [
        np.mean(e.bound("up", h, 0.5, 0.0) - e.mean("up", h, 0.5, 0.0))
        for e in (envelope(up=few), envelope(up=many))
    ]
    assert gaps[1] < 0.5 * gaps[0]


@pytest.mark.parametrize("seed", range(3))
def test_the_bound_holds_the_true_probability_about_as_often_as_it_says(seed) -> None:
    """Within the model, 80 %: here over 40 tables each, of places where failure matters."""
    rng = np.random.default_rng(seed)
    height = np.repeat(np.linspace(0.05, 0.35, 7), 12)
    parts = np.stack([height / 0.1], -1)
    base, weight = -8.0, 2.5
    true = np.log1p(np.exp(base + weight * parts[:, 0])) - np.log1p(np.exp(base))
    held = []
    for _ in range(40):
        failures = rng.random(len(true)) < -np.expm1(-true)
        fit = Fit(parts, np.ones(len(true)), failures)
        held += list((fit.bound(parts[::12]) >= true[::12])[2:6])
    assert 0.65 < np.mean(held) < 0.95


def test_the_fit_gives_back_what_made_the_counts() -> None:
    rng = np.random.default_rng(1)
    h = np.repeat(np.array([0.05, 0.1, 0.15, 0.2, 0.25]), 400)
    phi = np.tile(np.radians([0, 20, 40, 60]), len(h) // 4)
    parts = PARTS["up"](h, phi, np.zeros_like(h))
    true = np.array([2.0, 0.5, 4.0, 1.0])
    p = -np.expm1(-np.log1p(np.expm1(parts @ true) / (1.0 + np.exp(10.0))))
    fit = Fit(parts, np.ones(len(h)), rng.random(len(h)) < p)
    found = -np.expm1(-fit.mean(parts))
    assert np.abs(found - p).max() < 0.08
    assert np.abs(found - p).mean() < 0.015


def test_the_hybrid_controllers_faces_cost_what_the_design_asks() -> None:
    """Trials of faces up at the price that the planner's rules once had: head-on nothing, at 51 deg much, beyond no
    way."""
    trials = [(0.20, a, 8, 0) for a in (0, 10, 20, 30, 40, 45)]
    trials += [(0.20, 48, 16, 1), (0.20, 51, 16, 2), (0.20, 55, 12, 10)]
    trials += [(0.16, a, 8, 0) for a in (0, 10, 20, 30, 40, 45)] + [(0.16, 55, 12, 1), (0.16, 60, 12, 4)]
    trials += [(0.12, a, 9, 0) for a in (0, 10, 20, 30, 40, 45, 50, 60)]
    cells = tuple((h, float(a), 0.0, float(n), float(k), 0.0, 0.0, 0.0) for h, a, n, k in trials)
    axes = (
        Axis(name="height", unit="m", values=(0.12, 0.16, 0.20)),
        Axis(name="angle", unit="deg", values=(0, 10, 20, 30, 40, 45, 48, 50, 51, 55, 60)),
        Axis(name="slope", unit="deg", values=(0,)),
    )
    e = envelope(up=Table(per="crossing", axes=axes, cells=cells))

    def price(height: float, angle: float) -> float:
        return 100.0 * float(e.hazard("up", height, np.radians(angle), 0.0))

    assert price(0.20, 0) < 0.02
    assert price(0.20, 30) < 0.1
    assert 1.0 < price(0.20, 45) < 4.0
    assert price(0.20, 55) == np.inf
    assert price(0.16, 45) < 1.0
    assert price(0.16, 60) == np.inf
    assert price(0.12, 45) < 0.2
    assert 0.5 < price(0.12, 60) < 6.0


def test_beyond_what_was_tried_there_is_no_way() -> None:
    cells = tuple((h, 0.0, 0.0, 50.0, 0.0, 0.0, 0.0, 0.0) for h in (0.05, 0.10))
    e = envelope(up=Table(per="crossing", axes=(HEIGHT, ANGLE, SLOPE), cells=cells))
    assert np.isfinite(e.hazard("up", 0.10, 0.0, 0.0))
    assert e.hazard("up", 0.11, 0.0, 0.0) == np.inf
    assert e.hazard("up", 0.10, np.radians(30), 0.0) == np.inf


def test_an_assumed_table_costs_what_its_bound_says() -> None:
    measured = table(np.random.default_rng(2))
    assumed = measured.model_copy(update={"assumed": "another robot"})
    at = ("up", 0.12, 0.3, 0.0)
    assert envelope(up=assumed).mean(*at) == pytest.approx(float(envelope(up=measured).bound(*at)))
    assert envelope(up=assumed).mean(*at) > envelope(up=measured).mean(*at)


def test_a_motion_above_the_largest_risk_is_no_way() -> None:
    e = envelope(up=table(np.random.default_rng(3), most=40, hard=2.0))
    h = np.linspace(0.0, 0.2, 41)
    closed = ~np.isfinite(e.hazard("up", h, 0.5, 0.0))
    least = int(np.argmax(closed))
    assert 0 < least < len(h) - 1, "it begins within what was tried"
    assert closed[least:].all(), "and has no end"
    risk = e._probability("up", (h, 0.5, 0.0), bound=True)
    assert risk[least - 1] <= MAX_RISK < risk[least]


def test_the_file_gives_back_the_same_envelope(tmp_path: Path) -> None:
    e = envelope(up=table(np.random.default_rng(4)))
    e.write(tmp_path / "e.json")
    again = read(tmp_path / "e.json")
    assert again == e
    assert again.mean("up", 0.15, 0.2, 0.0) == e.mean("up", 0.15, 0.2, 0.0)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda d: d["manoeuvres"]["up"]["cells"][0].__setitem__(0, 0.07), "not on the axes"),
        (lambda d: d["manoeuvres"]["up"]["cells"][0].__setitem__(4, 99), "99"),
        (lambda d: d["manoeuvres"]["up"]["cells"][0].pop(), "numbers"),
        (lambda d: d["manoeuvres"]["up"]["cells"].append(d["manoeuvres"]["up"]["cells"][0]), "twice"),
        (lambda d: d["manoeuvres"].__setitem__("fly", d["manoeuvres"]["up"]), "fly"),
        (lambda d: d["manoeuvres"]["up"]["axes"][0]["values"].reverse(), "must rise"),
        (lambda d: d.pop("date"), "date"),
        (lambda d: d.__setitem__("date", "yesterday"), "date"),
    ],
)
def test_a_damaged_file_is_refused_with_its_place(tmp_path: Path, spoil, says: str) -> None:
    path = tmp_path / "e.json"
    envelope(up=table(np.random.default_rng(5))).write(path)
    content = json.loads(path.read_text())
    spoil(content)
    path.write_text(json.dumps(content))
    with pytest.raises(EnvelopeError, match=says):
        read(path)


def test_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(EnvelopeError, match="--write"):
        read(tmp_path / "none.json")


def test_every_manoeuvres_parts_are_none_where_nothing_is() -> None:
    flat = {
        "slope": (0.0, 1.0),
        "posts": (0.0, 0.2),
        "gap": (0.0,),
        "bend": (0.0, 0.0, 1.0),
        "spin": (0.0, 0.0, 1.0),
    }
    for name, parts in PARTS.items():
        at = flat.get(name, (0.0, 0.5, 0.3))
        assert np.all(parts(*(np.array(v) for v in at)) == 0.0), name


def whole(shrink: float = 1.0) -> Envelope:
    """Every manoeuvre, passed 60 times of 60 at what is easy and failed as often at what is hard; sizes times
    `shrink`."""
    sizes = {
        "up": (0.16, 0.32),
        "down": (0.20, 0.40),
        "back_up": (0.08, 0.20),
        "back_down": (0.12, 0.20),
        "slope": (25.0, 45.0),
        "posts": (0.08, 0.16),
        "gap": (0.10, 0.20),
    }
    tables = {}
    for name, (easy, hard) in sizes.items():
        rest: tuple[Axis, ...] = ()
        if name in ("up", "down", "back_up", "back_down"):
            rest = (ANGLE, SLOPE)
        elif name == "slope":
            rest = (Axis(name="direction", unit="deg", values=(0, 90, 180)),)
        elif name == "posts":
            rest = (Axis(name="speed", unit="m/s", values=(0.2, 0.5)),)
        easy, hard = shrink * easy, shrink * hard
        first = Axis(name="size", unit="deg" if name == "slope" else "m", values=(easy, hard))
        cells = []
        for at in np.ndindex(*(len(a.values) for a in rest)):
            others = tuple(a.values[k] for a, k in zip(rest, at, strict=True))
            slow = 60.0 if name == "posts" and others == (0.2,) else 0.0
            cells.append((easy, *others, 60.0, 0.0, slow, 0.0, 0.0))
            cells.append((hard, *others, 60.0, 60.0, 0.0, 0.0, 0.0))
        tables[name] = Table(per="crossing", axes=(first, *rest), cells=tuple(cells))
    return envelope(**tables)


def test_limits_are_the_largest_sizes_that_hardly_ever_fail() -> None:
    able = limits(whole())
    assert 0.15 <= able["max_step"] <= 0.22
    assert np.radians(19) <= able["max_slope"] <= np.radians(34)
    assert 0.09 <= able["max_gap"] <= 0.15
    assert able["max_posts"] >= 0.07
    assert able["step_vx"] == 0.5, "slower, posts stop it"
    e = whole()
    for name, limit, step, rest in (
        ("up", "max_step", 0.01, (0.0, 0.0)),
        ("gap", "max_gap", 0.01, ()),
        ("slope", "max_slope", np.radians(1.0), (np.radians([0, 45, 90, 135, 180]),)),
    ):
        at, more = (able[limit], *rest), (able[limit] + step, *rest)
        assert np.max(e.mean(name, *at)) <= ROUTINE_RISK, name
        assert np.max(e.mean(name, *more)) > ROUTINE_RISK or np.max(e.bound(name, *more)) > MAX_RISK, name


def test_a_weaker_controller_has_smaller_limits() -> None:
    strong, weak = limits(whole()), limits(whole(0.7))
    for name in ("max_step", "max_slope", "max_gap", "max_posts"):
        assert weak[name] < strong[name], name


def test_an_assumed_envelope_has_no_larger_limits_than_the_measured_one() -> None:
    e = whole()
    assumed = envelope(**{m: t.model_copy(update={"assumed": "dice"}) for m, t in e.manoeuvres.items()})
    assert all(limits(assumed)[name] <= value for name, value in limits(e).items() if name != "step_vx")


@pytest.mark.parametrize("controller", [*describe().own, SPORT])
def test_each_controllers_file_holds_every_manoeuvre(controller: str) -> None:
    e = stored(controller)
    assert e.controller == controller
    assert set(e.manoeuvres) == set(PARTS)
    assert all(table.trials.sum() > 0 for table in e.manoeuvres.values())
    assert all(bool(table.assumed) == (controller == SPORT) for table in e.manoeuvres.values())
    assert envelope_file(controller).stat().st_size < 64_000


@pytest.mark.parametrize("controller", describe().own)
def test_numbers_of_the_capabilities_are_kept_only_where_other_ones_were_measured(controller) -> None:
    declared = describe().controllers[controller].capabilities
    for name, value in limits(stored(controller)).items():
        if name in declared:
            assert declared[name] != pytest.approx(value), name
        else:
            assert getattr(describe().capabilities(controller), name) == value, name
