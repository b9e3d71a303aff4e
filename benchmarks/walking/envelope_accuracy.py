"""How far McCormick envelopes on the published segments are from the products along walks.

Terms and segments of Tables 8.4 and 8.5; the error is eq. (8.31), which has no say about products
near zero: there any error is a large part of the product. An envelope allows an interval of values:
its middle is what a solver takes that does not care, its farther end the worst that one can gain
from, and `solved` what OSQP leaves in the published program about each walk, against the products
of its own angles, rates, arms and forces. Which of these the text means it does not say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TextIO

import numpy as np

from benchmarks.walking.shipped_tasks import FORMS, shipped_task
from climbplan.arrays import Array
from climbplan.walking.check.reference_dynamics import euler_rates, transform_toes_to_body
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.sqp import build_iterate
from climbplan.walking.problem.random_tasks import StartRanges, sample_start
from climbplan.walking.published.layout import MOMENT, PAIRS, SQUARES, TRIPLES
from climbplan.walking.published.program import PublishedProgram
from climbplan.walking.task.task import ANGLES, RATE_RANGE, SPIN, WalkTask, WalkTrajectory

_POINTS, _QUICK = 200, 30  # knots of walks
_SECONDS = 60.0
_NOTHING = 1e-6  # products that are zero and whose envelope says so have no relative error
_SIZABLE = 0.05  # of the largest value: products beyond have a relative error that means something
_DRAWN = 2000  # points over the whole ranges of Table 8.4

Walk = tuple[WalkTask, WalkTrajectory]


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
        return mean_error(0.5 * (self.lower + self.upper), self.true)

    @property
    def worst(self) -> float:
        """Mean error of the intervals' farther ends."""
        far = np.where(self.upper - self.true > self.true - self.lower, self.upper, self.lower)
        return mean_error(far, self.true)


@dataclass(frozen=True)
class Left:
    """What the published program's answers leave of one kind of product."""

    found: Array  # (K,) the product's unknown
    true: Array  # (K,) of the answer's own factors

    @property
    def all(self) -> float:
        """Mean error, eq. (8.31)."""
        return mean_error(self.found, self.true)

    @property
    def sizable(self) -> float:
        """Mean error of the products that are not small."""
        size = np.maximum(np.abs(self.found), np.abs(self.true))
        big = size > _SIZABLE * size.max()
        return mean_error(self.found[big], self.true[big])


def accuracy_table(seed: int, quick: bool, stream: TextIO) -> None:
    """Print the errors of each kind of term beside the published ones."""
    walks = random_walks(seed, _QUICK if quick else _POINTS)
    for title, walked in (("walks from random starts", walks), ("the turn", _turn())):
        terms, left = envelope_terms(knots_of(walked)), solved_terms(walked)
        print(
            f"envelopes on the published segments, {title} ({len(terms[0].true)} knots), "
            "mean of eq. (8.31)\n"
            "term                        published  middle  farther end  solved  solved, sizable",
            file=stream,
        )
        for term, answer in zip(terms, left, strict=True):
            print(
                f"{term.name:<26} {100 * term.published:9.2f} %  {100 * term.middle:4.1f} %  "
                f"{100 * term.worst:9.1f} %  {100 * answer.all:4.1f} %  "
                f"{100 * answer.sizable:13.1f} %",
                file=stream,
                flush=True,
            )
    drawn = envelope_terms(_drawn(seed))
    middles = ", ".join(f"{100 * term.middle:.1f} %" for term in drawn)
    print(f"drawn evenly over the ranges of Table 8.4, middles: {middles}", file=stream)


@dataclass(frozen=True)
class Knots:
    """Where products are looked at."""

    angles: Array  # (K, 3)
    spin: Array  # (K, 3)
    arm: Array  # (M,) x of standing toes, body frame
    middle: Array  # (M,) of their boxes
    force: Array  # (M,) y
    reach: float
    limit: float


def envelope_terms(knots: Knots) -> tuple[Term, ...]:
    """All kinds of Table 8.5."""
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


