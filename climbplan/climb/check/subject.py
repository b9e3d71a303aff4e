"""What all checks look at: a plan's arrays with its limbs and solids built anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.capsules import Capsule, capsules_at
from climbplan.climb.check.anew.feet import foot_arm, touching_limbs
from climbplan.climb.check.anew.kinematics import Limbs, body_axes, limbs_at
from climbplan.climb.check.anew.soles import corners, lying
from climbplan.climb.check.anew.weights import link_torques, weight_on
from climbplan.climb.check.convex import ConvexBody, hull_of, solids_of
from climbplan.climb.plan.climb_plan import ClimbPlan


@dataclass(frozen=True)
class Subject:
    """One plan under verification. K instants, N limbs."""

    plan: ClimbPlan
    weight: float  # that residuals are relative to [N]
    body: ConvexBody  # in the body frame
    body_parts: tuple[ConvexBody, ...]  # that links keep off, in the body frame
    solids: tuple[ConvexBody, ...]
    axes: Array  # (K, 3, 3) body axes as rows, world
    limbs: Limbs  # at the instants
    pressed: Limbs  # with the points that touch in place of their toes
    capsules: tuple[Capsule, ...]  # links at the instants

    def at(self, k: int, *parts: int) -> str:
        """Instant k, limb and joint in the robot's terms: "round 3, LM lifted, RF femur"."""
        text = self.plan.instants.label(k, self.plan.robot.limb_names)
        if parts:
            text += f", {self.limb(*parts)}"
        return text

    def at_corner(self, k: int, limb: int, corner: int) -> str:
        """A corner of a sole at instant k: "round 3, LM lifted, RF, front right"."""
        ends = ("back left", "back right", "front right", "front left")
        return f"{self.at(k, limb)}, {ends[corner]}"

    def limb(self, limb: int, *joint: int) -> str:
        """Limb and joint: "RF femur"."""
        robot = self.plan.robot
        return " ".join([robot.limb_names[limb], *(robot.joint_name(limb, j) for j in joint)])

    def at_time(self, sample: int) -> str:
        """A sample of the trajectory: "t = 12.30 s"."""
        return f"t = {self.plan.trajectory.time[sample]:.2f} s"

    def posture(self, j: int) -> str:
        """Posture j: "start" or "end of round 3"."""
        return f"end of round {j}" if j else "start"

    @property
    def sags(self) -> bool:
        """Whether the plan moves the body from its planned pose (`force.sag: predicted`)."""
        return bool(self.plan.forces.com_deflection.any())

    @property
    def load(self) -> Array:
        """(K, 6) weight and external wrench on the body [N, N m]."""
        instants = self.plan.instants
        return instants.external_wrench + weight_on(
            self.plan.robot, self.axes, instants.joint_angles
        )

    @property
    def contact_force(self) -> Array:
        """(K, N) force along the surface normal [N]."""
        return np.einsum("kni,kni->kn", self.plan.forces.force, self.plan.instants.normal)

    @property
    def tangential_force(self) -> Array:
        """(K, N) force along the surface [N]."""
        normal = self.contact_force[..., None] * self.plan.instants.normal
        length: Array = np.linalg.norm(self.plan.forces.force - normal, axis=-1)
        return length

    @property
    def torques(self) -> Array:
        """(K, N, J) joint torques from joint angles, contact forces and moments [N m]."""
        torques = np.einsum("knij,kni->knj", self.pressed.jacobian(), self.plan.forces.force)
        if self.plan.robot.gripper is None and self.plan.robot.sole is None:
            return torques
        return torques + (self.limbs.turning() @ self.held_moment[..., None])[..., 0]

    @property
    def link_torques(self) -> Array:
        """(K, N, J) torques of the links' own weight, which motors hold too [N m]."""
        return link_torques(self.plan.robot, self.axes, self.plan.instants.joint_angles)

    @property
    def torque_use(self) -> Array:
        """(K, N, J) parts of their limits that motors hold, of contact and links."""
        return np.asarray(np.abs(self.torques + self.link_torques) / self.plan.robot.max_torque)

    @property
    def held_moment(self) -> Array:
        """(K, N, 3) moments on limbs beside their forces, about the toes [N m].

        Of grips, and of what corners of flat feet are pushed with.
        """
        sole, pushes = self.plan.robot.sole, self.plan.forces.corner_force
        if sole is None or pushes is None:
            return self.wrist_moment
        arms = corners(sole, lying(sole, self.plan.instants.normal))
        return np.asarray(np.cross(arms, pushes).sum(axis=-2))

    @property
    def arms(self) -> Array:
        """(K, N, 3) from the body origin to where toes touch [m]."""
        instants = self.plan.instants
        touching = instants.toes + foot_arm(self.plan.robot, instants.normal)
        arms: Array = touching - instants.com[:, None, :]
        return arms

    @property
    def wrist_moment(self) -> Array:
        """(K, N, 3) moment of grips about the wrists' centres, zeros without grippers [N m]."""
        plan = self.plan
        if plan.robot.gripper is None or plan.grips is None:
            return np.zeros_like(plan.forces.force)
        arm = -plan.robot.gripper.length * plan.instants.normal
        return plan.grips.instants.moment + np.cross(arm, plan.forces.force)


def subject_of(plan: ClimbPlan) -> Subject:
    """A plan whose numbers are finite and whose robot and terrain are sound."""
    robot, instants = plan.robot, plan.instants
    axes = body_axes(instants.rpy)
    weight = robot.mass * robot.gravity
    limbs = limbs_at(robot, instants.com, axes, instants.joint_angles)
    links = capsules_at(robot, instants.com, axes, instants.joint_angles, limbs.points)
    body = hull_of("body", robot.body_hull)
    parts = [hull_of("body", part) for part in robot.body_parts]
    return Subject(
        plan=plan,
        weight=weight if weight > 0 else 1.0,
        body=body,
        body_parts=tuple(parts) or (body,),
        solids=solids_of(plan.terrain),
        axes=axes,
        limbs=limbs,
        pressed=touching_limbs(limbs, foot_arm(robot, instants.normal)),
        capsules=tuple(links),
    )
