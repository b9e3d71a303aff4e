"""The force problem of every instant, as arrays (chapter 5.1.4).

    minimise    s - w sum_i n_i . f_i                     s = 1 / S_tau
    subject to  sum f_i + F = 0, sum r_i x f_i + M = 0    equilibrium
                |J_i^T f_i + w_i| <= s max_torque         torque; w_i of the links' own weight
                0 <= s <= 1 / (min S_tau)
                n_i . f_i >= min normal force             contact: a surface cannot pull
                n_i . J_i D_i f >= min penetration        inward: toes are commanded into surfaces
                |f_t,i| <= (mu_i / S_mu) (n_i . f_i - reserve)    friction
                lower <= theta - D f <= upper             command
                A(f) >= ratio A_0                         stability

Deflections are eliminated. The limb stiffness is invertible, so that any forces in equilibrium have
wall deflections that produce them; eqs. (4.14) and (4.17) together are equivalent to equilibrium.
Joint commands differ from the angles theta by the deflection D f under the forces
(`joint_bending`). It is linear in the forces, as is the stiffness A(f) of the body under load.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.climb.schema.force import ForcePlannerSpec
from climbplan.mechanics.equilibrium import link_torques, total_load, wrench_of
from climbplan.mechanics.friction import split_force
from climbplan.mechanics.stability import BracedBody, braced_body, loaded_stiffness
from climbplan.mechanics.stiffness import commanded_depth, joint_bending, limb_compliance
from climbplan.robots.kinematics import (
    by_point,
    contact_jacobian,
    contact_points,
    point_jacobian,
    pushed_points,
    toe_world,
)
from climbplan.robots.model import Robot

RESIDUAL_LIMIT = 1e-7  # largest residual of accepted forces, see ForceResiduals
TORQUE_MARGIN = 1e-8  # s stays this much (relative) below its bound, so that S_tau is met
COMMAND_MARGIN = 2e-3  # [rad] kept from joint bounds where possible: between two instants joints
# move on curves, which need a clearance from the straight lines between commands


@dataclass(frozen=True)
class ForceStatement:
    """Numbers of the force problems of K instants.

    Limbs are pushed at C points, limb by limb: N toes, or of flat feet the corners of N soles,
    whose forces together are what a sole's force and moment can be.
    """

    rounds: IntArray  # (K,) in which they are, from 1
    contact: BoolArray  # (K, C)
    arms: Array  # (K, C, 3) from the body origin to where limbs are pushed [m]
    normal: Array  # (K, C, 3) unit, into free space
    mu: Array  # (K, C)
    jacobian: Array  # (K, C, 3, J) of where limbs are pushed, world frame [m/rad]
    compliance: Array  # (K, C, 3, 3) of the limbs there [m/N]
    joint_angles: Array  # (K, N, J) [rad]
    deflection_per_force: Array  # (K, N, J, C, 3) D, joint angles less commands by forces [rad/N]
    penetration_per_force: (
        Array  # (K, N, C, 3) how deep in its surface each toe is commanded, by forces [m/N]
    )
    margin_below: Array  # (K, N, J) from the lower joint bound to the joint angle [rad]
    margin_above: Array  # (K, N, J) from the joint angle to the upper bound [rad]
    max_torque: Array  # (N, J) [N m]
    link_torques: Array  # (K, N, J) of the links' own weight [N m]
    load: Array  # (K, 6) weight and external wrench on the body [N, N m]
    safety_friction: float  # S_mu
    min_safety_torque: float  # lower bound on S_tau
    max_s: Array  # (K,) upper bound of s: of 1 / S_tau, or what margins leave of it
    min_stiffness_ratio: Array  # (K,) least share of the elastic stiffness left; -inf if not asked
    normal_force_weight: float  # w [1/N]
    min_normal_force: Array  # (K,) of each point in contact [N]
    reserve: Array  # (K,) pressure that it may miss before it slips [N]
    min_penetration: Array  # (K, N) of their commands inside the surface [m]; -inf if not asked
    unit: float  # force scale [N]
    length: float  # lever arm scale [m]
    robot: Robot
    rpy: Array  # (K, 3) [rad]

    @cached_property
    def braced_body(self) -> BracedBody:
        """Return what the stiffness of the K bodies depends on, other than the forces."""
        return braced_body(
            self.robot,
            self.rpy,
            self.joint_angles,
            self.jacobian,
            self.arms,
            contact=self.contact,
            normal=self.normal,
        )

    def as_published(self) -> ForceStatement:
        """Return the problem of chapter 5.1.4, without bounds on commands or stability."""
        unbounded = np.full(self.joint_angles.shape, np.inf)
        return replace(
            self,
            margin_below=unbounded,
            margin_above=unbounded,
            min_stiffness_ratio=np.full(len(self.arms), -np.inf),
            min_normal_force=np.zeros(len(self.arms)),
            reserve=np.zeros(len(self.arms)),
            min_penetration=np.full(self.min_penetration.shape, -np.inf),
        )

    @property
    def points(self) -> int:
        """Return the number of points at which each limb is pushed: C = N points."""
        return self.contact.shape[1] // self.robot.limb_count

    @property
    def standing(self) -> BoolArray:
        """Return which limbs (K, N) are in contact."""
        return self.contact[:, :: self.points]

    def take(self, rows: IntArray) -> ForceStatement:
        """Return the same problems for some of the instants."""
        constant_names = {"max_torque"}  # arrays that are not by instant
        selected: dict[str, Any] = {
            name: value[rows]
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray) and name not in constant_names
        }
        return replace(self, **selected)

    @property
    def usable_mu(self) -> Array:
        """Return mu / S_mu (K, C)."""
        return self.mu / self.safety_friction

    @property
    def torque_per_force(self) -> Array:
        """Return J^T with each row divided by its torque limit, (K, C, J, 3) [1/N]."""
        limit = by_point(self.robot, self.max_torque, 0)
        return np.asarray(np.swapaxes(self.jacobian, -1, -2) / limit[..., None])

    @property
    def link_torque_ratio(self) -> Array:
        """Return torques of the links' own weight as fractions of the limits (K, N, J)."""
        return np.asarray(self.link_torques / self.max_torque)


