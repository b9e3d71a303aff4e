"""The program with all integers given, linearised: states eliminated, a small dense QP left.

Unknowns are the forces of standing legs and the footholds that are still free. Friction cones are
inscribed pyramids, so that what the QP holds the cone holds too. What a gait alone decides is made
once; the numbers of a linearisation are written by compiled code into arrays that serve again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import daqp
import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.kernels.feet import place_toes, worst_beyond
from climbplan.walking.kernels.footing import walk_cost
from climbplan.walking.kernels.knots import knots_rolled
from climbplan.walking.kernels.qp import assembled, force_cost, in_units
from climbplan.walking.kernels.ways import swing_heights
from climbplan.walking.offline.footing import UNKNOWN, Footing, footing_of, toe_heights
from climbplan.walking.offline.joint_rows import JointRows
from climbplan.walking.task.task import ANGLES, POSITION, STATE, Gait, WalkTask

FACETS = 8
FOOT_SCALE = 0.1  # [m] unit of the foothold unknowns
_RIDGE = 1e-7  # curvature along directions that cost nothing
_SOLVED = 1
_SOLVED_SOFTLY = 2
_UNSOLVED = 0
_NOT_CONVEX = -5
_AT_UPPER, _AT_LOWER = 1, 3  # rows that DAQP starts with
_SOFT = 8  # rows that DAQP may break at a price
_FAR = 1e30
_TOO_FAST = 0.1  # [m] of overreach that joints twice as fast as they can be are worth
_MOST_STEPS = 2000  # DAQP iterations: infeasible QPs end far sooner


@dataclass(frozen=True)
class Iterate:
    """A point to linearise about."""

    state: Array  # (N + 1, 12)
    force: Array  # (N, L, 3) zeros of swinging legs
    spots: Array  # (F, 2) free footholds [m]


@dataclass(frozen=True)
class PinnedQp:
    """min 1/2 z'Hz + g'z with bounds and rows; states are offset + sensitivity z.

    Its arrays are the program's, which the next linearisation overwrites.
    """

    hessian: Array
    gradient: Array
    lower: Array  # variables, then rows
    upper: Array
    rows: Array
    offset: Array  # (N + 1, 12)
    sensitivity: Array  # (N + 1, 12, Z)


class PinnedProgram:
    """One gait of one task. `margin`: kept inside the boxes by toes yet to be placed [m]."""

    def __init__(self, task: WalkTask, gait: Gait, margin: float = 0.0) -> None:
        self.task, self.gait, self.margin = task, gait, margin
        self.start, self.steps = task.start, task.steps
        self.footing: Footing = footing_of(gait)
        self.height = toe_heights(task.ground, gait, task.lift)  # of swinging toes: at least
        ground, region = task.ground, self.footing.region
        self.tilt = ground.slope[region]  # (F, 2) rise of footholds
        self._sloped = bool(ground.slope.any())
        self.base = ground.height[region] - (self.tilt * ground.inner[region]).sum(axis=1)
        contact = gait.contact[:-1]
        self.stand_knot, self.stand_leg = np.nonzero(contact)
        self.forces = len(self.stand_knot)
        self.foot_column = 3 * self.forces
        self.size = self.foot_column + 2 * self.footing.count
        self.fixed = self.forces * FACETS + self.footing.count * ground.corners.shape[1]
        self.force_scale = task.weight / task.body.leg_count
        self._after = np.empty((task.knots, STATE))
        self._slopes = np.empty((task.knots, STATE + 6 * task.body.leg_count, STATE))
        self._columns = 3 * np.concatenate([[0], np.cumsum(contact.sum(axis=1))])  # by knot
        weights, reference = task.weights, task.reference
        self._weight = np.concatenate([[weights.height], weights.velocity, weights.angles])
        self._wanted = np.concatenate(
            [reference.height[:, None], reference.velocity, reference.euler], axis=1
        )
        self.joints = JointRows(task, gait, self.footing)
        self._force_hessian = self._force_cost()
        self._qp = self._empty_qp()
        self._scale: Array | None = None  # units of unknowns where rounding asks for them
        self._active: Array | None = None  # multipliers of the QP before: where to start
        self.spent = 0  # DAQP iterations of the last step
        self.softly = False  # its answer leaves the workspace where nothing else was possible

    def begin(self, task: WalkTask) -> None:
        """The same gait from another start; a first guess of what will be active is kept."""
        self.start, self.steps = task.start, task.steps
        self.joints.begin(task)
        if task.ground.rough:  # raised for the one before
            self.height = toe_heights(task.ground, self.gait, task.lift)
        reference = task.reference
        self._wanted[:, 0] = reference.height

    def split(self, z: Array) -> tuple[Array, Array]:
        """Forces (N, L, 3) [N] and free footholds (F, 2) [m] of the unknowns."""
        force, spots = in_units(
            np.ascontiguousarray(z), self.gait.contact, self.force_scale, FOOT_SCALE
        )
        return force, spots

    def toes(self, state: Array, spots: Array) -> Array:
        """All toes (N + 1, L, 3)."""
        body = self.task.body
        self.find_heights(state)
        toes: Array = place_toes(
            body.toe_center,
            body.toe_half,
            self.footing.foothold,
            state,
            self.height,
            self.start.toes,
            spots,
            self.base,
            self.tilt,
        )
        return toes

    def find_heights(self, state: Array) -> None:
        """Heights that are not known yet: of the ground under the middles of toes' boxes."""
        if not self._sloped:
            return
        unknown = self.height == UNKNOWN
        if not unknown.any():
            return
        body, ground = self.task.body, self.task.ground
        under = np.stack(
            [x[POSITION] + body.toe_center @ rotation_world_body(x[ANGLES]).T for x in state]
        )[..., :2]
        level = ground.level_at(ground.nearest(under), under)
        self.height = np.where(unknown, level, self.height)

    def raised(self, toes: Array) -> bool:
        """Lift swinging toes (N + 1, L, 3) above what is beneath their ways; False if they are.

        Heights only grow, so that linearisations come to an end.
        """
        task, ground = self.task, self.task.ground
        if not ground.rough:
            return False
        gait = self.gait
        clear = swing_heights(
            toes, gait.contact, gait.region, ground.lower, ground.upper, ground.sides,
            ground.height, ground.slope, ground.inner,
        )  # fmt: skip
        wanted = np.where(gait.contact, self.height, clear + task.lift)
        higher = bool((wanted > self.height + 1e-9).any())
        self.height = np.maximum(self.height, wanted)
        return higher

    def rolled(self, toes: Array, force: Array) -> Array:
        """States (N + 1, 12) that forces (N, L, 3) at toes (N + 1, L, 3) bring about."""
        task, body = self.task, self.task.body
        states: Array = knots_rolled(
            body.mass,
            body.gravity,
            body.inertia,
            body.inverse,
            self.steps,
            task.integrator == "mean",
            self.start.state,
            toes,
            force,
        )
        return states

    def reach(self, state: Array, toes: Array) -> float:
        """How far toes leave their boxes at knots 1 to N, and standing ones at 0 [m].

        Or the body misses its goal, or joints are too fast, if that is more.
        """
        body, whole = self.task.body, self.task.whole_stance
        contact = self.gait.contact
        worst = float(worst_beyond(body.toe_center, body.toe_half, whole, contact, state, toes))
        worst = max(worst, float(self.task.goal.missed(state[-1, :2])))
        spots = toes[self.footing.first, self.footing.leg, :2]
        return max(worst, _TOO_FAST * self.joints.too_fast(state, toes, spots, self.tilt))

    def cost(self, state: Array, force: Array) -> float:
        """The objective, eq. (8.30), of states (N + 1, 12) and forces (>= N, L, 3)."""
        weights = self.task.weights
        difference = weights.force_difference
        return float(
            walk_cost(state, force, self._wanted, self._weight, weights.motion, difference)
        )

    def qp(self, at: Iterate) -> PinnedQp:
        """The QP of the linearisation about an iterate."""
        task, qp = self.task, self._qp
        body, weights, foothold = task.body, task.weights, self.footing.foothold
        contact = self.gait.contact
        toes = self.toes(at.state, at.spots)
        if self.raised(toes):
            toes = self.toes(at.state, at.spots)
        first = self.fixed
        rows = qp.rows[first:]
        low, high = qp.lower[self.size + first :], qp.upper[self.size + first :]
        count = assembled(
            body.mass,
            body.gravity,
            body.inertia,
            body.inverse,
            self.steps,
            task.integrator == "mean",
            body.toe_center,
            body.toe_half,
            self.margin,
            task.whole_stance,
            contact,
            foothold,
            self.tilt,
            self.height,
            self.start.state,
            at.state,
            at.force,
            at.spots,
            toes,
            self._wanted,
            self._weight,
            weights.motion,
            self._force_hessian,
            _RIDGE,
            self._columns,
            self.force_scale,
            FOOT_SCALE,
            self.foot_column,
            self._after,
            self._slopes,
            qp.offset,
            qp.sensitivity,
            qp.hessian,
            qp.gradient,
            rows,
            low,
            high,
        )
        if task.goal.stated:  # of the centre of mass at the last knot
            rows[count:] = qp.sensitivity[-1, :2]
            low[count:] = task.goal.lower - qp.offset[-1, :2]
            high[count:] = task.goal.upper - qp.offset[-1, :2]
        motors = slice(self.motors, None)
        limits = slice(self.size + self.motors, None)
        written = self.joints.write(
            at.state, toes, at.spots, self.tilt, qp.offset, qp.sensitivity,
            self.force_scale, FOOT_SCALE, self.foot_column,
            qp.rows[motors], qp.lower[limits], qp.upper[limits],
        )  # fmt: skip
        used = self.motors + written
        if used == len(qp.rows):
            return qp
        return replace(
            qp, rows=qp.rows[:used], lower=qp.lower[: self.size + used],
            upper=qp.upper[: self.size + used],
        )  # fmt: skip

    def step(
        self,
        at: Iterate,
        elastic: bool = False,
        soft: bool = False,
        most: int = _MOST_STEPS,
        any_speed: bool = False,
    ) -> Iterate | None:
        """The optimum of that QP; None if it has none.

        elastic: if it has none, the one with the least overreach, dearly paid for; soft: look for
        that at once; any_speed: if it has none, the one for motors of any speed. most: DAQP
        iterations, with any_speed twice. `spent` and `softly` tell how it went.
        """
        self.spent, self.softly = 0, False
        qp = self.qp(at)
        if (qp.lower > qp.upper).any():
            return None
        if self.size == 0:  # no leg ever stands
            return self.iterate(qp, np.zeros(0))
        flag = 0
        if not soft:
            z, flag = self._minimised(qp, self._active, most)
            if flag != _SOLVED and self._active is not None:
                z, flag = self._minimised(qp, None, most - self.spent)
        if flag != _SOLVED and any_speed and self.joints.count:
            used, most = self.motors + self.joints.torques, most + self.spent
            qp = replace(
                qp, rows=qp.rows[:used], lower=qp.lower[: self.size + used],
                upper=qp.upper[: self.size + used],
            )  # fmt: skip
            z, flag = self._minimised(qp, None, most - self.spent)
        if flag != _SOLVED and (elastic or soft) and self.spent < most:
            z, flag = self._minimised(qp, None, most - self.spent, _SOFT)
            self.softly = flag == _SOLVED
        if flag != _SOLVED:
            return None
        return self.iterate(qp, z)

    def _minimised(
        self, qp: PinnedQp, multipliers: Array | None, most: int, reach: int = 0
    ) -> tuple[Array, int]:
        """DAQP's answer and flag, from an active set if multipliers are given.

        reach: how DAQP is to take the rows of the workspace.
        """
        sense = np.zeros(len(qp.lower), np.int32)
        if reach:
            sense[self.size + self.fixed : self.size + self.motors] = reach
        if multipliers is not None:
            # Which speeds have rows differs from one linearisation to the next
            before = multipliers[: self.size + self.motors + self.joints.torques]
            sense[: len(before)][before > 0] = _AT_UPPER
            sense[: len(before)][before < 0] = _AT_LOWER
        z, flag, info = _daqp(qp, self._scale, sense, most)
        if flag == _NOT_CONVEX and self._scale is None:
            # Over long horizons early forces weigh a million times what footholds do: in units of
            # their own curvature rounding leaves the Hessian what it is.
            self._scale = 1.0 / np.sqrt(np.diag(qp.hessian))
            z, flag, info = _daqp(qp, self._scale, sense, most)
        self.spent += int(info["iterations"])
        # Of QPs whose soft rows contradict others DAQP may say that it solved them, without numbers
        solved = flag in (_SOLVED, _SOLVED_SOFTLY) and bool(np.isfinite(z).all())
        self._active = info["lam"] if solved and flag == _SOLVED and reach == 0 else None
        return z, _SOLVED if solved else min(flag, _UNSOLVED)

    def iterate(self, qp: PinnedQp, z: Array) -> Iterate:
        """The point that unknowns stand for, its states as the QP predicts them."""
        force, spots = self.split(z)
        return Iterate(qp.offset + qp.sensitivity @ z, force, spots)

    def _empty_qp(self) -> PinnedQp:
        """Arrays of the QP with what no linearisation changes: friction and bounds."""
        knots, contact = self.task.knots, self.gait.contact
        standing, lifted = contact[1:].sum(), (~contact[1:]).sum()
        leaving = (contact[:-1] & ~contact[1:]).sum() if self.task.whole_stance else 0
        friction = self.forces * FACETS
        goal = 2 * int(self.task.goal.stated)
        moving = 3 * int(standing + leaving) + 2 * int(lifted) + goal
        self.motors = self.fixed + moving  # first row of joints
        rows = np.zeros((self.motors + self.joints.count, self.size))
        # Friction, eq. (8.18), as a pyramid inside the cone about each region's normal
        each = np.arange(self.forces)
        blocks = rows[:friction, : self.foot_column].reshape(self.forces, FACETS, self.forces, 3)
        stood = self.gait.region[self.stand_knot, self.stand_leg]
        blocks[each, :, each] = _facets(self.task.ground.friction) @ self.task.ground.frame[stood]
        # Force limits, eq. (8.23), and regions, eq. (8.24)
        most = self.task.body.force_limit / self.force_scale
        ground, region = self.task.ground, self.footing.region
        lower, upper = np.empty(self.size + len(rows)), np.empty(self.size + len(rows))
        lower[: self.foot_column] = np.tile([-most, -most, 0.0], self.forces)
        upper[: self.foot_column] = most
        least, largest, inside = ground.footholds
        lower[self.foot_column : self.size] = (least[region] / FOOT_SCALE).ravel()
        upper[self.foot_column : self.size] = (largest[region] / FOOT_SCALE).ravel()
        lower[self.size :], upper[self.size :] = -_FAR, 0.0
        motors = slice(self.size + self.motors, None)
        self.joints.bound_torques(lower[motors], upper[motors])
        sides = ground.corners.shape[1]
        for k in range(self.footing.count if sides else 0):
            first, column = friction + k * sides, self.foot_column + 2 * k
            rows[first : first + sides, column : column + 2] = inside[region[k], :, :2]
            beyond = slice(self.size + first, self.size + first + sides)
            upper[beyond] = inside[region[k], :, 2] / FOOT_SCALE
        return PinnedQp(
            np.zeros((self.size, self.size)),
            np.zeros(self.size),
            lower,
            upper,
            rows,
            np.zeros((knots + 1, STATE)),
            np.zeros((knots + 1, STATE, self.size)),
        )

    def _force_cost(self) -> Array:
        """Sum over ordered pairs of || f_s - f_t ||^2 = 2 (L sum f^2 - (sum f)^2) at each knot."""
        hessian = np.zeros((self.size, self.size))
        factor = 4.0 * self.task.weights.force_difference * self.force_scale**2
        force_cost(self.stand_knot, self.task.body.leg_count, factor, hessian)
        return hessian


