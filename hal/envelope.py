"""The envelope: what a controller was measured to do, and the probability that a motion fails.

A `Table` holds what was counted: trials and failures over a grid of sizes and angles. `Fit` is the model of one table,
a logistic regression whose parts grow with height, angle and steepness and which knows no harm on flat ground. Its mean
tells what a motion costs, its bound at 80 % what is no way. A file holds tables of our model of the robot, and of
others that it was driven in: the worst counts. `tools.bench envelope --write` makes the files; no number in them is
typed by hand.

    envelope = stored("hybrid")
    envelope.hazard("up", height, angle, slope)      # -ln(1 - p); infinite where there is no way

Metres and radians throughout; the file and `Axis.values` have degrees where the axis says so.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hal.errors import OperatorError
from hal.robots import envelope_file
from hal.types import Array

FAILURES = ("fell", "stuck", "slid", "touched")
"""How a trial fails: tilted beyond 40 deg; no progress for 5 s; 0.10 m or 20 deg off its line (0.25 m and 45 deg in
turns and among posts); lay on its trunk."""
MAX_RISK = 0.30
"""Probability of failure of one motion above which it is no way."""
BOUND_CONFIDENCE = 0.80
"""Of the bound that decides what is no way."""
FALL_COST = 100.0
"""Metres of driving that one failure is worth."""

SPORT = "sport"
"""The vendor's locomotion of a real robot, as a controller."""

_CHECKED = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class EnvelopeError(OperatorError):
    """The file of an envelope is missing or damaged."""


