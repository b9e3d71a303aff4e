"""The program with all integers given, linearised: states eliminated, a small dense QP left.

Unknowns are the forces of standing legs and the footholds that are still free. Friction cones are
inscribed pyramids, so that what the QP holds the cone holds too.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np

from climbplan.mpc.dynamics import BodyNumbers, knot_model
from climbplan.mpc.footing import HELD, Footing, footing_of, place_toes, toe_heights
from climbplan.mpc.task import LEGS, STATE, Array, Gait, WalkTask

FACETS = 8
FOOT_SCALE = 0.1  # [m] unit of the foothold unknowns
_RIDGE = 1e-7  # curvature along directions that cost nothing
_TRACKED = np.array([2, 3, 4, 5, 6, 7, 8])  # height, velocity, angles of a state
_SOLVED = 1
_SOLVED_SOFTLY = 2
_AT_UPPER, _AT_LOWER = 1, 3  # rows that DAQP starts with
_SOFT = 8  # rows that DAQP may break at a price
_FAR = 1e30
_ROUNDED = 0.05  # sine of a tilt
_MOST_STEPS = 2000  # DAQP iterations: infeasible QPs end far sooner


@dataclass(frozen=True)
class Iterate:
    """A point to linearise about."""

    state: Array  # (N + 1, 12)
    force: Array  # (N, 4, 3) zeros of swinging legs
    spots: Array  # (F, 2) free footholds [m]


@dataclass(frozen=True)
class PinnedQp:
    """min 1/2 z'Hz + g'z with bounds and rows; states are offset + sensitivity z."""

    hessian: Array
    gradient: Array
    lower: Array  # variables, then rows
    upper: Array
    rows: Array
    offset: Array  # (N + 1, 12)
    sensitivity: Array  # (N + 1, 12, Z)


class PinnedProgram:
    """One gait of one task. `margin`: kept inside the workspace boxes [m]."""

    def __init__(self, task: WalkTask, gait: Gait, margin: float = 0.0) -> None:
        self.task, self.gait, self.margin = task, gait, margin
        self.footing: Footing = footing_of(gait)
        self.height = toe_heights(task.ground, gait, task.lift)
        contact = gait.contact[:-1]
        self.stand_knot, self.stand_leg = np.nonzero(contact)
        self.forces = len(self.stand_knot)
        self.first_force = np.concatenate([[0], np.cumsum(contact.sum(axis=1))])  # by knot
        self.foot_column = 3 * self.forces
        self.size = self.foot_column + 2 * self.footing.count
        self.force_scale = task.weight / LEGS
        self.model = knot_model(BodyNumbers.of(task.body), task.knots)
        self._mean = 1.0 if task.integrator == "mean" else 0.0
        self._friction = self._friction_rows()
        self._bounds = self._variable_bounds()
        self._force_hessian = self._force_cost()
        self._active: Array | None = None  # multipliers of the QP before: where to start

    def split(self, z: Array) -> tuple[Array, Array]:
        """Forces (N, 4, 3) [N] and free footholds (F, 2) [m] of the unknowns."""
        force = np.zeros((self.task.knots, LEGS, 3))
        each = z[: self.foot_column].reshape(-1, 3) * self.force_scale
        force[self.stand_knot, self.stand_leg] = each
        return force, z[self.foot_column :].reshape(-1, 2) * FOOT_SCALE

    def toes(self, state: Array, spots: Array) -> Array:
        """All toes (N + 1, 4, 3)."""
        start = self.task.start.toes
        return place_toes(self.task.body, self.footing, state, self.height, start, spots)

    def qp(self, at: Iterate) -> PinnedQp:
        """The QP of the linearisation about an iterate."""
        toes = self.toes(at.state, at.spots)
        offset, sensitivity = self._states(at, toes)
        hessian, gradient = self._cost(offset, sensitivity)
        reach, low, high = self._reach(at, toes, offset, sensitivity)
        lower, upper = self._bounds
        return PinnedQp(
            hessian,
            gradient,
            np.concatenate([lower, np.full(len(self._friction), -_FAR), low]),
            np.concatenate([upper, np.zeros(len(self._friction)), high]),
            np.vstack([self._friction, reach]),
            offset,
            sensitivity,
        )

    def step(self, at: Iterate, elastic: bool = False) -> Iterate | None:
        """The optimum of that QP; None if it has none.

        elastic: if it has none, the one with the least overreach, dearly paid for.
        """
        qp = self.qp(at)
        if (qp.lower > qp.upper).any():
            return None
        if self.size == 0:  # no leg ever stands
            return self.iterate(qp, np.zeros(0))
        z, flag = self._minimised(qp, self._active)
        if flag != _SOLVED and self._active is not None:
            z, flag = self._minimised(qp, None)
        if flag != _SOLVED and elastic:
            z, flag = self._minimised(qp, None, _SOFT)
        if flag != _SOLVED:
            return None
        return self.iterate(qp, z)

    def _minimised(
        self, qp: PinnedQp, multipliers: Array | None, reach: int = 0
    ) -> tuple[Array, int]:
        """DAQP's answer and flag, from an active set if multipliers are given.

        reach: how DAQP is to take the rows of the workspace.
        """
        sense = np.zeros(len(qp.lower), np.int32)
        sense[self.size + len(self._friction) :] = reach
        if multipliers is not None and len(multipliers) == len(sense):
            sense[multipliers > 0], sense[multipliers < 0] = _AT_UPPER, _AT_LOWER
        z, _, flag, info = daqp.solve(
            qp.hessian,
            qp.gradient,
            qp.rows,
            qp.upper,
            qp.lower,
            sense,
            primal_tol=1e-8,
            iter_limit=_MOST_STEPS,
            eps_prox=0.0,
        )
        solved = flag in (_SOLVED, _SOLVED_SOFTLY)
        self._active = np.array(info["lam"]) if flag == _SOLVED and reach == 0 else None
        return np.asarray(z), _SOLVED if solved else int(flag)

    def iterate(self, qp: PinnedQp, z: Array) -> Iterate:
        """The point that unknowns stand for, its states as the QP predicts them."""
        force, spots = self.split(z)
        return Iterate(qp.offset + qp.sensitivity @ z, force, spots)

    # Dynamics, eqs. (8.14) to (8.19), about the iterate
    def _states(self, at: Iterate, toes: Array) -> tuple[Array, Array]:
        model, knots = self.model, self.task.knots
        model.state[:], model.toes[:], model.force[:] = at.state[:-1], toes[:-1], at.force
        model.dt[:], model.mean[:] = self.task.step, self._mean
        model.linearise_step()
        A, by_toes, by_force = model.by_state, model.by_toes, model.by_force
        offset = np.empty((knots + 1, STATE))
        sensitivity = np.zeros((knots + 1, STATE, self.size))
        offset[0] = self.task.start.state
        constant = model.after - np.einsum("nij,nj->ni", A, at.state[:-1])
        constant -= np.einsum("nilk,nlk->ni", by_force, at.force)
        for n in range(knots):
            here = slice(self.first_force[n], self.first_force[n + 1])
            columns = slice(3 * here.start, 3 * here.stop)
            np.matmul(A[n], sensitivity[n], out=sensitivity[n + 1])
            legs = self.stand_leg[here]
            block = by_force[n][:, legs].reshape(STATE, -1)
            sensitivity[n + 1][:, columns] += block * self.force_scale
            shift = constant[n]
            for leg in legs:
                index = self.footing.foothold[n, leg]
                if index != HELD:  # a free foothold moves the arm of its force
                    column = self.foot_column + 2 * index
                    turn = by_toes[n][:, leg, :2]
                    sensitivity[n + 1][:, column : column + 2] += turn * FOOT_SCALE
                    shift = shift - turn @ at.spots[index]
            offset[n + 1] = shift + A[n] @ offset[n]
        return offset, sensitivity

    # Objective, eq. (8.30)
    def _cost(self, offset: Array, sensitivity: Array) -> tuple[Array, Array]:
        task, knots = self.task, self.task.knots
        weights, reference = task.weights, task.reference
        tracked = np.concatenate(
            [reference.height[:, None], reference.velocity, reference.euler], axis=1
        )
        root = np.sqrt(np.concatenate([[weights.height], weights.velocity, weights.angles]))
        J = sensitivity[1:, _TRACKED] * root[:, None]
        r = (offset[1:, _TRACKED] - tracked) * root
        motion = np.sqrt(weights.motion)
        J_motion = np.diff(sensitivity[:, :3], axis=0) * motion
        r_motion = np.diff(offset[:, :3], axis=0) * motion
        J = np.concatenate([J.reshape(7 * knots, -1), J_motion.reshape(3 * knots, -1)])
        r = np.concatenate([r.ravel(), r_motion.ravel()])
        hessian = 2.0 * (J.T @ J) + self._force_hessian
        hessian[np.diag_indices(self.size)] += _RIDGE * (1.0 + np.abs(hessian.diagonal()))
        return hessian, 2.0 * (J.T @ r)

    def _force_cost(self) -> Array:
        """Sum over ordered pairs of || f_s - f_t ||^2 = 2 (4 sum f^2 - (sum f)^2) at each knot."""
        hessian = np.zeros((self.size, self.size))
        factor = 4.0 * self.task.weights.force_difference * self.force_scale**2
        same = self.stand_knot[:, None] == self.stand_knot[None, :]
        legs = LEGS * np.eye(self.forces) - same
        hessian[: self.foot_column, : self.foot_column] = factor * np.kron(legs, np.eye(3))
        return hessian

    # Friction, eq. (8.18), as a pyramid inside the cone
    def _friction_rows(self) -> Array:
        angle = 2 * np.pi * (np.arange(FACETS) + 0.5) / FACETS
        slope = self.task.ground.friction * np.cos(np.pi / FACETS)
        facets = np.column_stack([np.cos(angle), np.sin(angle), np.full(FACETS, -slope)])
        rows = np.zeros((self.forces * FACETS, self.size))
        rows[:, : self.foot_column] = np.kron(np.eye(self.forces), facets)
        return rows

    # Force limits, eq. (8.23), and regions, eq. (8.24)
    def _variable_bounds(self) -> tuple[Array, Array]:
        most = self.task.body.force_limit / self.force_scale
        ground, region = self.task.ground, self.footing.region
        lower = np.concatenate(
            [
                np.tile([-most, -most, 0.0], self.forces),
                (ground.lower[region] / FOOT_SCALE).ravel(),
            ]
        )
        upper = np.concatenate(
            [np.full(3 * self.forces, most), (ground.upper[region] / FOOT_SCALE).ravel()]
        )
        return lower, upper

    # Workspace boxes, eqs. (8.20), (8.21), at knots 1 to N
    def _reach(
        self, at: Iterate, toes: Array, offset: Array, sensitivity: Array
    ) -> tuple[Array, Array, Array]:
        model, body = self.model, self.task.body
        model.later_state[:], model.later_toes[:] = at.state[1:], toes[1:]
        model.linearise_toes()
        low = body.toe_center - body.toe_half + self.margin
        high = body.toe_center + body.toe_half - self.margin
        standing = self.gait.contact[1:]
        n, leg = np.nonzero(standing)
        R, T = model.body_world[n], model.spots_by_angles[n, leg]  # (M, 3, 3) each
        S = sensitivity[n + 1]
        rows = np.matmul(T, S[:, 6:9]) - np.matmul(R, S[:, :3])
        moved = offset[n + 1] - at.state[n + 1]
        here = model.spots[n, leg] + np.einsum("mij,mj->mi", T, moved[:, 6:9])
        here -= np.einsum("mij,mj->mi", R, moved[:, :3])
        index = self.footing.foothold[n + 1, leg]
        for m in np.flatnonzero(index >= 0):
            column = self.foot_column + 2 * index[m]
            rows[m, :, column : column + 2] += R[m, :, :2] * FOOT_SCALE
            here[m] -= R[m, :, :2] @ at.spots[index[m]]
        swing_rows, swing_low, swing_high = self._swing(at, offset, sensitivity)
        return (
            np.concatenate([rows.reshape(3 * len(n), self.size), swing_rows]),
            np.concatenate([(low[leg] - here).ravel(), swing_low]),
            np.concatenate([(high[leg] - here).ravel(), swing_high]),
        )

    def _swing(self, at: Iterate, offset: Array, sensitivity: Array) -> tuple[Array, Array, Array]:
        """Lifted toes: some point of their boxes has their height.

        The height in the body is linear in where the toe is, so that the corner where it is least
        must not be too high, and that where it is most not too low.
        """
        body = self.task.body
        n, leg = np.nonzero(~self.gait.contact[1:])
        n = n + 1
        height = self.height[n, leg]
        (sr, cr), (sp, cp) = ((np.sin(at.state[n, k]), np.cos(at.state[n, k])) for k in (6, 7))
        down, rise = cr * cp, height - at.state[n, 2]
        picked = np.array([2, 6, 7])
        S = sensitivity[n][:, picked]
        moved = offset[n][:, picked] - at.state[n][:, picked]
        rows, bounds = [], []
        for side in (-1.0, 1.0):  # the corner of least height, then of most
            # Rounded where the tilt changes its sign: any point of the box will do.
            along, across = np.tanh(sp / _ROUNDED), np.tanh(sr / _ROUNDED)
            a = body.toe_center[leg, 0] + side * body.toe_half[0] * along
            b = body.toe_center[leg, 1] - side * body.toe_half[1] * across
            a_turn = side * body.toe_half[0] * (1 - along**2) / _ROUNDED * cp
            b_turn = -side * body.toe_half[1] * (1 - across**2) / _ROUNDED * cr
            depth = (rise + sp * a - sr * cp * b) / down
            gradient = np.column_stack(
                [
                    -1.0 / down,
                    (-cr * cp * b - sr * cp * b_turn + depth * sr * cp) / down,
                    (cp * a + sp * a_turn + sr * sp * b + depth * cr * sp) / down,
                ]
            )
            rows.append(np.einsum("mk,mkz->mz", gradient, S))
            end = body.toe_center[leg, 2] - side * (body.toe_half[2] - self.margin)
            bounds.append(end - depth - (gradient * moved).sum(axis=1))
        far = np.full(len(n), _FAR)
        low, high = np.concatenate([-far, bounds[1]]), np.concatenate([bounds[0], far])
        return np.concatenate(rows), low, high
