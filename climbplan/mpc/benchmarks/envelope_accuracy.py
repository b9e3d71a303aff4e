"""How far McCormick envelopes on the published segments are from the products along walks.

Terms and segments of Tables 8.4 and 8.5; the error is eq. (8.31). An envelope allows an interval of
values, of which a solver takes any: its middle is what one takes that does not care, its farther
end the worst that one can gain from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TextIO

import numpy as np

from climbplan.mpc.benchmarks.shipped_tasks import shipped_task
from climbplan.mpc.draws import StartRanges, drawn_start
from climbplan.mpc.nlp import solve_nlp
from climbplan.mpc.task import ANGLES, RATE_RANGE, SPIN, Array, WalkTask
from climbplan.mpc.truth import euler_rates, toes_in_body

_POINTS, _QUICK = 200, 30  # knots of walks
_SECONDS = 60.0
_NOTHING = 1e-6  # products that are zero and whose envelope says so have no relative error


@dataclass(frozen=True)
class Term:
    """Values of one kind of product at K points, and the interval that its envelope allows."""

    name: str
    published: float  # mean error, Table 8.5
    true: Array  # (K,)
    lower: Array  # (K,)
    upper: Array  # (K,)

    @property
    def middle(self) -> float:
        """Mean error of the intervals' middles, eq. (8.31)."""
        return _mean_error(0.5 * (self.lower + self.upper), self.true)

    @property
    def worst(self) -> float:
        """Mean error of the intervals' farther ends."""
        far = np.where(self.upper - self.true > self.true - self.lower, self.upper, self.lower)
        return _mean_error(far, self.true)

    @property
    def width(self) -> float:
        """Mean half width of the intervals to the largest value."""
        return float((0.5 * (self.upper - self.lower)).mean() / np.abs(self.true).max())


def accuracy_table(seed: int, quick: bool, stream: TextIO) -> None:
    """Print the errors of each kind of term beside the published ones."""
    terms = envelope_terms(seed, _QUICK if quick else _POINTS)
    print(
        f"envelopes on the published segments at {len(terms[0].true)} knots of walks, eq. (8.31)\n"
        "term                        published  middle  farther end  half width to largest value",
        file=stream,
    )
    for term in terms:
        print(
            f"{term.name:<26} {100 * term.published:9.2f} %  {100 * term.middle:4.1f} %  "
            f"{100 * term.worst:9.1f} %  {100 * term.width:24.1f} %",
            file=stream,
            flush=True,
        )


def envelope_terms(seed: int, points: int) -> tuple[Term, ...]:
    """All kinds of Table 8.5, at knots of walks from random starts and of the turn."""
    knots = _knots(seed, points)
    angles = _grid(np.pi / 2, 4)
    theta = knots.angles
    rates = euler_rates(theta, knots.spin)
    s, c = np.sin(theta), np.cos(theta)
    sin, cos = _images(np.sin, theta, angles), _images(np.cos, theta, angles)
    products, fine = _grid(1.0, 4), _grid(RATE_RANGE, 16)
    first = _envelope(sin[:, 0], cos[:, 1], s[:, 0], s[:, 0], c[:, 1])
    two = s[:, 0] * s[:, 1]
    inner = _envelope(sin[:, 0], sin[:, 1], s[:, 0], s[:, 0], s[:, 1])
    cell = _cells(two, products)
    second = _envelope(cell, cos[:, 2], *_within(inner, cell), c[:, 2])
    turn = s[:, 2] * c[:, 1]
    inner = _envelope(sin[:, 2], cos[:, 1], s[:, 2], s[:, 2], c[:, 1])
    cell, rate = _cells(turn, products), _cells(rates[:, 0], fine)
    third = _envelope(cell, rate, *_within(inner, cell), rates[:, 0])
    spins = _cells(knots.spin, fine)
    fourth = _envelope(spins[:, 0], spins[:, 1], *2 * (knots.spin[:, 0],), knots.spin[:, 1])
    toe = knots.middle[:, None] + _grid(knots.reach, 4)  # (K, 4 + 1) about each leg's middle
    at = np.stack([_cells(x, g)[0] for x, g in zip(knots.arm[:, None], toe, strict=True)])
    force = _cells(knots.force, _grid(knots.limit, 16))
    fifth = _envelope(at, force, knots.arm, knots.arm, knots.force)
    return (
        Term("sin roll cos pitch", 0.1084, s[:, 0] * c[:, 1], *first.T),
        Term("sin roll sin pitch cos yaw", 0.1238, two * c[:, 2], *second.T),
        Term("sin yaw cos pitch d roll", 0.0286, turn * rates[:, 0], *third.T),
        Term("spin x spin y", 0.1173, knots.spin[:, 0] * knots.spin[:, 1], *fourth.T),
        Term("arm x force y", 0.0781, knots.arm * knots.force, *fifth.T),
    )


