"""Joint torques that move the whole robot as a plan asks: inverse dynamics as one QP a tick.

Unknowns are accelerations of all joints and of the body, and forces of the legs that stand. The
robot's dynamics hold exactly, forces stay in friction cones, torques within the motors' limits;
within these the body follows its path before swinging toes follow theirs, standing toes stay, and
forces stay near the planned ones. Dynamics are MuJoCo's, of the robot as its URDF has it: what the
simulated world adds (a payload, another friction) is not known here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.rotations import skew
from climbplan.robots.walking_legs import WalkingLegs

BODY_STIFF = 12.0  # [rad/s] of the body's way back to its path, critically damped
SWING_STIFF = 60.0  # [rad/s] of a swinging toe's, critically damped
_BEND_STIFF = 8.0  # [rad/s] of joints that no toe needs, likewise
_STAND_DAMPING = 60.0  # [1/s] of what speed a standing toe has
# Weights of squared accelerations. On two legs a body that is off its path aside can only be slowed
# down by leaning: it leans a little. Where it was to keep upright first twice as many toes
# slid, and bodies were further off their paths.
_LEVEL, _UP, _TURN, _SWING, _STAND = 10.0, 50.0, 20.0, 5.0, 50.0
_BEND = 1e-3  # of joints that no toe needs: their masses move the body
_FORCE = 20.0  # of squared departures from planned forces, in robot's weights
_CALM = 1e-4  # of squared joint accelerations
_LEAST = 1.0  # [N] pressure of a leg that stands
_FACETS = 8
_EQUAL, _SOLVED = 5, 1
_FAR = 1e30
_MOST_STEPS = 500


@dataclass(frozen=True)
class Wanted:
    """What the next moment is to be like, world frame."""

    acceleration: Array  # (3,) of the body's origin [m/s^2]
    turning: Array  # (3,) angular [rad/s^2]
    toes: Array  # (L, 3) accelerations of toes that do not carry [m/s^2]
    carries: BoolArray  # (L,) legs whose toes stand on the ground
    force: Array  # (L, 3) planned [N]
    normal: Array  # (L, 3) of the ground under each toe


@dataclass(frozen=True)
class Commanded:
    """A tick's answer."""

    torque: Array  # (L J,) [N m]
    force: Array  # (L, 3) that it counts on [N]
    solved: bool