def build_force_statement(
    scene: MotionScene, instants: Instants, margin: float = 0.0
) -> ForceStatement:
    """Return the force problems of a scene's instants.

    Args:
        scene: The scene.
        instants: All instants.
        margin: Fraction of soles that is not pressed on.
    """
    return build_robot_forces(scene.robot.pressed_within(margin), scene.spec.force, instants)


def build_robot_forces(robot: Robot, force: ForcePlannerSpec, instants: Instants) -> ForceStatement:
    """Return the force problems of a robot's instants, without a scene; see above."""
    count = instants.count
    min_penetration = -np.inf if force.min_penetration is None else force.min_penetration
    arms = pushed_points(robot, instants.toes, instants.normal) - instants.com[:, None]
    load = total_load(robot, instants.external_wrench, instants.rpy, instants.joint_angles)
    length = robot.reach
    load_norms = np.hypot(
        np.linalg.norm(load[:, :3], axis=1), np.linalg.norm(load[:, 3:], axis=1) / length
    )
    max_load = float(load_norms.max(initial=0.0))
    # Without any load the torque limits set the scale.
    unit = max_load if max_load > 0 else float(robot.max_torque.min() / length)
    pose = instants.rpy, instants.joint_angles, instants.normal
    jacobian, toe_jacobian = point_jacobian(robot, *pose), contact_jacobian(robot, *pose)
    contact = by_point(robot, instants.contact, 1)
    compensated = force.deflection_compensation == "compensated"
    bending = joint_bending(robot, jacobian, arms, contact, compensated)
    points = contact.shape[1] // instants.contact.shape[1]
    return ForceStatement(
        rounds=instants.round,
        contact=contact,
        arms=arms,
        normal=by_point(robot, instants.normal, 1),
        mu=by_point(robot, instants.mu, 1),
        jacobian=jacobian,
        compliance=limb_compliance(robot, jacobian),
        joint_angles=instants.joint_angles,
        deflection_per_force=bending,
        penetration_per_force=commanded_depth(toe_jacobian, instants.normal, bending),
        margin_below=np.maximum(instants.joint_angles - robot.joint_lower, 0.0),
        margin_above=np.maximum(robot.joint_upper - instants.joint_angles, 0.0),
        max_torque=robot.max_torque,
        link_torques=link_torques(robot, instants.rpy, instants.joint_angles),
        load=load,
        safety_friction=force.safety_friction,
        min_safety_torque=force.safety_torque,
        max_s=np.full(count, (1 - TORQUE_MARGIN) / force.safety_torque),
        min_stiffness_ratio=np.full(count, force.min_stiffness_ratio),
        normal_force_weight=force.normal_force_weight,
        min_normal_force=np.full(count, force.min_normal_force / points),
        reserve=np.zeros(count),
        min_penetration=np.full(instants.contact.shape, min_penetration),
        unit=unit,
        length=length,
        robot=robot,
        rpy=instants.rpy,
    )


