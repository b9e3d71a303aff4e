"""Joints of a walk by a robot from a URDF: angles by inverse kinematics, torques of its links.

The plan moves a rigid body on massless legs. Motors bring what its contact forces ask of them,
-J^T f, and what the legs' own inertia does on the planned motion; what holds the links' weight is
told apart, as of climbs. Both are Pinocchio's, of the URDF.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.exports.base_link import BaseLink, base_link, urdf_facts
from climbplan.exports.damping import critical_damping
from climbplan.exports.motion import JointLimits, JointMotion, LimbShape, RobotMotion
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.robots.urdf.mimics import follows
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.walking.plan.body_way import Moving

_TICK = 2e-4  # [s] of difference quotients
_LIMB_RADIUS = 0.02  # [m] of links in pictures


@dataclass(frozen=True)
class WalkJoints:
    """What turns toes of a walk into joints."""

    legs: WalkingLegs
    leg_names: tuple[str, ...]
    model: UrdfModel
    base: BaseLink
    facts: Mapping[str, object]

    def added(
        self,
        motion: RobotMotion,
        bodies: Sequence[Moving],
        force: Array,
        toes: Callable[[float], Array],
    ) -> RobotMotion:
        """Return the motion with joints, links and the URDF's root link.

        Args:
            motion: Body and contacts at M times.
            bodies: The body at each.
            force: (M, L, 3) on the feet, world frame [N].
            toes: Of an offset [s]: toes (M, L, 3) in the body frame that much later [m].
        """
        chain, there = self.legs.chain, self.legs.there
        solutions = [
            chain.inverse(toes(offset), self.legs.lower, self.legs.upper)
            for offset in (-_TICK, 0.0, _TICK)
        ]
        before, angle, after = (solution.angles[:, 0] for solution in solutions)
        missed = int((~solutions[1].valid).any(axis=-1).sum())
        velocity = (after - before) / (2 * _TICK)
        acceleration = (after - 2 * angle + before) / _TICK**2
        rotation = np.stack([body.rotation for body in bodies])
        position = motion.bodies[0].position
        pushed = (force @ rotation)[..., None, :] @ chain.jacobian(angle)  # (M, L, 1, J)
        gravity, inertia = self._links(bodies, angle, velocity, acceleration)
        torque = (inertia - pushed[..., 0, :])[:, there]
        slides = tuple(chain.sliding[there].tolist())
        points = position[:, None, None] + chain.joint_points(angle) @ np.swapaxes(
            rotation[:, None], -1, -2
        )
        words = motion.words
        if missed:
            words = (*words, f"joints do not reach the toes at {missed} of {len(angle)} samples")
        return replace(
            motion,
            base=self.base.motion(position, rotation),
            joints=JointMotion(
                names=tuple(name for own in chain.joint_names for name in own if name),
                command=angle[:, there],
                velocity=velocity[:, there],
                acceleration=acceleration[:, there],
                angle=angle[:, there],
                torque=torque,
                feedforward=torque,
                gravity=gravity[:, there],
                gain=self._gains(),
                slides=slides,
                limits=self._limits(angle[0]),
            ),
            limbs=tuple(
                LimbShape(name, points[:, leg], _LIMB_RADIUS)
                for leg, name in enumerate(self.leg_names)
            ),
            words=words,
        )

    def _gains(self) -> Array:
        spec, slides = self.model.robot.spec, self.legs.chain.sliding
        return np.array(
            [
                (spec.joints[name].stiffness if name in spec.joints else None)
                or (spec.slide_stiffness if slide else spec.joint_stiffness)
                for own, row in zip(self.legs.chain.joint_names, slides, strict=True)
                for name, slide in zip(own, row, strict=True)
                if name
            ],
            float,
        )

    def _limits(self, angle: Array) -> JointLimits:
        pin, model = self.model.library, self.model.model
        mass = pin.crba(model, model.createData(), self.model.build_configuration(self._named(angle)))
        inertia = np.diag(mass)[self._columns()]
        gain, there = self._gains(), self.legs.there
        names = np.broadcast_to(np.array(self.leg_names)[:, None], there.shape)
        return JointLimits(
            limb=tuple(names[there].tolist()),
            rigid_gain=gain,
            damping=critical_damping(inertia, gain),
            max_torque=self.legs.max_torque[there],
        )

    def _columns(self) -> list[int]:
        """Of Pinocchio's speeds, those of the joints that have motors, in order."""
        model = self.model.model
        return [
            int(model.idx_vs[model.getJointId(name)])
            for own in self.legs.chain.joint_names
            for name in own
            if name
        ]

    def _named(self, angle: Array) -> dict[str, float]:
        names = self.legs.chain.joint_names
        return {
            name: float(value)
            for own, row in zip(names, angle, strict=True)
            for name, value in zip(own, row, strict=True)
            if name
        }

    def _links(
        self, bodies: Sequence[Moving], angle: Array, velocity: Array, acceleration: Array
    ) -> tuple[Array, Array]:
        """Torques (M, L, J) that hold the links' weight, and that accelerate them beside it."""
        pin, model = self.model.library, self.model.model
        data, there = model.createData(), self.legs.there
        columns, ratios = self._columns(), self._followers()
        gravity, inertia = np.zeros_like(angle), np.zeros_like(angle)
        for k, body in enumerate(bodies):
            q = self.model.build_configuration(self._named(angle[k]))
            q[3:7] = pin.Quaternion(body.rotation @ self.base.rotation).coeffs()
            v, a = np.zeros(model.nv), np.zeros(model.nv)
            v[:6], a[:6] = self._base_motion(body)
            v[columns], a[columns] = velocity[k][there], acceleration[k][there]
            for follower, leader, ratio in ratios:
                v[follower], a[follower] = ratio * v[leader], ratio * a[leader]
            held = pin.computeGeneralizedGravity(model, data, q).copy()
            whole = pin.rnea(model, data, q, v, a).copy()
            for follower, leader, ratio in ratios:
                held[leader] += ratio * held[follower]
                whole[leader] += ratio * whole[follower]
            gravity[k][there] = held[columns]
            inertia[k][there] = whole[columns] - held[columns]
        return gravity, inertia

    def _base_motion(self, body: Moving) -> tuple[Array, Array]:
        """Velocity and spatial acceleration (6,) of the root link in its own frame."""
        arm = body.rotation @ self.base.position
        turn = (body.rotation @ self.base.rotation).T
        moving = body.velocity + np.cross(body.spin, arm)
        speeding = (
            body.acceleration
            + np.cross(body.turning, arm)
            + np.cross(body.spin, np.cross(body.spin, arm))
        )
        velocity = np.concatenate([turn @ moving, turn @ body.spin])
        spatial = turn @ (speeding - np.cross(body.spin, moving))
        return velocity, np.concatenate([spatial, turn @ body.turning])

    def _followers(self) -> list[tuple[int, int, float]]:
        """Columns of joints that mimic others, of those others, and ratios."""
        tree, model = self.model.robot.tree, self.model.model
        out: list[tuple[int, int, float]] = []
        for joint in tree.joints.values():
            by = follows(tree, joint)
            if by is None or joint.name in self.model.robot.spec.held:
                continue
            one, other = (
                int(model.idx_vs[model.getJointId(name)]) for name in (joint.name, by.leader)
            )
            out.append((one, other, by.ratio))
        return out


def walk_joints(legs: WalkingLegs, leg_names: tuple[str, ...], robot: UrdfRobot) -> WalkJoints:
    """Return what turns toes into joints of a robot.

    Raises:
        MissingSolver: Pinocchio is not installed.
        ValueError: The legs of the plan are not those of its URDF.
    """
    model: Any = build_urdf_model(robot)
    link = base_link(robot, legs.chain, TO_WALKING)
    return WalkJoints(legs, leg_names, model, link, urdf_facts(robot))
