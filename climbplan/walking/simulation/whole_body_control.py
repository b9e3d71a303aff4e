"""Whole-body control: joint torques by inverse dynamics, one QP a tick.

The unknowns are accelerations of body and joints and contact forces of standing legs. Constraints:
the robot's dynamics, friction pyramids, and torque limits. The weighted objective tracks the
body's path, swinging toes with less weight, standing toes at rest, and planned forces. The
dynamics are MuJoCo's for the robot of the URDF. The controller does not know what the simulated
world changes (a payload, another friction).
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

BODY_FREQUENCY = 12.0  # [rad/s] of body tracking, critically damped
SWING_FREQUENCY = 60.0  # [rad/s] of swing tracking, critically damped
_POSTURE_FREQUENCY = 8.0  # [rad/s] of redundant joints, critically damped
_STANCE_DAMPING = 60.0  # [1/s] of standing toes
# Weights of squared accelerations. On two legs a lateral deviation can only be reduced by leaning.
# Attitude has therefore less weight than height.
_HORIZONTAL_WEIGHT, _VERTICAL_WEIGHT, _ROTATION_WEIGHT, _SWING_WEIGHT, _STANCE_WEIGHT = (
    10.0,
    50.0,
    20.0,
    5.0,
    50.0,
)
_POSTURE_WEIGHT = 1e-3  # of redundant joints, whose masses move the body
_FORCE_WEIGHT = 20.0  # of squared deviations from planned forces, in robot weights
_REGULARISATION = 1e-4  # of squared accelerations
_MIN_NORMAL_FORCE = 1.0  # [N] of a standing leg
_FACETS = 8
_EQUALITY, _OPTIMAL = 5, 1
_FAR = 1e30
_MAX_ITERATIONS = 500


@dataclass(frozen=True)
class ControlTargets:
    """The targets of one tick, world frame."""

    acceleration: Array  # (3,) of the body's origin [m/s^2]
    angular_acceleration: Array  # (3,) angular [rad/s^2]
    toe_acceleration: Array  # (L, 3) of toes not in contact [m/s^2]
    in_contact: BoolArray  # (L,) legs in contact
    force: Array  # (L, 3) planned [N]
    normal: Array  # (L, 3) of the ground under each toe


@dataclass(frozen=True)
class TorqueCommand:
    """The solution of one tick."""

    torque: Array  # (L J,) [N m]
    force: Array  # (L, 3) predicted contact forces [N]
    is_solved: bool


class WholeBodyController:
    """The inverse-dynamics QP of one robot."""

    def __init__(
        self,
        mujoco: Any,
        model: Any,
        *,
        qpos_index: Array,
        dof_index: Array,
        legs: WalkingLegs,
        friction: float,
        weight: float,
    ) -> None:
        """Prepare the maps between motors and MuJoCo's joints.

        Args:
            mujoco: the module.
            model: model of the robot as the controller knows it.
            qpos_index: (L, J) addresses of joint angles, -1 where there is no joint.
            dof_index: (L, J) addresses of joint speeds.
            legs: joints and their limits.
            friction: friction coefficient.
            weight: weight of the robot [N].
        """
        self.mujoco, self.model, self.data = mujoco, model, mujoco.MjData(model)
        self.qpos_index, self.dof_index = np.asarray(qpos_index, int), np.asarray(dof_index, int)
        self.has_motor = legs.there
        self.joints = self.dof_index[self.has_motor]
        self.posture = legs.chain.posture
        self.limits, self.friction, self.weight = legs.max_torque[self.has_motor], friction, weight
        self.sites = [model.site(f"toe{leg}").id for leg in range(len(dof_index))]
        self.bodies = [int(model.site_bodyid[site]) for site in self.sites]
        self.root = model.body("body").id
        self.size = int(model.nv)
        # All speeds by speeds of motors; equality constraints of joints that mimic others
        self.by_angle = np.zeros((len(self.joints), self.size))
        self.by_angle[np.arange(len(self.joints)), self.joints] = 1.0
        column = np.full(self.has_motor.shape, -1)
        column[self.has_motor] = np.arange(len(self.joints))
        self.ties = np.zeros((int(legs.mimics.sum()), self.size))
        for row, (leg, j) in enumerate(np.argwhere(legs.mimics)):
            drive = legs.chain.drives[leg, j]
            leader = int(np.argmax(np.abs(drive)))
            self.by_angle[column[leg, leader], self.dof_index[leg, j]] = drive[leader]
            self.ties[row, self.dof_index[leg, j]] = 1.0
            self.ties[row, self.dof_index[leg, leader]] = -drive[leader]
        self.previous_command: TorqueCommand | None = None

    def compute_command(self, qpos: Array, qvel: Array, targets: ControlTargets) -> TorqueCommand:
        """Return the torques for a state; those of the previous tick where the QP is infeasible."""
        mujoco, model, data = self.mujoco, self.model, self.data
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        n = self.size
        mass, bias = np.zeros((n, n)), data.qfrc_bias.copy()
        mujoco.mj_fullM(model, data, mass)
        jacobians, drifts = self._compute_toe_jacobians(qvel)
        stance = np.flatnonzero(targets.in_contact)
        unknowns = n + 3 * len(stance)
        contact_map = np.zeros((n, 3 * len(stance)))  # generalised forces by forces of the ground
        for k, leg in enumerate(stance):
            contact_map[:, 3 * k : 3 * k + 3] = jacobians[leg].T
        hessian, gradient = self._build_objective(targets, jacobians, drifts, stance, unknowns)
        dynamics = np.hstack([mass, -contact_map])  # = torques - bias
        motors, motor_bias = self.by_angle @ dynamics, self.by_angle @ bias
        equality_rows = np.hstack([self.ties, np.zeros((len(self.ties), 3 * len(stance)))])
        zeros = np.zeros(len(self.ties))
        rows = [dynamics[:6], motors, equality_rows]
        lower = [-bias[:6], -self.limits - motor_bias, zeros]
        upper = [-bias[:6], self.limits - motor_bias, zeros]
        sense = [_EQUALITY] * 6 + [0] * len(self.joints) + [_EQUALITY] * len(self.ties)
        cones = _build_friction_rows(targets.normal[stance], self.friction)
        cone = np.zeros((cones.shape[0] * cones.shape[1], unknowns))
        for k in range(len(stance)):
            facets = slice(k * cones.shape[1], (k + 1) * cones.shape[1])
            cone[facets, n + 3 * k : n + 3 * k + 3] = cones[k]
        rows.append(cone)
        floor = np.tile([-_FAR] * _FACETS + [_MIN_NORMAL_FORCE], len(stance))
        ceiling = np.tile([0.0] * _FACETS + [_FAR], len(stance))
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
            iter_limit=_MAX_ITERATIONS,
        )
        x = np.asarray(answer)
        if flag != _OPTIMAL or not np.isfinite(x).all():
            torque_before = (
                self.previous_command.torque
                if self.previous_command is not None
                else np.zeros(len(self.joints))
            )
            return TorqueCommand(torque_before, np.zeros((len(self.sites), 3)), False)
        torque = np.clip(motors @ x + motor_bias, -self.limits, self.limits)
        force = np.zeros((len(self.sites), 3))
        force[stance] = x[n:].reshape(-1, 3)
        self.previous_command = TorqueCommand(torque, force, True)
        return self.previous_command

    def _compute_toe_jacobians(self, qvel: Array) -> tuple[list[Array], list[Array]]:
        """Return Jacobians (3, n) of toes and their bias accelerations J' qvel."""
        mujoco, model, data = self.mujoco, self.model, self.data
        jacobians, drifts = [], []
        for site, body in zip(self.sites, self.bodies, strict=True):
            jacobian, rate = np.zeros((3, self.size)), np.zeros((3, self.size))
            point = data.site_xpos[site]
            mujoco.mj_jac(model, data, jacobian, None, point, body)
            mujoco.mj_jacDot(model, data, rate, None, point, body)
            jacobians.append(jacobian)
            drifts.append(rate @ qvel)
        return jacobians, drifts

    def _build_posture_tasks(
        self, jacobians: list[Array], unknowns: int
    ) -> Iterator[tuple[Array, Array, float]]:
        """Yield nullspace tasks that move redundant legs to their posture."""
        data = self.data
        for leg, has_motor in enumerate(self.has_motor):
            dofs = self.dof_index[leg][has_motor]
            if len(dofs) <= 3:
                continue
            by_joint = (jacobians[leg] @ self.by_angle.T)[:, np.isin(self.joints, dofs)]
            nullspace = np.eye(len(dofs)) - np.linalg.pinv(by_joint) @ by_joint
            offset = self.posture[leg][has_motor] - data.qpos[self.qpos_index[leg][has_motor]]
            speed = data.qvel[dofs]
            rows = np.zeros((len(dofs), unknowns))
            rows[:, dofs] = nullspace
            yield (
                rows,
                nullspace @ (_POSTURE_FREQUENCY**2 * offset - 2 * _POSTURE_FREQUENCY * speed),
                _POSTURE_WEIGHT,
            )

    def _build_objective(
        self,
        targets: ControlTargets,
        jacobians: list[Array],
        drifts: list[Array],
        stance: IntArray,
        unknowns: int,
    ) -> tuple[Array, Array]:
        """Return Hessian and gradient of the weighted task errors."""
        n = self.size
        tasks: list[tuple[Array, Array, float]] = []
        body = np.zeros((3, unknowns))
        body[:, :3] = np.eye(3)
        tasks.append((body[:2], targets.acceleration[:2], _HORIZONTAL_WEIGHT))
        tasks.append((body[2:], targets.acceleration[2:], _VERTICAL_WEIGHT))
        turn = np.zeros((3, unknowns))
        turn[:, 3:6] = self.data.xmat[self.root].reshape(3, 3)  # MuJoCo's is in the body frame
        tasks.append((turn, targets.angular_acceleration, _ROTATION_WEIGHT))
        for leg in range(len(self.sites)):
            toe = np.zeros((3, unknowns))
            toe[:, :n] = jacobians[leg]
            if targets.in_contact[leg]:
                speed = jacobians[leg] @ self.data.qvel
                tasks.append((toe, -_STANCE_DAMPING * speed - drifts[leg], _STANCE_WEIGHT))
            else:
                tasks.append((toe, targets.toe_acceleration[leg] - drifts[leg], _SWING_WEIGHT))
        tasks += self._build_posture_tasks(jacobians, unknowns)
        hessian = np.zeros((unknowns, unknowns))
        gradient = np.zeros(unknowns)
        for rows, target, weight in tasks:
            hessian += weight * rows.T @ rows
            gradient -= weight * rows.T @ target
        hessian[np.arange(n), np.arange(n)] += _REGULARISATION
        force = _FORCE_WEIGHT / self.weight**2
        force_index = np.arange(n, unknowns)
        hessian[force_index, force_index] += force
        gradient[n:] -= force * targets.force[stance].ravel()
        return hessian, gradient


def _build_friction_rows(normal: Array, friction: float) -> Array:
    """Return rows (S, F + 1, 3): facets of friction pyramids about normals (S, 3), and normals."""
    angle = 2 * np.pi * (np.arange(_FACETS) + 0.5) / _FACETS
    slope = friction * np.cos(np.pi / _FACETS)
    rows = np.empty((len(normal), _FACETS + 1, 3))
    for k, up in enumerate(normal):
        across = skew(up) @ np.array([1.0, 0.0, 0.0])
        across = across / np.linalg.norm(across)
        along = np.cross(across, up)
        rows[k, :_FACETS] = (
            np.cos(angle)[:, None] * along + np.sin(angle)[:, None] * across - slope * up
        )
        rows[k, _FACETS] = up
    return rows
