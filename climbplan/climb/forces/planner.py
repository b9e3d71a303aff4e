"""The force planner: contact forces and joint commands at every instant (chapter 5.1.4).

Each instant is one convex problem (`statement`). It is reduced to the forces that equilibrium
leaves free (`reduction`), solved and checked (`solving`), and converted to joint commands, torques
and safety factors.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.explanation import describe_fragile_instants, explain_infeasible_forces
from climbplan.climb.forces.sole_margins import solve_with_sole_margins
from climbplan.climb.forces.statement import (
    ForceStatement,
    compute_commands,
    compute_joint_torques,
    compute_torque_ratio,
    sum_over_limb_points,
)
from climbplan.climb.plan.climb_plan import InstantForces, Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import UsageError
from climbplan.mechanics.friction import critical_friction
from climbplan.mechanics.stiffness import Deflections, deflections_for_forces
from climbplan.robots.kinematics import toe_world


def plan_forces(scene: MotionScene, instants: Instants, solver: str | None = None) -> InstantForces:
    """Return contact forces, torques and commands of all instants.

    Every answer is checked against the exact constraints. One that fails, or that an inscribed
    pyramid excludes, is solved again by Clarabel on the exact cones.

    Args:
        scene: The scene.
        instants: All instants.
        solver: "daqp", "clarabel" or "osqp"; None for that of the spec.

    Raises:
        NoForces: Some instants have no admissible forces; names the conflicting constraints.
        LimitReached: Clarabel cannot decide an instant.
    """
    if scene.grippers is not None:
        if scene.spec.force.min_normal_force > 0:
            raise UsageError(
                "force.min_normal_force: expected none for a robot with grippers, which may pull"
            )
        if scene.spec.force.min_penetration is not None:
            raise UsageError(
                "force.min_penetration: expected none for a robot with grippers, which hold on"
            )
        from climbplan.climb.forces.grips.planner import plan_grip_forces

        return plan_grip_forces(scene, instants, scene.grippers, solver)
    statement, margined = solve_with_sole_margins(
        scene, instants, solver or scene.spec.solver.force_solver
    )
    solved = margined.solved
    if len(solved.missing) or len(solved.unbalanced):
        raise explain_infeasible_forces(scene, instants, statement, solved)
    forces = _assemble_forces(scene, instants, statement, solved.force)
    notes = describe_fragile_instants(scene, instants, margined.required, margined.margin_fraction)
    return replace(forces, margin_share=margined.margin_fraction, notes=notes)


def _assemble_forces(
    scene: MotionScene, instants: Instants, statement: ForceStatement, force: Array
) -> InstantForces:
    """Return torques, commands and safety factors; factors are infinite where nothing is loaded."""
    compensated = scene.spec.force.deflection_compensation == "compensated"
    deflections = compute_deflections(statement, force, compensated)
    command = compute_commands(statement, force)
    torques = compute_joint_torques(statement, force)
    torque_ratio = compute_torque_ratio(statement, force)
    critical_mu = critical_friction(force, statement.normal)
    safety_friction = np.full(critical_mu.shape, np.inf)
    np.divide(statement.mu, critical_mu, out=safety_friction, where=critical_mu > 0)
    points = statement.points
    foot_shape = (*instants.contact.shape, points)
    safety_torque = np.full(len(torque_ratio), np.inf)
    np.divide(1.0, torque_ratio, out=safety_torque, where=torque_ratio > 0)
    return InstantForces(
        force=sum_over_limb_points(force, points),
        joint_torques=torques,
        wall_deflection=deflections.wall,
        com_deflection=deflections.com,
        joint_command=command,
        toe_command=toe_world(scene.robot, instants.com, instants.rpy, command),
        safety_torque=safety_torque,
        safety_friction=safety_friction.min(axis=1),
        mu_critical=critical_mu if points == 1 else critical_mu.reshape(foot_shape).max(axis=-1),
        link_torques=None if scene.robot.links is None else statement.link_torques,
        corner_force=None if points == 1 else force.reshape(*foot_shape, 3),
    )


def compute_deflections(statement: ForceStatement, force: Array, compensated: bool) -> Deflections:
    """Return the deflections of toes and body.

    With flat feet, toes deflect as far as the joints comply, and the body does not move.
    """
    if statement.points == 1:
        return deflections_for_forces(
            statement.compliance, statement.arms, force, statement.contact, compensated
        )
    joint_deflection = statement.joint_angles - compute_commands(statement, force)
    jacobian = statement.jacobian.reshape(
        *joint_deflection.shape[:2], statement.points, 3, -1
    ).mean(axis=2)
    return Deflections((jacobian @ joint_deflection[..., None])[..., 0], np.zeros((len(force), 6)))
