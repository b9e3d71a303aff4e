"""Replay of a walk in MuJoCo with the whole robot: links with mass, joints with limited torque.

At each tick of 2 ms the true state is read, a QP of the robot's dynamics (`whole_body_control.py`)
gives torques that track the plan, and MuJoCo integrates. A leg in planned stance without contact
reaches down. A toe that touches late in its swing carries load at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.simulation.conditions import NOMINAL, Conditions
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.walking.check.reference_dynamics import transform_toes_to_body
from climbplan.walking.online.estimation import logarithm
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.mujoco_model import TIME_STEP
from climbplan.walking.simulation.replay import (
    WalkRun,
    apply_contact_losses,
    build_empty_record,
    compute_euler_angles,
    measure_ground_forces,
)
from climbplan.walking.simulation.whole_body_control import (
    BODY_FREQUENCY,
    SWING_FREQUENCY,
    ControlTargets,
    TorqueCommand,
    WholeBodyController,
)
from climbplan.walking.simulation.whole_body_model import (
    WholeBodyRobot,
    build_whole_body_mjcf,
    build_whole_body_robot,
)
from climbplan.walking.simulation.whole_body_reference import WholeBodyReference
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY

STEPS_PER_TICK = 2  # steps of the simulation
PUSH_DURATION = 0.05  # [s] of a push, as a force on the body
_POSITION_FREQUENCY = 5.0  # [rad/s] of horizontal position tracking
_MAX_HORIZONTAL_FEEDBACK = 2.5  # [m/s^2] in addition to the planned acceleration
_CONTACT_HOLD = 0.015  # [s] after its last contact for which a toe counts as standing
_EARLY_CONTACT_FRACTION = 0.6  # of a swing, after which a touching toe carries load
_CONTACT_SEARCH_VELOCITY = -0.4  # [m/s] of a toe in planned stance without contact
_CONTACT_SEARCH_GAIN = 60.0  # [1/s]
_MAX_TILT = 1.0  # [rad]
_MIN_HEIGHT_FRACTION = 0.5  # of the standing height


@dataclass(frozen=True)
class BodyPush:
    """A push of the body."""

    time: float  # [s]
    velocity: Array  # (3,) velocity jump of the whole robot with the same momentum [m/s]


@dataclass(frozen=True)
class WholeBodyRun(WalkRun):
    """A simulation of the whole robot; maxima are until the next sample."""

    torque: Array  # (S, L, J) largest fraction of the torque limit
    speed: Array  # (S, L, J) largest fraction of the speed limit
    num_unsolved: int  # ticks whose QP was infeasible
    pushes: tuple[BodyPush, ...]
    num_ticks: int


def simulate_whole_body(
    plan: WalkPlan,
    conditions: Conditions,
    pushes: tuple[BodyPush, ...] = (),
    progress: Callable[[float], None] | None = None,
    watch: Callable[[int, Any, Any], None] | None = None,
) -> WholeBodyRun:
    """Simulate a plan of a robot from a URDF.

    Args:
        plan: the walk.
        conditions: of the simulation.
        pushes: in addition to those of the plan.
        progress: receives the fraction that is done.
        watch: called with sample, model and data at every sample, for pictures.

    Raises:
        MissingSolver: MuJoCo or Pinocchio is not installed.
        UsageError: a robot without links.
    """
    return _WholeBodyReplay(plan, conditions, pushes).replay(progress, watch)


class _WholeBodyReplay:
    """The replay of one walk with the whole robot."""

    def __init__(
        self, plan: WalkPlan, conditions: Conditions, pushes: tuple[BodyPush, ...]
    ) -> None:
        assert plan.task.legs is not None
        self.mujoco = load_mujoco()
        self.plan, self.conditions, self.legs = plan, conditions, plan.task.legs
        robot: WholeBodyRobot = build_whole_body_robot(plan, conditions)
        self.centre, self.mass = robot.centre, robot.mass
        self.foot = robot.urdf_model.robot.spec.foot_radius
        nominal = vars(conditions) | {"payload": 0.0, "armature": 1.0, "armature_value": None}
        nominal_robot = (
            robot if nominal == vars(conditions) else build_whole_body_robot(plan, NOMINAL)
        )
        make = self.mujoco.MjModel.from_xml_string
        self.model = make(build_whole_body_mjcf(plan, robot, conditions))
        self.data = self.mujoco.MjData(self.model)
        self.reference = WholeBodyReference(plan, self.foot)
        self.has_motor = self.legs.there
        self.qpos_index = np.full(self.has_motor.shape, -1)
        self.dof_index = self.qpos_index.copy()
        for leg, j in np.argwhere(self.has_motor | self.legs.mimics):
            hinge = self.model.joint(f"{leg}_{j}")
            self.qpos_index[leg, j], self.dof_index[leg, j] = hinge.qposadr[0], hinge.dofadr[0]
        self.control = WholeBodyController(
            self.mujoco,
            make(build_whole_body_mjcf(plan, nominal_robot, NOMINAL)),
            qpos_index=self.qpos_index,
            dof_index=self.dof_index,
            legs=self.legs,
            friction=plan.task.ground.min_friction,
            weight=plan.task.weight,
        )
        self.root = self.model.body("body").id
        self.sites = [self.model.site(f"toe{leg}").id for leg in range(plan.task.body.leg_count)]
        self.toe_geom = np.array(
            [self.model.geom(f"toe{leg}").id for leg in range(plan.task.body.leg_count)]
        )
        self.leg_of_geom = np.full(self.model.ngeom, -1)
        self.leg_of_geom[self.toe_geom] = np.arange(plan.task.body.leg_count)
        planned = plan.loop.push if plan.loop is not None else np.zeros((0, 3))
        recorded = [
            BodyPush(float(self.reference.time[n]), planned[n])
            for n in range(1, len(planned))
            if planned[n].any()
        ]
        self.pushes = (*recorded, *pushes)
        self.height = -float(plan.task.body.toe_center[:, 2].mean())
        self.last_contact = np.full(plan.task.body.leg_count, -np.inf)  # [s] of each toe
        self.torque = np.zeros_like(self.legs.max_torque)
        self.command: TorqueCommand | None = None
        self.num_unsolved = self.num_ticks = 0

    def replay(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
    ) -> WholeBodyRun:
        """Simulate all intervals, up to the end or a fall."""
        time, rows, has_fallen = self.reference.time, [], False
        self._initialise_state()
        for sample in range(len(time)):
            row = self._read_state()
            if watch is not None:
                watch(sample, self.model, self.data)
            has_fallen = self._has_fallen(row)
            last = sample + 1 == len(time) or has_fallen
            rows.append(
                row | (_build_empty_record(self.legs) if last else self._simulate_interval(sample))
            )
            if progress is not None:
                progress((sample + 1) / len(time))
            if has_fallen:
                break
        stacked = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return WholeBodyRun(
            conditions=self.conditions,
            feedback=True,
            time=time[: len(rows)],
            fallen=has_fallen,
            foot=self.foot,
            num_unsolved=self.num_unsolved,
            pushes=self.pushes,
            num_ticks=self.num_ticks,
            **stacked,
        )

    def _initialise_state(self) -> None:
        """Set the plan's first state; joint speeds keep standing toes at rest."""
        state, toes = self.plan.trajectory.state[0], self.plan.trajectory.toes[0]
        rotation, data, legs = rotation_world_body(state[ANGLES]), self.data, self.legs
        spots = transform_toes_to_body(state, toes)
        angles = legs.chain.inverse(spots, legs.lower, legs.upper).best()
        angles = np.where(np.isfinite(angles), angles, legs.chain.posture)
        data.qpos[:3] = state[POSITION] - rotation @ self.centre
        quat = np.empty(4)
        self.mujoco.mju_mat2Quat(quat, rotation.ravel())
        data.qpos[3:7] = quat
        has_joint, drives = self.has_motor | legs.mimics, legs.chain.drives
        data.qpos[self.qpos_index[has_joint]] = (drives @ angles[..., None])[..., 0][has_joint]
        angular_velocity = rotation.T @ state[SPIN]
        linear_velocity = rotation.T @ state[VELOCITY]
        data.qvel[:3] = state[VELOCITY] - rotation @ np.cross(angular_velocity, self.centre)
        data.qvel[3:6] = angular_velocity
        toe_velocity = -(linear_velocity + np.cross(angular_velocity, spots))  # (L, 3) body frame
        jacobian = legs.chain.jacobian(angles)
        speed = (np.linalg.pinv(jacobian) @ toe_velocity[..., None])[..., 0]
        data.qvel[self.dof_index[has_joint]] = (drives @ speed[..., None])[..., 0][has_joint]
        self.mujoco.mj_forward(self.model, data)

    def _simulate_interval(self, sample: int) -> dict[str, Any]:
        """Simulate up to the next sample and return means and maxima over the interval."""
        begin, end = self.reference.time[sample], self.reference.time[sample + 1]
        steps = max(round((end - begin) / TIME_STEP), 1)
        contact = np.asarray(self.reference.contact[sample], bool)
        planned = self.reference.select_planned_force(sample)
        total = _build_empty_record(self.legs)
        for step in range(steps):
            now = begin + step * (end - begin) / steps
            apply_contact_losses(self.model, self.toe_geom, self.conditions, now)
            if round(now / TIME_STEP) % STEPS_PER_TICK == 0 or self.command is None:
                self._update_torques(sample, now, contact, planned)
            self._apply_pushes(now)
            self.data.qfrc_applied[self.dof_index[self.has_motor]] = self.torque[self.has_motor]
            self.mujoco.mj_step(self.model, self.data)
            force, pressure, shear = measure_ground_forces(
                self.mujoco, self.model, self.data, self.leg_of_geom
            )
            self.last_contact[pressure > 0] = now + TIME_STEP
            total["force"] += force / steps
            total["pressure"] += pressure / steps
            total["shear"] += shear / steps
            total["touching"] += (pressure > 0) / steps
            assert self.command is not None
            total["correction"] += (self.command.force - planned) / steps
            violation = self._compute_reach_violation()[contact]
            total["overreach"] = max(total["overreach"], float(violation.max(initial=0.0)))
            torque_fraction = np.abs(self.torque) / self.legs.max_torque
            total["torque"] = np.maximum(total["torque"], torque_fraction)
            speed_fraction = (
                np.where(self.has_motor, np.abs(self.data.qvel[self.dof_index]), 0)
                / self.legs.max_speed
            )
            total["speed"] = np.maximum(total["speed"], speed_fraction)
        return total

    def _update_torques(self, sample: int, now: float, contact: BoolArray, planned: Array) -> None:
        """Compute the torques until the next tick."""
        data, reference = self.data, self.reference.interpolate_body(now)
        rotation = data.xmat[self.root].reshape(3, 3)
        angular_velocity = rotation @ data.qvel[3:6]
        arm = rotation @ self.centre
        position, velocity = data.qpos[:3] + arm, data.qvel[:3] + np.cross(angular_velocity, arm)
        position_error, velocity_error = (
            reference.position - position,
            reference.velocity - velocity,
        )
        frequency = np.array([_POSITION_FREQUENCY, _POSITION_FREQUENCY, BODY_FREQUENCY])
        feedback = frequency**2 * position_error + 2 * frequency * velocity_error
        horizontal = float(np.linalg.norm(feedback[:2]))
        feedback[:2] *= min(1.0, _MAX_HORIZONTAL_FEEDBACK / max(horizontal, 1e-9))
        rotation_error = logarithm(reference.rotation @ rotation.T)
        angular_acceleration = (
            reference.angular_acceleration
            + BODY_FREQUENCY**2 * rotation_error
            + 2 * BODY_FREQUENCY * (reference.angular_velocity - angular_velocity)
        )
        # The QP's body acceleration is that of the root body's origin.
        origin_acceleration = np.cross(reference.angular_acceleration, arm) + np.cross(
            angular_velocity, np.cross(angular_velocity, arm)
        )
        capture = -(position_error + self.reference.pendulum * velocity_error)
        toes = data.site_xpos[self.sites]
        toe_acceleration, in_contact = self._plan_toes(now, contact, toes, capture)
        self.command = self.control.compute_command(
            data.qpos, data.qvel,
            ControlTargets(
                acceleration=reference.acceleration + feedback - origin_acceleration,
                angular_acceleration=angular_acceleration,
                toe_acceleration=toe_acceleration,
                in_contact=in_contact,
                force=np.where(in_contact[:, None], planned, 0.0),
                normal=self.reference.normal[sample],
            ),
        )  # fmt: skip
        self.num_ticks += 1
        self.num_unsolved += not self.command.is_solved
        self.torque[self.has_motor] = self.command.torque

    def _plan_toes(
        self, now: float, contact: BoolArray, toes: Array, capture: Array
    ) -> tuple[Array, BoolArray]:
        """Return accelerations (L, 3) of toes not in contact, and the contact mask (L,)."""
        acceleration, in_contact = np.zeros_like(toes), np.zeros_like(contact)
        speeds = self._compute_toe_velocities()
        for leg in range(len(contact)):
            touches = now - self.last_contact[leg] <= _CONTACT_HOLD or now == 0.0
            if contact[leg]:
                self.reference.mark_touchdown(leg)
                in_contact[leg] = touches
                acceleration[leg] = _CONTACT_SEARCH_GAIN * (
                    np.array([0.0, 0.0, _CONTACT_SEARCH_VELOCITY]) - speeds[leg]
                )
                continue
            swing = self.reference.compute_swing(leg, now, toes[leg], capture)
            in_contact[leg] = touches and swing.fraction > _EARLY_CONTACT_FRACTION
            feedback = SWING_FREQUENCY**2 * (swing.position - toes[leg])
            feedback += 2 * SWING_FREQUENCY * (swing.velocity - speeds[leg])
            acceleration[leg] = swing.acceleration + feedback
        return acceleration, in_contact

    def _compute_toe_velocities(self) -> Array:
        """Return the velocities (L, 3) of toes, world frame [m/s]."""
        velocities, jacobian = np.zeros((len(self.sites), 3)), np.zeros((3, self.model.nv))
        for leg, site in enumerate(self.sites):
            self.mujoco.mj_jacSite(self.model, self.data, jacobian, None, site)
            velocities[leg] = jacobian @ self.data.qvel
        return velocities

    def _apply_pushes(self, now: float) -> None:
        """Apply the pushes of a time as forces on the body."""
        force = np.zeros(3)
        for push in self.pushes:
            if push.time <= now < push.time + PUSH_DURATION:
                force += self.mass * push.velocity / PUSH_DURATION
        self.data.xfrc_applied[self.root, :3] = force

    def _compute_reach_violation(self) -> Array:
        """Return how far toes (L,) are outside their workspace boxes [m], <= 0 inside."""
        body, data = self.plan.task.body, self.data
        rotation = data.xmat[self.root].reshape(3, 3)
        spots = (data.site_xpos[self.sites] - data.qpos[:3]) @ rotation - self.centre
        return np.asarray((np.abs(spots - body.toe_center) - body.toe_half).max(axis=1))

    def _has_fallen(self, row: dict[str, Any]) -> bool:
        """Return whether the body is tipped over, too low, or has diverged."""
        roll, pitch, _ = compute_euler_angles(row["rotation"])
        is_low = row["com"][2] - row["toes"][:, 2].min() < _MIN_HEIGHT_FRACTION * self.height
        return bool(
            max(abs(roll), abs(pitch)) > _MAX_TILT or is_low or not np.isfinite(row["com"]).all()
        )

    def _read_state(self) -> dict[str, Any]:
        """Return centre of mass, rotation, velocity, toes and links."""
        data = self.data
        rotation = data.xmat[self.root].reshape(3, 3).copy()
        arm = rotation @ self.centre
        return {
            "com": data.qpos[:3] + arm,
            "rotation": rotation,
            "velocity": data.qvel[:3] + np.cross(rotation @ data.qvel[3:6], arm),
            "toes": data.site_xpos[self.sites].copy(),
            "links": data.site_xmat[self.sites].reshape(-1, 3, 3).copy(),
        }


def _build_empty_record(legs: WalkingLegs) -> dict[str, Any]:
    """Return the record of legs for an interval that has not begun."""
    zeros = np.zeros_like(legs.max_torque)
    return build_empty_record(len(zeros)) | {"torque": zeros, "speed": zeros.copy()}
