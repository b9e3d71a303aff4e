"""One run of a walk in MuJoCo: planned contact forces push a rigid body off feet held by friction.

Forces alone do not keep a body on its path for long, whatever is planned: errors of place grow with
time. So forces are corrected for the body's departure from its reference, within the friction the
plan believes in, and the corrections are recorded: they say by how much the plan is off. Without
`feedback` forces are as planned.
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
from climbplan.walking.online.closed_loop import fallen as lies_down
from climbplan.walking.online.estimation import logarithm
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.model import TIME_STEP, TOE_MASS, TOE_RADIUS, build_mjcf
from climbplan.walking.simulation.reference import WalkReference, walk_reference
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY

STIFF = 10.0  # [rad/s] natural frequency of the correction, critically damped
REACH = 0.25  # [m] beyond its workspace at which a leg carries nothing any more
_SWING = 120.0  # [rad/s] of a toe on its way through the air, critically damped
_STANDING_DRAG = 2.0  # [N s/m] of a toe in contact, so that none flies off
_EVEN = 1e-3  # weight on corrections themselves beside what they miss, relative
_AWAY = 0.15  # [m] off the reference that counts as a fall


@dataclass(frozen=True)
class WalkRun:
    """What happened, at the plan's samples up to the end or a fall (S of T)."""

    conditions: Conditions
    feedback: bool
    time: Array  # (S,) [s]
    com: Array  # (S, 3) [m]
    rotation: Array  # (S, 3, 3) body to world
    velocity: Array  # (S, 3) [m/s]
    toes: Array  # (S, L, 3) [m]
    force: Array  # (S, L, 3) of the ground on the toes, mean until the next sample [N]
    pressure: Array  # (S, L) normal force likewise [N]
    shear: Array  # (S, L) [N]
    touching: Array  # (S, L) share of the time until the next sample
    correction: Array  # (S, L, 3) of the planned force, mean likewise [N]
    overreach: Array  # (S,) furthest that a standing toe is out of its workspace box [m]
    fallen: bool
    links: Array | None  # (S, L, 3, 3) of toes' links to the world; None: of bodies without any
    foot: float  # radius of spherical feet, zero of point toes [m]

    @property
    def samples(self) -> int:
        """S."""
        return len(self.time)


def simulate_walk(
    plan: WalkPlan,
    conditions: Conditions,
    *,
    feedback: bool = True,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[int, Any, Any], None] | None = None,
) -> WalkRun:
    """Play a plan. watch: called with sample, model and data at every sample, for pictures.

    Raises MissingSolver without MuJoCo.
    """
    mujoco = load_mujoco()
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, conditions))
    walker = _Walker(mujoco, model, mujoco.MjData(model), plan, conditions, feedback)
    return walker.play(progress, watch)


