"""The motion of a walk: body, toes and forces, and joints of robots from URDFs.

Forces of a walk are constant from one sample of its plan to the next, and so they are exported at
any rate: held. Toes stay on their stance points until they lift, and swing as the plan's checker
has them. Joints follow by inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.errors import ClimbplanError
from climbplan.exports.motion import BodyMotion, ContactMotion, RobotMotion, continuous_quaternions
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.walking.exports.joints import WalkJoints, walk_joints
from climbplan.walking.exports.toe_ways import ToePhase, toe_phases
from climbplan.walking.plan.body_way import Moving, body_within
from climbplan.walking.plan.file import read_walk_plan
from climbplan.walking.plan.foot_centres import material, raised
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.whole_body_model import read_plan_robot

NO_JOINTS = "a walk is planned as a body and its toes: joints are its controller's"
_UP = np.array([0.0, 0.0, 1.0])
_AROUND = 1.0  # [m] of ground beyond a walk, where a region has no end
_WHOLE = 1e-6  # [s] beyond an interval


def read_motion(path: Path) -> RobotMotion:
    """Read a plan file; raises PlanFileError for a damaged one."""
    plan = read_walk_plan(path)
    robot, words = _robot(plan)
    radius = plan.task.ground.standoff
    if robot is not None and radius == 0 and robot.spec.foot_radius > 0:
        radius = robot.spec.foot_radius
        ground = replace(plan.task.ground, standoff=radius)
        plan = raised(replace(plan, task=replace(plan.task, ground=ground)))
        words.append(
            f"planned with centres of feet on the ground: raised by their radius of {radius:g} m"
        )
    joints = None
    if robot is not None and plan.task.legs is not None:
        try:
            joints = walk_joints(plan.task.legs, plan.task.body.leg_names, robot)
        except (ClimbplanError, ValueError) as reason:
            words.append(f"joints are not exported: {str(reason).splitlines()[0]}")
    if joints is None and not words:
        words.append(NO_JOINTS)
    sampler = WalkSampler(plan, toe_phases(plan, radius), joints, tuple(words))
    return sampler(plan.task.dt * np.arange(plan.task.knots + 1, dtype=float))


def _robot(plan: WalkPlan) -> tuple[UrdfRobot | None, list[str]]:
    """The robot of a plan that carries its URDF."""
    if not plan.robot_urdf:
        return None, []
    try:
        return read_plan_robot(plan), []
    except ClimbplanError as reason:
        return None, [f"joints are not exported: {str(reason).splitlines()[0]}"]


@dataclass(frozen=True)
class WalkSampler:
    """A walk at any times."""

    plan: WalkPlan
    phases: list[list[ToePhase]]  # [leg][interval]
    joints: WalkJoints | None
    words: tuple[str, ...]

    def __call__(self, time: Array) -> RobotMotion:
        """Return the motion at times (M,) [s], increasing."""
        plan = self.plan
        task, found = plan.task, plan.trajectory
        index = self.intervals(time)
        bodies = [body_within(plan, n, float(t)) for n, t in zip(index.tolist(), time, strict=True)]
        position = np.stack([body.position for body in bodies])
        rotation = np.stack([body.rotation for body in bodies])
        toes = self.toes(index, time)
        touching = found.gait.contact[index]
        force = np.where(touching[..., None], found.force[index], 0.0)
        normal = np.where(
            touching[..., None], task.ground.frame[found.gait.region[index]][..., 2, :], _UP
        )
        quaternion = Rotation.from_matrix(rotation).as_quat()
        motion = RobotMotion(
            name=plan.name,
            robot=task.body.name,
            time=time,
            bodies=(BodyMotion("body", position, continuous_quaternions(quaternion)),),
            joints=None,
            contacts=ContactMotion(
                tuple(task.body.leg_names),
                toes - task.ground.standoff * normal,
                force,
                touching,
            ),
            words=(*self.words, *self._rate_words(time)),
            facts={"foot_radius": task.ground.standoff, **self._facts()},
            sampler=self,
            changes=np.asarray(task.dt * np.arange(task.knots + 1), float),
        )
        if self.joints is None:
            return motion
        return self.joints.added(
            motion, bodies, force, lambda offset: self._seen(index, time + offset)
        )

    def intervals(self, time: Array) -> np.ndarray:
        """(M,) of the plan that times are in, the later one where two meet."""
        step, last = self.plan.task.dt, self.plan.task.knots - 1
        return np.clip(np.floor((time + 1e-9) / step).astype(int), 0, last)

    def toes(self, index: np.ndarray, time: Array) -> Array:
        """(M, L, 3) centres of feet at times of intervals [m]."""
        step = self.plan.task.dt
        return np.array(
            [
                [own[n].at(float(t), step) for own in self.phases]
                for n, t in zip(index.tolist(), time, strict=True)
            ]
        )

    def _seen(self, index: np.ndarray, time: Array) -> Array:
        """(M, L, 3) of them in the body frame, that curves of these intervals go on to [m]."""
        bodies: list[Moving] = [
            body_within(self.plan, n, float(t)) for n, t in zip(index.tolist(), time, strict=True)
        ]
        position = np.stack([body.position for body in bodies])
        rotation = np.stack([body.rotation for body in bodies])
        return np.asarray((self.toes(index, time) - position[:, None]) @ rotation)

    def _rate_words(self, time: Array) -> tuple[str, ...]:
        """That samples come less often than forces change."""
        step = self.plan.task.dt
        slowest = float(np.diff(time).max())
        if slowest <= step + _WHOLE:
            return ()
        words = (
            f"forces change every {step:g} s, samples come every {slowest:g} s: they miss changes, "
            f"and what forces add up to; expected --rate {1 / step:.4g} or more"
        )
        return (words,)

    def _facts(self) -> dict[str, object]:
        task, found = self.plan.task, self.plan.trajectory
        ground = material(task.ground)
        xy = np.concatenate([found.state[:, :2], found.toes[..., :2].reshape(-1, 2)])
        low, high = xy.min(axis=0) - _AROUND, xy.max(axis=0) + _AROUND
        surfaces = []
        for region, name in enumerate(ground.names):
            corners = ground.outline(region, low, high)
            if len(corners):
                surfaces.append(
                    {
                        "name": name,
                        "kind": "flat",
                        "corners": corners.tolist(),
                        "normal": ground.frame[region, 2].tolist(),
                        "friction": ground.friction,
                    }
                )
        return {
            "plan_step_s": task.dt,
            "force_is": "constant from each sample to the next",
            "surfaces": surfaces,
            **({} if self.joints is None else self.joints.facts),
        }