@dataclass(frozen=True)
class _Knots:
    angles: Array  # (K, 3)
    spin: Array  # (K, 3)
    arm: Array  # (M,) x of standing toes, body frame
    middle: Array  # (M,) of their boxes
    force: Array  # (M,) y
    reach: float
    limit: float


def _knots(seed: int, points: int) -> _Knots:
    turn = shipped_task("mpc_turn")
    walks = [(turn, solve_nlp(turn, "trot", _SECONDS).trajectory)]
    task = shipped_task("mpc_forward")
    ranges = StartRanges(sideways=0.5, tilt=0.1, spin=0.6)
    k = 0
    while sum(x.state[1:].shape[0] for _, x in walks if x is not None) < points:
        drawn: WalkTask = drawn_start(task, ranges, np.random.default_rng([seed, k])).task
        walks.append((drawn, solve_nlp(drawn, "trot", _SECONDS).trajectory))
        k += 1
    found = [(one, x) for one, x in walks if x is not None]
    stands = np.concatenate([x.gait.contact[1:-1].ravel() for _, x in found])
    spots = np.concatenate([toes_in_body(x.state, x.toes)[1:-1].reshape(-1, 3) for _, x in found])
    force = np.concatenate([x.force[1:-1].reshape(-1, 3) for _, x in found])
    middle = np.concatenate(
        [np.tile(one.body.toe_center[:, 0], len(x.force) - 2) for one, x in found]
    )
    return _Knots(
        np.concatenate([x.state[1:, ANGLES] for _, x in found]),
        np.concatenate([x.state[1:, SPIN] for _, x in found]),
        spots[stands, 0],
        middle[stands],
        force[stands, 1],
        float(task.body.toe_half[0]),
        task.body.force_limit,
    )


def _grid(reach: float, count: int) -> Array:
    """Ends (count + 1,) of equal segments of [-reach, reach]."""
    return np.linspace(-reach, reach, count + 1)


def _cells(values: Array, ends: Array) -> Array:
    """The segment (..., 2) that each value lies in."""
    index = np.clip(np.searchsorted(ends, values, side="right") - 1, 0, len(ends) - 2)
    return np.stack([ends[index], ends[index + 1]], axis=-1)


def _images(function: np.ufunc, angles: Array, ends: Array) -> Array:
    """Ranges (..., 2) of sine or cosine over the segments of angles; segments end at 0."""
    values = function(_cells(angles, ends))
    return np.sort(values, axis=-1)


def _within(interval: Array, cell: Array) -> tuple[Array, Array]:
    """Ends of intervals (K, 2) as far as they are within cells (K, 2)."""
    low, high = np.clip(interval, cell[:, :1], cell[:, 1:]).T
    return low, high


def _envelope(x: Array, y: Array, low: Array, high: Array, at: Array) -> Array:
    """Values (K, 2) that eq. (8.26) on cells x, y (K, 2) allows at x in [low, high] and y = at."""
    xl, xu, yl, yu = x[:, 0], x[:, 1], y[:, 0], y[:, 1]
    ends = []
    for sign, (a, b) in ((1.0, ((xl, yl), (xu, yu))), (-1.0, ((xu, yl), (xl, yu)))):
        # Two planes, of which the larger is the lower bound and the smaller the upper one.
        planes = [(q, p * at - p * q) for p, q in (a, b)]  # slope in x, rest
        (s1, r1), (s2, r2) = planes
        apart = np.where(np.abs(s1 - s2) > 0, s1 - s2, 1.0)
        cross = np.clip((r2 - r1) / apart, low, high)
        values = [
            sign * np.maximum(sign * (s1 * v + r1), sign * (s2 * v + r2))
            for v in (low, high, cross)
        ]
        ends.append(sign * np.min([sign * v for v in values], axis=0))
    return np.stack(ends, axis=1)


def _mean_error(found: Array, true: Array) -> float:
    size = np.maximum(np.abs(found), np.abs(true))
    counted = size > _NOTHING
    return float((np.abs(found - true)[counted] / size[counted]).mean())