class _Walker:
    """One model on its way through a walk."""

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
        self.reference: WalkReference = walk_reference(plan)
        self.body = model.body("body").id
        legs = plan.task.body.leg_count
        self.toe_geom = np.array([model.geom(f"toe{leg}").id for leg in range(legs)])
        self.leg_of = np.full(model.ngeom, -1)
        self.leg_of[self.toe_geom] = np.arange(legs)
        slide = [[model.joint(f"toe{leg}{axis}") for axis in "xyz"] for leg in range(legs)]
        self.at = np.array([[joint.qposadr[0] for joint in row] for row in slide])
        self.dof = np.array([[joint.dofadr[0] for joint in row] for row in slide])

    def play(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
    ) -> WalkRun:
        reference, plan = self.reference, self.plan
        self._stand()
        rows: list[dict[str, Any]] = []
        fell = False
        pushes = plan.loop.push if plan.loop is not None else None
        for sample, start in enumerate(reference.time):
            if pushes is not None and sample:
                self.data.qvel[:3] += pushes[sample]
            row = self._state()
            if watch is not None:
                watch(sample, self.model, self.data)
            last = sample + 1 == len(reference.time)
            rows.append(
                row | (nothing(plan.task.body.leg_count) if last else self._interval(sample))
            )
            if progress is not None:
                progress((sample + 1) / len(reference.time))
            state = np.concatenate(
                [row["com"], row["velocity"], euler_angles(row["rotation"]), np.zeros(3)]
            )
            away = float(np.linalg.norm(row["com"] - reference.state[sample, POSITION]))
            if (
                lies_down(plan.task.body, state, row["toes"])
                or (self.feedback and away > _AWAY)
                or not np.isfinite(start)
            ):
                fell = True
                break
        stacked = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return WalkRun(
            conditions=self.conditions,
            feedback=self.feedback,
            time=reference.time[: len(rows)],
            fallen=fell,
            links=None,
            foot=0.0,
            **stacked,
        )

    def _stand(self) -> None:
        start, data = self.reference.state[0], self.data
        rotation = self.reference.rotation[0]
        data.qpos[:3] = start[POSITION]
        quat = np.empty(4)
        self.mujoco.mju_mat2Quat(quat, rotation.ravel())
        data.qpos[3:7] = quat
        data.qvel[:3] = start[VELOCITY]
        data.qvel[3:6] = rotation.T @ start[SPIN]  # MuJoCo turns free bodies in their own frame
        data.qpos[self.at] = self.plan.trajectory.toes[0] + [0, 0, TOE_RADIUS]
        self.mujoco.mj_forward(self.model, data)

    def _interval(self, sample: int) -> dict[str, Any]:
        """Steps to the next sample; means over them."""
        reference, data = self.reference, self.data
        begin, end = reference.time[sample], reference.time[sample + 1]
        steps = max(round((end - begin) / TIME_STEP), 1)
        contact = reference.contact[sample]
        planned = np.where(contact[:, None], self.plan.trajectory.force[sample], 0.0)
        lose_contacts(self.model, self.toe_geom, self.conditions, begin)
        total = nothing(len(self.toe_geom))
        for step in range(steps):
            share = (step + 0.5) / steps
            reachable = self._overreach() <= REACH
            pushed = planned * reachable[:, None]
            if self.feedback:
                pushed = self._corrected(sample, share, pushed, contact & reachable)
            self._apply(pushed, contact, begin + share * (end - begin))
            self.mujoco.mj_step(self.model, data)
            force, pressure, shear = ground_forces(self.mujoco, self.model, data, self.leg_of)
            total["force"] += force / steps
            total["pressure"] += pressure / steps
            total["shear"] += shear / steps
            total["touching"] += (pressure > 0) / steps
            total["correction"] += (pushed - planned) / steps
            over = self._overreach()[contact]
            total["overreach"] = max(total["overreach"], float(over.max(initial=0.0)))
        return total

    def _apply(self, pushed: Array, contact: BoolArray, now: float) -> None:
        """Leg forces on the body and on standing toes; swinging ones follow their way."""
        data = self.data
        toes, speed = data.qpos[self.at], data.qvel[self.dof]
        ground = toes - [0, 0, TOE_RADIUS]
        arms = ground - data.qpos[:3]
        data.xfrc_applied[self.body, :3] = pushed.sum(axis=0)
        data.xfrc_applied[self.body, 3:] = np.cross(arms, pushed).sum(axis=0)
        on_toes = -pushed - _STANDING_DRAG * speed
        for leg in np.flatnonzero(~contact):
            spot = self.reference.toe(int(leg), now)
            going = (self.reference.toe(int(leg), now + TIME_STEP) - spot) / TIME_STEP
            off = spot - ground[leg]
            on_toes[leg] = TOE_MASS * (_SWING**2 * off + 2 * _SWING * (going - speed[leg]))
        data.qfrc_applied[self.dof] = on_toes

    def _corrected(self, sample: int, share: float, planned: Array, carries: BoolArray) -> Array:
        """Planned forces (L, 3) with what brings the body back, as far as friction allows."""
        if not carries.any():
            return planned
        task, data = self.plan.task, self.data
        wanted = self.reference.body(sample, share)
        rotation = data.xmat[self.body].reshape(3, 3)
        turned = logarithm(rotation_world_body(wanted[ANGLES]) @ rotation.T)
        spin = wanted[SPIN] - rotation @ data.qvel[3:6]
        pull = STIFF**2 * (wanted[POSITION] - data.qpos[:3])
        pull = task.body.mass * (pull + 2 * STIFF * (wanted[VELOCITY] - data.qvel[:3]))
        inertia = rotation @ task.body.inertia @ rotation.T
        moment = inertia @ (STIFF**2 * turned + 2 * STIFF * spin)
        legs = np.flatnonzero(carries)
        arms = data.qpos[self.at[legs]] - [0, 0, TOE_RADIUS] - data.qpos[:3]
        length = float(np.abs(task.body.toe_center[:, :2]).mean())
        grasp = np.concatenate([np.vstack([np.eye(3), skew(arm) / length]) for arm in arms], axis=1)
        wrench = np.concatenate([pull, moment / length])
        square = grasp @ grasp.T + _EVEN * np.eye(6)
        more = (grasp.T @ np.linalg.solve(square, wrench)).reshape(-1, 3)
        out = planned.copy()
        out[legs] = self._allowed(planned[legs] + more)
        return out

    def _allowed(self, force: Array) -> Array:
        """The nearest forces (n, 3) along their own shear that pushing legs can have."""
        most = self.plan.task.body.force_limit
        out = force.copy()
        out[:, 2] = np.clip(force[:, 2], 0.0, most)
        shear = np.linalg.norm(force[:, :2], axis=1)
        holds = np.minimum(self.plan.task.ground.friction * out[:, 2], most)
        out[:, :2] *= np.minimum(1.0, holds / np.maximum(shear, 1e-9))[:, None]
        return out

    def _overreach(self) -> Array:
        """(L,) how far toes are out of their workspace boxes [m], <= 0 inside."""
        body, data = self.plan.task.body, self.data
        rotation = data.xmat[self.body].reshape(3, 3)
        spots = (data.qpos[self.at] - [0, 0, TOE_RADIUS] - data.qpos[:3]) @ rotation
        return np.asarray((np.abs(spots - body.toe_center) - body.toe_half).max(axis=1))

    def _state(self) -> dict[str, Any]:
        data = self.data
        return {
            "com": data.qpos[:3].copy(),
            "rotation": data.xmat[self.body].reshape(3, 3).copy(),
            "velocity": data.qvel[:3].copy(),
            "toes": data.qpos[self.at] - [0, 0, TOE_RADIUS],
        }


