"""The force planner of robots with grippers: contact forces, grips and commands by instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.grips.explanation import describe_fragile_grips, explain_grips
from climbplan.climb.forces.grips.margins import solve_grips_with_margins
from climbplan.climb.forces.grips.solving import SolvedGrips
from climbplan.climb.forces.grips.statement import GripStatement, build_grip_statement
from climbplan.climb.plan.climb_plan import InstantForces, Instants
from climbplan.climb.plan.grips import GripForces
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import UsageError
from climbplan.mechanics.grip import FIRST, PALM, SECOND, Grippers, pull_margin
from climbplan.robots.kinematics import toe_world

SHEAR_TOLERANCE = 1e-6  # in units of the load: less is rounding of forces that are zero


@dataclass(frozen=True)
class GripAnswers:
    """Contact forces, and the forces of the grippers' parts."""

    force: Array  # (K, N, 3) [N]
    grips: GripForces
    part_forces: Array  # (K, N, 3, 3) forces on palm and fingers [N]


def plan_grip_forces(
    scene: MotionScene, instants: Instants, grippers: Grippers, solver: str | None = None
) -> InstantForces:
    """Return contact forces, gripping forces, moments, torques and commands of all instants.

    Every answer is checked against the exact constraints, and keeps as much of the spec's margins
    as is feasible.

    Args:
        scene: The scene.
        instants: All instants.
        grippers: The robot's grippers on the holds.
        solver: Name of the force solver; None for that of the spec.

    Raises:
        Unresolved: Some instants have no admissible forces; says how much pull is missing where.
        UsageError: The spec does not compensate deflections.
    """
    if scene.spec.force.deflection_compensation != "compensated":
        raise UsageError(
            "force.deflection_compensation: grippers hold the body at its planned pose: "
            "`compensated`"
        )
    statement = build_grip_statement(scene, instants, grippers)
    spec = scene.spec
    margined = solve_grips_with_margins(
        statement,
        spec.margins,
        scene.robot.weight,
        instants.round,
        solver or spec.solver.force_solver,
        spec.force.facets,
    )
    if len(margined.solved.missing):
        raise explain_grips(scene, instants, statement, margined.solved.missing)
    forces = _assemble_forces(
        scene, instants, statement, assemble_grip_answers(statement, margined.solved)
    )
    notes = describe_fragile_grips(scene, instants, margined.required, margined.margin_fraction)
    return replace(forces, margin_share=margined.margin_fraction, notes=notes)


def assemble_grip_answers(statement: GripStatement, solved: SolvedGrips) -> GripAnswers:
    """Return contact forces and moments from the solved forces of palms and fingers."""
    part_forces = solved.part_forces
    finger_difference = part_forces[:, :, FIRST] - part_forces[:, :, SECOND]
    axis = statement.axis
    grips = GripForces(
        grip=np.einsum("kni,kni->kn", axis, finger_difference) / 2,
        palm=part_forces[:, :, PALM],
        moment=statement.gripper.finger_span / 2 * np.cross(axis, finger_difference),
    )
    return GripAnswers(part_forces.sum(axis=2), grips, part_forces)


def compute_grip_torques(statement: GripStatement, force: Array, moment: Array) -> Array:
    """Return joint torques (K, N, 3) of forces and moments (K, N, 3) at the grips."""
    wrench = np.concatenate([force, moment], axis=-1)
    return np.einsum("knji,kni->knj", statement.torque, wrench)


def compute_wrist_torques(statement: GripStatement, force: Array, moment: Array) -> Array:
    """Return wrist torques (K, N, 3) of forces and moments (K, N, 3) at the grips."""
    wrench = np.concatenate([force, moment], axis=-1)
    return np.einsum("knji,kni->knj", statement.wrist, wrench)


def _assemble_forces(
    scene: MotionScene, instants: Instants, statement: GripStatement, answers: GripAnswers
) -> InstantForces:
    """Return torques, commands and safety factors; factors are infinite where nothing is loaded."""
    force, grips = answers.force, answers.grips
    torques = compute_grip_torques(statement, force, grips.moment)
    wrist = compute_wrist_torques(statement, force, grips.moment)
    deflection = statement.softness * torques * instants.contact[..., None]
    command = instants.joint_angles - deflection
    load_ratios = [
        (np.abs(torques + statement.link_torques) / statement.max_torque).max(axis=(1, 2)),
        (np.abs(wrist) / statement.gripper.wrist_max_torque).max(axis=(1, 2)),
    ]
    if statement.gripper.max_force > 0:
        load_ratios.append((grips.grip / statement.gripper.max_force).max(axis=1))
    max_ratio = np.max(load_ratios, axis=0)
    slip = compute_slip_margins(statement, answers.part_forces)
    safety_torque = np.full(len(max_ratio), np.inf)
    np.divide(1.0, max_ratio, out=safety_torque, where=max_ratio > 0)
    return InstantForces(
        force=force,
        joint_torques=torques,
        link_torques=None if scene.robot.links is None else statement.link_torques,
        wall_deflection=np.einsum("knij,knj->kni", statement.jacobian, deflection),
        com_deflection=np.zeros((len(force), 6)),
        joint_command=command,
        toe_command=toe_world(scene.robot, instants.com, instants.rpy, command),
        safety_torque=safety_torque,
        safety_friction=slip.factor.min(axis=1),
        mu_critical=slip.mu_critical,
        grips=grips,
    )


@dataclass(frozen=True)
class SlipMargins:
    """How near grips are to slipping, by their worst part."""

    mu_critical: Array  # (K, N) friction coefficient at which one slips, its spines as counted on
    factor: Array  # (K, N) shear that is held over shear that is planned


def compute_slip_margins(statement: GripStatement, part_forces: Array) -> SlipMargins:
    """Return slip margins for forces (K, N, 3, 3) on palms and fingers; infinite if unloaded."""
    cones = statement.cones
    pressure, shear = np.maximum(cones.pressure(part_forces), 0.0), cones.shear(part_forces)
    is_sheared = (shear > SHEAR_TOLERANCE * statement.unit) & statement.contact[..., None]
    shear_excess = np.maximum(shear - cones.spines, 0.0)
    critical_mu = np.where(shear_excess > 0, np.inf, 0.0)
    np.divide(shear_excess, pressure, out=critical_mu, where=pressure > 0)
    factor = np.full(shear.shape, np.inf)
    max_shear = cones.mu[..., None] * pressure + cones.spines
    np.divide(max_shear, shear, out=factor, where=is_sheared)
    critical_mu = np.where(is_sheared, critical_mu, 0.0)
    return SlipMargins(critical_mu.max(axis=-1), factor.min(axis=-1))


def compute_pull_margins(statement: GripStatement, part_forces: Array) -> Array:
    """Return the additional pull (K, N) that grips hold [N], 0 for lifted limbs."""
    margin = pull_margin(statement.cones, part_forces, statement.normal)
    return np.where(statement.contact, margin, 0.0)
