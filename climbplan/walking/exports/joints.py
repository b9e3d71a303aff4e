"""Joints of a walk by a URDF robot: angles by inverse kinematics, torques by inverse dynamics.

The plan moves a rigid body on massless legs. Motors provide -J^T f for its contact forces, and the
torques for the legs' own inertia on the planned motion. Torques that hold the links' weight are
separate, as for climbs. Pinocchio computes both from the URDF.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.exports.base_link import BaseLink, build_base_link, collect_urdf_facts
from climbplan.exports.damping import critical_damping
from climbplan.exports.motion import ExportedJoints, JointLimits, LimbLinks, RobotMotion
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.robots.urdf.mimics import resolve_mimic
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.walking.plan.body_motion import PlannedBody

_DIFFERENCE_STEP = 2e-4  # [s] of difference quotients
_LIMB_RADIUS = 0.02  # [m] of links in pictures


@dataclass(frozen=True)
class WalkJoints:
    """The conversion of a walk's toes into joints."""

    legs: WalkingLegs
    leg_names: tuple[str, ...]
    model: UrdfModel
    base: BaseLink
    facts: Mapping[str, object]

    def add_joints(
        self,
        motion: RobotMotion,
        bodies: Sequence[PlannedBody],
        force: Array,
        toes: Callable[[float], Array],
    ) -> RobotMotion:
        """Return the motion with joints, links and the URDF's root link.

        Args:
            motion: body and contacts at M times.
            bodies: the body at each time.
            force: (M, L, 3) on the feet, world frame [N].
            toes: function of an offset [s] that gives toes (M, L, 3) in the body frame that much
                later [m].
        """
        chain, has_motor = self.legs.chain, self.legs.there
        solutions = [
            chain.inverse(toes(offset), self.legs.lower, self.legs.upper)
            for offset in (-_DIFFERENCE_STEP, 0.0, _DIFFERENCE_STEP)
        ]
        before, angle, after = (solution.angles[:, 0] for solution in solutions)
        missed = int((~solutions[1].valid).any(axis=-1).sum())
        velocity = (after - before) / (2 * _DIFFERENCE_STEP)
        acceleration = (after - 2 * angle + before) / _DIFFERENCE_STEP**2
        rotation = np.stack([body.rotation for body in bodies])
        position = motion.bodies[0].position
        pushed = (force @ rotation)[..., None, :] @ chain.jacobian(angle)  # (M, L, 1, J)
        gravity, inertia = self._compute_link_torques(bodies, angle, velocity, acceleration)
        torque = (inertia - pushed[..., 0, :])[:, has_motor]
        slides = tuple(chain.sliding[has_motor].tolist())
        points = position[:, None, None] + chain.joint_points(angle) @ np.swapaxes(
            rotation[:, None], -1, -2
        )
        notes = motion.words
        if missed:
            notes = (*notes, f"joints do not reach the toes at {missed} of {len(angle)} samples")
        return replace(
            motion,
            base=self.base.motion(position, rotation),
            joints=ExportedJoints(
                names=tuple(name for names in chain.joint_names for name in names if name),
                command=angle[:, has_motor],
                velocity=velocity[:, has_motor],
                acceleration=acceleration[:, has_motor],
                angle=angle[:, has_motor],
                torque=torque,
                feedforward=torque,
                gravity=gravity[:, has_motor],
                gain=self._read_gains(),
                slides=slides,
                limits=self._read_limits(angle[0]),
            ),
            limbs=tuple(
                LimbLinks(name, points[:, leg], _LIMB_RADIUS)
                for leg, name in enumerate(self.leg_names)
            ),
            words=notes,
        )

    def _read_gains(self) -> Array:
        """Return the joint stiffnesses of all motors."""
        spec, slides = self.model.robot.spec, self.legs.chain.sliding
        return np.array(
            [
                (spec.joints[name].stiffness if name in spec.joints else None)
                or (spec.slide_stiffness if slide else spec.joint_stiffness)
                for names, row in zip(self.legs.chain.joint_names, slides, strict=True)
                for name, slide in zip(names, row, strict=True)
                if name
            ],
            float,
        )

    def _read_limits(self, angle: Array) -> JointLimits:
        """Return stiffness, damping and torque limits of all motors."""
        pin, model = self.model.library, self.model.model
        mass = pin.crba(
            model, model.createData(), self.model.build_configuration(self._name_angles(angle))
        )
        inertia = np.diag(mass)[self._find_columns()]
        gain, has_motor = self._read_gains(), self.legs.there
        names = np.broadcast_to(np.array(self.leg_names)[:, None], has_motor.shape)
        return JointLimits(
            limb=tuple(names[has_motor].tolist()),
            rigid_gain=gain,
            damping=critical_damping(inertia, gain),
            max_torque=self.legs.max_torque[has_motor],
        )

    def _find_columns(self) -> list[int]:
        """Return the columns of Pinocchio's speeds for joints with motors, in order."""
        model = self.model.model
        return [
            int(model.idx_vs[model.getJointId(name)])
            for leg_names in self.legs.chain.joint_names
            for name in leg_names
            if name
        ]

    def _name_angles(self, angle: Array) -> dict[str, float]:
        """Return angles (L, J) by joint name."""
        names = self.legs.chain.joint_names
        return {
            name: float(value)
            for leg_joints, row in zip(names, angle, strict=True)
            for name, value in zip(leg_joints, row, strict=True)
            if name
        }

    def _compute_link_torques(
        self, bodies: Sequence[PlannedBody], angle: Array, velocity: Array, acceleration: Array
    ) -> tuple[Array, Array]:
        """Return torques (M, L, J) that hold and those that accelerate the links."""
        pin, model = self.model.library, self.model.model
        data, has_motor = model.createData(), self.legs.there
        columns, ratios = self._find_columns(), self._find_followers()
        gravity, inertia = np.zeros_like(angle), np.zeros_like(angle)
        for k, body in enumerate(bodies):
            q = self.model.build_configuration(self._name_angles(angle[k]))
            q[3:7] = pin.Quaternion(body.rotation @ self.base.rotation).coeffs()
            v, a = np.zeros(model.nv), np.zeros(model.nv)
            v[:6], a[:6] = self._compute_base_motion(body)
            v[columns], a[columns] = velocity[k][has_motor], acceleration[k][has_motor]
            for follower, leader, ratio in ratios:
                v[follower], a[follower] = ratio * v[leader], ratio * a[leader]
            static_torque = pin.computeGeneralizedGravity(model, data, q).copy()
            total_torque = pin.rnea(model, data, q, v, a).copy()
            for follower, leader, ratio in ratios:
                static_torque[leader] += ratio * static_torque[follower]
                total_torque[leader] += ratio * total_torque[follower]
            gravity[k][has_motor] = static_torque[columns]
            inertia[k][has_motor] = total_torque[columns] - static_torque[columns]
        return gravity, inertia

    def _compute_base_motion(self, body: PlannedBody) -> tuple[Array, Array]:
        """Return velocity and spatial acceleration (6,) of the root link in its own frame."""
        arm = body.rotation @ self.base.position
        turn = (body.rotation @ self.base.rotation).T
        moving = body.velocity + np.cross(body.angular_velocity, arm)
        speeding = (
            body.acceleration
            + np.cross(body.angular_acceleration, arm)
            + np.cross(body.angular_velocity, np.cross(body.angular_velocity, arm))
        )
        velocity = np.concatenate([turn @ moving, turn @ body.angular_velocity])
        spatial = turn @ (speeding - np.cross(body.angular_velocity, moving))
        return velocity, np.concatenate([spatial, turn @ body.angular_acceleration])

    def _find_followers(self) -> list[tuple[int, int, float]]:
        """Return columns of joints that mimic others, columns of these, and ratios."""
        tree, model = self.model.robot.tree, self.model.model
        followers: list[tuple[int, int, float]] = []
        for joint in tree.joints.values():
            by = resolve_mimic(tree, joint)
            if by is None or joint.name in self.model.robot.spec.locked_positions:
                continue
            follower, leader = (
                int(model.idx_vs[model.getJointId(name)]) for name in (joint.name, by.leader)
            )
            followers.append((follower, leader, by.ratio))
        return followers


def build_walk_joints(
    legs: WalkingLegs, leg_names: tuple[str, ...], robot: UrdfRobot
) -> WalkJoints:
    """Build the conversion of toes into joints of a robot.

    Raises:
        MissingSolver: Pinocchio is not installed.
        ValueError: the legs of the plan are not those of its URDF.
    """
    model: Any = build_urdf_model(robot)
    link = build_base_link(robot, legs.chain, TO_WALKING)
    return WalkJoints(legs, leg_names, model, link, collect_urdf_facts(robot))
