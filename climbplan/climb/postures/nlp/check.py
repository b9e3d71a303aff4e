"""The exact check of a posture sequence, from the postures alone.

The check shares no expression with the NLP: rotations, kinematics and surfaces are those of the
robot and the terrain, evaluated in NumPy. No choice is fixed, and body and links are followed along
their whole paths. Blocks are named as in the NLP and in the checks of plans.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.body import compute_body_shortfall, hull_world
from climbplan.climb.clearance.limb_pairs import find_standing_overlap
from climbplan.climb.clearance.limbs import (
    INTERPOLATION_MARGIN,
    compute_world_capsules,
    find_closest_link,
    find_limb_shortfall,
)
from climbplan.climb.clearance.raw_surface import ToeContacts, find_nearest_raw
from climbplan.climb.clearance.swing import TOE_CLEARANCE, SwingBlocked, plan_swing_paths
from climbplan.climb.gait.gait import interpolate_poses, plan_instants
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import ReachFailure, Unresolved
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.surfaces import Tube

TOLERANCE = 1e-6  # [m] or [rad]
_NUM_TUBE_POSES = 13  # poses along a round at which the body must be inside a tube


@dataclass(frozen=True)
class Violation:
    """The worst point of one block of constraints."""

    name: str
    amount: float  # [m] or [rad], <= 0 if the block holds
    unit: str  # "m" or "rad"
    where: str  # "round 3, limb LM"

    @property
    def holds(self) -> bool:
        """Return whether the violation is within the tolerance."""
        return self.amount <= TOLERANCE

    def __str__(self) -> str:
        size = f"{1e3 * self.amount:.3g} mm"
        if self.unit == "rad":
            size = f"{np.rad2deg(self.amount):.3g} deg"
        return f"{self.name} at {self.where} by {size}"


@dataclass(frozen=True)
class _ViolationCollector:
    """Collects the worst point of every block."""

    limb_names: tuple[str, ...]
    violations: list[Violation]

    def add(self, name: str, amounts: Array, unit: str = "m", first_round: int = 1) -> None:
        """Add the worst entry of a block.

        Args:
            name: Name of the block.
            amounts: By round (M,), by round and limb (M, N), or with the body first (M, 1 + N).
            unit: "m" or "rad".
            first_round: Number of the first row's round.
        """
        amounts = np.nan_to_num(amounts, nan=np.inf)  # a diverged answer holds nothing
        worst = np.unravel_index(int(np.argmax(amounts)), amounts.shape)
        place = f"round {worst[0] + first_round}"
        if len(worst) > 1:
            row_names = ("body", *(f"limb {limb}" for limb in self.limb_names))
            place += f", {row_names[worst[1] - amounts.shape[1]]}"
        self.violations.append(Violation(name, float(amounts[worst]), unit, place))


def compute_posture_cost(scene: ClimbScene, rounds: Rounds) -> float:
    """Return the cost of chapter 5.1.3 [m^2]: squared distance to the goal and squared steps."""
    weights, goal = scene.spec.posture.weights, scene.goal
    return float(
        weights.goal * ((rounds.toes[-1] - goal.toes) ** 2).sum()
        + weights.goal_com * ((rounds.com[-1] - goal.com) ** 2).sum()
        + weights.goal_rotation * ((rounds.rpy[-1] - goal.rpy) ** 2).sum()
        + weights.com * (np.diff(rounds.com, axis=0) ** 2).sum()
        + weights.toe * (np.diff(rounds.toes, axis=0) ** 2).sum()
        + weights.rotation * (np.diff(rounds.rpy, axis=0) ** 2).sum()
    )


def check_postures(scene: ClimbScene, rounds: Rounds) -> tuple[Violation, ...]:
    """Return the worst violation of every block of constraints, joint bounds at all instants
    included.
    """
    findings = _ViolationCollector(scene.robot.limb_names, [])
    _check_steps(scene, rounds, findings)
    _check_workspaces(scene, rounds, findings)

    # Toes on surfaces that their limbs may use
    surfaces, allowed = scene.terrain.surfaces, scene.terrain.allowed
    distance_to_region = np.empty(rounds.region.shape)
    for j, i in np.ndindex(*distance_to_region.shape):
        surface = rounds.region[j, i]
        distance = surfaces[surface].distance(rounds.toes[j, i])
        distance_to_region[j, i] = distance if allowed[i, surface] else np.inf
    findings.add("contact.region", distance_to_region[1:])

    # Body clear of the terrain along its way
    body_violation = compute_body_shortfall(scene, rounds)
    wall = surfaces[0]
    if isinstance(wall, Tube):
        poses = interpolate_poses(rounds, np.linspace(0.0, 1.0, _NUM_TUBE_POSES))
        corners = hull_world(scene, *poses)[..., :2]  # (M, S, V, 2)
        corner_distance = np.linalg.norm(corners - wall.center, axis=-1).max(axis=(1, 2))
        body_violation = np.maximum(
            body_violation, corner_distance + scene.spec.posture.body_clearance - wall.radius
        )
    findings.add("body.clearance", body_violation)

    # Goal
    goal, task = scene.goal, scene.spec.task.goal
    last = rounds.count
    goal_distance = np.vstack([rounds.com[-1] - goal.com, rounds.toes[-1] - goal.toes])
    goal_distance = np.linalg.norm(goal_distance, axis=1)[None] - task.tolerance
    rotation_error = np.abs(rounds.rpy[-1:] - goal.rpy).max(axis=1)
    rotation_error -= np.deg2rad(task.rotation_tolerance_deg)
    findings.add("goal.position", goal_distance, first_round=last)
    findings.add("goal.rotation", rotation_error, "rad", first_round=last)

    # Joint bounds and links at all instants
    try:
        instants = plan_instants(scene, rounds)
    except ReachFailure as error:
        amount = max(error.missing, 10 * TOLERANCE)
        where = f"{error.where}, limb {error.limb} ({error.reason})"
        findings.violations.append(Violation("kinematics.forward", amount, "m", where))
    else:
        findings.violations.append(Violation("kinematics.forward", 0.0, "m", "no instant"))
        findings.violations.extend(_check_limb_clearance(scene, rounds, instants))
        collision = find_standing_overlap(scene, instants)
        overlap = Violation("limbs.self_collision", -np.inf, "m", "no instant")
        if collision is not None:
            where = f"{collision[1]}, {collision[0].describe(scene.robot)}"
            overlap = Violation("limbs.self_collision", collision[0].missing, "m", where)
        findings.violations.append(overlap)
    return tuple(findings.violations)


def _check_limb_clearance(
    scene: ClimbScene, rounds: Rounds, instants: Instants
) -> Iterator[Violation]:
    """Yield violations of the links' clearance: first at the instants, then along the swings."""
    standing = find_limb_shortfall(scene, rounds, instants)
    if standing is None:
        yield Violation("limbs.axis_collision", -np.inf, "m", "no solids")
        return
    links = compute_world_capsules(
        scene, instants.com, instants.rpy, instants.toes, instants.normal
    )
    limb_index, where, amount = standing.limb, standing.where, standing.missing
    nearest = []
    if scene.terrain.link_solids:
        closest = find_closest_link(scene, links)
        nearest.append((INTERPOLATION_MARGIN - closest.distance, closest.index))
    if scene.terrain.scan is not None:
        lift_height = instants.lifted[..., None] * scene.spec.trajectory.swing_clearance
        contact_points = instants.toes - lift_height * instants.normal
        contacts = ToeContacts(contact_points[..., None, :], instants.normal[..., None, :])
        raw = find_nearest_raw(scene.terrain.scan, links, contacts, INTERPOLATION_MARGIN)
        nearest.append((raw.missing, raw.index))
    for missing, (k, limb) in nearest:
        if missing > amount:
            limb_index, where = limb, instants.label(k, scene.robot.limb_names)
            amount = missing
    where += f", limb {scene.robot.limb_names[limb_index]}"
    yield Violation("limbs.axis_collision", amount, "m", where)
    if amount > TOLERANCE:
        return  # no need to look at the ways between
    try:
        plan_swing_paths(scene, rounds, instants)
    except SwingBlocked as error:
        shortfall = error.shortfall
        where = f"{shortfall.where}, {shortfall.describe(scene)}"
        yield Violation("swing.limb_free", shortfall.missing, "m", where)
    except Unresolved as error:
        yield Violation("swing.toe_free", TOE_CLEARANCE, "m", str(error.conflicts[0]))


