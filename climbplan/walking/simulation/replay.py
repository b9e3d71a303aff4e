"""Replay of a walk in MuJoCo: planned contact forces act on a rigid body and on feet with friction.

Under open-loop forces errors of position grow with time. A feedback law therefore corrects the
forces for deviations from the reference, within the friction that the plan assumes. The
corrections
are recorded: they measure the error of the plan. Without `feedback` forces are as planned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.walking.online.closed_loop import has_fallen as lies_down
from climbplan.walking.online.estimation import logarithm
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.mujoco_model import (
    TIME_STEP,
    TOE_MASS,
    TOE_RADIUS,
    build_walk_mjcf,
)
from climbplan.walking.simulation.walk_reference import WalkReference, build_walk_reference
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY

FEEDBACK_FREQUENCY = 10.0  # [rad/s] natural frequency, critically damped
MAX_REACH_VIOLATION = 0.25  # [m] outside its workspace at which a leg exerts no force
_SWING_FREQUENCY = 120.0  # [rad/s] of swinging toes, critically damped
_STANCE_DAMPING = 2.0  # [N s/m] of a toe in contact
_REGULARISATION = 1e-3  # relative weight of the corrections
_MAX_DEVIATION = 0.15  # [m] from the reference that counts as a fall


@dataclass(frozen=True)
class WalkRun:
    """A simulated walk at S of the T samples of the plan, up to the end or a fall."""

    conditions: Conditions
    feedback: bool
    time: Array  # (S,) [s]
    com: Array  # (S, 3) [m]
    rotation: Array  # (S, 3, 3) body to world
    velocity: Array  # (S, 3) [m/s]
    toes: Array  # (S, L, 3) [m]
    force: Array  # (S, L, 3) contact force on toes, mean until the next sample [N]
    pressure: Array  # (S, L) normal force likewise [N]
    shear: Array  # (S, L) [N]
    touching: Array  # (S, L) fraction of the time until the next sample
    correction: Array  # (S, L, 3) added to the planned force, mean likewise [N]
    overreach: Array  # (S,) largest workspace violation of a standing toe [m]
    fallen: bool
    links: Array | None  # (S, L, 3, 3) rotations of the toes' links; None: a rigid body
    foot: float  # radius of spherical feet, zero of point toes [m]

    @property
    def samples(self) -> int:
        """Number S of samples."""
        return len(self.time)


def simulate_walk(
    plan: WalkPlan,
    conditions: Conditions,
    *,
    feedback: bool = True,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[int, Any, Any], None] | None = None,
) -> WalkRun:
    """Simulate a plan as one rigid body.

    Args:
        plan: the walk.
        conditions: of the simulation.
        feedback: correct forces for deviations from the reference.
        progress: receives the fraction that is done.
        watch: called with sample, model and data at every sample, for pictures.

    Raises:
        MissingSolver: MuJoCo is not installed.
    """
    mujoco = load_mujoco()
    model = mujoco.MjModel.from_xml_string(build_walk_mjcf(plan, conditions))
    walker = _WalkReplay(mujoco, model, mujoco.MjData(model), plan, conditions, feedback)
    return walker.replay(progress, watch)


class _WalkReplay:
    """The replay of one walk."""

    def __init__(
        self,
        mujoco: ModuleType,
        model: Any,
        data: Any,
        plan: WalkPlan,
        conditions: Conditions,
        feedback: bool,
    ) -> None:
        self.mujoco, self.model, self.data = mujoco, model, data
        self.plan, self.conditions, self.feedback = plan, conditions, feedback
        self.reference: WalkReference = build_walk_reference(plan)
        self.body = model.body("body").id
        legs = plan.task.body.leg_count
        self.toe_geom = np.array([model.geom(f"toe{leg}").id for leg in range(legs)])
        self.leg_of_geom = np.full(model.ngeom, -1)
        self.leg_of_geom[self.toe_geom] = np.arange(legs)
        slide = [[model.joint(f"toe{leg}{axis}") for axis in "xyz"] for leg in range(legs)]
        self.qpos_index = np.array([[joint.qposadr[0] for joint in row] for row in slide])
        self.dof_index = np.array([[joint.dofadr[0] for joint in row] for row in slide])

    def replay(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
    ) -> WalkRun:
        """Simulate all intervals, up to the end or a fall."""
        reference, plan = self.reference, self.plan
        self._initialise_state()
        rows: list[dict[str, Any]] = []
        has_fallen = False
        pushes = plan.loop.push if plan.loop is not None else None
        for sample, start in enumerate(reference.time):
            if pushes is not None and sample:
                self.data.qvel[:3] += pushes[sample]
            row = self._read_state()
            if watch is not None:
                watch(sample, self.model, self.data)
            last = sample + 1 == len(reference.time)
            rows.append(
                row
                | (
                    build_empty_record(plan.task.body.leg_count)
                    if last
                    else self._simulate_interval(sample)
                )
            )
            if progress is not None:
                progress((sample + 1) / len(reference.time))
            state = np.concatenate(
                [row["com"], row["velocity"], compute_euler_angles(row["rotation"]), np.zeros(3)]
            )
            deviation = float(np.linalg.norm(row["com"] - reference.state[sample, POSITION]))
            if (
                lies_down(plan.task.body, state, row["toes"])
                or (self.feedback and deviation > _MAX_DEVIATION)
                or not np.isfinite(start)
            ):
                has_fallen = True
                break
        stacked = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return WalkRun(
            conditions=self.conditions,
            feedback=self.feedback,
            time=reference.time[: len(rows)],
            fallen=has_fallen,
            links=None,
            foot=0.0,
            **stacked,
        )

    def _initialise_state(self) -> None:
        """Set body and toes to the plan's first state."""
        start, data = self.reference.state[0], self.data
        rotation = self.reference.rotation[0]
        data.qpos[:3] = start[POSITION]
        quat = np.empty(4)
        self.mujoco.mju_mat2Quat(quat, rotation.ravel())
        data.qpos[3:7] = quat
        data.qvel[:3] = start[VELOCITY]
        data.qvel[3:6] = rotation.T @ start[SPIN]  # MuJoCo has it in the body frame
        data.qpos[self.qpos_index] = self.plan.trajectory.toes[0] + [0, 0, TOE_RADIUS]
        self.mujoco.mj_forward(self.model, data)

    def _simulate_interval(self, sample: int) -> dict[str, Any]:
        """Simulate up to the next sample and return means over the interval."""
        reference, data = self.reference, self.data
        begin, end = reference.time[sample], reference.time[sample + 1]
        steps = max(round((end - begin) / TIME_STEP), 1)
        contact = reference.contact[sample]
        planned = np.where(contact[:, None], self.plan.trajectory.force[sample], 0.0)
        apply_contact_losses(self.model, self.toe_geom, self.conditions, begin)
        total = build_empty_record(len(self.toe_geom))
        for step in range(steps):
            fraction = (step + 0.5) / steps
            reachable = self._compute_reach_violation() <= MAX_REACH_VIOLATION
            leg_force = planned * reachable[:, None]
            if self.feedback:
                leg_force = self._correct_forces(sample, fraction, leg_force, contact & reachable)
            self._apply_forces(leg_force, contact, begin + fraction * (end - begin))
            self.mujoco.mj_step(self.model, data)
            force, pressure, shear = measure_ground_forces(
                self.mujoco, self.model, data, self.leg_of_geom
            )
            total["force"] += force / steps
            total["pressure"] += pressure / steps
            total["shear"] += shear / steps
            total["touching"] += (pressure > 0) / steps
            total["correction"] += (leg_force - planned) / steps
            violation = self._compute_reach_violation()[contact]
            total["overreach"] = max(total["overreach"], float(violation.max(initial=0.0)))
        return total

    def _apply_forces(self, leg_force: Array, contact: BoolArray, now: float) -> None:
        """Apply leg forces (L, 3) to body and standing toes, and track swing trajectories."""
        data = self.data
        toes, speed = data.qpos[self.qpos_index], data.qvel[self.dof_index]
        ground = toes - [0, 0, TOE_RADIUS]
        arms = ground - data.qpos[:3]
        data.xfrc_applied[self.body, :3] = leg_force.sum(axis=0)
        data.xfrc_applied[self.body, 3:] = np.cross(arms, leg_force).sum(axis=0)
        toe_force = -leg_force - _STANCE_DAMPING * speed
        for leg in np.flatnonzero(~contact):
            spot = self.reference.compute_swing_toe(int(leg), now)
            swing_velocity = (
                self.reference.compute_swing_toe(int(leg), now + TIME_STEP) - spot
            ) / TIME_STEP
            offset = spot - ground[leg]
            toe_force[leg] = TOE_MASS * (
                _SWING_FREQUENCY**2 * offset + 2 * _SWING_FREQUENCY * (swing_velocity - speed[leg])
            )
        data.qfrc_applied[self.dof_index] = toe_force

    def _correct_forces(
        self, sample: int, fraction: float, planned: Array, can_push: BoolArray
    ) -> Array:
        """Return planned forces (L, 3) plus feedback, within friction and force limits."""
        if not can_push.any():
            return planned
        task, data = self.plan.task, self.data
        reference = self.reference.interpolate_state(sample, fraction)
        rotation = data.xmat[self.body].reshape(3, 3)
        rotation_error = logarithm(rotation_world_body(reference[ANGLES]) @ rotation.T)
        angular_velocity_error = reference[SPIN] - rotation @ data.qvel[3:6]
        force = FEEDBACK_FREQUENCY**2 * (reference[POSITION] - data.qpos[:3])
        force = task.body.mass * (
            force + 2 * FEEDBACK_FREQUENCY * (reference[VELOCITY] - data.qvel[:3])
        )
        inertia = rotation @ task.body.inertia @ rotation.T
        moment = inertia @ (
            FEEDBACK_FREQUENCY**2 * rotation_error + 2 * FEEDBACK_FREQUENCY * angular_velocity_error
        )
        legs = np.flatnonzero(can_push)
        arms = data.qpos[self.qpos_index[legs]] - [0, 0, TOE_RADIUS] - data.qpos[:3]
        length = float(np.abs(task.body.toe_center[:, :2]).mean())
        grasp_map = np.concatenate(
            [np.vstack([np.eye(3), skew(arm) / length]) for arm in arms], axis=1
        )
        wrench = np.concatenate([force, moment / length])
        square = grasp_map @ grasp_map.T + _REGULARISATION * np.eye(6)
        correction = (grasp_map.T @ np.linalg.solve(square, wrench)).reshape(-1, 3)
        corrected = planned.copy()
        corrected[legs] = self._limit_forces(planned[legs] + correction)
        return corrected

    def _limit_forces(self, force: Array) -> Array:
        """Return forces (n, 3) within limits and friction; shear keeps its direction."""
        force_limit = self.plan.task.body.force_limit
        limited = force.copy()
        limited[:, 2] = np.clip(force[:, 2], 0.0, force_limit)
        shear = np.linalg.norm(force[:, :2], axis=1)
        max_shear = np.minimum(self.plan.task.ground.min_friction * limited[:, 2], force_limit)
        limited[:, :2] *= np.minimum(1.0, max_shear / np.maximum(shear, 1e-9))[:, None]
        return limited

    def _compute_reach_violation(self) -> Array:
        """Return how far toes (L,) are outside their workspace boxes [m], <= 0 inside."""
        body, data = self.plan.task.body, self.data
        rotation = data.xmat[self.body].reshape(3, 3)
        spots = (data.qpos[self.qpos_index] - [0, 0, TOE_RADIUS] - data.qpos[:3]) @ rotation
        return np.asarray((np.abs(spots - body.toe_center) - body.toe_half).max(axis=1))

    def _read_state(self) -> dict[str, Any]:
        """Return position, rotation and velocity of the body, and toes."""
        data = self.data
        return {
            "com": data.qpos[:3].copy(),
            "rotation": data.xmat[self.body].reshape(3, 3).copy(),
            "velocity": data.qvel[:3].copy(),
            "toes": data.qpos[self.qpos_index] - [0, 0, TOE_RADIUS],
        }