class WholeBodyControl:
    """The QP of one robot.

    `at`, `dof`: (L, J) addresses of angles and speeds in MuJoCo's model, of joints that are there.
    """

    def __init__(
        self,
        mujoco: Any,
        model: Any,
        at: Array,
        dof: Array,
        legs: WalkingLegs,
        friction: float,
        weight: float,
    ) -> None:
        self.mujoco, self.model, self.data = mujoco, model, mujoco.MjData(model)
        self.at, self.dof = np.asarray(at, int), np.asarray(dof, int)
        self.there = legs.there
        self.joints = self.dof[self.there]
        self.posture = legs.chain.posture
        self.limits, self.friction, self.weight = legs.max_torque[self.there], friction, weight
        self.sites = [model.site(f"toe{leg}").id for leg in range(len(dof))]
        self.bodies = [int(model.site_bodyid[site]) for site in self.sites]
        self.root = model.body("body").id
        self.size = int(model.nv)
        # Speeds by those of angles, of joints that have some; what holds joints that mimic others
        self.by_angle = np.zeros((len(self.joints), self.size))
        self.by_angle[np.arange(len(self.joints)), self.joints] = 1.0
        column = np.full(self.there.shape, -1)
        column[self.there] = np.arange(len(self.joints))
        self.ties = np.zeros((int(legs.mimics.sum()), self.size))
        for row, (leg, j) in enumerate(np.argwhere(legs.mimics)):
            drive = legs.chain.drives[leg, j]
            leader = int(np.argmax(np.abs(drive)))
            self.by_angle[column[leg, leader], self.dof[leg, j]] = drive[leader]
            self.ties[row, self.dof[leg, j]] = 1.0
            self.ties[row, self.dof[leg, leader]] = -drive[leader]
        self.before: Commanded | None = None

    def command(self, qpos: Array, qvel: Array, wanted: Wanted) -> Commanded:
        """Torques for a state of the robot; those of the tick before where the QP has no answer."""
        mujoco, model, data = self.mujoco, self.model, self.data
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        n = self.size
        mass, bias = np.zeros((n, n)), data.qfrc_bias.copy()
        mujoco.mj_fullM(model, data, mass)
        jacobians, drifts = self._toes(qvel)
        stands = np.flatnonzero(wanted.carries)
        unknowns = n + 3 * len(stands)
        pushes = np.zeros((n, 3 * len(stands)))  # generalised forces by forces of the ground
        for k, leg in enumerate(stands):
            pushes[:, 3 * k : 3 * k + 3] = jacobians[leg].T
        hessian, gradient = self._costs(wanted, jacobians, drifts, stands, unknowns)
        dynamics = np.hstack([mass, -pushes])  # = torques - bias
        motors, held = self.by_angle @ dynamics, self.by_angle @ bias
        tied = np.hstack([self.ties, np.zeros((len(self.ties), 3 * len(stands)))])
        none = np.zeros(len(self.ties))
        rows = [dynamics[:6], motors, tied]
        lower = [-bias[:6], -self.limits - held, none]
        upper = [-bias[:6], self.limits - held, none]
        sense = [_EQUAL] * 6 + [0] * len(self.joints) + [_EQUAL] * len(self.ties)
        cones = _cones(wanted.normal[stands], self.friction)
        cone = np.zeros((cones.shape[0] * cones.shape[1], unknowns))
        for k in range(len(stands)):
            part = slice(k * cones.shape[1], (k + 1) * cones.shape[1])
            cone[part, n + 3 * k : n + 3 * k + 3] = cones[k]
        rows.append(cone)
        floor = np.tile([-_FAR] * _FACETS + [_LEAST], len(stands))
        ceiling = np.tile([0.0] * _FACETS + [_FAR], len(stands))
        lower.append(floor)
        upper.append(ceiling)
        sense += [0] * len(cone)
        answer, _, flag, _ = daqp.solve(
            hessian,
            gradient,
            np.vstack(rows),
            np.concatenate(upper),
            np.concatenate(lower),
            np.array(sense, np.int32),
            iter_limit=_MOST_STEPS,
        )
        x = np.asarray(answer)
        if flag != _SOLVED or not np.isfinite(x).all():
            kept = self.before.torque if self.before is not None else np.zeros(len(self.joints))
            return Commanded(kept, np.zeros((len(self.sites), 3)), False)
        torque = np.clip(motors @ x + held, -self.limits, self.limits)
        force = np.zeros((len(self.sites), 3))
        force[stands] = x[n:].reshape(-1, 3)
        self.before = Commanded(torque, force, True)
        return self.before

    def _toes(self, qvel: Array) -> tuple[list[Array], list[Array]]:
        """Jacobians (3, n) of toes and what their accelerations are beside J qacc."""
        mujoco, model, data = self.mujoco, self.model, self.data
        jacobians, drifts = [], []
        for site, body in zip(self.sites, self.bodies, strict=True):
            own, rate = np.zeros((3, self.size)), np.zeros((3, self.size))
            point = data.site_xpos[site]
            mujoco.mj_jac(model, data, own, None, point, body)
            mujoco.mj_jacDot(model, data, rate, None, point, body)
            jacobians.append(own)
            drifts.append(rate @ qvel)
        return jacobians, drifts

    def _bends(self, jacobians: list[Array], unknowns: int) -> Iterator[tuple[Array, Array, float]]:
        """Of legs of more than three joints: what moves no toe goes back to the posture."""
        data = self.data
        for leg, there in enumerate(self.there):
            own = self.dof[leg][there]
            if len(own) <= 3:
                continue
            by_joint = (jacobians[leg] @ self.by_angle.T)[:, np.isin(self.joints, own)]
            free = np.eye(len(own)) - np.linalg.pinv(by_joint) @ by_joint
            off = self.posture[leg][there] - data.qpos[self.at[leg][there]]
            speed = data.qvel[own]
            rows = np.zeros((len(own), unknowns))
            rows[:, own] = free
            yield rows, free @ (_BEND_STIFF**2 * off - 2 * _BEND_STIFF * speed), _BEND

    def _costs(
        self,
        wanted: Wanted,
        jacobians: list[Array],
        drifts: list[Array],
        stands: IntArray,
        unknowns: int,
    ) -> tuple[Array, Array]:
        """Hessian and gradient of weighted squares."""
        n = self.size
        tasks: list[tuple[Array, Array, float]] = []
        body = np.zeros((3, unknowns))
        body[:, :3] = np.eye(3)
        tasks.append((body[:2], wanted.acceleration[:2], _LEVEL))
        tasks.append((body[2:], wanted.acceleration[2:], _UP))
        turn = np.zeros((3, unknowns))
        turn[:, 3:6] = self.data.xmat[self.root].reshape(3, 3)  # MuJoCo's is in the body's frame
        tasks.append((turn, wanted.turning, _TURN))
        for leg in range(len(self.sites)):
            toe = np.zeros((3, unknowns))
            toe[:, :n] = jacobians[leg]
            if wanted.carries[leg]:
                speed = jacobians[leg] @ self.data.qvel
                tasks.append((toe, -_STAND_DAMPING * speed - drifts[leg], _STAND))
            else:
                tasks.append((toe, wanted.toes[leg] - drifts[leg], _SWING))
        tasks += self._bends(jacobians, unknowns)
        hessian = np.zeros((unknowns, unknowns))
        gradient = np.zeros(unknowns)
        for rows, target, weight in tasks:
            hessian += weight * rows.T @ rows
            gradient -= weight * rows.T @ target
        hessian[np.arange(n), np.arange(n)] += _CALM
        force = _FORCE / self.weight**2
        at = np.arange(n, unknowns)
        hessian[at, at] += force
        gradient[n:] -= force * wanted.force[stands].ravel()
        return hessian, gradient


def _cones(normal: Array, friction: float) -> Array:
    """Rows (S, F + 1, 3): facets of pyramids inside the cones about normals (S, 3), and normals."""
    angle = 2 * np.pi * (np.arange(_FACETS) + 0.5) / _FACETS
    slope = friction * np.cos(np.pi / _FACETS)
    out = np.empty((len(normal), _FACETS + 1, 3))
    for k, up in enumerate(normal):
        across = skew(up) @ np.array([1.0, 0.0, 0.0])
        across = across / np.linalg.norm(across)
        along = np.cross(across, up)
        out[k, :_FACETS] = (
            np.cos(angle)[:, None] * along + np.sin(angle)[:, None] * across - slope * up
        )
        out[k, _FACETS] = up
    return out