class Axis(BaseModel):
    """One dimension of a table."""

    model_config = _CHECKED

    name: str
    unit: Literal["m", "deg", "m/s", "-"]
    values: tuple[float, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _rises(self) -> Axis:
        if any(a >= b for a, b in zip(self.values, self.values[1:], strict=False)):
            raise ValueError(f"the values of axis {self.name} must rise")
        return self

    @property
    def si(self) -> Array:
        """(n,) values in m, rad or m/s."""
        values = np.array(self.values)
        return np.radians(values) if self.unit == "deg" else values


class Table(BaseModel):
    """What was counted of one manoeuvre."""

    model_config = _CHECKED

    per: Literal["crossing", "riser", "radian", "metre"]
    """What one trial of the counts is; a drive makes several."""
    axes: tuple[Axis, ...]
    cells: tuple[tuple[float, ...], ...]
    """Rows of: a value of each axis, trials, failures of each of `FAILURES`. Cells without trials are left out."""
    drives: int = Field(0, ge=0)
    log_loss: float | None = None
    """Mean of -ln(probability of what happened) per trial, on trials left out of the fit; None: not known."""
    log_loss_of_rate: float | None = None
    """The same for a model that knows the mean rate of the table alone."""
    assumed: str = ""
    """From what the counts were made up; empty: they were measured."""

    @model_validator(mode="after")
    def _fits(self) -> Table:
        n = len(self.axes)
        seen = set()
        for row in self.cells:
            at, trials, failures = row[:n], row[n : n + 1], row[n + 1 :]
            if len(row) != n + 1 + len(FAILURES):
                raise ValueError(f"a cell has {n + 1 + len(FAILURES)} numbers, not {len(row)}")
            if any(v not in axis.values for v, axis in zip(at, self.axes, strict=True)):
                raise ValueError(f"cell {at} is not on the axes")
            if any(k < 0 or k != int(k) for k in (*trials, *failures)) or sum(failures) > trials[0]:
                raise ValueError(f"cell {at} counts {trials[0]} trials and {failures} failures")
            if at in seen:
                raise ValueError(f"cell {at} comes twice")
            seen.add(at)
        return self

    @cached_property
    def trials(self) -> NDArray[np.int64]:
        """Over the grid of the axes."""
        return self._grid(0)

    @cached_property
    def failures(self) -> NDArray[np.int64]:
        """Over the grid of the axes, of all kinds."""
        return sum((self._grid(1 + k) for k in range(len(FAILURES))), np.zeros_like(self.trials))

    def _grid(self, column: int) -> NDArray[np.int64]:
        n = len(self.axes)
        out = np.zeros([len(axis.values) for axis in self.axes], np.int64)
        for row in self.cells:
            at = tuple(axis.values.index(v) for v, axis in zip(row[:n], self.axes, strict=True))
            out[at] = row[n + column]
        return out


# --- features ------------------------------------------------------------------------------------------------------
# Each maps values of the axes (SI) to parts (..., m) that are zero where nothing can go wrong and never fall with size.
# One is about what makes a face of 10 cm or a slope of 20 deg hard.
_TEN_CM = 0.10
_STEEP_SLOPE = math.tan(math.radians(20.0))


def _face_parts(height: Array, angle: Array, slope: Array) -> Array:
    s = np.sin(np.abs(angle))
    h = height / _TEN_CM
    # A robot slides on a slope at any face that holds a wheel, high or low; at none it is the business of `slope`.
    held = np.minimum(h, 0.5)
    return np.stack([h, h * s, h * s**4, held * np.tan(slope) / _STEEP_SLOPE], -1)


def _stairs_parts(riser: Array, tread: Array, angle: Array) -> Array:
    h = riser / _TEN_CM
    return np.stack([h, h * np.maximum(0.40 - tread, 0.0) / _TEN_CM, h * np.sin(np.abs(angle))], -1)


def _turn_parts(height: Array, slope: Array, place: Array) -> Array:
    h = height / _TEN_CM
    return np.stack([h, h * place, np.tan(slope) / _STEEP_SLOPE, h * np.tan(slope) / _STEEP_SLOPE], -1)


def _slope_parts(steepness: Array, direction: Array) -> Array:
    t, c = np.tan(steepness) / _STEEP_SLOPE, np.cos(direction)
    return np.stack([t * np.maximum(c, 0.0), t * np.maximum(-c, 0.0), t * np.abs(np.sin(direction))], -1)


def _posts_parts(height: Array, speed: Array) -> Array:
    h = height / _TEN_CM
    return np.stack([h, h * np.maximum(0.5 - speed, 0.0) / 0.3], -1)


def _gap_parts(width: Array) -> Array:
    return np.stack([width / _TEN_CM], -1)


PARTS: dict[str, Callable[..., Array]] = {
    "up": _face_parts,
    "down": _face_parts,
    "back_up": _face_parts,
    "back_down": _face_parts,
    "stairs_up": _stairs_parts,
    "stairs_down": _stairs_parts,
    "bend": _turn_parts,
    "spin": _turn_parts,
    "slope": _slope_parts,
    "posts": _posts_parts,
    "gap": _gap_parts,
}
"""Parts of the model of each manoeuvre."""

# --- fit -----------------------------------------------------------------------------------------------------------
PRIOR_BASE, PRIOR_BASE_SIGMA = -10.0, 5.0
"""Logit of the harm on flat ground that the model takes off again: how sharply harm rises. Weak."""
PRIOR_PART, PRIOR_PART_SIGMA = 0.0, 1.5
"""Logarithm of the weight of each part. Weights are positive by it, so harm never falls with size."""
DRAW_COUNT = 128
"""Parameters drawn about the fit, for its bound."""
MAX_EXPONENT = 50.0
MIN_HAZARD = 1e-12
MOST_ROUNDS = 100


class Fit:
    """Hazard of a manoeuvre over its parts: h = softplus(base + w . parts) - softplus(base).

    So it is none where all parts are zero. p = 1 - exp(-h) is a logistic curve of the parts with its value on flat
    ground taken off (Abbott's formula). Base and logarithms of the weights are the mode of their posterior; its normal
    approximation there (Laplace) gives the bound.
    """

    def __init__(self, parts: Array, trials: ArrayLike, failures: ArrayLike) -> None:
        """`parts` (n, m) of n cells with so many trials (n,) and failures (n,)."""
        parts = np.asarray(parts, np.float64)
        n, k = np.asarray(trials, np.float64), np.asarray(failures, np.float64)
        count = parts.shape[1]
        prior = np.array([PRIOR_BASE, *[PRIOR_PART] * count])
        precision = np.array([PRIOR_BASE_SIGMA, *[PRIOR_PART_SIGMA] * count]) ** -2.0

        def cost(theta: Array) -> float:
            h = np.maximum(_hazard(theta[0], np.exp(theta[1:]), parts), MIN_HAZARD)
            return float(
                ((n - k) * h - k * np.log(-np.expm1(-h))).sum() + 0.5 * precision @ (theta - prior) ** 2
            )

        theta, damping = prior.copy(), 1.0
        best = cost(theta)
        for _ in range(MOST_ROUNDS):
            gradient, information = self._derivatives(theta, parts, n, k)
            gradient = gradient + precision * (theta - prior)
            information = information + np.diag(precision)
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), -gradient)
            tried = theta + np.clip(step, -1.0, 1.0)
            now = cost(tried)
            if now <= best:
                done = best - now < 1e-9 and damping < 1e-3
                theta, best, damping = tried, now, 0.2 * damping
                if done:
                    break
            else:
                damping *= 5.0
                if damping > 1e9:
                    break
        _, information = self._derivatives(theta, parts, n, k)
        # The logit is linear in the weights, not in their logarithms: that is where the posterior looks normal.
        weights = np.exp(theta[1:])
        scale = np.array([1.0, *weights])
        root = np.linalg.inv(np.linalg.cholesky(information + np.diag(precision)))
        normal = np.random.default_rng(0).standard_normal((DRAW_COUNT // 2, count + 1))
        drawn = np.concatenate([normal, -normal]) @ root * scale
        self.base, self.weights = float(theta[0]), weights
        """Logit on flat ground, and what each part adds to it (m,)."""
        self.bases, self.drawn = theta[0] + drawn[:, 0], np.maximum(weights + drawn[:, 1:], 0.0)
        """(DRAW_COUNT,) and (DRAW_COUNT, m): the same, drawn from what is possible after the trials."""

    @staticmethod
    def _derivatives(theta: Array, parts: Array, n: Array, k: Array) -> tuple[Array, Array]:
        """Gradient (m + 1,) of the negative log likelihood and Fisher's information (m + 1, m + 1)."""
        weights = np.exp(theta[1:])
        h = np.maximum(_hazard(theta[0], weights, parts), MIN_HAZARD)
        z = np.minimum(theta[0] + parts @ weights, MAX_EXPONENT + theta[0])
        sigma = 1.0 / (1.0 + np.exp(-z))
        jacobian = np.column_stack(
            [sigma - 1.0 / (1.0 + np.exp(-theta[0])), sigma[:, None] * parts * weights]
        )
        odds = np.expm1(h)
        return jacobian.T @ ((n - k) - k / odds), jacobian.T @ (jacobian * (n / odds)[:, None])

    def mean(self, parts: Array) -> Array:
        """Hazard (...) of parts (..., m)."""
        return _hazard(self.base, self.weights, parts)

    def bound(self, parts: Array) -> Array:
        """Hazard (...) that is not exceeded at `BOUND_CONFIDENCE`, never below the mean.

        Each drawn curve rises with every part, and so does the curve of their quantile.
        """
        drawn = np.stack([_hazard(b, w, parts) for b, w in zip(self.bases, self.drawn, strict=True)])
        return np.maximum(np.quantile(drawn, BOUND_CONFIDENCE, axis=0), self.mean(parts))


def _hazard(base: float, weights: Array, parts: Array) -> Array:
    """softplus(base + w . parts) - softplus(base), without loss of digits near zero."""
    rise = np.minimum(parts @ weights, MAX_EXPONENT)
    return np.log1p(np.expm1(rise) / (1.0 + math.exp(-base)))


# --- envelope ------------------------------------------------------------------------------------------------------
class Counted(BaseModel):
    """What was counted of one controller in one model of its robot, or on the robot itself."""

    model_config = _CHECKED

    physics: str
    """What it was measured in: simulator with version, or the real robot."""
    date: str = Field(pattern=r"^\d{4}-\d{2}-\d{2}$")
    commit: str
    drawn: dict[str, tuple[str, float, float]] = {}
    """What was drawn at random in each trial: unit, least, most."""
    manoeuvres: dict[str, Table]

    @model_validator(mode="after")
    def _known(self) -> Counted:
        unknown = [name for name in self.manoeuvres if name not in PARTS]
        if unknown:
            raise ValueError(f"no manoeuvre is called {', '.join(unknown)}; there are {', '.join(PARTS)}")
        return self

    @cached_property
    def _fits(self) -> dict[str, Fit]:
        return {name: fit(name, table) for name, table in self.manoeuvres.items()}

    def mean(self, name: str, *values: ArrayLike) -> Array:
        """Probability of failure of one unit of a manoeuvre, by which it costs. Values of its axes in SI, broadcast."""
        return self._probability(name, values, bound=bool(self.manoeuvres[name].assumed))

    def bound(self, name: str, *values: ArrayLike) -> Array:
        """The same at `BOUND_CONFIDENCE`, by which it is a way. One beyond what was tested, but where there is
        nothing."""
        p = self._probability(name, values, bound=True)
        return np.where(self.tested(name, *values) | (p == 0.0), p, 1.0)

    def tested(self, name: str, *values: ArrayLike) -> NDArray[np.bool_]:
        """Whether no value is beyond the largest one that was tried. Of speed, the least counts."""
        table = self.manoeuvres[name]
        inside: NDArray[np.bool_] = np.array(True)
        for k, (axis, value) in enumerate(zip(table.axes, values, strict=True)):
            tried = table.trials.sum(axis=tuple(i for i in range(len(table.axes)) if i != k)) > 0
            if not tried.any():
                return np.zeros(np.broadcast_shapes(*(np.shape(v) for v in values)), np.bool_)
            si = axis.si[tried]
            value = np.abs(np.asarray(value, np.float64))
            inside = inside & (value >= si.min() - 1e-6 if axis.unit == "m/s" else value <= si.max() + 1e-6)
        return inside

    def _probability(self, name: str, values: tuple[ArrayLike, ...], bound: bool) -> Array:
        arrays = np.broadcast_arrays(*(np.asarray(v, np.float64) for v in values))
        parts = PARTS[name](*arrays)
        model = self._fits[name]
        return -np.expm1(-(model.bound(parts) if bound else model.mean(parts)))


Share = Callable[[Table], float]


def _all(_: Table) -> float:
    return 1.0


class Envelope(Counted):
    """Everything that was measured of one controller: in our model of the robot, and in those of others.

    What is believed of a motion is the worst of the models it was tried in."""

    robot: str
    controller: str
    elsewhere: dict[str, Counted] = {}
    """By the name of another model."""

    def mean(self, name: str, *values: ArrayLike, share: Share = _all) -> Array:
        """As of `Counted`, in the worst model. `share`: of the failures in a table that count."""
        return self._worst(Counted.mean, name, values, share)

    def bound(self, name: str, *values: ArrayLike, share: Share = _all) -> Array:
        """As `mean`."""
        return self._worst(Counted.bound, name, values, share)

    def hazard(self, name: str, *values: ArrayLike) -> Array:
        """-ln(1 - p) of one unit; infinite where it is no way: `bound` above `MAX_RISK`.

        `FALL_COST` times it is the price [m].
        """
        h = -np.log1p(-np.minimum(self.mean(name, *values), 1.0 - 1e-9))
        return np.where(self.bound(name, *values) > MAX_RISK, np.inf, h)

    def _worst(
        self, of: Callable[..., Array], name: str, values: tuple[ArrayLike, ...], share: Share
    ) -> Array:
        models = [counted for counted in (self, *self.elsewhere.values()) if name in counted.manoeuvres]
        worst: Array = np.max(
            [share(counted.manoeuvres[name]) * of(counted, name, *values) for counted in models], axis=0
        )
        return worst

    def write(self, path: Path) -> None:
        """As JSON, a line for each cell."""
        values = self.model_dump(mode="json", exclude_defaults=True)
        who = {key: values.pop(key) for key in ("robot", "controller")}
        path.write_text(_compact(json.dumps(who | values, indent=1)) + "\n")


def fit(name: str, table: Table) -> Fit:
    """The model of one manoeuvre's table."""
    grid = np.meshgrid(*(axis.si for axis in table.axes), indexing="ij")
    tried = table.trials > 0
    parts = PARTS[name](*(values[tried] for values in grid))
    return Fit(parts, table.trials[tried], table.failures[tried])


def read(path: Path) -> Envelope:
    """Raises EnvelopeError: the file is missing or damaged."""
    try:
        return Envelope.model_validate_json(path.read_bytes())
    except OSError as error:
        raise EnvelopeError(
            f"no envelope at {path}: {error.strerror}; `python -m tools.bench envelope --write` makes it"
        ) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise EnvelopeError(f"{path} is no envelope: {where}: {first['msg']}; measure it again") from error


# --- what a controller can ------------------------------------------------------------------------------------------
ROUTINE_RISK = 0.02
"""Probability of failure up to which a size is within a controller's limits."""
CENTIMETRE, DEGREE = 0.01, math.radians(1.0)


def limits(envelope: Envelope) -> dict[str, float]:
    """Limits by the names of `Capabilities`: the largest of each size with `ROUTINE_RISK` at most, and a way.

    Steps are met head-on on level ground; `max_slope` holds in every direction; `max_posts` is for the fastest drive
    that was tried. `step_vx` is the slowest at which such posts fail no more than twice as often; zero where each does.
    """

    def largest(names: tuple[str, ...], step: float, *rest: Array | float) -> float:
        """Of the first axis, in multiples of `step`."""
        able = 0.0
        for k in range(1, 1000):
            p, bound = (
                max(float(np.max(of(name, k * step, *rest))) for name in names)
                for of in (envelope.mean, envelope.bound)
            )
            if p > ROUTINE_RISK or bound > MAX_RISK:
                break
            able = k * step
        return able

    out = {
        "max_step": largest(("up", "down"), CENTIMETRE, 0.0, 0.0),
        "max_slope": largest(("slope",), DEGREE, np.radians([0, 45, 90, 135, 180])),
        "max_gap": largest(("gap",), CENTIMETRE),
    }
    speeds = envelope.manoeuvres["posts"].axes[1].si
    out["max_posts"] = largest(("posts",), CENTIMETRE, speeds[-1])
    slow = [v for v in speeds if float(envelope.mean("posts", out["max_posts"], v)) <= 2.0 * ROUTINE_RISK]
    out["step_vx"] = 0.0 if slow[0] == speeds[0] else float(slow[0])
    return out


@cache
def stored(controller: str) -> Envelope:
    """The envelope of `CONTROLLER` of the default robot, or of `ROBOT/CONTROLLER`. Raises EnvelopeError, RobotError."""
    return read(envelope_file(controller))


def _compact(text: str) -> str:
    """Lists of numbers on one line, counts without a point."""
    joined = re.sub(
        r"\[\s+([^\[\]{}]*?)\s+\]", lambda m: "[" + re.sub(r"\s*\n\s*", " ", m.group(1)) + "]", text
    )
    return re.sub(r"(?<=\d)\.0(?=[,\]])", "", joined)