def compute_joint_torques(statement: ForceStatement, force: Array) -> Array:
    """Return joint torques J^T f (K, N, J) [N m] of forces (K, C, 3)."""
    return sum_over_limb_points(
        np.einsum("knij,kni->knj", statement.jacobian, force), statement.points
    )


def compute_torque_ratio(statement: ForceStatement, force: Array) -> Array:
    """Return the largest ratio (K,) of motor torque and limit under forces (K, C, 3)."""
    return np.asarray(_compute_limb_torque_ratios(statement, force).max(axis=1))


def compute_contact_torque_ratio(statement: ForceStatement, force: Array) -> Array:
    """Return the largest torque ratio (K,) of the limbs in contact: no force changes that of
    others.
    """
    ratios = _compute_limb_torque_ratios(statement, force)
    return np.asarray(np.where(statement.standing, ratios, 0.0).max(axis=1))


def _compute_limb_torque_ratios(statement: ForceStatement, force: Array) -> Array:
    """Return the largest torque ratio (K, N) of each limb's motors."""
    torques = compute_joint_torques(statement, force) + statement.link_torques
    return np.asarray((np.abs(torques) / statement.max_torque).max(axis=2))


def sum_over_limb_points(values: Array, points: int) -> Array:
    """Return sums (B, N, ...) over the points of each limb, of values (B, N points, ...)."""
    return (
        values
        if points == 1
        else values.reshape(len(values), -1, points, *values.shape[2:]).sum(axis=2)
    )


def compute_commands(statement: ForceStatement, force: Array) -> Array:
    """Return joint commands theta - D f (K, N, J) [rad] that press with forces (K, C, 3)."""
    return np.asarray(statement.joint_angles - _compute_deflection(statement, force))


def _compute_deflection(statement: ForceStatement, force: Array) -> Array:
    """Return joint deflections D f (K, N, J) [rad] under forces (K, C, 3)."""
    return np.einsum("knjml,kml->knj", statement.deflection_per_force, force, optimize=True)


def compute_bound_violation(statement: ForceStatement, force: Array, margin: float = 0.0) -> Array:
    """Return how far commands leave the joint bounds, tightened by a reserve, (K, N, J) [rad]."""
    deflection = _compute_deflection(statement, force)
    max_below, max_above = (
        reduce_margin(bound_margin, margin)
        for bound_margin in (statement.margin_below, statement.margin_above)
    )
    return np.maximum(np.maximum(deflection - max_below, -deflection - max_above), 0.0)


def compute_penetration(statement: ForceStatement, force: Array) -> Array:
    """Return how deep inside their surfaces toes are commanded by forces (K, C, 3), (K, N) [m]."""
    return np.asarray(
        np.einsum("kiml,kml->ki", statement.penetration_per_force, force, optimize=True)
    )


