"""The scene of a transition: robot, terrain, start and goal postures in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.raw_surface import THE_SCAN, raw_body_room
from climbplan.climb.planner.proof import no_support, out_of_reach
from climbplan.climb.scene.climb_scene import (
    MotionScene,
    Stance,
    stance_of,
    warn_of_backs,
    with_scan,
)
from climbplan.climb.scene.plausible_lengths import implausible_lengths
from climbplan.climb.schema.transition import TransitionSpec
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.errors import (
    Conflict,
    Infeasible,
    NotProved,
    ReachFailure,
    Remedy,
    SpecError,
    SpecMistake,
)
from climbplan.robots.any_robot import build_robot, without_flat_feet
from climbplan.robots.kinematics import require_reachable, to_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.task_robot import with_stance
from climbplan.terrain.model import Terrain, build_terrain
from climbplan.terrain.solids import Solid

_INSIDE = 1e-3  # [m] links may be this deep in a solid, as the verification has it


@dataclass(frozen=True)
class TransitionScene(MotionScene):
    """All numbers the transition planner starts from."""

    spec: TransitionSpec


def build_transition(loaded: LoadedTransition) -> TransitionScene:
    """Numbers of a validated spec.

    Raises SpecError for toes off their surfaces or inside a box, and for lengths in another unit,
    NotProved for a body that has
    no room at the start or the goal, and for goal toes out of reach; Infeasible where that is
    proved.
    """
    spec = loaded.spec
    pointed = without_flat_feet(loaded.robot, "transitions")
    robot = with_stance(build_robot(pointed), spec.task.stance)
    terrain = build_terrain(spec.terrain, robot)
    terrain = with_scan(terrain, spec, robot, loaded.directory)
    mistakes = list(implausible_lengths(spec, robot, terrain))
    if mistakes:
        raise SpecError(loaded.source, mistakes)
    start = stance_of(spec.task.start, "task.start", robot, terrain, mistakes)
    goal = stance_of(spec.task.goal, "task.goal", robot, terrain, mistakes)
    for key, stance in (("task.start", start), ("task.goal", goal)):
        mistakes += _buried(key, stance, terrain, robot)
    if mistakes:
        raise SpecError(loaded.source, mistakes)
    warn_of_backs(terrain, (start, goal))
    scene = TransitionScene(spec, robot, terrain, start, goal)
    for name, stance in (("start posture", start), ("goal posture", goal)):
        _require_room(scene, name, stance)
        _require_reach(scene, name, stance)
    return scene


def _buried(key: str, stance: Stance, terrain: Terrain, robot: Robot) -> list[SpecMistake]:
    """Toes that a box or obstacle covers: the point just off their surface is inside."""
    found = []
    size = 0.0 if robot.foot is None else robot.foot.radius
    for limb, name in enumerate(robot.limb_names):
        toe = stance.toes[limb]
        off = toe + 2 * _INSIDE * terrain.surfaces[stance.region[limb]].normal_at(toe)
        found += [
            SpecMistake(f"{key}.toes.{name}", f"{name} is covered by {solid.name!r}: move one")
            for solid in terrain.obstacles
            if float(solid.face_distance(off)) < size - _INSIDE * (size > 0)
        ]
    return found


def _require_room(scene: TransitionScene, name: str, stance: Stance) -> None:
    """The body hull keeps its clearance from every solid."""
    hull = stance.com + scene.robot.body_hull @ rotation_world_body(stance.rpy).T
    asked = scene.spec.posture.body_clearance
    scan = scene.terrain.scan
    if scan is not None and (room := float(raw_body_room(scan, hull, asked))) < asked:
        what = f"the body {1e3 * asked:.0f} mm clear of {THE_SCAN} (it has {1e3 * room:.0f})"
        raise NotProved(
            f"the {name} has no room",
            [Conflict(name, (what,))],
            because="the clearance asked is posture.body_clearance",
            stage="scene",
            remedies=_narrower(asked, room),
        )
    for solid in scene.terrain.solids:
        room = hull_room(hull, solid)
        if room < asked:
            what = (
                f"the body {1e3 * asked:.0f} mm clear of {solid.name!r} (it has {1e3 * room:.0f})"
            )
            conflict = Conflict(name, (what,))
            if float(solid.face_distance(stance.com)) < 0:
                raise Infeasible(f"the {name} has no room", [conflict], stage="scene")
            raise NotProved(
                f"the {name} has no room",
                [conflict],
                because="the room is measured by the solid's faces, at posture.body_clearance",
                stage="scene",
                remedies=_narrower(asked, room),
            )


def _narrower(asked: float, room: float) -> tuple[Remedy, ...]:
    """The clearance that there is room for."""
    if room < 0:
        return ()
    value = np.floor(1e3 * room) / 1e3
    words = f"body clearance of {1e3 * value:.0f} mm"
    return (Remedy(words, "posture.body_clearance", float(value)),)


def hull_room(hull: Array, solid: Solid) -> float:
    """Room [m] between a hull (8, 3) and a solid by the solid's faces, negative if they overlap.

    The true distance is no less.
    """
    return float((hull @ solid.A.T - solid.b).min(axis=0).max())


def _require_reach(scene: TransitionScene, name: str, stance: Stance) -> None:
    toes = to_body(stance.com, stance.rpy, stance.toes)
    if proofs := [*out_of_reach(scene), *no_support(scene)]:
        raise Infeasible("no plan exists", proofs, stage="scene")
    try:
        require_reachable(scene.robot, toes, name)
    except ReachFailure as error:
        if name != "goal posture":
            raise
        walls = scene.spec.terrain.walls
        hint = f"; the walls are {walls.gap:g} m apart" if walls is not None else ""
        shortest = _widest_gap(scene, stance)
        cure: tuple[Remedy, ...] = ()
        if walls is not None and shortest:
            gap = float(np.floor(1e3 * shortest)) / 1e3
            cure = (Remedy(f"walls {gap:.3f} m apart", "terrain.walls.gap", gap),)
        raise NotProved(
            f"{error}{hint}",
            [Conflict(name, (f"reach of {error.limb}",), cure)],
            because="toes that the spec leaves out are put nearest to the stance",
            stage="scene",
        ) from error


def _widest_gap(scene: TransitionScene, stance: Stance) -> float | None:
    """The widest gap between walls at which all limbs reach their goal; None if there is none."""
    robot = scene.robot
    now = float(np.ptp(stance.toes[:, 0]))
    for gap in np.arange(np.floor(now * 100) / 100, 0.3, -0.01):
        toes = stance.toes * [gap / now, 1.0, 1.0]
        try:
            require_reachable(robot, to_body(stance.com, stance.rpy, toes), "")
        except ReachFailure:
            continue
        return float(gap) + 2 * robot.standoff
    return None
