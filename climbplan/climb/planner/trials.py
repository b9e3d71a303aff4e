"""What method `auto` tries: methods that can state the climb, and what the spec leaves open.

Left open are the height of a lift, the order of the limbs, the angles of the goal, and on ground
whether the body stands over the limbs that stay before each lift, each only where the spec does not
state it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.scene.within_reach import window_of
from climbplan.errors import NoPlanFound, ReachFailure
from climbplan.robots.five_bar import FiveBar
from climbplan.schema.overrides import Override
from climbplan.schema.stated import stated

_LIFTS = (0.03, 0.015)  # [m]
_UPWARD = 0.7  # of a normal: ground rather than wall
_AWAY = 0.6  # of the toes' level distance from the body, that it may shift at most
_FORCE_STAGES = ("force", "trajectory")  # that ask for postures chosen together with forces


@dataclass(frozen=True)
class Trial:
    """A method, with choices of what the spec leaves open."""

    name: str  # for people: "micp", "nlp, trajectory.lift=0.03"
    method: str  # of `solver.method`
    choices: tuple[Override, ...] = ()


def first_trial(scene: ClimbScene) -> Trial:
    """The global method where it can state the climb, else the one with exact rotations."""
    if window_of(scene) is not None:
        return Trial("windows", "auto")  # each by the first method that has a plan for it
    steps = scene.spec.posture.steps
    convex = not scene.terrain.curved and steps.com_min == 0 and steps.toe_min == 0
    return Trial("micp", "micp") if convex else Trial("nlp", "nlp")


def further_trials(scene: ClimbScene, error: NoPlanFound) -> Iterator[Trial]:
    """What the failure of the first trial suggests, the likeliest first."""
    first = first_trial(scene).method
    if first == "auto":
        yield from (_chosen(first, c) for c in _choices(scene) if c.key == "trajectory.lift")
        return
    methods = _methods(scene, error)
    suited = [choice for choice in _choices(scene) if _may_help(choice, error)]
    if error.stage in _FORCE_STAGES and (over := _over_the_others(scene)) is not None:
        yield _chosen(first, over)
        for order in (choice for choice in suited if choice.key == "task.gait"):
            name = f"{_chosen(first, over).name}, {order.key}={order.value}"
            yield Trial(name, first, (over, order))
    # Choices cost a run of the global method each, other methods tend to cost more
    if not _needs_choices(error):
        yield from (Trial(method, method) for method in methods)
        methods = ()
    yield from (_chosen(first, choice) for choice in suited)
    yield from (Trial(method, method) for method in methods)
    if error.stage != "force" and "nlp" in _methods(scene, error):
        yield from (_chosen("nlp", choice) for choice in suited)


def _needs_choices(error: NoPlanFound) -> bool:
    """Whether a limb in the air is what fails: a lower lift or another order is likelier to help
    than other postures."""
    return isinstance(error, ReachFailure) or error.stage in ("swing", "kinematics")


def _methods(scene: ClimbScene, error: NoPlanFound) -> tuple[str, ...]:
    """Methods beside the first that can state this robot and terrain."""
    robot = scene.robot
    if isinstance(robot.mechanism, FiveBar) or robot.gripper is not None:
        return ()  # the others state no closed linkages and no grips
    if robot.sole is not None:
        return ()  # and no flat feet
    if first_trial(scene).method == "nlp":
        return ()  # the others are convex
    if error.stage in _FORCE_STAGES:
        return ("coupled", "coupled-nlp", "nlp")
    return ("nlp", "coupled")


def _may_help(choice: Override, error: NoPlanFound) -> bool:
    """Whether a choice changes what the convex statement could not meet."""
    if error.stage == "force":
        return choice.key != "trajectory.lift"  # the limbs that stand bear the same loads
    if not isinstance(error, NoPostures):
        return True
    touched = {
        "trajectory.lift": ("limbs.clearance",),
        "task.gait": tuple(b for b in error.blocks if b.endswith(("_lift", "_place"))),
        "task.goal.rotation_tolerance_deg": ("goal.rotation", "steps.rotation"),
    }
    return not error.blocks.isdisjoint(touched[choice.key])


def _chosen(method: str, choice: Override) -> Trial:
    return Trial(f"{method}, {choice.key}={choice.value}", method, (choice,))


def _choices(scene: ClimbScene) -> Iterator[Override]:
    """What the spec leaves open, in other ways than by default."""
    spec = scene.spec
    if not stated(spec, "trajectory.lift"):
        for lift in _LIFTS:
            if lift < spec.trajectory.lift:
                yield _choice("trajectory.lift", f"{lift:g}")
    if not stated(spec, "task.gait"):
        for order in _orders(scene):
            yield _choice("task.gait", f"[{', '.join(order)}]")
    open_angles = ("task.goal.rpy_deg", "task.goal.rotation_tolerance_deg")
    if not any(stated(spec, key) for key in open_angles):
        limit = spec.posture.rotation_limit_deg
        if spec.task.goal.rotation_tolerance_deg < limit:
            yield _choice("task.goal.rotation_tolerance_deg", f"{limit:g}")


def _over_the_others(scene: ClimbScene) -> Override | None:
    """Leave for the body to stand over the limbs that stay, where all of them stand on ground."""
    key = "posture.steps.shift_max"
    normals = [
        scene.terrain.surfaces[int(r)].normal_at(toe)
        for r, toe in zip(scene.start.region, scene.start.toes, strict=True)
    ]
    if stated(scene.spec, key) or min(float(n[2]) for n in normals) < _UPWARD:
        return None
    away = np.linalg.norm((scene.start.toes - scene.start.com)[:, :2], axis=1).max()
    return _choice(key, f"{_AWAY * float(away):.2f}")


def _choice(key: str, value: str) -> Override:
    return Override(key, value, f"method auto, {key}={value}")


def _orders(scene: ClimbScene) -> Iterator[list[str]]:
    """Orders in which neighbours do not follow each other: from side to side, front to back."""
    robot = scene.robot
    rows = sorted(range(robot.limb_count), key=lambda i: -float(robot.shoulder_body[i, 1]))
    right = [i for i in rows if robot.shoulder_body[i, 0] > 0]
    left = [i for i in rows if robot.shoulder_body[i, 0] <= 0]
    if len(right) != len(left):
        return
    across = [i for pair in zip(right, reversed(left), strict=True) for i in pair]
    for order in (across, across[::-1]):
        if tuple(order) != scene.gait:
            yield [robot.limb_names[i] for i in order]