def compute_free_penetration(statement: ForceStatement, force: Array) -> Array:
    """Return how deep toes would be inside their surfaces without contact, (K, N) [m].

    `compute_penetration` is its first order: limbs with large deflections move on arcs.
    """
    command = compute_commands(statement, force)
    free_toes = toe_world(statement.robot, np.zeros((len(force), 3)), statement.rpy, command)
    points, normal = statement.points, statement.normal[:, :: statement.points]
    free_contacts = contact_points(statement.robot, free_toes, normal)
    arms = statement.arms
    if points > 1:  # to the middles of soles
        arms = arms.reshape(len(arms), -1, points, 3).mean(axis=2)
    return np.asarray(np.einsum("kni,kni->kn", normal, arms - free_contacts))


def compute_penetration_shortfall(statement: ForceStatement, force: Array) -> Array:
    """Return by how much toes in contact are commanded less deep than required, (K, N) [m]."""
    penetration = compute_penetration(statement, force)
    return np.where(
        statement.standing, np.maximum(statement.min_penetration - penetration, 0.0), 0.0
    )


def _compute_stiffness_shortfall(statement: ForceStatement, force: Array) -> Array:
    """Return the fraction (K,) of the elastic stiffness that is missing."""
    if (statement.min_stiffness_ratio == -np.inf).all():
        return np.zeros(len(force))
    return np.maximum(
        statement.min_stiffness_ratio - loaded_stiffness(statement.braced_body, force).left, 0.0
    )


def reduce_margin(margin: Array, reserve: float) -> Array:
    """Return joint margins [rad] less a reserve, at least 0: without force no joint deflects."""
    return np.maximum(margin - reserve, 0.0)


def compute_objective(statement: ForceStatement, force: Array) -> Array:
    """Return s - w sum n . f (K,) of forces (K, C, 3), with s as small as their torques allow."""
    s = compute_torque_ratio(statement, force)
    normal_force = split_force(force, statement.normal).normal.sum(axis=1)
    return np.asarray(s - statement.normal_force_weight * normal_force)


@dataclass(frozen=True)
class ForceResiduals:
    """Violations of each instant's constraints, 0 where they hold (dimensionless, rad or m)."""

    equilibrium: Array  # (K,) relative to the largest load
    friction: Array  # (K,) relative to the largest load
    contact: Array  # (K,) pressure missing or force on a lifted limb, relative to the largest load
    torque: Array  # (K,) relative to the torque limit
    command: Array  # (K,) of joint commands beyond their bounds [rad]
    inward: Array  # (K,) of commanded toes, less deep in their surface than asked [m]
    stability: Array  # (K,) share of the elastic stiffness missing

    @property
    def worst(self) -> Array:
        """Return the largest of the seven residuals (K,)."""
        return np.max(list(vars(self).values()), axis=0)


def check_forces(statement: ForceStatement, force: Array) -> ForceResiduals:
    """Return residuals of forces (K, C, 3) against the exact constraints, cones included."""
    residual_wrench = wrench_of(statement.arms, force) + statement.load
    residual_wrench[:, 3:] /= statement.length
    components = split_force(force, statement.normal)
    cone_force = np.maximum(components.normal - statement.reserve[:, None] * statement.contact, 0.0)
    excess = components.shear - statement.usable_mu * cone_force
    missing_pressure = statement.min_normal_force[:, None] * statement.contact - components.normal
    airborne_force = np.abs(force).max(axis=-1) * ~statement.contact
    safety_ratio = compute_torque_ratio(statement, force) * statement.min_safety_torque
    margin_ratio = (
        compute_contact_torque_ratio(statement, force) * (1 - TORQUE_MARGIN) / statement.max_s
    )
    return ForceResiduals(
        equilibrium=np.linalg.norm(residual_wrench, axis=1) / statement.unit,
        friction=np.maximum(excess, 0.0).max(axis=1) / statement.unit,
        contact=np.maximum(np.maximum(missing_pressure, airborne_force), 0.0).max(axis=1)
        / statement.unit,
        torque=np.maximum(np.maximum(safety_ratio, margin_ratio) - 1.0, 0.0),
        command=compute_bound_violation(statement, force).max(axis=(1, 2)),
        inward=compute_penetration_shortfall(statement, force).max(axis=1),
        stability=_compute_stiffness_shortfall(statement, force),
    )
