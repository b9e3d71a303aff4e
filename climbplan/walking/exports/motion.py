"""The motion of a walk for exports: body, toes and forces, and joints of URDF robots.

Forces are constant from one sample of the plan to the next, and exported so at any rate. Toes stay
at their stance points and swing as in the plan's check. Joints follow by inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.errors import ClimbplanError
from climbplan.exports.motion import BodyMotion, ContactMotion, RobotMotion, unwrap_quaternions
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.walking.exports.joints import WalkJoints, build_walk_joints
from climbplan.walking.exports.toe_trajectories import ToePhase, build_toe_phases
from climbplan.walking.plan.body_motion import PlannedBody, interpolate_body
from climbplan.walking.plan.file import read_walk_plan
from climbplan.walking.plan.foot_centres import raise_plan, restore_surface
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.whole_body_model import read_plan_robot

NO_JOINTS = "a walk is planned as a body and its toes: joints are its controller's"
_UP = np.array([0.0, 0.0, 1.0])
_GROUND_MARGIN = 1.0  # [m] of terrain beyond a walk, for unbounded regions
_TIME_TOLERANCE = 1e-6  # [s] beyond an interval


def read_motion(path: Path) -> RobotMotion:
    """Read the motion of a plan file.

    Raises:
        PlanFileError: a damaged file.
    """
    plan = read_walk_plan(path)
    robot, notes = _read_robot(plan)
    radius = plan.task.ground.standoff
    if robot is not None and radius == 0 and robot.spec.foot_radius > 0:
        radius = robot.spec.foot_radius
        ground = replace(plan.task.ground, standoff=radius)
        plan = raise_plan(replace(plan, task=replace(plan.task, ground=ground)))
        notes.append(
            f"planned with centres of feet on the ground: raised by their radius of {radius:g} m"
        )
    joints = None
    if robot is not None and plan.task.legs is not None:
        try:
            joints = build_walk_joints(plan.task.legs, plan.task.body.leg_names, robot)
        except (ClimbplanError, ValueError) as reason:
            notes.append(f"joints are not exported: {str(reason).splitlines()[0]}")
    if joints is None and not notes:
        notes.append(NO_JOINTS)
    sampler = WalkSampler(plan, build_toe_phases(plan, radius), joints, tuple(notes))
    return sampler(plan.task.dt * np.arange(plan.task.knots + 1, dtype=float))


def _read_robot(plan: WalkPlan) -> tuple[UrdfRobot | None, list[str]]:
    """Return the URDF robot of a plan, or the reason why there is none."""
    if not plan.robot_urdf:
        return None, []
    try:
        return read_plan_robot(plan), []
    except ClimbplanError as reason:
        return None, [f"joints are not exported: {str(reason).splitlines()[0]}"]


@dataclass(frozen=True)
class WalkSampler:
    """A walk as a function of time."""

    plan: WalkPlan
    phases: list[list[ToePhase]]  # [leg][interval]
    joints: WalkJoints | None
    words: tuple[str, ...]

    def __call__(self, time: Array) -> RobotMotion:
        """Return the motion at times (M,) [s], increasing."""
        plan = self.plan
        task, trajectory = plan.task, plan.trajectory
        index = self.find_intervals(time)
        bodies = [
            interpolate_body(plan, n, float(t)) for n, t in zip(index.tolist(), time, strict=True)
        ]
        position = np.stack([body.position for body in bodies])
        rotation = np.stack([body.rotation for body in bodies])
        toes = self.compute_toes(index, time)
        touching = trajectory.gait.contact[index]
        force = np.where(touching[..., None], trajectory.force[index], 0.0)
        normal = np.where(
            touching[..., None], task.ground.frame[trajectory.gait.region[index]][..., 2, :], _UP
        )
        quaternion = Rotation.from_matrix(rotation).as_quat()
        motion = RobotMotion(
            name=plan.name,
            robot=task.body.name,
            time=time,
            bodies=(BodyMotion("body", position, unwrap_quaternions(quaternion)),),
            joints=None,
            contacts=ContactMotion(
                tuple(task.body.leg_names),
                toes - task.ground.standoff * normal,
                force,
                touching,
            ),
            words=(*self.words, *self._warn_of_slow_rate(time)),
            facts={"foot_radius": task.ground.standoff, **self._build_facts()},
            sampler=self,
            changes=np.asarray(task.dt * np.arange(task.knots + 1), float),
        )
        if self.joints is None:
            return motion
        return self.joints.add_joints(
            motion, bodies, force, lambda offset: self._compute_toes_in_body(index, time + offset)
        )

    def find_intervals(self, time: Array) -> np.ndarray:
        """Return the interval (M,) of each time, the later one at a knot."""
        step, last = self.plan.task.dt, self.plan.task.knots - 1
        return np.clip(np.floor((time + 1e-9) / step).astype(int), 0, last)

    def compute_toes(self, index: np.ndarray, time: Array) -> Array:
        """Return foot centres (M, L, 3) at times of intervals [m]."""
        step = self.plan.task.dt
        return np.array(
            [
                [leg_phases[n].compute_position(float(t), step) for leg_phases in self.phases]
                for n, t in zip(index.tolist(), time, strict=True)
            ]
        )

    def _compute_toes_in_body(self, index: np.ndarray, time: Array) -> Array:
        """Return foot centres (M, L, 3) in the body frame, by the curves of given intervals [m]."""
        bodies: list[PlannedBody] = [
            interpolate_body(self.plan, n, float(t))
            for n, t in zip(index.tolist(), time, strict=True)
        ]
        position = np.stack([body.position for body in bodies])
        rotation = np.stack([body.rotation for body in bodies])
        return np.asarray((self.compute_toes(index, time) - position[:, None]) @ rotation)

    def _warn_of_slow_rate(self, time: Array) -> tuple[str, ...]:
        """Return a warning if samples come less often than forces change."""
        step = self.plan.task.dt
        slowest = float(np.diff(time).max())
        if slowest <= step + _TIME_TOLERANCE:
            return ()
        warning = (
            f"forces change every {step:g} s, samples come every {slowest:g} s: they miss changes, "
            f"and what forces add up to; expected --rate {1 / step:.4g} or more"
        )
        return (warning,)

    def _build_facts(self) -> dict[str, object]:
        """Return the facts of a walk: step, forces and surfaces."""
        task, trajectory = self.plan.task, self.plan.trajectory
        ground = restore_surface(task.ground)
        xy = np.concatenate([trajectory.state[:, :2], trajectory.toes[..., :2].reshape(-1, 2)])
        low, high = xy.min(axis=0) - _GROUND_MARGIN, xy.max(axis=0) + _GROUND_MARGIN
        surfaces = []
        friction = ground.find_friction(np.arange(ground.count)).tolist()
        for region, name in enumerate(ground.names):
            corners = ground.outline(region, low, high)
            if len(corners):
                surfaces.append(
                    {
                        "name": name,
                        "kind": "flat",
                        "corners": corners.tolist(),
                        "normal": ground.frame[region, 2].tolist(),
                        "friction": friction[region],
                    }
                )
        return {
            "plan_step_s": task.dt,
            "forward": self.plan.forward,
            "force_is": "constant from each sample to the next",
            "surfaces": surfaces,
            **({} if self.joints is None else self.joints.facts),
        }
