"""One run of a walk in MuJoCo with the whole robot: links with mass, joints of limited torque.

A tick is 2 ms: the state of the robot is taken as it is, a QP of its dynamics
(`whole_body_control.py`) gives torques for what the plan asks, and MuJoCo moves links and contacts.
A leg that is to stand and does not touch reaches down; one that touches late in its swing carries
at once.
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
from climbplan.walking.check.truth import toes_in_body
from climbplan.walking.online.estimation import logarithm
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.model import TIME_STEP
from climbplan.walking.simulation.replay import (
    WalkRun,
    euler_angles,
    ground_forces,
    lose_contacts,
    nothing,
)
from climbplan.walking.simulation.whole_body_control import (
    BODY_STIFF,
    SWING_STIFF,
    Commanded,
    Wanted,
    WholeBodyControl,
)
from climbplan.walking.simulation.whole_reference import WholeReference
from climbplan.walking.simulation.whole_robot import WholeRobot, whole_model, whole_robot
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY

TICK = 2  # steps of the simulation
PUSH = 0.05  # [s] that a push takes, as a force on the body
_PLACE_STIFF = 5.0  # [rad/s] of the body's way back to its place on the level
_HARDEST = 2.5  # [m/s^2] on the level, that the body is asked to speed up beside its plan
_FELT = 0.015  # [s] after its last contact that a toe still counts as standing
_EARLY = 0.6  # share of a swing after which a touching toe carries
_DOWN = -0.4  # [m/s] of a toe that is to stand and does not touch
_DOWN_GAIN = 60.0  # [1/s]
_TIPPED = 1.0  # [rad]
_SUNK = 0.5  # of the standing height


@dataclass(frozen=True)
class Pushed:
    """A push of the body."""

    time: float  # [s]
    velocity: Array  # (3,) change of the whole robot's velocity that its momentum is worth [m/s]


@dataclass(frozen=True)
class WholeRun(WalkRun):
    """A run of the whole robot; maxima are until the next sample."""

    torque: Array  # (S, L, J) largest share of the torque limit
    speed: Array  # (S, L, J) largest share of the speed limit
    unanswered: int  # ticks whose QP had no answer
    pushes: tuple[Pushed, ...]
    ticks: int


def simulate_whole(
    plan: WalkPlan,
    conditions: Conditions,
    pushes: tuple[Pushed, ...] = (),
    progress: Callable[[float], None] | None = None,
    watch: Callable[[int, Any, Any], None] | None = None,
) -> WholeRun:
    """Play a plan of a robot from a URDF.

    Raises MissingSolver without MuJoCo or Pinocchio, UsageError for a robot without links.
    """
    return _Player(plan, conditions, pushes).play(progress, watch)


class _Player:
    def __init__(self, plan: WalkPlan, conditions: Conditions, pushes: tuple[Pushed, ...]) -> None:
        assert plan.task.legs is not None
        self.mujoco = load_mujoco()
        self.plan, self.conditions, self.legs = plan, conditions, plan.task.legs
        robot: WholeRobot = whole_robot(plan, conditions)
        self.centre, self.mass = robot.centre, robot.mass
        self.foot = robot.found.robot.spec.foot_radius
        as_known = vars(conditions) | {"payload": 0.0, "armature": 1.0, "armature_value": None}
        known = robot if as_known == vars(conditions) else whole_robot(plan, NOMINAL)
        make = self.mujoco.MjModel.from_xml_string
        self.model = make(whole_model(plan, robot, conditions))
        self.data = self.mujoco.MjData(self.model)
        self.reference = WholeReference(plan, self.foot)
        self.there = self.legs.there
        self.at = np.full(self.there.shape, -1)
        self.dof = self.at.copy()
        for leg, j in np.argwhere(self.there | self.legs.mimics):
            hinge = self.model.joint(f"{leg}_{j}")
            self.at[leg, j], self.dof[leg, j] = hinge.qposadr[0], hinge.dofadr[0]
        self.control = WholeBodyControl(
            self.mujoco, make(whole_model(plan, known, NOMINAL)), self.at, self.dof, self.legs,
            plan.task.ground.friction, plan.task.weight,
        )  # fmt: skip
        self.root = self.model.body("body").id
        self.sites = [self.model.site(f"toe{leg}").id for leg in range(plan.task.body.leg_count)]
        self.toe_geom = np.array(
            [self.model.geom(f"toe{leg}").id for leg in range(plan.task.body.leg_count)]
        )
        self.leg_of = np.full(self.model.ngeom, -1)
        self.leg_of[self.toe_geom] = np.arange(plan.task.body.leg_count)
        planned = plan.loop.push if plan.loop is not None else np.zeros((0, 3))
        own = [
            Pushed(float(self.reference.time[n]), planned[n])
            for n in range(1, len(planned))
            if planned[n].any()
        ]
        self.pushes = (*own, *pushes)
        self.height = -float(plan.task.body.toe_center[:, 2].mean())
        self.felt = np.full(plan.task.body.leg_count, -np.inf)  # [s] when toes last touched
        self.torque = np.zeros_like(self.legs.max_torque)
        self.commanded: Commanded | None = None
        self.unanswered = self.ticks = 0

    def play(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
    ) -> WholeRun:
        time, rows, fell = self.reference.time, [], False
        self._stand()
        for sample in range(len(time)):
            row = self._state()
            if watch is not None:
                watch(sample, self.model, self.data)
            fell = self._lies(row)
            last = sample + 1 == len(time) or fell
            rows.append(row | (_nothing(self.legs) if last else self._interval(sample)))
            if progress is not None:
                progress((sample + 1) / len(time))
            if fell:
                break
        stacked = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return WholeRun(
            conditions=self.conditions,
            feedback=True,
            time=time[: len(rows)],
            fallen=fell,
            foot=self.foot,
            unanswered=self.unanswered,
            pushes=self.pushes,
            ticks=self.ticks,
            **stacked,
        )

    def _stand(self) -> None:
        """As the plan begins, joints turning as fast as toes that stand ask for."""
        state, toes = self.plan.trajectory.state[0], self.plan.trajectory.toes[0]
        rotation, data, legs = rotation_world_body(state[ANGLES]), self.data, self.legs
        spots = toes_in_body(state, toes)
        angles = legs.chain.inverse(spots, legs.lower, legs.upper).best()
        angles = np.where(np.isfinite(angles), angles, legs.chain.posture)
        data.qpos[:3] = state[POSITION] - rotation @ self.centre
        quat = np.empty(4)
        self.mujoco.mju_mat2Quat(quat, rotation.ravel())
        data.qpos[3:7] = quat
        named, drives = self.there | legs.mimics, legs.chain.drives
        data.qpos[self.at[named]] = (drives @ angles[..., None])[..., 0][named]
        spin = rotation.T @ state[SPIN]
        drift = rotation.T @ state[VELOCITY]
        data.qvel[:3] = state[VELOCITY] - rotation @ np.cross(spin, self.centre)
        data.qvel[3:6] = spin
        away = -(drift + np.cross(spin, spots))  # (L, 3) of toes in the body
        jacobian = legs.chain.jacobian(angles)
        speed = (np.linalg.pinv(jacobian) @ away[..., None])[..., 0]
        data.qvel[self.dof[named]] = (drives @ speed[..., None])[..., 0][named]
        self.mujoco.mj_forward(self.model, data)

    def _interval(self, sample: int) -> dict[str, Any]:
        begin, end = self.reference.time[sample], self.reference.time[sample + 1]
        steps = max(round((end - begin) / TIME_STEP), 1)
        stands = np.asarray(self.reference.contact[sample], bool)
        planned = self.reference.planned_force(sample)
        total = _nothing(self.legs)
        for step in range(steps):
            now = begin + step * (end - begin) / steps
            lose_contacts(self.model, self.toe_geom, self.conditions, now)
            if round(now / TIME_STEP) % TICK == 0 or self.commanded is None:
                self._command(sample, now, stands, planned)
            self._push(now)
            self.data.qfrc_applied[self.dof[self.there]] = self.torque[self.there]
            self.mujoco.mj_step(self.model, self.data)
            force, pressure, shear = ground_forces(self.mujoco, self.model, self.data, self.leg_of)
            self.felt[pressure > 0] = now + TIME_STEP
            total["force"] += force / steps
            total["pressure"] += pressure / steps
            total["shear"] += shear / steps
            total["touching"] += (pressure > 0) / steps
            assert self.commanded is not None
            total["correction"] += (self.commanded.force - planned) / steps
            over = self._overreach()[stands]
            total["overreach"] = max(total["overreach"], float(over.max(initial=0.0)))
            share = np.abs(self.torque) / self.legs.max_torque
            total["torque"] = np.maximum(total["torque"], share)
            fast = np.where(self.there, np.abs(self.data.qvel[self.dof]), 0) / self.legs.max_speed
            total["speed"] = np.maximum(total["speed"], fast)
        return total

    def _command(self, sample: int, now: float, stands: BoolArray, planned: Array) -> None:
        """Torques until the next tick."""
        data, wanted = self.data, self.reference.body(now)
        rotation = data.xmat[self.root].reshape(3, 3)
        spin = rotation @ data.qvel[3:6]
        arm = rotation @ self.centre
        position, velocity = data.qpos[:3] + arm, data.qvel[:3] + np.cross(spin, arm)
        off, slow = wanted.position - position, wanted.velocity - velocity
        stiff = np.array([_PLACE_STIFF, _PLACE_STIFF, BODY_STIFF])
        more = stiff**2 * off + 2 * stiff * slow
        level = float(np.linalg.norm(more[:2]))
        more[:2] *= min(1.0, _HARDEST / max(level, 1e-9))
        turned = logarithm(wanted.rotation @ rotation.T)
        turning = wanted.turning + BODY_STIFF**2 * turned + 2 * BODY_STIFF * (wanted.spin - spin)
        # Of the root body's origin, which the QP moves
        swung = np.cross(wanted.turning, arm) + np.cross(spin, np.cross(spin, arm))
        capture = -(off + self.reference.pendulum * slow)
        toes = data.site_xpos[self.sites]
        asked, carries = self._toes(now, stands, toes, capture)
        self.commanded = self.control.command(
            data.qpos, data.qvel,
            Wanted(
                acceleration=wanted.acceleration + more - swung,
                turning=turning,
                toes=asked,
                carries=carries,
                force=np.where(carries[:, None], planned, 0.0),
                normal=self.reference.normal[sample],
            ),
        )  # fmt: skip
        self.ticks += 1
        self.unanswered += not self.commanded.solved
        self.torque[self.there] = self.commanded.torque

    def _toes(
        self, now: float, stands: BoolArray, toes: Array, capture: Array
    ) -> tuple[Array, BoolArray]:
        """Accelerations (L, 3) of toes that do not carry, and which carry."""
        asked, carries = np.zeros_like(toes), np.zeros_like(stands)
        speeds = self._toe_speeds()
        for leg in range(len(stands)):
            touches = now - self.felt[leg] <= _FELT or now == 0.0
            if stands[leg]:
                self.reference.stands(leg)
                carries[leg] = touches
                asked[leg] = _DOWN_GAIN * (np.array([0.0, 0.0, _DOWN]) - speeds[leg])
                continue
            way = self.reference.swing(leg, now, toes[leg], capture)
            carries[leg] = touches and way.share > _EARLY
            back = SWING_STIFF**2 * (way.place - toes[leg])
            back += 2 * SWING_STIFF * (way.velocity - speeds[leg])
            asked[leg] = way.acceleration + back
        return asked, carries

    def _toe_speeds(self) -> Array:
        out, own = np.zeros((len(self.sites), 3)), np.zeros((3, self.model.nv))
        for leg, site in enumerate(self.sites):
            self.mujoco.mj_jacSite(self.model, self.data, own, None, site)
            out[leg] = own @ self.data.qvel
        return out

    def _push(self, now: float) -> None:
        force = np.zeros(3)
        for push in self.pushes:
            if push.time <= now < push.time + PUSH:
                force += self.mass * push.velocity / PUSH
        self.data.xfrc_applied[self.root, :3] = force

    def _overreach(self) -> Array:
        """(L,) how far toes are out of their boxes [m], <= 0 inside."""
        body, data = self.plan.task.body, self.data
        rotation = data.xmat[self.root].reshape(3, 3)
        spots = (data.site_xpos[self.sites] - data.qpos[:3]) @ rotation - self.centre
        return np.asarray((np.abs(spots - body.toe_center) - body.toe_half).max(axis=1))

    def _lies(self, row: dict[str, Any]) -> bool:
        roll, pitch, _ = euler_angles(row["rotation"])
        sunk = row["com"][2] - row["toes"][:, 2].min() < _SUNK * self.height
        return bool(
            max(abs(roll), abs(pitch)) > _TIPPED or sunk or not np.isfinite(row["com"]).all()
        )

    def _state(self) -> dict[str, Any]:
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


def _nothing(legs: WalkingLegs) -> dict[str, Any]:
    none = np.zeros_like(legs.max_torque)
    return nothing(len(none)) | {"torque": none, "speed": none.copy()}