def lose_contacts(model: Any, toe_geom: NDArray[Any], conditions: Conditions, now: float) -> None:
    """A toe that lost its contact at a time [s] slides on anything; toe_geom: of each leg."""
    for loss in conditions.losses:
        gone = loss.start <= now < loss.start + loss.duration
        model.geom_priority[toe_geom[loss.limb]] = int(gone)
        model.geom_friction[toe_geom[loss.limb], 0] = 1e-5 if gone else 0.0


def nothing(legs: int) -> dict[str, Any]:
    """What toes felt in an interval that has not begun."""
    return {
        "force": np.zeros((legs, 3)),
        "pressure": np.zeros(legs),
        "shear": np.zeros(legs),
        "touching": np.zeros(legs),
        "correction": np.zeros((legs, 3)),
        "overreach": 0.0,
    }


def ground_forces(
    mujoco: ModuleType, model: Any, data: Any, leg_of: IntArray
) -> tuple[Array, Array, Array]:
    """Force (L, 3) of the ground on toes, its normal part and its shear (L,) [N].

    leg_of: (geoms,) the leg whose toe a geom is, else -1.
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


def euler_angles(rotation: Array) -> Array:
    """Roll, pitch, yaw of R = Rz Ry Rx."""
    pitch = -np.arcsin(np.clip(rotation[2, 0], -1, 1))
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])
