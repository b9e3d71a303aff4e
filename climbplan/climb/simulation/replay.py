"""One run of a plan in MuJoCo: joint commands played to position servos, forces and poses recorded.

The robot starts at its planned posture with toes on the terrain and its first commands, settles,
and then plays the trajectory's commands, which unload, lift, swing, lower, press and push.
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
from climbplan.climb.simulation.control.feedforward import limb_weight_torques
from climbplan.climb.simulation.control.regulator import JointOdometry, Regulator
from climbplan.climb.simulation.grips.gripping import Gripped, Grips
from climbplan.climb.simulation.instants import instant_samples
from climbplan.climb.simulation.model.chain_limb import drive_of, followers, motor_names
from climbplan.climb.simulation.model.linkage_limb import elbow_angles
from climbplan.climb.simulation.model.mjcf import TIME_STEP, build_mjcf
from climbplan.climb.simulation.start import set_up
from climbplan.climb.simulation.worlds.ground import moved_terrain
from climbplan.climb.simulation.worlds.placement import missed_footholds
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import Conditions, regulated
from climbplan.simulation.measures import FALLEN, TUMBLED, planned_tilt
from climbplan.simulation.motors import believed_stiffness
from climbplan.simulation.mujoco_loading import load_mujoco

REST = 1.0  # [s] for which commands are held to see where the body comes to rest
SETTLE = 1.0  # [s] at the first commands before the motion starts
_CONTROL = 0.01  # [s] between new commands to the motors


@dataclass(frozen=True)
class Run:
    """What happened, at the trajectory's samples up to the end or a fall (S of T)."""

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
    grips: Gripped | None = None  # of robots with grippers

    @property
    def samples(self) -> int:
        """S."""
        return len(self.time)


def simulate(
    plan: ClimbPlan,
    conditions: Conditions,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[int, Any, Any], None] | None = None,
    rests: bool = False,
) -> Run:
    """Play a plan.

    watch: called with sample, model and data at every sample of the trajectory, for pictures.
    rests: at each instant a copy of the run holds its commands until the body is at rest.
    Raises MissingSolver without MuJoCo.
    """
    mujoco = load_mujoco()
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, conditions))
    data = mujoco.MjData(model)
    return _Player(mujoco, model, data, plan, conditions).play(progress, watch, rests)


