"""Solve the force problems of stance sets: can limbs on footholds support the body at a pose?

A stance is a foothold index for every limb, or `LIFTED`. Batches of force problems are solved by an
active-set solver on inscribed friction pyramids. Feasible answers satisfy the exact check; near the
boundary of feasibility some feasible stances are missed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.daqp import solve_daqp
from climbplan.climb.forces.reduction import build_halfspaces, reduce_forces
from climbplan.climb.forces.statement import (
    ForceStatement,
    build_force_statement,
    check_forces,
    compute_torque_ratio,
)
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import compute_load_wrench
from climbplan.climb.transition.footholds import (
    CandidateBodyPoses,
    CandidateFootholds,
    Reach,
    compute_reach,
)
from climbplan.climb.transition.scene import TransitionScene
from climbplan.mechanics.friction import regular_corners, split_force
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain

LIFTED = -1
_CHUNK_SIZE = 2000  # problems of a batch
_RESIDUAL_TOLERANCE = 1e-6  # residual of accepted forces; the force planner solves again to 1e-7
_MIN_FACTOR, _MAX_FACTOR = 0.05, 20.0  # range of S_mu in bisection
_NUM_BISECTIONS = 12
_TRIAL_TORQUE_SCALE = 10.0  # by the torque limits, to find sufficient ones
_UNLIMITED_TORQUE_SCALE = 1e3  # by the torque limits, which then are inactive


@dataclass(frozen=True)
class StanceForces:
    """Solutions for Q stances."""

    torque_use: (
        Array  # (Q,) fraction of the torque limits in use, 1 / S_tau; infinite if infeasible
    )
    force: Array  # (Q, N, 3) [N], zero where infeasible


@dataclass(frozen=True)
class SearchTables:
    """Precomputed tables of the search: footholds, poses and reachability."""

    scene: TransitionScene
    footholds: CandidateFootholds
    poses: CandidateBodyPoses
    reach: Reach

    def with_poses(self, poses: CandidateBodyPoses) -> SearchTables:
        """Return tables with other poses."""
        reach = compute_reach(self.scene, self.footholds, poses)
        return SearchTables(self.scene, self.footholds, poses, reach)


def build_stance_instants(tables: SearchTables, stance: IntArray, pose: IntArray) -> Instants:
    """Build instants (Q) of stances (Q, N) at poses (Q,), given by their indices.

    The toes of lifted limbs are at their start foothold.
    """
    footholds, scene = tables.footholds, tables.scene
    limb = np.arange(stance.shape[1])
    contact = stance != LIFTED
    index = np.where(contact, stance, 0)
    angles = tables.reach.angles[pose[:, None], limb, index]
    is_known = contact[..., None] & np.isfinite(angles)
    angles = np.where(is_known, angles, _get_hanging_angles(scene.robot))
    rpy = tables.poses.rpy[pose]
    return Instants(
        round=np.ones(len(pose), np.int64),
        lifted=~contact,
        contact=contact,
        com=tables.poses.com[pose],
        rpy=rpy,
        toes=footholds.toe[limb, index],
        normal=footholds.normal[limb, index],
        mu=footholds.mu[limb, index],
        region=footholds.region[limb, index],
        joint_angles=angles,
        external_wrench=compute_load_wrench(scene.spec, scene.robot, rpy),
    )


def _get_hanging_angles(robot: Robot) -> Array:
    """Return joint angles (N, J) of lifted limbs, at which the weight of their links acts."""
    chain = robot.mechanism
    if isinstance(chain, SerialChain):
        return chain.posture
    return np.zeros((robot.limb_count, robot.joint_count))


def solve_stance_forces(tables: SearchTables, stance: IntArray, pose: IntArray) -> StanceForces:
    """Solve for the smallest torque use of stances (Q, N) at poses (Q,), with the spec's S_mu."""
    torque_use = np.full(len(pose), np.inf)
    force = np.zeros((*stance.shape, 3))
    for first in range(0, len(pose), _CHUNK_SIZE):
        batch = slice(first, first + _CHUNK_SIZE)
        statement = build_force_statement(
            tables.scene, build_stance_instants(tables, stance[batch], pose[batch])
        )
        torque_use[batch], force[batch] = _solve_batch(tables, statement)
    return StanceForces(torque_use, force)


