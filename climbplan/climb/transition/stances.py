"""Force problems of stance sets: which limbs on which footholds hold the body at which pose.

A stance is a foothold number for every limb, or `LIFTED`. Many are asked for at once, and one pass
of the active-set solver on inscribed pyramids answers each in a fraction of a millisecond: what it
calls feasible is, by the exact check; near the edge of feasibility it may miss a little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.daqp import solve_daqp
from climbplan.climb.forces.reduction import halfspaces, reduce_forces
from climbplan.climb.forces.statement import ForceStatement, check_forces, state_forces, torque_use
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import load_wrench
from climbplan.climb.transition.footholds import Footholds, Poses, Reach, reach_of
from climbplan.climb.transition.scene import TransitionScene
from climbplan.mechanics.friction import regular_corners, split_force
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain

LIFTED = -1
_CHUNK = 2000  # problems assembled at once
_PASSES = 1e-6  # residual of accepted forces; the force planner solves again to 1e-7
_LEAST_FACTOR, _MOST_FACTOR = 0.05, 20.0  # S_mu looked for between these
_HALVINGS = 12
_STRONGER = 10.0  # times the torque limits, to see which would do
_STRONG = 1e3  # times the torque limits, which then limit nothing


@dataclass(frozen=True)
class StanceForces:
    """Answers for Q stances."""

    use: Array  # (Q,) share of the torque limits in use, 1 / S_tau; infinite where infeasible
    force: Array  # (Q, N, 3) [N], zero where infeasible


@dataclass(frozen=True)
class Laboratory:
    """What stances are made of."""

    scene: TransitionScene
    footholds: Footholds
    poses: Poses
    reach: Reach

    def at(self, poses: Poses) -> Laboratory:
        """With other poses."""
        reach = reach_of(self.scene, self.footholds, poses)
        return Laboratory(self.scene, self.footholds, poses, reach)


def stance_instants(lab: Laboratory, stance: IntArray, pose: IntArray) -> Instants:
    """Instants (Q) of stances (Q, N) at poses (Q,); lifted limbs hang at their start foothold."""
    holds, scene = lab.footholds, lab.scene
    limb = np.arange(stance.shape[1])
    contact = stance != LIFTED
    number = np.where(contact, stance, 0)
    angles = lab.reach.angles[pose[:, None], limb, number]
    known = contact[..., None] & np.isfinite(angles)
    angles = np.where(known, angles, _hanging(scene.robot))
    rpy = lab.poses.rpy[pose]
    return Instants(
        round=np.ones(len(pose), np.int64),
        lifted=~contact,
        contact=contact,
        com=lab.poses.com[pose],
        rpy=rpy,
        toes=holds.toe[limb, number],
        normal=holds.normal[limb, number],
        mu=holds.mu[limb, number],
        region=holds.region[limb, number],
        joint_angles=angles,
        external_wrench=load_wrench(scene.spec, scene.robot, rpy),
    )


def _hanging(robot: Robot) -> Array:
    """(N, J) angles of lifted limbs, whose weight counts where they have any."""
    chain = robot.mechanism
    if isinstance(chain, SerialChain):
        return chain.posture
    return np.zeros((robot.limb_count, robot.joint_count))


def stance_forces(lab: Laboratory, stance: IntArray, pose: IntArray) -> StanceForces:
    """Least torque use of stances (Q, N) at poses (Q,) with the friction asked for."""
    use = np.full(len(pose), np.inf)
    force = np.zeros((*stance.shape, 3))
    for first in range(0, len(pose), _CHUNK):
        rows = slice(first, first + _CHUNK)
        statement = state_forces(lab.scene, stance_instants(lab, stance[rows], pose[rows]))
        use[rows], force[rows] = _solved(lab, statement)
    return StanceForces(use, force)


def _solved(lab: Laboratory, statement: ForceStatement) -> tuple[Array, Array]:
    """Torque use (Q,) and forces (Q, N, 3) of one batch."""
    force = np.zeros(statement.arms.shape)
    solved = np.zeros(len(force), bool)
    facets = lab.scene.spec.force.facets
    least = lab.scene.spec.search.least_load * lab.scene.robot.weight
    for group in reduce_forces(statement).groups:
        b, n = group.limb.shape
        corners = np.broadcast_to(regular_corners(facets), (b, n, facets))
        rows = halfspaces(group, corners)
        # Contact rows -n . f <= 0 become -n . f <= -least: who supports carries some load.
        rows.upper[:, rows.contact] -= least / statement.unit
        optima = solve_daqp(group, rows)
        force[group.instant[:, None], group.limb] = group.forces(optima.x[:, 1:])
        solved[group.instant] = optima.solved
    force[~solved] = 0.0
    residuals = check_forces(statement, force)
    # Commands and stability only matter to few: the force planner has restrictions for those.
    held = np.maximum(
        np.maximum(residuals.equilibrium, residuals.friction),
        np.maximum(residuals.contact, residuals.torque),
    )
    solved &= held <= _PASSES
    use = torque_use(statement, force)
    return np.where(solved, use, np.inf), np.where(solved[:, None, None], force, 0.0)


def largest_friction_factor(lab: Laboratory, stance: IntArray, pose: IntArray) -> Array:
    """The largest S_mu (Q,) at which stances hold with the torque factor asked for; 0 for none."""
    instants = stance_instants(lab, stance, pose)
    statement = state_forces(lab.scene, instants)
    low = np.full(len(pose), np.log(_LEAST_FACTOR))
    high = np.full(len(pose), np.log(_MOST_FACTOR))
    asked = statement.safety_friction
    possible = np.isfinite(
        _solved(lab, replace(statement, mu=statement.mu * asked / _LEAST_FACTOR))[0]
    )
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        scaled = replace(statement, mu=statement.mu * (asked / np.exp(middle))[:, None])
        holds = np.isfinite(_solved(lab, scaled)[0])
        low, high = np.where(holds, middle, low), np.where(holds, high, middle)
    return np.where(possible, np.exp(low), 0.0)


def balances(lab: Laboratory, stance: IntArray, pose: int) -> bool:
    """Whether a stance (N,) could hold the body with friction and torques without end."""
    statement = state_forces(lab.scene, stance_instants(lab, stance[None], np.array([pose])))
    mu = statement.mu * statement.safety_friction / _LEAST_FACTOR
    strong = replace(statement, mu=mu, max_torque=statement.max_torque * _STRONG)
    return bool(np.isfinite(_solved(lab, strong)[0][0]))


def largest_torque_factor(lab: Laboratory, stance: IntArray, pose: int) -> float:
    """The largest S_tau at which a stance (N,) holds with the friction asked for; 0 for none."""
    statement = state_forces(lab.scene, stance_instants(lab, stance[None], np.array([pose])))
    motors = replace(statement, max_torque=statement.max_torque * _STRONGER)
    use = float(_solved(lab, motors)[0][0])
    return 0.0 if not np.isfinite(use) else 1.0 / max(use * _STRONGER, 1e-9)


@dataclass(frozen=True)
class Slip:
    """One contact of a refused stance that would have to hold more than it can."""

    limb: int
    needed: float  # friction coefficient
    available: float  # mu


def slipping(lab: Laboratory, stance: IntArray, pose: int, factor: float) -> list[Slip]:
    """Contacts of a stance (N,) that use all friction at S_mu = `factor`, worst first."""
    at = np.array([pose])
    statement = state_forces(lab.scene, stance_instants(lab, stance[None], at))
    scale = statement.safety_friction / (factor * (1 - 1e-3))
    force = _solved(lab, replace(statement, mu=statement.mu * scale))[1][0]
    parts = split_force(force, statement.normal[0])
    limit = parts.normal * statement.mu[0] / statement.safety_friction
    limbs = np.flatnonzero((parts.shear > limit * (1 + 1e-6)) & (stance != LIFTED))
    found = [
        Slip(int(i), float(parts.shear[i] / parts.normal[i]), float(statement.mu[0, i]))
        for i in limbs
    ]
    return sorted(found, key=lambda slip: slip.available / slip.needed)
