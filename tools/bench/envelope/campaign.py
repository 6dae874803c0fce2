"""Measuring an envelope: drive trial after trial where they tell most, and keep what was counted in the controller's
file."""

from __future__ import annotations

import datetime
import subprocess
import time
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from hal.envelope import FAILURES, MAX_RISK, PARTS, SPORT, Axis, Counted, Envelope, Fit, Table, read
from hal.lowlevel import Locomotion
from hal.mujoco.mjcf import Foreign
from hal.mujoco.robot import Simulated
from hal.robots import Robot
from hal.types import Array
from tools.bench.envelope.manoeuvres import DRAWN, MANOEUVRES, attempt

Per = Literal["crossing", "riser", "radian", "metre"]

_HEIGHT = Axis(
    name="height",
    unit="m",
    values=(0.02, 0.03, 0.04, 0.05, 0.08, 0.10, 0.12, 0.15, 0.18, 0.20, 0.23, 0.26, 0.30, 0.35),
)
_FACE = (
    _HEIGHT,
    Axis(name="angle", unit="deg", values=(0, 15, 30, 45, 55, 65, 75)),
    Axis(name="slope", unit="deg", values=(0, 10, 20)),
)
_STAIRS = (
    Axis(name="riser", unit="m", values=(0.03, 0.05, 0.10, 0.13, 0.15, 0.17, 0.20, 0.25)),
    Axis(name="tread", unit="m", values=(0.24, 0.26, 0.28, 0.30, 0.35)),
    Axis(name="angle", unit="deg", values=(0, 10, 20, 30, 45)),
)
_TURN = (
    Axis(name="height", unit="m", values=(0.0, 0.02, 0.03, 0.05, 0.08, 0.10, 0.12, 0.15, 0.20)),
    Axis(name="slope", unit="deg", values=(0, 10, 20, 30)),
    Axis(name="astride", unit="-", values=(0, 1)),
)
GRID: dict[str, tuple[Per, tuple[Axis, ...], int]] = {
    "up": ("crossing", _FACE, 4),
    "down": ("crossing", _FACE, 2),
    "back_up": ("crossing", _FACE, 2),
    "back_down": ("crossing", _FACE, 1),
    "stairs_up": ("riser", _STAIRS, 2),
    "stairs_down": ("riser", _STAIRS, 1),
    "bend": ("radian", _TURN, 2),
    "spin": ("radian", _TURN, 2),
    "slope": (
        "metre",
        (
            Axis(name="steepness", unit="deg", values=(5, 10, 15, 20, 25, 30, 35, 40, 45)),
            Axis(name="direction", unit="deg", values=(0, 45, 90, 135, 180)),
        ),
        2,
    ),
    "posts": (
        "metre",
        (
            Axis(name="height", unit="m", values=(0.02, 0.03, 0.04, 0.05, 0.07, 0.10, 0.12, 0.15, 0.20)),
            Axis(name="speed", unit="m/s", values=(0.2, 0.3, 0.4, 0.5)),
        ),
        1,
    ),
    "gap": (
        "crossing",
        (Axis(name="width", unit="m", values=(0.03, 0.06, 0.08, 0.10, 0.12, 0.14, 0.16, 0.20, 0.25, 0.30)),),
        1,
    ),
}
"""What one trial counts, the grid, and the share of the drives of each manoeuvre."""

KEEP_EVERY = 30.0
"""The file is written after so many seconds."""
SURE_WORTH = 0.02
"""How much a trial is worth where the model is sure, against where it is least sure: models err, too."""
ON_SLOPES = 0.3
"""How much a trial at a face on a slope is worth, against one on level ground: most faces stand there."""
FOLD_COUNT = 5
"""Shares of the trials that are left out of the fit in turn, to tell how well it predicts."""


