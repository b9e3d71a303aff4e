"""The common input of all checks: a plan's arrays with its recomputed limbs and solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.capsules import Capsule, build_capsules
from climbplan.climb.check.anew.feet import compute_contact_arm, move_toes_to_contacts
from climbplan.climb.check.anew.kinematics import Limbs, build_limbs, compute_body_axes
from climbplan.climb.check.anew.soles import compute_corner_offsets, compute_sole_axes
from climbplan.climb.check.anew.weights import compute_link_torques, compute_weight_wrench
from climbplan.climb.check.convex import ConvexBody, build_hull, build_solids
from climbplan.climb.plan.climb_plan import ClimbPlan


@dataclass(frozen=True)
class Subject:
    """One plan under verification, with K instants and N limbs."""

    plan: ClimbPlan
    weight: float  # that residuals are relative to [N]
    body: ConvexBody  # in the body frame
    body_parts: tuple[ConvexBody, ...]  # that links keep off, in the body frame
    solids: tuple[ConvexBody, ...]
    axes: Array  # (K, 3, 3) body axes as rows, world
    limbs: Limbs  # at the instants
    contact_limbs: Limbs  # with the points that touch in place of their toes
    capsules: tuple[Capsule, ...]  # links at the instants

    def describe_instant(self, k: int, *limb_and_joint: int) -> str:
        """Describe instant k, limb and joint: "round 3, LM lifted, RF femur"."""
        text = self.plan.instants.label(k, self.plan.robot.limb_names)
        if limb_and_joint:
            text += f", {self.name_limb(*limb_and_joint)}"
        return text

    def describe_corner(self, k: int, limb: int, corner: int) -> str:
        """Describe a corner of a sole at instant k: "round 3, LM lifted, RF, front right"."""
        ends = ("back left", "back right", "front right", "front left")
        return f"{self.describe_instant(k, limb)}, {ends[corner]}"

    def name_limb(self, limb: int, *joint: int) -> str:
        """Return limb and joint as "RF femur"."""
        robot = self.plan.robot
        return " ".join([robot.limb_names[limb], *(robot.joint_name(limb, j) for j in joint)])

    def describe_time(self, sample: int) -> str:
        """Describe a sample of the trajectory: "t = 12.30 s"."""
        return f"t = {self.plan.trajectory.time[sample]:.2f} s"

    def describe_posture(self, j: int) -> str:
        """Describe posture j: "start" or "end of round 3"."""
        return f"end of round {j}" if j else "start"

    @property
    def predicts_deflection(self) -> bool:
        """Return whether the plan predicts deflections of the body instead of compensating them."""
        return bool(self.plan.forces.com_deflection.any())

    @property
    def load(self) -> Array:
        """Return weight and external wrench on the body (K, 6) [N, N m]."""
        instants = self.plan.instants
        return instants.external_wrench + compute_weight_wrench(
            self.plan.robot, self.axes, instants.joint_angles
        )

    @property
    def contact_force(self) -> Array:
        """Return the normal force (K, N) [N]."""
        return np.einsum("kni,kni->kn", self.plan.forces.force, self.plan.instants.normal)

    @property
    def tangential_force(self) -> Array:
        """Return the tangential force (K, N) [N]."""
        normal = self.contact_force[..., None] * self.plan.instants.normal
        length: Array = np.linalg.norm(self.plan.forces.force - normal, axis=-1)
        return length

    @property
    def torques(self) -> Array:
        """Return joint torques (K, N, J) from joint angles, contact forces and moments [N m]."""
        torques = np.einsum("knij,kni->knj", self.contact_limbs.jacobian(), self.plan.forces.force)
        if self.plan.robot.gripper is None and self.plan.robot.sole is None:
            return torques
        return (
            torques
            + (self.limbs.compute_angular_jacobian() @ self.contact_moment[..., None])[..., 0]
        )

    @property
    def link_torques(self) -> Array:
        """Return torques of the links' own weight (K, N, J), which motors hold too [N m]."""
        return compute_link_torques(self.plan.robot, self.axes, self.plan.instants.joint_angles)

    @property
    def torque_ratio(self) -> Array:
        """Return ratios (K, N, J) of motor torques to their limits, contact and links together."""
        return np.asarray(np.abs(self.torques + self.link_torques) / self.plan.robot.max_torque)

    @property
    def contact_moment(self) -> Array:
        """Return the moments on limbs (K, N, 3) in addition to their forces, about the toes [N m].

        These are moments of grips, and of the corner forces of flat feet.
        """
        sole, corner_forces = self.plan.robot.sole, self.plan.forces.corner_force
        if sole is None or corner_forces is None:
            return self.wrist_moment
        arms = compute_corner_offsets(sole, compute_sole_axes(sole, self.plan.instants.normal))
        return np.asarray(np.cross(arms, corner_forces).sum(axis=-2))

    @property
    def arms(self) -> Array:
        """Return vectors (K, N, 3) from the body origin to the contact points [m]."""
        instants = self.plan.instants
        contact_points = instants.toes + compute_contact_arm(self.plan.robot, instants.normal)
        arms: Array = contact_points - instants.com[:, None, :]
        return arms

    @property
    def wrist_moment(self) -> Array:
        """Return the moment of grips (K, N, 3) about the wrists' centres, zero without grippers [N
        m].
        """
        plan = self.plan
        if plan.robot.gripper is None or plan.grips is None:
            return np.zeros_like(plan.forces.force)
        lever_arm = -plan.robot.gripper.length * plan.instants.normal
        return plan.grips.instants.moment + np.cross(lever_arm, plan.forces.force)


def build_subject(plan: ClimbPlan) -> Subject:
    """Return the input of the checks for a plan with finite numbers and sound robot and terrain."""
    robot, instants = plan.robot, plan.instants
    axes = compute_body_axes(instants.rpy)
    weight = robot.mass * robot.gravity
    limbs = build_limbs(robot, instants.com, axes, instants.joint_angles)
    links = build_capsules(robot, instants.com, axes, instants.joint_angles, limbs.points)
    body = build_hull("body", robot.body_hull)
    body_parts = [build_hull("body", body_part) for body_part in robot.body_parts]
    return Subject(
        plan=plan,
        weight=weight if weight > 0 else 1.0,
        body=body,
        body_parts=tuple(body_parts) or (body,),
        solids=build_solids(plan.terrain),
        axes=axes,
        limbs=limbs,
        contact_limbs=move_toes_to_contacts(limbs, compute_contact_arm(robot, instants.normal)),
        capsules=tuple(links),
    )