def _solve_batch(tables: SearchTables, statement: ForceStatement) -> tuple[Array, Array]:
    """Solve one batch: torque use (Q,) and forces (Q, N, 3) [N]."""
    force = np.zeros(statement.arms.shape)
    is_solved = np.zeros(len(force), bool)
    facets = tables.scene.spec.force.facets
    min_load = tables.scene.spec.search.min_load * tables.scene.robot.weight
    for group in reduce_forces(statement).groups:
        b, n = group.limb.shape
        corners = np.broadcast_to(regular_corners(facets), (b, n, facets))
        rows = build_halfspaces(group, corners)
        # Contact rows -n . f <= 0 become -n . f <= -min_load: each supporting limb carries load
        rows.upper[:, rows.contact] -= min_load / statement.unit
        optima = solve_daqp(group, rows)
        force[group.instant[:, None], group.limb] = group.compute_forces(optima.x[:, 1:])
        is_solved[group.instant] = optima.solved
    force[~is_solved] = 0.0
    residuals = check_forces(statement, force)
    # The force planner restricts commands and stability later; they are rarely active
    residual = np.maximum(
        np.maximum(residuals.equilibrium, residuals.friction),
        np.maximum(residuals.contact, residuals.torque),
    )
    is_solved &= residual <= _RESIDUAL_TOLERANCE
    torque_use = compute_torque_ratio(statement, force)
    return np.where(is_solved, torque_use, np.inf), np.where(is_solved[:, None, None], force, 0.0)


def find_max_friction_factor(tables: SearchTables, stance: IntArray, pose: IntArray) -> Array:
    """Find the largest S_mu (Q,) of stances at the spec's S_tau by bisection; 0 if none."""
    instants = build_stance_instants(tables, stance, pose)
    statement = build_force_statement(tables.scene, instants)
    low = np.full(len(pose), np.log(_MIN_FACTOR))
    high = np.full(len(pose), np.log(_MAX_FACTOR))
    required = statement.safety_friction
    is_possible = np.isfinite(
        _solve_batch(tables, replace(statement, mu=statement.mu * required / _MIN_FACTOR))[0]
    )
    for _ in range(_NUM_BISECTIONS):
        middle = (low + high) / 2
        scaled = replace(statement, mu=statement.mu * (required / np.exp(middle))[:, None])
        is_feasible = np.isfinite(_solve_batch(tables, scaled)[0])
        low, high = np.where(is_feasible, middle, low), np.where(is_feasible, high, middle)
    return np.where(is_possible, np.exp(low), 0.0)


def is_balanced(tables: SearchTables, stance: IntArray, pose: int) -> bool:
    """Return whether a stance (N,) balances the body with unlimited friction and torques."""
    statement = build_force_statement(
        tables.scene, build_stance_instants(tables, stance[None], np.array([pose]))
    )
    mu = statement.mu * statement.safety_friction / _MIN_FACTOR
    unlimited = replace(statement, mu=mu, max_torque=statement.max_torque * _UNLIMITED_TORQUE_SCALE)
    return bool(np.isfinite(_solve_batch(tables, unlimited)[0][0]))


def find_max_torque_factor(tables: SearchTables, stance: IntArray, pose: int) -> float:
    """Find the largest feasible S_tau of a stance (N,) with the spec's S_mu; 0 if none."""
    statement = build_force_statement(
        tables.scene, build_stance_instants(tables, stance[None], np.array([pose]))
    )
    stronger = replace(statement, max_torque=statement.max_torque * _TRIAL_TORQUE_SCALE)
    torque_use = float(_solve_batch(tables, stronger)[0][0])
    return 0.0 if not np.isfinite(torque_use) else 1.0 / max(torque_use * _TRIAL_TORQUE_SCALE, 1e-9)


@dataclass(frozen=True)
class InsufficientFriction:
    """A contact of an infeasible stance whose friction is insufficient."""

    limb: int
    needed: float  # friction coefficient
    available: float  # mu


def find_slipping_contacts(
    tables: SearchTables, stance: IntArray, pose: int, factor: float
) -> list[InsufficientFriction]:
    """Find contacts of a stance (N,) that use all friction at S_mu = `factor`, worst first."""
    pose_index = np.array([pose])
    statement = build_force_statement(
        tables.scene, build_stance_instants(tables, stance[None], pose_index)
    )
    scale = statement.safety_friction / (factor * (1 - 1e-3))
    force = _solve_batch(tables, replace(statement, mu=statement.mu * scale))[1][0]
    components = split_force(force, statement.normal[0])
    limit = components.normal * statement.mu[0] / statement.safety_friction
    limbs = np.flatnonzero((components.shear > limit * (1 + 1e-6)) & (stance != LIFTED))
    slips = [
        InsufficientFriction(
            int(i), float(components.shear[i] / components.normal[i]), float(statement.mu[0, i])
        )
        for i in limbs
    ]
    return sorted(slips, key=lambda slip: slip.available / slip.needed)
