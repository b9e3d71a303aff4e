"""The trials of method `auto`: methods that can state the climb, and choices that the spec leaves
open.

Choices concern the swing clearance, the order of the limbs, the angles of the goal and, on the
ground, whether the body shifts over the supporting limbs before each lift. Each is made only where
the spec does not state it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.climb.contact_search.suitability import find_obstacle_to_method, starts_on_ground
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.scene.within_reach import select_window
from climbplan.errors import NoPlanFound, ReachFailure
from climbplan.robots.five_bar import FiveBar
from climbplan.schema.overrides import Override
from climbplan.schema.stated import is_stated

_SWING_CLEARANCES = (0.03, 0.015)  # [m]
_MIN_UPWARD_NORMAL = 0.7  # of a normal: ground rather than wall
_SHIFT_FRACTION = 0.6  # of the toes' level distance from the body, that it may shift at most
_FORCE_STAGES = ("force", "trajectory")  # that ask for postures chosen together with forces


@dataclass(frozen=True)
class MethodVariant:
    """A method together with choices of what the spec leaves open."""

    name: str  # for people: "micp", "nlp, trajectory.swing_clearance=0.03"
    method: str  # of `solver.method`
    choices: tuple[Override, ...] = ()


_SEARCH = MethodVariant("contact-search", "contact-search")
_WINDOWS = MethodVariant("windows", "auto")  # each by the first method that has a plan for it


def select_first_trial(scene: ClimbScene) -> MethodVariant:
    """Return the method that is tried first.

    Long ways (`rounds: auto`, or a window) are planned by the contact search on ground, elsewhere
    in windows. All others by the global method where it can state the climb, else by the one with
    exact rotations.
    """
    if select_window(scene) is not None:
        return (
            _SEARCH
            if find_obstacle_to_method(scene) is None and starts_on_ground(scene)
            else _WINDOWS
        )
    steps = scene.spec.posture.steps
    convex = not scene.terrain.is_curved and steps.com_min == 0 and steps.toe_min == 0
    return MethodVariant("micp", "micp") if convex else MethodVariant("nlp", "nlp")


def generate_further_trials(scene: ClimbScene, error: NoPlanFound) -> Iterator[MethodVariant]:
    """Yield the trials that the failure of the first one suggests, the likeliest first."""
    first = select_first_trial(scene).method
    if select_window(scene) is not None:
        if first == _SEARCH.method:
            if (com_shift := _choose_com_shift(scene)) is not None:
                yield _build_trial(first, com_shift)
            yield _WINDOWS
        elif find_obstacle_to_method(scene) is None:
            yield _SEARCH
        yield from (
            _build_trial(first, c)
            for c in _generate_choices(scene)
            if c.key == "trajectory.swing_clearance"
        )
        return
    methods = _select_methods(scene, error)
    helpful = [choice for choice in _generate_choices(scene) if _may_help(choice, error)]
    if error.stage in _FORCE_STAGES and (com_shift := _choose_com_shift(scene)) is not None:
        yield _build_trial(first, com_shift)
        for order in (choice for choice in helpful if choice.key == "task.gait"):
            name = f"{_build_trial(first, com_shift).name}, {order.key}={order.value}"
            yield MethodVariant(name, first, (com_shift, order))
    # Choices cost a run of the global method each, other methods tend to cost more
    if not _needs_choices(error):
        yield from (MethodVariant(method, method) for method in methods)
        methods = ()
    yield from (_build_trial(first, choice) for choice in helpful)
    yield from (MethodVariant(method, method) for method in methods)
    if error.stage != "force" and "nlp" in _select_methods(scene, error):
        yield from (_build_trial("nlp", choice) for choice in helpful)


def _needs_choices(error: NoPlanFound) -> bool:
    """Return whether a limb in the air failed.

    A lower lift or another order is then likelier to help than other postures.
    """
    return isinstance(error, ReachFailure) or error.stage in ("swing", "kinematics")


def _select_methods(scene: ClimbScene, error: NoPlanFound) -> tuple[str, ...]:
    """Return the methods other than the first that can state this robot and terrain."""
    robot = scene.robot
    if isinstance(robot.mechanism, FiveBar) or robot.gripper is not None:
        return ()  # the others state no closed linkages and no grips
    if robot.sole is not None:
        return ()  # and no flat feet
    if select_first_trial(scene).method == "nlp":
        return ()  # the others are convex
    if error.stage in _FORCE_STAGES:
        return ("coupled", "coupled-nlp", "nlp")
    return ("nlp", "coupled")


def _may_help(choice: Override, error: NoPlanFound) -> bool:
    """Return whether a choice changes a constraint that the convex statement could not satisfy."""
    if error.stage == "force":
        return (
            choice.key != "trajectory.swing_clearance"
        )  # the limbs that stand bear the same loads
    if not isinstance(error, NoPostures):
        return True
    affected_blocks = {
        "trajectory.swing_clearance": ("limbs.axis_collision",),
        "task.gait": tuple(b for b in error.blocks if b.endswith(("_lift", "_place"))),
        "task.goal.rotation_tolerance_deg": ("goal.rotation", "steps.rotation"),
    }
    return not error.blocks.isdisjoint(affected_blocks[choice.key])


def _build_trial(method: str, choice: Override) -> MethodVariant:
    """Return a trial of a method with one choice."""
    return MethodVariant(f"{method}, {choice.key}={choice.value}", method, (choice,))


def _generate_choices(scene: ClimbScene) -> Iterator[Override]:
    """Yield choices other than the default of what the spec leaves open."""
    spec = scene.spec
    if not is_stated(spec, "trajectory.swing_clearance"):
        for clearance in _SWING_CLEARANCES:
            if clearance < spec.trajectory.swing_clearance:
                yield _build_override("trajectory.swing_clearance", f"{clearance:g}")
    if not is_stated(spec, "task.gait"):
        for order in _generate_limb_orders(scene):
            yield _build_override("task.gait", f"[{', '.join(order)}]")
    open_angles = ("task.goal.rpy_deg", "task.goal.rotation_tolerance_deg")
    if not any(is_stated(spec, key) for key in open_angles):
        limit = spec.posture.rotation_limit_deg
        if spec.task.goal.rotation_tolerance_deg < limit:
            yield _build_override("task.goal.rotation_tolerance_deg", f"{limit:g}")


def _choose_com_shift(scene: ClimbScene) -> Override | None:
    """Return a bound on the body's shift over the supporting limbs, if all of them stand on the
    ground.
    """
    key = "posture.steps.com_shift_max"
    normals = [
        scene.terrain.surfaces[int(r)].normal_at(toe)
        for r, toe in zip(scene.start.region, scene.start.toes, strict=True)
    ]
    if is_stated(scene.spec, key) or min(float(n[2]) for n in normals) < _MIN_UPWARD_NORMAL:
        return None
    max_distance = np.linalg.norm((scene.start.toes - scene.start.com)[:, :2], axis=1).max()
    return _build_override(key, f"{_SHIFT_FRACTION * float(max_distance):.2f}")


def _build_override(key: str, value: str) -> Override:
    """Return a choice as an override of a spec key."""
    return Override(key, value, f"method auto, {key}={value}")


def _generate_limb_orders(scene: ClimbScene) -> Iterator[list[str]]:
    """Yield orders that alternate between the sides, front to back, so that neighbours never
    follow.
    """
    robot = scene.robot
    rows = sorted(range(robot.limb_count), key=lambda i: -float(robot.shoulder_body[i, 1]))
    right = [i for i in rows if robot.shoulder_body[i, 0] > 0]
    left = [i for i in rows if robot.shoulder_body[i, 0] <= 0]
    if len(right) != len(left):
        return
    alternating = [i for pair in zip(right, reversed(left), strict=True) for i in pair]
    for order in (alternating, alternating[::-1]):
        if tuple(order) != scene.gait:
            yield [robot.limb_names[i] for i in order]
