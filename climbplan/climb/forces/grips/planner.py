"""The force planner of robots with grippers: contact forces, grips and commands by instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.grips.explanation import explain_grips, fragile_grips
from climbplan.climb.forces.grips.margins import solve_with_margins
from climbplan.climb.forces.grips.solving import SolvedGrips
from climbplan.climb.forces.grips.statement import GripStatement, state_grips
from climbplan.climb.plan.climb_plan import Forces, Instants
from climbplan.climb.plan.grips import GripForces
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import UsageError
from climbplan.mechanics.grip import FIRST, PALM, SECOND, Grippers, pull_margin
from climbplan.robots.kinematics import toe_world

NO_SHEAR = 1e-6  # in units of the load: less is rounding of forces that are zero


@dataclass(frozen=True)
class GripAnswers:
    """Contact forces, and what grippers do beside them."""

    force: Array  # (K, N, 3) [N]
    grips: GripForces
    parts: Array  # (K, N, 3, 3) forces on palm and fingers [N]


def plan_grip_forces(
    scene: MotionScene, instants: Instants, grippers: Grippers, solver: str | None = None
) -> Forces:
    """Contact forces, gripping forces, moments, torques and commands of all instants.

    Every answer is checked against the exact constraints, and keeps what it can of the spec's
    margins. Raises NotProved with what is missing at
    instants that have no admissible forces, in newtons of pull at which gripper.
    """
    if scene.spec.force.sag != "compensated":
        raise UsageError("force.sag: grippers hold the body at its planned pose: `compensated`")
    statement = state_grips(scene, instants, grippers)
    spec = scene.spec
    found = solve_with_margins(
        statement,
        spec.margins,
        scene.robot.weight,
        instants.round,
        solver or spec.solver.force,
        spec.force.facets,
    )
    if len(found.solved.missing):
        raise explain_grips(scene, instants, statement, found.solved.missing)
    forces = _assembled(scene, instants, statement, answers_of(statement, found.solved))
    notes = fragile_grips(scene, instants, found.asked, found.share)
    return replace(forces, margin_share=found.share, notes=notes)


def answers_of(statement: GripStatement, solved: SolvedGrips) -> GripAnswers:
    """Forces and moments of solved parts."""
    parts = solved.parts
    apart = parts[:, :, FIRST] - parts[:, :, SECOND]
    axis = statement.axis
    grips = GripForces(
        grip=np.einsum("kni,kni->kn", axis, apart) / 2,
        palm=parts[:, :, PALM],
        moment=statement.gripper.finger_span / 2 * np.cross(axis, apart),
    )
    return GripAnswers(parts.sum(axis=2), grips, parts)


def grip_torques(statement: GripStatement, force: Array, moment: Array) -> Array:
    """(K, N, 3) torques of the limbs' joints by forces and moments (K, N, 3) at the grips."""
    wrench = np.concatenate([force, moment], axis=-1)
    return np.einsum("knji,kni->knj", statement.torque, wrench)


def wrist_torques(statement: GripStatement, force: Array, moment: Array) -> Array:
    """(K, N, 3) torques of the wrists' joints likewise."""
    wrench = np.concatenate([force, moment], axis=-1)
    return np.einsum("knji,kni->knj", statement.wrist, wrench)


def _assembled(
    scene: MotionScene, instants: Instants, statement: GripStatement, found: GripAnswers
) -> Forces:
    force, grips = found.force, found.grips
    torques = grip_torques(statement, force, grips.moment)
    wrist = wrist_torques(statement, force, grips.moment)
    bent = statement.softness * torques * instants.contact[..., None]
    command = instants.joint_angles - bent
    used = [
        (np.abs(torques + statement.link_torques) / statement.max_torque).max(axis=(1, 2)),
        (np.abs(wrist) / statement.gripper.wrist_max_torque).max(axis=(1, 2)),
    ]
    if statement.gripper.max_force > 0:
        used.append((grips.grip / statement.gripper.max_force).max(axis=1))
    use = np.max(used, axis=0)
    slip = slipping(statement, found.parts)
    safety_torque = np.full(len(use), np.inf)
    np.divide(1.0, use, out=safety_torque, where=use > 0)
    return Forces(
        force=force,
        joint_torques=torques,
        link_torques=None if scene.robot.links is None else statement.link_torques,
        wall_deflection=np.einsum("knij,knj->kni", statement.jacobian, bent),
        com_deflection=np.zeros((len(force), 6)),
        joint_command=command,
        toe_command=toe_world(scene.robot, instants.com, instants.rpy, command),
        safety_torque=safety_torque,
        safety_friction=slip.factor.min(axis=1),
        mu_critical=slip.mu_critical,
        grips=grips,
    )


@dataclass(frozen=True)
class Slipping:
    """How near grips are to slipping, by their worst part."""

    mu_critical: Array  # (K, N) friction coefficient at which one slips, its spines as counted on
    factor: Array  # (K, N) shear that is held over shear that is planned


def slipping(statement: GripStatement, parts: Array) -> Slipping:
    """For forces (K, N, 3, 3) on palms and fingers; no force at all slips at no friction."""
    cones = statement.cones
    pressure, shear = np.maximum(cones.pressure(parts), 0.0), cones.shear(parts)
    loaded = (shear > NO_SHEAR * statement.unit) & statement.contact[..., None]
    beyond = np.maximum(shear - cones.spines, 0.0)
    critical = np.where(beyond > 0, np.inf, 0.0)
    np.divide(beyond, pressure, out=critical, where=pressure > 0)
    factor = np.full(shear.shape, np.inf)
    held = cones.mu[..., None] * pressure + cones.spines
    np.divide(held, shear, out=factor, where=loaded)
    critical = np.where(loaded, critical, 0.0)
    return Slipping(critical.max(axis=-1), factor.min(axis=-1))


def pull_margins(statement: GripStatement, parts: Array) -> Array:
    """(K, N) further pull that grips hold [N], 0 for lifted limbs."""
    margin = pull_margin(statement.cones, parts, statement.normal)
    return np.where(statement.contact, margin, 0.0)