def solved_terms(walks: list[Walk]) -> tuple[Left, ...]:
    """The same kinds in what OSQP answers to the published program about each walk.

    Its regions are those of the walk itself, so that it has an answer; walks about which OSQP finds
    none in its iterations are left out.
    """
    found: list[list[tuple[Array, Array]]] = []
    for task, walk in walks:
        program = PublishedProgram(FixedContactProgram(task, walk.gait))
        x = program.solve(build_iterate(walk, walk.gait)).values
        if x is None:
            continue
        at, during = program.layout, program.layout.during
        angles, rate = x[at.angle], x[at.rate][:, 0]
        s, c = np.sin(angles), np.cos(angles)
        pair, triple = PAIRS.index((0, 4)), TRIPLES.index(PAIRS.index((0, 5)))
        spin, arm, force = x[at.spin], x[at.arm], x[at.force]
        found.append(
            [
                (x[at.pair[:, pair]], s[:, 0] * c[:, 1]),
                (x[at.triple[:, triple]], s[:, 0] * s[:, 1] * c[:, 2]),
                (x[at.swept[:, 2]], s[during, 2] * c[during, 1] * rate),
                (x[at.square[:, SQUARES.index((0, 1))]], spin[:, 0] * spin[:, 1]),
                (x[at.moment[:, MOMENT.index((0, 1))]], arm[:, 0] * force[:, 1]),
            ]
        )
    return tuple(
        Left(*(np.concatenate([one[k][part] for one in found]) for part in range(2)))
        for k in range(5)
    )


def random_walks(seed: int, points: int) -> list[Walk]:
    """Walks of the NLP from random starts, disturbed ones too, with so many knots together."""
    task = shipped_task("mpc_forward", *FORMS["published"])
    ranges = StartRanges(lateral=0.5, tilt=0.1, angular_velocity=0.6)
    walks: list[Walk] = []
    k = 0
    while len(walks) * task.knots < points:
        drawn = sample_start(task, ranges, np.random.default_rng([seed, k])).task
        found = solve_nlp(drawn, "trot", _SECONDS).trajectory
        if found is not None:
            walks.append((drawn, found))
        k += 1
    return walks


def _turn() -> list[Walk]:
    turn = shipped_task("mpc_turn", *FORMS["published"])
    found = solve_nlp(turn, "trot", _SECONDS).trajectory
    return [] if found is None else [(turn, found)]


def knots_of(walks: list[Walk]) -> Knots:
    """Knots 1 to N of walks, and the legs that stand at knots 1 to N - 1."""
    walked = [walk for _, walk in walks]
    stands = np.concatenate([x.gait.contact[1:-1].ravel() for x in walked])
    spots = np.concatenate(
        [transform_toes_to_body(x.state, x.toes)[1:-1].reshape(-1, 3) for x in walked]
    )
    force = np.concatenate([x.force[1:-1].reshape(-1, 3) for x in walked])
    body = walks[0][0].body
    middle = np.concatenate([np.tile(body.toe_center[:, 0], len(x.force) - 2) for x in walked])
    return Knots(
        np.concatenate([x.state[1:, ANGLES] for x in walked]),
        np.concatenate([x.state[1:, SPIN] for x in walked]),
        spots[stands, 0],
        middle[stands],
        force[stands, 1],
        float(body.toe_half[0]),
        body.force_limit,
    )


def _drawn(seed: int) -> Knots:
    """Points drawn evenly over the ranges of Table 8.4."""
    rng = np.random.default_rng(seed)
    body = shipped_task("mpc_forward", *FORMS["published"]).body
    reach, limit = float(body.toe_half[0]), body.force_limit
    return Knots(
        rng.uniform(-np.pi / 2, np.pi / 2, (_DRAWN, 3)),
        rng.uniform(-RATE_RANGE, RATE_RANGE, (_DRAWN, 3)),
        rng.uniform(-reach, reach, _DRAWN),
        np.zeros(_DRAWN),
        rng.uniform(-limit, limit, _DRAWN),
        reach,
        limit,
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


def mean_error(found: Array, true: Array) -> float:
    """Mean of eq. (8.31), of products that are not zero."""
    size = np.maximum(np.abs(found), np.abs(true))
    counted = size > _NOTHING
    return float((np.abs(found - true)[counted] / size[counted]).mean())
