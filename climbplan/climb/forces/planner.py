"""The force planner: contact forces and joint commands at every instant (chapter 5.1.4).

One convex problem an instant (`statement`), reduced to the forces that equilibrium leaves
free (`reduction`), solved and checked (`solving`), and turned into what the robot is told and what
a user wants to know.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.explanation import explain, fragile_notes
from climbplan.climb.forces.soles import solve_on_feet
from climbplan.climb.forces.statement import (
    ForceStatement,
    commands_of,
    of_limbs,
    torque_use,
    torques_of,
)
from climbplan.climb.plan.climb_plan import Forces, Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import UsageError
from climbplan.mechanics.friction import critical_friction
from climbplan.mechanics.stiffness import Deflections, deflections_for_forces
from climbplan.robots.kinematics import toe_world


def plan_forces(scene: MotionScene, instants: Instants, solver: str | None = None) -> Forces:
    """Contact forces, torques and commands of all instants.

    solver: "daqp", "clarabel" or "osqp", by default the spec's. Every answer is checked against
    the exact constraints; one that fails, or for which an inscribed pyramid has no room, is solved
    again by Clarabel on the exact cones. Raises NoForces with the conflicting constraints of
    instants without admissible forces, and LimitReached if Clarabel cannot settle an instant.
    """
    if scene.grippers is not None:
        if scene.spec.force.least_pressure > 0:
            raise UsageError("force.least_pressure: grippers pull; it is for toes that only press")
        if scene.spec.force.least_depth is not None:
            raise UsageError("force.least_depth: grippers hold; it is for toes that only press")
        from climbplan.climb.forces.grips.planner import plan_grip_forces

        return plan_grip_forces(scene, instants, scene.grippers, solver)
    statement, found = solve_on_feet(scene, instants, solver or scene.spec.solver.force)
    solved = found.solved
    if len(solved.missing) or len(solved.unbalanced):
        raise explain(scene, instants, statement, solved)
    forces = _assembled(scene, instants, statement, solved.force)
    notes = fragile_notes(scene, instants, found.asked, found.share)
    return replace(forces, margin_share=found.share, notes=notes)


def _assembled(
    scene: MotionScene, instants: Instants, statement: ForceStatement, force: Array
) -> Forces:
    """Torques, commands and safety factors; factors are infinite where nothing is loaded."""
    compensated = scene.spec.force.sag == "compensated"
    deflections = deflections_of(statement, force, compensated)
    command = commands_of(statement, force)
    torques = torques_of(statement, force)
    use = torque_use(statement, force)
    critical = critical_friction(force, statement.normal)
    ratio = np.full(critical.shape, np.inf)
    np.divide(statement.mu, critical, out=ratio, where=critical > 0)
    points = statement.points
    by_foot = (*instants.contact.shape, points)
    safety_torque = np.full(len(use), np.inf)
    np.divide(1.0, use, out=safety_torque, where=use > 0)
    return Forces(
        force=of_limbs(force, points),
        joint_torques=torques,
        wall_deflection=deflections.wall,
        com_deflection=deflections.com,
        joint_command=command,
        toe_command=toe_world(scene.robot, instants.com, instants.rpy, command),
        safety_torque=safety_torque,
        safety_friction=ratio.min(axis=1),
        mu_critical=critical if points == 1 else critical.reshape(by_foot).max(axis=-1),
        link_torques=None if scene.robot.links is None else statement.link_torques,
        corner_force=None if points == 1 else force.reshape(*by_foot, 3),
    )


def deflections_of(statement: ForceStatement, force: Array, compensated: bool) -> Deflections:
    """Of toes and body; of flat feet the toes' as far as the joints give way, the body's none."""
    if statement.points == 1:
        return deflections_for_forces(
            statement.compliance, statement.arms, force, statement.contact, compensated
        )
    bent = statement.joint_angles - commands_of(statement, force)
    jacobian = statement.jacobian.reshape(*bent.shape[:2], statement.points, 3, -1).mean(axis=2)
    return Deflections((jacobian @ bent[..., None])[..., 0], np.zeros((len(force), 6)))
