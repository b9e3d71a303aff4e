"""The scene of a transition: robot, terrain, start and goal postures as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.raw_surface import THE_SCAN, compute_raw_body_distance
from climbplan.climb.planner.proof import find_missing_support, find_unreachable_toes
from climbplan.climb.scene.climb_scene import (
    ClimbStance,
    MotionScene,
    add_raw_surface,
    build_stance,
    warn_of_reversed_regions,
)
from climbplan.climb.scene.plausible_lengths import find_implausible_lengths
from climbplan.climb.schema.transition import TransitionSpec
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.errors import (
    Conflict,
    Infeasible,
    ReachFailure,
    Remedy,
    SpecError,
    SpecMistake,
    Unresolved,
)
from climbplan.robots.any_robot import build_robot, require_no_flat_feet
from climbplan.robots.kinematics import require_reachable, to_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.task_robot import with_stance
from climbplan.terrain.model import Terrain, build_terrain
from climbplan.terrain.solids import Solid

_PENETRATION_TOLERANCE = 1e-3  # [m] of links into solids, as in the verification


@dataclass(frozen=True)
class TransitionScene(MotionScene):
    """The data that the transition planner starts from."""

    spec: TransitionSpec


def build_transition(loaded: LoadedTransition) -> TransitionScene:
    """Build the scene of a validated spec.

    Raises:
        SpecError: Toes lie off their surfaces or inside a box, or lengths are in another unit.
        Unresolved: The body is too close to a solid at start or goal, or goal toes are not reached.
        Infeasible: One of these is proved.
    """
    spec = loaded.spec
    pointed = require_no_flat_feet(loaded.robot, "transitions")
    robot = with_stance(build_robot(pointed), spec.task.stance)
    terrain = build_terrain(spec.terrain, robot)
    terrain = add_raw_surface(terrain, spec, robot, loaded.directory)
    mistakes = list(find_implausible_lengths(spec, robot, terrain))
    if mistakes:
        raise SpecError(loaded.source, mistakes)
    start = build_stance(spec.task.start, "task.start", robot, terrain, mistakes)
    goal = build_stance(spec.task.goal, "task.goal", robot, terrain, mistakes)
    for key, stance in (("task.start", start), ("task.goal", goal)):
        mistakes += _find_covered_toes(key, stance, terrain, robot)
    if mistakes:
        raise SpecError(loaded.source, mistakes)
    warn_of_reversed_regions(terrain, (start, goal))
    scene = TransitionScene(spec, robot, terrain, start, goal)
    for name, stance in (("start posture", start), ("goal posture", goal)):
        _require_clearance(scene, name, stance)
        _require_reach(scene, name, stance)
    return scene


def _find_covered_toes(
    key: str, stance: ClimbStance, terrain: Terrain, robot: Robot
) -> list[SpecMistake]:
    """Find toes that a box or obstacle covers: the point just off their surface is inside."""
    mistakes = []
    size = 0.0 if robot.foot is None else robot.foot.radius
    for limb, name in enumerate(robot.limb_names):
        toe = stance.toes[limb]
        outside = toe + 2 * _PENETRATION_TOLERANCE * terrain.surfaces[
            stance.region[limb]
        ].normal_at(toe)
        mistakes += [
            SpecMistake(f"{key}.toes.{name}", f"{name} is covered by {solid.name!r}: move one")
            for solid in terrain.obstacles
            if float(solid.face_distance(outside)) < size - _PENETRATION_TOLERANCE * (size > 0)
        ]
    return mistakes


def _require_clearance(scene: TransitionScene, name: str, stance: ClimbStance) -> None:
    """Raise Unresolved or Infeasible unless the body hull keeps its clearance from every solid."""
    hull = stance.com + scene.robot.body_hull @ rotation_world_body(stance.rpy).T
    min_clearance = scene.spec.posture.body_clearance
    scan = scene.terrain.scan
    if (
        scan is not None
        and (clearance := float(compute_raw_body_distance(scan, hull, min_clearance)))
        < min_clearance
    ):
        clearance_text = (
            f"the body {1e3 * min_clearance:.0f} mm clear of {THE_SCAN} "
            f"(it has {1e3 * clearance:.0f})"
        )
        raise Unresolved(
            f"the body is too close to obstacles in the {name}",
            [Conflict(name, (clearance_text,))],
            because="the clearance required is posture.body_clearance",
            stage="scene",
            remedies=_suggest_clearance(min_clearance, clearance),
        )
    for solid in scene.terrain.solids:
        clearance = compute_hull_distance(hull, solid)
        if clearance < min_clearance:
            clearance_text = (
                f"the body {1e3 * min_clearance:.0f} mm clear of {solid.name!r} "
                f"(it has {1e3 * clearance:.0f})"
            )
            conflict = Conflict(name, (clearance_text,))
            if float(solid.face_distance(stance.com)) < 0:
                raise Infeasible(
                    f"the body is too close to obstacles in the {name}", [conflict], stage="scene"
                )
            raise Unresolved(
                f"the body is too close to obstacles in the {name}",
                [conflict],
                because="the distance is measured to faces of the solid and required by "
                "posture.body_clearance",
                stage="scene",
                remedies=_suggest_clearance(min_clearance, clearance),
            )


def _suggest_clearance(min_clearance: float, clearance: float) -> tuple[Remedy, ...]:
    """Suggest the clearance that the body has."""
    if clearance < 0:
        return ()
    value = np.floor(1e3 * clearance) / 1e3
    text = f"body clearance of {1e3 * value:.0f} mm"
    return (Remedy(text, "posture.body_clearance", float(value)),)


def compute_hull_distance(hull: Array, solid: Solid) -> float:
    """Compute the distance between a hull (8, 3) and a solid by the solid's faces [m].

    It is a lower bound of the true distance, negative if they overlap.
    """
    return float((hull @ solid.A.T - solid.b).min(axis=0).max())


def _require_reach(scene: TransitionScene, name: str, stance: ClimbStance) -> None:
    toes = to_body(stance.com, stance.rpy, stance.toes)
    if proofs := [*find_unreachable_toes(scene), *find_missing_support(scene)]:
        raise Infeasible("no plan exists", proofs, stage="scene")
    try:
        require_reachable(scene.robot, toes, name)
    except ReachFailure as error:
        if name != "goal posture":
            raise
        walls = scene.spec.terrain.walls
        hint = f"; the walls are {walls.gap:g} m apart" if walls is not None else ""
        shortest = _find_widest_gap(scene, stance)
        remedies: tuple[Remedy, ...] = ()
        if walls is not None and shortest:
            gap = float(np.floor(1e3 * shortest)) / 1e3
            remedies = (Remedy(f"walls {gap:.3f} m apart", "terrain.walls.gap", gap),)
        raise Unresolved(
            f"{error}{hint}",
            [Conflict(name, (f"reach of {error.limb}",), remedies)],
            because="toes that the spec leaves out are put nearest to the stance",
            stage="scene",
        ) from error


def _find_widest_gap(scene: TransitionScene, stance: ClimbStance) -> float | None:
    """Find the widest gap between walls at which all limbs reach their goal; None if none."""
    robot = scene.robot
    current_gap = float(np.ptp(stance.toes[:, 0]))
    for gap in np.arange(np.floor(current_gap * 100) / 100, 0.3, -0.01):
        toes = stance.toes * [gap / current_gap, 1.0, 1.0]
        try:
            require_reachable(robot, to_body(stance.com, stance.rpy, toes), "")
        except ReachFailure:
            continue
        return float(gap) + 2 * robot.standoff
    return None
