"""Unknowns of the online program of X. Lin, their exact values along a motion, and their regions.

Chapter 8.2.1.2 and Table 8.4: angles in 4 regions, their trigonometric products in 4, Euler rates
and angular velocities in 16, toe positions in 4, forces in 16. The motion of a library neighbour
gives the region of each unknown; these are all integers of the published program except contacts.

Published methods, and equation, chapter and table numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.offline.footing import Footing
from climbplan.walking.task.task import (
    ANGLE_RANGE,
    ANGLES,
    POSITION,
    RATE_RANGE,
    SPIN,
    VELOCITY,
    Gait,
    WalkTask,
)

_TOE_RANGE = 0.08  # [m] about the middle of the box
REGIONS = {"angle": 4, "trig": 4, "rate": 16, "spin": 16, "toe": 4, "force": 16}
# The products of sines (0, 1, 2: of roll, pitch, yaw) and cosines (3, 4, 5), eq. (8.16)
PAIRS = ((4, 5), (2, 4), (2, 3), (0, 2), (3, 5), (0, 5), (0, 4), (3, 4))
TRIPLES = (5, 3, 4, 2)  # pairs that are multiplied by the sine of the pitch
# Entries of R as +-1 times pairs (0 to 7), triples (8 to 11) and the sine of the pitch (12)
ENTRIES: tuple[tuple[tuple[int, int], ...], ...] = (
    ((0, 1),),
    ((8, 1), (2, -1)),
    ((3, 1), (10, 1)),
    ((1, 1),),
    ((4, 1), (9, 1)),
    ((11, 1), (5, -1)),
    ((12, -1),),
    ((6, 1),),
    ((7, 1),),
)
MOMENT = ((1, 2), (2, 1), (2, 0), (0, 2), (0, 1), (1, 0))  # of an arm and a force
SQUARES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of angular velocities


@dataclass(frozen=True)
class ToeConstraint:
    """A toe that must be in its workspace box at a knot."""

    knot: int
    leg: int
    foothold: int  # of `Footing`
    lifts: bool = False  # just before lift-off, at its stance position


class VariableLayout:
    """The indices of all unknowns of a gait in one vector."""

    def __init__(self, task: WalkTask, gait: Gait, footing: Footing) -> None:
        self.task, self.gait, self.footing = task, gait, footing
        self.mean = task.integrator == "mean"
        self.force_unit = task.weight / task.body.leg_count
        knots = task.knots
        self.stand_knot, self.stand_leg = np.nonzero(gait.contact[:-1])
        self.reaches = tuple(_list_toe_constraints(task, gait, footing))
        # Poses: knots 0 to N, and for averaged steps the middle of each interval
        self.poses = knots + 1 + (knots if self.mean else 0)
        self.during = np.arange(knots) + (knots + 1 if self.mean else 0)
        self.size = 0
        self.state = self._append_variables(knots + 1, 12)
        self.angle = self._append_variables(self.poses, 3)
        self.trig = self._append_variables(self.poses, 6)
        self.pair = self._append_variables(self.poses, len(PAIRS))
        self.triple = self._append_variables(self.poses, len(TRIPLES))
        self.turn = self._append_variables(self.poses, 9)  # entries of R
        self.spin = self._append_variables(knots, 3)  # during each interval
        self.square = self._append_variables(knots, len(SQUARES))
        self.rate = self._append_variables(knots, 3)
        self.swept = self._append_variables(
            knots, 5
        )  # trigonometric terms times Euler rates, eq. (8.17)
        self.force = self._append_variables(len(self.stand_leg), 3)
        self.arm = self._append_variables(len(self.stand_leg), 3)
        self.moment = self._append_variables(len(self.stand_leg), len(MOMENT))
        self.toe = self._append_variables(len(self.reaches), 3)  # in the box, from its middle
        self.rotated_toe = self._append_variables(len(self.reaches), 9)  # entries of R times it
        self.spot = self._append_variables(footing.count, 2)

    def _append_variables(self, count: int, width: int) -> IntArray:
        """Append unknowns and return their indices (count, width)."""
        index = self.size + np.arange(count * width, dtype=np.int64).reshape(count, width)
        self.size += count * width
        return index

    def list_products(self) -> tuple[IntArray, IntArray, IntArray]:
        """Return all bilinear terms w = x y as three index arrays."""
        w, x, y = [], [], []

        def add(product: IntArray, first_factor: IntArray, second_factor: IntArray) -> None:
            w.append(product.ravel())
            x.append(first_factor.ravel())
            y.append(second_factor.ravel())

        first, second = np.array(PAIRS).T
        add(self.pair, self.trig[:, first], self.trig[:, second])
        pitch = np.repeat(self.trig[:, 1:2], len(TRIPLES), axis=1)
        add(self.triple, self.pair[:, list(TRIPLES)], pitch)
        row, column = np.array(SQUARES).T
        add(self.square, self.spin[:, row], self.spin[:, column])
        pose = self.during
        swept = np.column_stack(
            [
                self.pair[pose, 0],
                self.trig[pose, 2],
                self.pair[pose, 1],
                self.trig[pose, 5],
                self.trig[pose, 1],
            ]
        )
        add(self.swept, swept, self.rate[:, [0, 1, 0, 1, 0]])
        arm, force = np.array(MOMENT).T
        add(self.moment, self.arm[:, arm], self.force[:, force])
        knot = np.array([reach.knot for reach in self.reaches], np.int64)
        add(self.rotated_toe, self.turn[knot], np.tile(self.toe, (1, 3)))
        return np.concatenate(w), np.concatenate(x), np.concatenate(y)

    def evaluate_motion(self, state: Array, force: Array, toes: Array, spots: Array) -> Array:
        """Return all unknowns along a motion, with exact products.

        Args:
            state: (N + 1, 12).
            force: (N, L, 3) [N].
            toes: (N + 1, L, 3) [m].
            spots: (F, 2) free footholds [m].
        """
        body = self.task.body
        x = np.zeros(self.size)
        x[self.state] = state
        middle = 0.5 * (state[:-1] + state[1:])
        during = middle if self.mean else state[:-1]
        angles = np.vstack([state[:, ANGLES], middle[:, ANGLES]])[: self.poses]
        x[self.angle] = angles
        x[self.trig] = np.hstack([np.sin(angles), np.cos(angles)])
        first, second = np.array(PAIRS).T
        x[self.pair] = x[self.trig[:, first]] * x[self.trig[:, second]]
        x[self.triple] = x[self.pair[:, list(TRIPLES)]] * x[self.trig[:, 1:2]]
        factors = np.concatenate([self.pair, self.triple, self.trig[:, 1:2]], axis=1)
        for entry, terms in enumerate(ENTRIES):
            x[self.turn[:, entry]] = sum(sign * x[factors[:, k]] for k, sign in terms)
        x[self.spin] = during[:, SPIN]
        x[self.rate] = np.diff(state[:, ANGLES], axis=0) / self.task.dt
        x[self.force] = force[self.stand_knot, self.stand_leg] / self.force_unit
        x[self.arm] = toes[self.stand_knot, self.stand_leg] - during[self.stand_knot, POSITION]
        x[self.spot] = spots
        for k, reach in enumerate(self.reaches):
            knot_state = state[reach.knot]
            R = x[self.turn[reach.knot]].reshape(3, 3)
            toe = toes[reach.knot - 1 if reach.lifts else reach.knot, reach.leg]
            x[self.toe[k]] = (toe - knot_state[POSITION]) @ R
            x[self.toe[k]] -= body.toe_center[reach.leg]
        w, first_factor, second_factor = self.list_products()
        x[w] = x[first_factor] * x[second_factor]
        return x

    def compute_cells(
        self, neighbour: Array, neighbour_region_fraction: float = 0.0
    ) -> tuple[Array, Array]:
        """Return lower and upper ends of the region of each unknown.

        Args:
            neighbour: values of the library neighbour; those of knot 0 are exact.
            neighbour_region_fraction: fraction of adjacent regions that is added; published: 0.
        """
        task = self.task
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)

        def restrict(
            index: IntArray, middle: Array | float, half: Array | float, kind: str
        ) -> None:
            value, count = neighbour[index], REGIONS[kind]
            width = 2 * np.broadcast_to(half, index.shape) / count
            bottom = np.broadcast_to(middle, index.shape) - count * width / 2
            number = np.clip(np.floor((value - bottom) / width), 0, count - 1)
            # The outermost regions extend beyond the table's range.
            low[index] = np.minimum(bottom + (number - neighbour_region_fraction) * width, value)
            high[index] = np.maximum(
                bottom + (number + 1 + neighbour_region_fraction) * width, value
            )

        restrict(self.angle, 0.0, ANGLE_RANGE, "angle")
        begin, end = low[self.angle], high[self.angle]
        low[self.trig[:, :3]], high[self.trig[:, :3]] = np.sin(begin), np.sin(end)
        ends = np.cos(begin), np.cos(end)
        low[self.trig[:, 3:]], high[self.trig[:, 3:]] = np.minimum(*ends), np.maximum(*ends)
        high[self.trig[:, 3:]] = np.where((begin < 0) & (end > 0), 1.0, high[self.trig[:, 3:]])
        restrict(self.pair, 0.0, 1.0, "trig")
        restrict(self.spin, 0.0, RATE_RANGE, "spin")
        restrict(self.rate, 0.0, RATE_RANGE, "rate")
        restrict(self.force, 0.0, task.body.force_limit / self.force_unit, "force")
        restrict(self.arm, task.body.toe_center[self.stand_leg], _TOE_RANGE, "toe")
        restrict(self.toe, 0.0, task.body.toe_half, "toe")
        fixed = [self.angle[0], self.trig[0], self.pair[0]]
        if not self.mean:
            fixed += [self.spin[0], *self.arm[self.stand_knot == 0]]
        for index in fixed:
            low[index] = high[index] = neighbour[index]
        self._bound_rotation_entries(low, high)
        return low, high

    def _bound_rotation_entries(self, low: Array, high: Array) -> None:
        """Bound triples and entries of R, which have no own regions, by interval arithmetic."""
        pair, pitch = self.pair[:, list(TRIPLES)], self.trig[:, 1:2]
        corners = [a[pair] * b[pitch] for a in (low, high) for b in (low, high)]
        low[self.triple], high[self.triple] = np.min(corners, axis=0), np.max(corners, axis=0)
        factors = np.concatenate([self.pair, self.triple, self.trig[:, 1:2]], axis=1)
        for entry, terms in enumerate(ENTRIES):
            ends = [(low, high) if sign > 0 else (-high, -low) for _, sign in terms]
            column = self.turn[:, entry]
            low[column] = sum(e[0][factors[:, k]] for e, (k, _) in zip(ends, terms, strict=True))
            high[column] = sum(e[1][factors[:, k]] for e, (k, _) in zip(ends, terms, strict=True))


def _list_toe_constraints(task: WalkTask, gait: Gait, footing: Footing) -> Iterator[ToeConstraint]:
    """Yield the workspace constraints at knots 1 to N."""
    contact: BoolArray = gait.contact
    for knot in range(1, task.knots + 1):
        for leg in range(task.body.leg_count):
            yield ToeConstraint(knot, leg, int(footing.foothold[knot, leg]))
            if task.workspace_over_stance and contact[knot - 1, leg] and not contact[knot, leg]:
                yield ToeConstraint(knot, leg, int(footing.foothold[knot - 1, leg]), lifts=True)


def select_tracked_columns(layout: VariableLayout) -> IntArray:
    """Return indices (N, 7) of height, velocity and angles at knots 1 to N."""
    state = layout.state[1:]
    columns: IntArray = np.concatenate(
        [state[:, 2:3], state[:, VELOCITY], state[:, ANGLES]], axis=1
    )
    return columns