def apply_contact_losses(
    model: Any, toe_geom: NDArray[Any], conditions: Conditions, now: float
) -> None:
    """Remove the friction of toes that have lost their contact at a time [s]."""
    for loss in conditions.losses:
        is_lost = loss.start <= now < loss.start + loss.duration
        model.geom_priority[toe_geom[loss.limb]] = int(is_lost)
        model.geom_friction[toe_geom[loss.limb], 0] = 1e-5 if is_lost else 0.0


def build_empty_record(legs: int) -> dict[str, Any]:
    """Return the record of toes for an interval that has not begun."""
    return {
        "force": np.zeros((legs, 3)),
        "pressure": np.zeros(legs),
        "shear": np.zeros(legs),
        "touching": np.zeros(legs),
        "correction": np.zeros((legs, 3)),
        "overreach": 0.0,
    }


def measure_ground_forces(
    mujoco: ModuleType, model: Any, data: Any, leg_of: IntArray
) -> tuple[Array, Array, Array]:
    """Return contact forces (L, 3) on toes, and normal and shear force (L,) [N].

    Args:
        mujoco: the module.
        model: the model.
        data: its state.
        leg_of: (geoms,) leg of each toe geom, else -1.
    """
    legs = int(leg_of.max()) + 1
    force, pressure, shear = np.zeros((legs, 3)), np.zeros(legs), np.zeros(legs)
    local = np.zeros(6)
    for index in range(data.ncon):
        contact = data.contact[index]
        leg = max(leg_of[contact.geom1], leg_of[contact.geom2])
        if leg < 0:
            continue
        mujoco.mj_contactForce(model, data, index, local)
        frame = np.asarray(contact.frame).reshape(3, 3)
        sign = 1.0 if leg_of[contact.geom2] >= 0 else -1.0
        force[leg] += sign * local[:3] @ frame
        pressure[leg] += local[0]
        shear[leg] += np.hypot(local[1], local[2])
    return force, pressure, shear


def compute_euler_angles(rotation: Array) -> Array:
    """Return roll, pitch, yaw (3,) of R = Rz Ry Rx."""
    pitch = -np.arcsin(np.clip(rotation[2, 0], -1, 1))
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])
