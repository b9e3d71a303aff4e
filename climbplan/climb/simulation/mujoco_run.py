"""A plan in MuJoCo: joint commands drive position servos; poses and forces are recorded.

The robot starts at its planned posture with toes on the terrain and settles at its first commands.
It then follows the trajectory's commands, which unload, lift, swing, lower, press and push.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.control.feedforward import (
    compute_gravity_torques,
    compute_inertia_torques,
    compute_speed_offsets,
)
from climbplan.climb.simulation.control.regulator import JointOdometry, Regulator
from climbplan.climb.simulation.executive.settings import ExecutiveEvent
from climbplan.climb.simulation.grips.gripping import GripperSimulation, GripReport
from climbplan.climb.simulation.initial_posture import place_robot
from climbplan.climb.simulation.instant_samples import find_instant_samples
from climbplan.climb.simulation.model.chain_limb import (
    compute_drive,
    find_mimic_joints,
    name_motors,
)
from climbplan.climb.simulation.model.linkage_limb import compute_elbow_angles
from climbplan.climb.simulation.model.mjcf import TIME_STEP
from climbplan.climb.simulation.worlds.foothold_errors import compute_foothold_commands
from climbplan.climb.simulation.worlds.perturbed_terrain import perturb_terrain
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import Conditions, select_regulator
from climbplan.simulation.measures import FALLEN, TUMBLED, compute_tilt
from climbplan.simulation.motors import compute_assumed_stiffness

REST_TIME = 1.0  # [s] of constant commands, after which the body is at rest
SETTLING_TIME = 1.0  # [s] at the first commands before the motion starts
CONTROL_PERIOD = 0.01  # [s] between new commands to the motors


@dataclass(frozen=True)
class Replan:
    """A plan from a measured stance that a robot went on by, after it had stopped."""

    plan: ClimbPlan
    reason: str  # why the robot had stopped
    planning_time: float  # computing time [s], in which the robot stood
    duration: float  # of its execution [s]


@dataclass(frozen=True)
class ExecutionRecord:
    """A closed-loop execution."""

    events: tuple[ExecutiveEvent, ...]
    stopped: str  # why the robot stopped before the end, if it did
    elapsed: Array  # (S,) since the motion started, at each sample [s]
    step_times: Array  # computing times of steps [s]
    replans: tuple[Replan, ...] = ()

    @property
    def duration(self) -> float:
        """Time from the start to the end, or to the stop or fall, without that of planning [s]."""
        return float(self.elapsed[-1]) + sum(replan.duration for replan in self.replans)


@dataclass(frozen=True)
class RecordedRun:
    """A recorded simulation, at the S of T samples of the trajectory up to its end or a fall.

    Where a robot goes on by another plan, samples are those up to then, and `fallen` and
    `execution` tell the whole.
    """

    conditions: Conditions
    time: Array  # (S,) of the plan [s]
    com: Array  # (S, 3) body origin [m]
    rotation: Array  # (S, 3, 3) body to world
    toes: Array  # (S, N, 3) [m]
    links: Array  # (S, N, 3, 3) of the links that toes are on to the world
    force: Array  # (S, N, 3) on the toes, from the terrain [N]
    normal: Array  # (S, N) pressure [N]
    shear: Array  # (S, N) [N]
    torque: Array  # (S, N, J) of the motors [N m]
    touching: BoolArray  # (S, N)
    bumped: BoolArray  # (S,) a link or the body touches something
    fallen: bool
    rest_com: Array  # (K, 3) body at each instant if commands stayed there, NaN if not reached [m]
    rest_toes: Array  # (K, N, 3) toes likewise [m]
    grips: GripReport | None = None  # of robots with grippers
    execution: ExecutionRecord | None = None  # of closed-loop runs, plans made anew included

    @property
    def samples(self) -> int:
        """Number S of recorded samples."""
        return len(self.time)

    @property
    def end_time(self) -> float:
        """Time of the end or fall [s]: of the plan, or of the robot that went on by another one."""
        if self.execution is not None and self.execution.replans:
            return self.execution.duration
        return float(self.time[-1])


class MujocoRun:
    """A MuJoCo model that follows a trajectory."""

    def __init__(
        self, mujoco: ModuleType, model: Any, data: Any, plan: ClimbPlan, conditions: Conditions
    ) -> None:
        self.mujoco, self.model, self.data = mujoco, model, data
        self.plan, self.conditions = plan, conditions
        n = plan.robot.limb_count
        names = [name for limb in range(n) for name in name_motors(plan.robot, limb)]
        self.address = np.array([model.joint(name).qposadr[0] for name in names])
        self.toe_geom = np.array([model.geom(f"toe{limb}").id for limb in range(n)])
        self.limb_of = np.full(model.ngeom, -1)
        self.limb_of[self.toe_geom] = np.arange(n)
        self.body = model.body("body").id
        self._mimics = find_mimic_joints(plan.robot)
        self.joints = len(names)  # motors of the limbs, which come before those of wrists
        world = conditions.world
        terrain = plan.terrain if world is None else perturb_terrain(plan.terrain, world)
        self.start = place_robot(plan, terrain)
        self.grips = None
        if plan.robot.gripper is not None:
            self.grips = GripperSimulation(mujoco, model, data, plan, terrain, conditions)
        self.regulator = None
        regulator_mode = select_regulator(conditions, plan.robot)
        if regulator_mode != "nothing":
            self.regulator = Regulator(plan, correct_position=regulator_mode != "attitude")
            self.regulator.offset[:] = self.start.toes - plan.rounds.toes[0]
        self.odometry = None
        if regulator_mode == "joints":
            assert self.regulator is not None
            self.odometry = JointOdometry(plan, self.start.toes, self.regulator.tables)
        self._pending: deque[Array] = deque()  # corrections on their way to the motors
        self._initial_correction = np.zeros_like(
            plan.trajectory.joint_command[0]
        )  # those it starts with
        self._noise = np.random.default_rng(conditions.noise_seed)
        self.command = plan.trajectory.joint_command
        self.carrying = np.zeros_like(self.command)
        if conditions.limb_weights:
            # Commanded with the stiffness the motors are believed to have
            believed = compute_assumed_stiffness(plan.robot, conditions)
            carrying = compute_gravity_torques(plan, conditions) + compute_inertia_torques(plan)
            self.carrying = carrying / believed
            self.command = self.command + self.carrying
        if plan.trajectory.is_paced:
            self.command = self.command + compute_speed_offsets(plan, conditions)
        if conditions.world is not None:
            self.command = self.command + compute_foothold_commands(plan, conditions.world)

    def play(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
        rests: bool,
    ) -> RecordedRun:
        trajectory, conditions = self.plan.trajectory, self.conditions
        self._place()
        if self.regulator is not None:
            self._initial_correction = self.regulator.compute_joint_offsets(0).copy()
        self._hold_command(self.command[0] + self._initial_correction, SETTLING_TIME)
        planned = rotation_world_body(trajectory.rpy)
        wrench = self._compute_loads()
        instant_samples = find_instant_samples(self.plan)
        rest_positions = np.full((len(instant_samples), 1 + self.plan.robot.limb_count, 3), np.nan)
        rows: list[dict[str, Any]] = []
        fallen = False
        for sample in range(len(trajectory.time)):
            if sample:
                self._move_to_sample(sample, wrench)
            rows.append(self._record_sample(sample))
            if rests:
                for k in np.flatnonzero(instant_samples == sample):
                    rest_positions[k] = self._simulate_rest()
            if watch is not None:
                watch(sample, self.model, self.data)
            if progress is not None and sample % 100 == 0:
                progress(sample / len(trajectory.time))
            is_low = trajectory.com[sample, 2] - rows[-1]["com"][2] > FALLEN
            tilt = compute_tilt(rows[-1]["rotation"], planned[sample])
            if is_low or tilt > TUMBLED:
                fallen = True
                break
        stacked = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return RecordedRun(
            conditions=conditions,
            time=trajectory.time[: len(rows)],
            fallen=fallen,
            rest_com=rest_positions[:, 0],
            rest_toes=rest_positions[:, 1:],
            grips=None if self.grips is None else self.grips.report,
            execution=None,
            **stacked,
        )

    def _place(self) -> None:
        plan = self.plan
        com, rpy = plan.rounds.com[0], plan.rounds.rpy[0]
        self.data.qpos[:3] = com
        quat = np.empty(4)
        self.mujoco.mju_mat2Quat(quat, rotation_world_body(rpy).ravel())
        self.data.qpos[3:7] = quat
        joint_positions = compute_drive(plan.robot) @ self.start.angles[..., None]
        self.data.qpos[self.address] = joint_positions.ravel()
        if isinstance(plan.robot.mechanism, FiveBar):
            elbows = compute_elbow_angles(plan.robot, self.start.angles)
            for limb, angle in enumerate(elbows):
                self.data.qpos[self.model.joint(f"elbow{limb}").qposadr[0]] = angle
        self.mujoco.mj_forward(self.model, self.data)
        if self.grips is not None:
            self.grips.close_initial()

    def _hold_command(self, command: Array, seconds: float) -> None:
        self.data.ctrl[: self.joints] = command.ravel()
        self.data.xfrc_applied[self.body] = self.plan.instants.external_wrench[0]
        if self.grips is None:
            self.mujoco.mj_step(self.model, self.data, nstep=round(seconds / TIME_STEP))
            return
        for _ in range(round(seconds / CONTROL_PERIOD)):
            self.grips.command_wrists(0)
            self.mujoco.mj_step(self.model, self.data, nstep=round(CONTROL_PERIOD / TIME_STEP))
            self.grips.update_grips(0, CONTROL_PERIOD, 0.0)

    def _move_to_sample(self, sample: int, wrench: Array) -> None:
        trajectory, data = self.plan.trajectory, self.data
        span = (trajectory.time[sample] - trajectory.time[sample - 1]) / self.conditions.speed
        num_pieces = max(round(span / CONTROL_PERIOD), 1)
        steps = max(round(span / num_pieces / TIME_STEP), 1)
        previous, following = self.command[sample - 1], self.command[sample]
        self._apply_friction_losses(trajectory.time[sample])
        data.xfrc_applied[self.body] = wrench[sample]
        if self.grips is not None:
            self.grips.switch_grippers(sample, float(trajectory.time[sample]))
        for piece in range(1, num_pieces + 1):
            fraction = piece / num_pieces
            command = (1 - fraction) * previous + fraction * following
            if self.regulator is not None:
                sample_time = sample - 1 + fraction
                angles = self._read_angles()
                commanded = data.ctrl[: self.joints].reshape(angles.shape)
                lag = angles - (commanded - self.carrying[sample])
                correction = self.regulator.compute_correction(
                    sample_time, span / num_pieces, self._estimate_pose(sample, angles), lag
                )
                command = command + self._delay_correction(correction, span / num_pieces)
            data.ctrl[: self.joints] = command.ravel()
            if self.grips is not None:
                self.grips.command_wrists(sample, fraction)
            self.mujoco.mj_step(self.model, data, nstep=steps)
            if self.grips is not None:
                self.grips.update_grips(sample, steps * TIME_STEP, float(trajectory.time[sample]))

    def _delay_correction(self, correction: Array, seconds: float) -> Array:
        """Return the correction (N, J) that reaches the motors now, behind the delay [rad]."""
        self._pending.append(correction)
        num_delayed = round(self.conditions.delay / seconds)
        if len(self._pending) <= num_delayed:
            return self._initial_correction
        while len(self._pending) > num_delayed + 1:
            self._pending.popleft()
        return self._pending[0]

    def _simulate_rest(self) -> Array:
        """Simulate where body and toes (1 + N, 3) come to rest at the present commands [m]."""
        copy = self.mujoco.MjData(self.model)
        self.mujoco.mj_copyData(copy, self.model, self.data)
        self.mujoco.mj_step(self.model, copy, nstep=round(REST_TIME / TIME_STEP))
        return np.vstack([copy.qpos[:3], copy.geom_xpos[self.toe_geom]])

    def _read_angles(self) -> Array:
        """Read joint angles (N, J) with sensor noise [rad]."""
        angles = self.data.qpos[self.address].reshape(self.plan.robot.limb_count, -1)
        if self.conditions.joint_noise > 0:
            noise = self._noise.normal(0.0, self.conditions.joint_noise, angles.shape)
            angles = angles + noise * self.plan.robot.joint_unit
        return np.where(self._mimics, 0.0, angles)

    def _estimate_pose(self, sample: int, angles: Array) -> tuple[Array, Array]:
        """Return position and rotation of the body: true, or by odometry if there is one."""
        if self.odometry is not None:
            return self.odometry.pose(sample, angles)
        return self.data.qpos[:3].copy(), self.data.xmat[self.body].reshape(3, 3).copy()

    def _apply_friction_losses(self, now: float) -> None:
        """Remove the friction of toes with a contact loss at a time [s]."""
        for loss in self.conditions.losses:
            self._set_slippery(loss.limb, loss.start <= now < loss.start + loss.duration)

    def _set_slippery(self, limb: int, is_slippery: bool) -> None:
        """Take a toe's friction away, or give it back."""
        # Friction of a pair is that of the geom of higher priority, here the slippery toe's.
        self.model.geom_priority[self.toe_geom[limb]] = int(is_slippery)
        self.model.geom_friction[self.toe_geom[limb], 0] = 1e-5 if is_slippery else 0.0

    def _compute_loads(self) -> Array:
        """Compute the plan's external wrench (T, 6) at every sample, without the weight."""
        instant = np.maximum(sample_instants(self.plan), 0)
        return np.asarray(self.plan.instants.external_wrench[instant])

    def _record_sample(self, sample: int) -> dict[str, Any]:
        data, n = self.data, self.plan.robot.limb_count
        force, normal, shear = np.zeros((n, 3)), np.zeros(n), np.zeros(n)
        touching, bumped = np.zeros(n, bool), False
        local = np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            limb = max(self.limb_of[contact.geom1], self.limb_of[contact.geom2])
            if limb < 0:
                bumped = True
                continue
            self.mujoco.mj_contactForce(self.model, data, index, local)
            frame = np.asarray(contact.frame).reshape(3, 3)  # rows: normal from geom1 to geom2
            sign = 1.0 if self.limb_of[contact.geom2] >= 0 else -1.0
            force[limb] += sign * local[:3] @ frame
            normal[limb] += local[0]
            shear[limb] += np.hypot(local[1], local[2])
            touching[limb] |= local[0] > 0
        if self.grips is not None:
            force, normal, shear, touching = self.grips.compute_loads(sample)
        return {
            "com": data.qpos[:3].copy(),
            "rotation": data.xmat[self.body].reshape(3, 3).copy(),
            "toes": data.geom_xpos[self.toe_geom].copy(),
            "links": data.geom_xmat[self.toe_geom].reshape(n, 3, 3).copy(),
            "force": force,
            "normal": normal,
            "shear": shear,
            "torque": data.actuator_force[: self.joints].reshape(n, -1).copy(),
            "touching": touching,
            "bumped": bumped,
        }