def _check_steps(scene: ClimbScene, rounds: Rounds, findings: _ViolationCollector) -> None:
    """Add the violations of step lengths and rotation limits."""
    steps = scene.spec.posture.steps
    com = np.linalg.norm(np.diff(rounds.com, axis=0), axis=-1)
    toes = np.linalg.norm(np.diff(rounds.toes, axis=0), axis=-1)
    rotation_step = np.abs(np.diff(rounds.rpy, axis=0)).max(axis=-1)
    findings.add("steps.com", np.maximum(com - steps.com_max, steps.com_min - com))
    findings.add("steps.toe", np.maximum(toes - steps.toe_max, steps.toe_min - toes))
    findings.add("steps.rotation", rotation_step - np.deg2rad(steps.rotation_max_deg), "rad")
    rotation_from_level = np.abs(rounds.rpy[1:] - [0.0, 0.0, scene.start.rpy[2]])
    if scene.terrain.is_curved:
        rotation_from_level = rotation_from_level[:, :2]
    limit = np.deg2rad(scene.spec.posture.rotation_limit_deg)
    findings.add("rotation.limit", rotation_from_level.max(axis=1) - limit, "rad")


def _check_workspaces(scene: ClimbScene, rounds: Rounds, findings: _ViolationCollector) -> None:
    """Add the violations of the workspace balls about shoulders and nominal stances."""
    spec, robot = scene.spec.posture, scene.robot
    fraction = np.empty(robot.limb_count)
    fraction[list(scene.gait)] = np.arange(robot.limb_count) / robot.limb_count
    poses_at_move = interpolate_poses(rounds, fraction)
    poses_at_end = rounds.com[1:, None], rounds.rpy[1:, None]
    events = [(rounds.toes[1:], poses_at_end)]
    if spec.check_reach_during_round:
        events += [(rounds.toes[:-1], poses_at_move), (rounds.toes[1:], poses_at_move)]
    balls = [("reach", robot.shoulder_body, robot.reach)]
    if spec.stance_workspace:
        balls.append(("stance", robot.stance_body, robot.stance_radius))
    for label, centre, radius in balls:
        excess = []
        for toes, (com, rpy) in events:
            offset = np.einsum("...nab,nb->...na", rotation_world_body(rpy), centre)
            excess.append(np.linalg.norm(toes - com - offset, axis=-1) - radius)
        findings.add(f"workspace.{label}", np.max(excess, axis=0))