@dataclass(slots=True)
class Tally:
    """Counts of one manoeuvre while it is measured."""

    name: str
    drives: int = 0
    counts: NDArray[np.int64] = field(init=False)
    """Over the grid, then trials and failures of each kind."""
    parts: Array = field(init=False)
    """Over the grid, then parts of the model."""
    usual: Array = field(init=False)
    """Over the grid: how often a robot is there, against level ground."""

    def __post_init__(self) -> None:
        axes = GRID[self.name][1]
        self.counts = np.zeros((*(len(a.values) for a in axes), 1 + len(FAILURES)), np.int64)
        grid = dict(
            zip([a.name for a in axes], np.meshgrid(*(a.si for a in axes), indexing="ij"), strict=True)
        )
        self.parts = PARTS[self.name](*grid.values())
        faces_on_slopes = (
            grid["slope"] * grid["height"] > 0.0 if "slope" in grid else np.zeros(self.counts.shape[:-1])
        )
        self.usual = np.where(faces_on_slopes, ON_SLOPES, 1.0)

    @classmethod
    def of(cls, name: str, table: Table) -> Tally:
        """Goes on from a table; its cells must lie on the grid."""
        tally = cls(name, table.drives)
        axes = GRID[name][1]
        for row in table.cells:
            at = tuple(a.values.index(v) for a, v in zip(axes, row, strict=False))
            tally.counts[at] = [int(v) for v in row[len(axes) :]]
        return tally

    def fitted(self) -> Fit:
        """The model of what was counted so far."""
        return _fitted(self.parts, self.counts)

    def next_cell(self, rng: np.random.Generator) -> tuple[int, ...]:
        """A cell where a trial tells much: the bound is far from the mean, and the mean is no hopeless one.

        So trials gather where failure has 1 to 30 %; where nothing is known yet, all cells are far from their bound.
        """
        fit = self.fitted()
        mean, bound = -np.expm1(-fit.mean(self.parts)), -np.expm1(-fit.bound(self.parts))
        worth = (bound - mean) * self.usual
        if (mean <= MAX_RISK).any():
            worth *= mean <= MAX_RISK
        some = self.parts.sum(-1) > 0.0
        flat = (worth + SURE_WORTH * worth.max() * some).ravel()
        if not flat.sum() > 0.0:  # the bound is the mean everywhere
            flat = some.ravel().astype(np.float64)
        flat /= flat.sum()
        return tuple(int(k) for k in np.unravel_index(rng.choice(flat.size, p=flat), worth.shape))

    def add(self, cell: tuple[int, ...], units: int, failure: str) -> None:
        """One drive: `units` begun, the last of which failed where `failure` says how."""
        self.drives += 1
        self.counts[(*cell, 0)] += units
        if failure:
            self.counts[(*cell, 1 + FAILURES.index(failure))] += 1

    def table(self, judged: bool = True) -> Table:
        """As it stands in the file; `judged`: with how well it predicts."""
        per, axes, _ = GRID[self.name]
        cells = tuple(
            (*(a.values[k] for a, k in zip(axes, at, strict=True)), *(float(c) for c in self.counts[at]))
            for at in np.ndindex(self.counts.shape[:-1])
            if self.counts[(*at, 0)] > 0
        )
        loss, blind = log_losses(self) if judged else (None, None)
        return Table(
            per=per, axes=axes, cells=cells, drives=self.drives, log_loss=loss, log_loss_of_rate=blind
        )


def _fitted(parts: Array, counts: NDArray[np.int64]) -> Fit:
    tried = counts[..., 0] > 0
    return Fit(parts[tried], counts[tried][:, 0], counts[tried][:, 1:].sum(1))


def log_losses(tally: Tally) -> tuple[float | None, float | None]:
    """Mean -ln(probability of what happened) on trials left out: of the fit, and of the bare rate of the others."""
    tried = tally.counts[..., 0] > 0
    parts, trials = tally.parts[tried], tally.counts[tried][:, 0]
    failures = tally.counts[tried][:, 1:].sum(1)
    if trials.sum() < 2 * FOLD_COUNT:
        return None, None
    rng = np.random.default_rng(0)
    outcome = np.concatenate([np.arange(n) < k for n, k in zip(trials, failures, strict=True)])
    cell = np.repeat(np.arange(len(trials)), trials)
    fold = rng.permutation(len(cell)) % FOLD_COUNT
    loss = blind = 0.0
    for f in range(FOLD_COUNT):
        kept, out = fold != f, fold == f
        n = np.bincount(cell[kept], minlength=len(trials))
        k = np.bincount(cell[kept & outcome], minlength=len(trials))
        h = np.maximum(Fit(parts, n, k).mean(parts)[cell[out]], 1e-9)
        loss += float(np.where(outcome[out], -np.log(-np.expm1(-h)), h).sum())
        rate = (k.sum() + 0.5) / (n.sum() + 1.0)
        blind += float(np.where(outcome[out], -np.log(rate), -np.log1p(-rate)).sum())
    return round(loss / len(cell), 4), round(blind / len(cell), 4)