class _Player:
    """One model on its way through a trajectory."""

    def __init__(
        self, mujoco: ModuleType, model: Any, data: Any, plan: ClimbPlan, conditions: Conditions
    ) -> None:
        self.mujoco, self.model, self.data = mujoco, model, data
        self.plan, self.conditions = plan, conditions
        n = plan.robot.limb_count
        names = [name for limb in range(n) for name in motor_names(plan.robot, limb)]
        self.address = np.array([model.joint(name).qposadr[0] for name in names])
        self.toe_geom = np.array([model.geom(f"toe{limb}").id for limb in range(n)])
        self.limb_of = np.full(model.ngeom, -1)
        self.limb_of[self.toe_geom] = np.arange(n)
        self.body = model.body("body").id
        self._mimics = followers(plan.robot)
        self.joints = len(names)  # motors of the limbs, which come before those of wrists
        world = conditions.world
        terrain = plan.terrain if world is None else moved_terrain(plan.terrain, world)
        self.start = set_up(plan, terrain)
        self.grips = None
        if plan.robot.gripper is not None:
            self.grips = Grips(mujoco, model, data, plan, terrain, conditions)
        self.regulator = None
        correcting = regulated(conditions, plan.robot)
        if correcting != "nothing":
            self.regulator = Regulator(plan, place=correcting != "attitude")
            self.regulator.offset[:] = self.start.toes - plan.rounds.toes[0]
        self.odometry = None
        if correcting == "joints":
            assert self.regulator is not None
            self.odometry = JointOdometry(plan, self.start.toes, self.regulator.tables)
        self._late: deque[Array] = deque()  # corrections on their way to the motors
        self._found = np.zeros_like(plan.trajectory.joint_command[0])  # those it starts with
        self._noise = np.random.default_rng(conditions.noise_seed)
        self.command = plan.trajectory.joint_command
        self.carrying = np.zeros_like(self.command)
        if conditions.limb_weights:
            # Commanded with the stiffness the motors are believed to have
            believed = believed_stiffness(plan.robot, conditions)
            self.carrying = limb_weight_torques(plan, conditions) / believed
            self.command = self.command + self.carrying
        if conditions.world is not None:
            self.command = self.command + missed_footholds(plan, conditions.world)

    def play(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
        rests: bool,
    ) -> Run:
        moving, conditions = self.plan.trajectory, self.conditions
        self._stand()
        if self.regulator is not None:
            self._found = self.regulator.told(0).copy()
        self._hold(self.command[0] + self._found, SETTLE)
        planned = rotation_world_body(moving.rpy)
        wrench = self._loads()
        at = instant_samples(self.plan)
        still = np.full((len(at), 1 + self.plan.robot.limb_count, 3), np.nan)
        rows: list[dict[str, Any]] = []
        fallen = False
        for sample in range(len(moving.time)):
            if sample:
                self._move(sample, wrench)
            rows.append(self._record(sample))
            if rests:
                for k in np.flatnonzero(at == sample):
                    still[k] = self._at_rest()
            if watch is not None:
                watch(sample, self.model, self.data)
            if progress is not None and sample % 100 == 0:
                progress(sample / len(moving.time))
            low = moving.com[sample, 2] - rows[-1]["com"][2] > FALLEN
            tilt = planned_tilt(rows[-1]["rotation"], planned[sample])
            if low or tilt > TUMBLED:
                fallen = True
                break
        stacked = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return Run(
            conditions=conditions,
            time=moving.time[: len(rows)],
            fallen=fallen,
            rest_com=still[:, 0],
            rest_toes=still[:, 1:],
            grips=None if self.grips is None else self.grips.told,
            **stacked,
        )

    def _stand(self) -> None:
        plan = self.plan
        com, rpy = plan.rounds.com[0], plan.rounds.rpy[0]
        self.data.qpos[:3] = com
        quat = np.empty(4)
        self.mujoco.mju_mat2Quat(quat, rotation_world_body(rpy).ravel())
        self.data.qpos[3:7] = quat
        moved = drive_of(plan.robot) @ self.start.angles[..., None]
        self.data.qpos[self.address] = moved.ravel()
        if isinstance(plan.robot.mechanism, FiveBar):
            elbows = elbow_angles(plan.robot, self.start.angles)
            for limb, angle in enumerate(elbows):
                self.data.qpos[self.model.joint(f"elbow{limb}").qposadr[0]] = angle
        self.mujoco.mj_forward(self.model, self.data)
        if self.grips is not None:
            self.grips.start()

    def _hold(self, command: Array, seconds: float) -> None:
        self.data.ctrl[: self.joints] = command.ravel()
        self.data.xfrc_applied[self.body] = self.plan.instants.external_wrench[0]
        if self.grips is None:
            self.mujoco.mj_step(self.model, self.data, nstep=round(seconds / TIME_STEP))
            return
        for _ in range(round(seconds / _CONTROL)):
            self.grips.command(0)
            self.mujoco.mj_step(self.model, self.data, nstep=round(_CONTROL / TIME_STEP))
            self.grips.feel(0, _CONTROL, 0.0)

    def _move(self, sample: int, wrench: Array) -> None:
        moving, data = self.plan.trajectory, self.data
        span = (moving.time[sample] - moving.time[sample - 1]) / self.conditions.speed
        pieces = max(round(span / _CONTROL), 1)
        steps = max(round(span / pieces / TIME_STEP), 1)
        before, after = self.command[sample - 1], self.command[sample]
        self._lose_contacts(moving.time[sample])
        data.xfrc_applied[self.body] = wrench[sample]
        if self.grips is not None:
            self.grips.switch(sample, float(moving.time[sample]))
        for piece in range(1, pieces + 1):
            share = piece / pieces
            command = (1 - share) * before + share * after
            if self.regulator is not None:
                now = sample - 1 + share
                angles = self._angles()
                told = data.ctrl[: self.joints].reshape(angles.shape)
                lag = angles - (told - self.carrying[sample])
                more = self.regulator.correction(
                    now, span / pieces, self._pose(sample, angles), lag
                )
                command = command + self._delayed(more, span / pieces)
            data.ctrl[: self.joints] = command.ravel()
            if self.grips is not None:
                self.grips.command(sample, share)
            self.mujoco.mj_step(self.model, data, nstep=steps)
            if self.grips is not None:
                self.grips.feel(sample, steps * TIME_STEP, float(moving.time[sample]))

    def _delayed(self, correction: Array, seconds: float) -> Array:
        """(N, J) what motors are told now of corrections that come every so many seconds."""
        self._late.append(correction)
        late = round(self.conditions.delay / seconds)
        if len(self._late) <= late:
            return self._found
        while len(self._late) > late + 1:
            self._late.popleft()
        return self._late[0]

    def _at_rest(self) -> Array:
        """(1 + N, 3) where body and toes would be if the commands stayed what they are."""
        copy = self.mujoco.MjData(self.model)
        self.mujoco.mj_copyData(copy, self.model, self.data)
        self.mujoco.mj_step(self.model, copy, nstep=round(REST / TIME_STEP))
        return np.vstack([copy.qpos[:3], copy.geom_xpos[self.toe_geom]])

    def _angles(self) -> Array:
        """(N, J) what the joints' sensors tell [rad]."""
        angles = self.data.qpos[self.address].reshape(self.plan.robot.limb_count, -1)
        if self.conditions.joint_noise > 0:
            noise = self._noise.normal(0.0, self.conditions.joint_noise, angles.shape)
            angles = angles + noise * self.plan.robot.joint_unit
        return np.where(self._mimics, 0.0, angles)

    def _pose(self, sample: int, angles: Array) -> tuple[Array, Array]:
        """Where the body is, or where its joints say it is."""
        if self.odometry is not None:
            return self.odometry.pose(sample, angles)
        return self.data.qpos[:3].copy(), self.data.xmat[self.body].reshape(3, 3).copy()

    def _lose_contacts(self, now: float) -> None:
        """A toe that lost its contact slides on anything."""
        for loss in self.conditions.losses:
            gone = loss.start <= now < loss.start + loss.duration
            # Friction of a pair is that of the geom of higher priority, here the slippery toe's.
            self.model.geom_priority[self.toe_geom[loss.limb]] = int(gone)
            self.model.geom_friction[self.toe_geom[loss.limb], 0] = 1e-5 if gone else 0.0

    def _loads(self) -> Array:
        """(T, 6) the plan's load beside the robot's weight at every sample."""
        instant = np.maximum(sample_instants(self.plan), 0)
        return np.asarray(self.plan.instants.external_wrench[instant])

    def _record(self, sample: int) -> dict[str, Any]:
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
            force, normal, shear, touching = self.grips.borne(sample)
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