@cache
def _facets(friction: float) -> Array:
    """(FACETS, 3) rows of a pyramid inside a friction cone about z."""
    angle = 2 * np.pi * (np.arange(FACETS) + 0.5) / FACETS
    slope = friction * np.cos(np.pi / FACETS)
    return np.column_stack([np.cos(angle), np.sin(angle), np.full(FACETS, -slope)])


def _daqp(
    qp: PinnedQp, unit: Array | None, sense: NDArray[np.int32], most: int
) -> tuple[Array, int, Mapping[str, Any]]:
    """DAQP's answer, flag and facts; unit (Z,): of unknowns, 1 if None."""
    rows, hessian, gradient, upper, lower = qp.rows, qp.hessian, qp.gradient, qp.upper, qp.lower
    if unit is not None:
        rows, hessian, gradient = rows * unit, hessian * np.outer(unit, unit), gradient * unit
        upper, lower = upper.copy(), lower.copy()
        upper[: len(unit)] /= unit
        lower[: len(unit)] /= unit
    z, _, flag, info = daqp.solve(
        hessian,
        gradient,
        rows,
        upper,
        lower,
        sense,
        primal_tol=1e-8,
        iter_limit=max(most, 1),
        eps_prox=0.0,
    )
    if unit is not None and np.isfinite(z).all():
        z = z * unit
    return z, int(flag), info