def measure(
    controller: Locomotion,
    name: str,
    path: Path,
    robot: Robot,
    *,
    seconds: float = np.inf,
    drives: int | None = None,
    seed: int = 0,
    only: str = "",
    foreign: Foreign | None = None,
) -> Envelope:
    """Add trials to the file at `path` for `seconds` of wall time, or so many drives; starts it where there is none.
    `foreign`: in that model instead of ours, once there is a file.

    Which trial comes next depends on the counts and `seed` alone, so a file that is interrupted and gone on with is the
    same.
    `only`: the beginning of the manoeuvres' names. Raises EnvelopeError for a damaged file.
    """
    old = read(path) if path.exists() or foreign else None
    before: Counted | None = old.elsewhere.get(foreign.name) if old and foreign else old
    tables = before.manoeuvres if before else {}
    tallies = {m: Tally.of(m, tables[m]) if m in tables else Tally(m) for m in GRID}

    def keep(judged: bool) -> Envelope:
        counted = _counted(tallies, foreign.name if foreign else "hal.mujoco", judged)
        if old and foreign:
            envelope = old.model_copy(update={"elsewhere": {**old.elsewhere, foreign.name: counted}})
        else:
            others = old.elsewhere if old else {}
            envelope = Envelope(robot=robot.name, controller=name, elsewhere=others, **dict(counted))
        envelope.write(path)
        return envelope

    model: Simulated = foreign or robot.model()
    chosen = [m for m in GRID if m.startswith(only)]
    began = kept = time.monotonic()
    driven = 0
    while (drives is None or driven < drives) and time.monotonic() - began < seconds:
        m = min(chosen, key=lambda m: tallies[m].drives / GRID[m][2])
        tally = tallies[m]
        rng = np.random.default_rng((seed, zlib.crc32(m.encode()), tally.drives))
        cell = tally.next_cell(rng)
        axes = GRID[m][1]
        values = tuple(float(a.si[k]) for a, k in zip(axes, cell, strict=True))
        end = attempt(controller, MANOEUVRES[m](values, rng), model)
        tally.add(cell, end.units, end.failure)
        driven += 1
        if time.monotonic() - kept > KEEP_EVERY:
            keep(judged=False)
            kept = time.monotonic()
    return keep(judged=True)


def assumed(measured: Envelope) -> Envelope:
    """Of the vendor's service on the real robot, which nobody measured: counts of a controller that was, every table
    marked as assumed.

    An assumed table costs what its bound says, so this is the measured controller with less trust in it.
    """
    why = (
        f"counts of the {measured.controller} controller on the simulated robot ({measured.date}, "
        f"{measured.commit}); no trial on the real one"
    )

    def mark(counted: Counted) -> dict[str, Table]:
        return {name: table.model_copy(update={"assumed": why}) for name, table in counted.manoeuvres.items()}

    elsewhere = {
        name: counted.model_copy(update={"manoeuvres": mark(counted)})
        for name, counted in measured.elsewhere.items()
    }
    return measured.model_copy(
        update={
            "controller": SPORT,
            "physics": f"none; assumed from {measured.physics}",
            "manoeuvres": mark(measured),
            "elsewhere": elsewhere,
        }
    )


def _counted(tallies: dict[str, Tally], model: str, judged: bool) -> Counted:
    return Counted(
        physics=f"{model} on MuJoCo {mujoco.__version__}, steps of 5 ms",
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        commit=_commit(),
        drawn=DRAWN,
        manoeuvres={m: tally.table(judged) for m, tally in tallies.items() if tally.drives},
    )


def _commit() -> str:
    """Short hash of the code that measured; empty outside a checkout."""
    try:
        out = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=Path(__file__).parent
        )
    except OSError:
        return ""
    return out.stdout.strip()
