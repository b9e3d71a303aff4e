"""The exact check of a posture sequence: every constraint again, from the postures alone.

It shares no expression with the NLP: rotations, kinematics and surfaces are those of the robot
and the terrain, evaluated in NumPy. Nothing is pinned, and body and links are followed along their
whole ways. Blocks are named as in the NLP and in the checks of plans.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.body import body_shortfall, hull_world
from climbplan.climb.clearance.limb_pairs import standing_overlap
from climbplan.climb.clearance.limbs import (
    BETWEEN,
    closest_link,
    limb_shortfall,
    world_capsules,
)
from climbplan.climb.clearance.raw_surface import Contacts, nearest_raw
from climbplan.climb.clearance.swing import TOE_CLEARANCE, SwingBlocked, swing_paths
from climbplan.climb.gait.gait import plan_instants, poses_between
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import NotProved, ReachFailure
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.surfaces import Tube

TOLERANCE = 1e-6  # [m] or [rad]
_POSES = 13  # poses along a round at which the body must be inside a tube


@dataclass(frozen=True)
class Violation:
    """The worst point of one block of constraints."""

    name: str
    amount: float  # [m] or [rad], <= 0 if the block holds
    unit: str  # "m" or "rad"
    where: str  # "round 3, limb LM"

    @property
    def holds(self) -> bool:
        """Within the tolerance."""
        return self.amount <= TOLERANCE

    def __str__(self) -> str:
        size = f"{1e3 * self.amount:.3g} mm"
        if self.unit == "rad":
            size = f"{np.rad2deg(self.amount):.3g} deg"
        return f"{self.name} at {self.where} by {size}"


@dataclass(frozen=True)
class _Findings:
    """Collects the worst point of every block."""

    limb_names: tuple[str, ...]
    found: list[Violation]

    def add(self, name: str, amounts: Array, unit: str = "m", first_round: int = 1) -> None:
        """amounts: by round (M,), by round and limb (M, N), or with the body first (M, 1 + N)."""
        amounts = np.nan_to_num(amounts, nan=np.inf)  # a diverged answer holds nothing
        worst = np.unravel_index(int(np.argmax(amounts)), amounts.shape)
        where = f"round {worst[0] + first_round}"
        if len(worst) > 1:
            parts = ("body", *(f"limb {limb}" for limb in self.limb_names))
            where += f", {parts[worst[1] - amounts.shape[1]]}"
        self.found.append(Violation(name, float(amounts[worst]), unit, where))


def posture_cost(scene: ClimbScene, rounds: Rounds) -> float:
    """Cost of chapter 5.1.3 [m^2]: the goal missed and the steps taken."""
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
    """Worst violation of every block of constraints, joint bounds at all instants included."""
    findings = _Findings(scene.robot.limb_names, [])
    _add_steps(scene, rounds, findings)
    _add_workspaces(scene, rounds, findings)

    # Toes on surfaces that their limbs may use
    surfaces, allowed = scene.terrain.surfaces, scene.terrain.allowed
    off = np.empty(rounds.region.shape)
    for j, i in np.ndindex(*off.shape):
        surface = rounds.region[j, i]
        distance = surfaces[surface].distance(rounds.toes[j, i])
        off[j, i] = distance if allowed[i, surface] else np.inf
    findings.add("contact.region", off[1:])

    # Body clear of the terrain along its way
    short = body_shortfall(scene, rounds)
    wall = surfaces[0]
    if isinstance(wall, Tube):
        poses = poses_between(rounds, np.linspace(0.0, 1.0, _POSES))
        corners = hull_world(scene, *poses)[..., :2]  # (M, S, V, 2)
        far = np.linalg.norm(corners - wall.center, axis=-1).max(axis=(1, 2))
        short = np.maximum(short, far + scene.spec.posture.body_clearance - wall.radius)
    findings.add("body.clearance", short)

    # Goal
    goal, task = scene.goal, scene.spec.task.goal
    last = rounds.count
    missed = np.vstack([rounds.com[-1] - goal.com, rounds.toes[-1] - goal.toes])
    missed = np.linalg.norm(missed, axis=1)[None] - task.tolerance
    turned = np.abs(rounds.rpy[-1:] - goal.rpy).max(axis=1)
    turned -= np.deg2rad(task.rotation_tolerance_deg)
    findings.add("goal.reached", missed, first_round=last)
    findings.add("goal.rotation", turned, "rad", first_round=last)

    # Joint bounds and links at all instants
    try:
        instants = plan_instants(scene, rounds)
    except ReachFailure as error:
        amount = max(error.missing, 10 * TOLERANCE)
        where = f"{error.where}, limb {error.limb} ({error.reason})"
        findings.found.append(Violation("kinematics.toes", amount, "m", where))
    else:
        findings.found.append(Violation("kinematics.toes", 0.0, "m", "no instant"))
        findings.found.extend(_limbs_free(scene, rounds, instants))
        meets = standing_overlap(scene, instants)
        overlap = Violation("limbs.self_collision", -np.inf, "m", "no instant")
        if meets is not None:
            where = f"{meets[1]}, {meets[0].words(scene.robot)}"
            overlap = Violation("limbs.self_collision", meets[0].missing, "m", where)
        findings.found.append(overlap)
    return tuple(findings.found)


def _limbs_free(scene: ClimbScene, rounds: Rounds, instants: Instants) -> Iterator[Violation]:
    """Room of links beside obstacles: standing and lifted, then on the ways of the swings."""
    standing = limb_shortfall(scene, rounds, instants)
    if standing is None:
        yield Violation("limbs.clearance", -np.inf, "m", "no solids")
        return
    links = world_capsules(scene, instants.com, instants.rpy, instants.toes, instants.normal)
    name, where, amount = standing.limb, standing.where, standing.missing
    near = []
    if scene.terrain.link_solids:
        found = closest_link(scene, links)
        near.append((BETWEEN - found.distance, found.index))
    if scene.terrain.scan is not None:
        lifted = instants.lifted[..., None] * scene.spec.trajectory.lift
        stood = instants.toes - lifted * instants.normal
        contacts = Contacts(stood[..., None, :], instants.normal[..., None, :])
        raw = nearest_raw(scene.terrain.scan, links, contacts, BETWEEN)
        near.append((raw.missing, raw.index))
    for missing, (k, limb) in near:
        if missing > amount:
            name, where = limb, instants.label(k, scene.robot.limb_names)
            amount = missing
    where += f", limb {scene.robot.limb_names[name]}"
    yield Violation("limbs.clearance", amount, "m", where)
    if amount > TOLERANCE:
        return  # no need to look at the ways between
    try:
        swing_paths(scene, rounds, instants)
    except SwingBlocked as error:
        short = error.shortfall
        where = f"{short.where}, {short.words(scene)}"
        yield Violation("swing.limb_free", short.missing, "m", where)
    except NotProved as error:
        yield Violation("swing.toe_free", TOE_CLEARANCE, "m", str(error.conflicts[0]))


def _add_steps(scene: ClimbScene, rounds: Rounds, findings: _Findings) -> None:
    steps = scene.spec.posture.steps
    com = np.linalg.norm(np.diff(rounds.com, axis=0), axis=-1)
    toes = np.linalg.norm(np.diff(rounds.toes, axis=0), axis=-1)
    turn = np.abs(np.diff(rounds.rpy, axis=0)).max(axis=-1)
    findings.add("steps.com", np.maximum(com - steps.com_max, steps.com_min - com))
    findings.add("steps.toe", np.maximum(toes - steps.toe_max, steps.toe_min - toes))
    findings.add("steps.rotation", turn - np.deg2rad(steps.rotation_max_deg), "rad")
    turned = np.abs(rounds.rpy[1:] - [0.0, 0.0, scene.start.rpy[2]])
    if scene.terrain.curved:
        turned = turned[:, :2]
    limit = np.deg2rad(scene.spec.posture.rotation_limit_deg)
    findings.add("rotation.limit", turned.max(axis=1) - limit, "rad")


def _add_workspaces(scene: ClimbScene, rounds: Rounds, findings: _Findings) -> None:
    spec, robot = scene.spec.posture, scene.robot
    share = np.empty(robot.limb_count)
    share[list(scene.gait)] = np.arange(robot.limb_count) / robot.limb_count
    moving = poses_between(rounds, share)
    at_end = rounds.com[1:, None], rounds.rpy[1:, None]
    events = [(rounds.toes[1:], at_end)]
    if spec.intermediate_reach:
        events += [(rounds.toes[:-1], moving), (rounds.toes[1:], moving)]
    balls = [("reach", robot.shoulder_body, robot.reach)]
    if spec.stance_workspace:
        balls.append(("stance", robot.stance_body, robot.stance_radius))
    for label, centre, radius in balls:
        beyond = []
        for toes, (com, rpy) in events:
            turned = np.einsum("...nab,nb->...na", rotation_world_body(rpy), centre)
            beyond.append(np.linalg.norm(toes - com - turned, axis=-1) - radius)
        findings.add(f"workspace.{label}", np.max(beyond, axis=0))
