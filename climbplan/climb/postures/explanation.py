"""Why there are no postures, in the robot's terms.

First what can be said by arithmetic (start and goal on their own, distance against rounds), then
the constraints that the closest posture sequence found still violates, with their amounts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from climbplan.climb.scene import ClimbScene, Stance
from climbplan.errors import Conflict, Infeasible, ReachFailure, Remedy
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.robots.kinematics import require_reachable, to_body
from climbplan.solvers.elastic import Violations, least_violations

_SHOWN = 6  # violations listed
_SMALL = 5e-4  # [m or rad] below which a violation is not worth a line

_WORDS = {
    "posture.com_step": "body step {mm} longer than com_max",
    "posture.toe_step": "toe step {mm} longer than toe_max",
    "posture.rotation_step": "turn {deg} larger than rotation_max_deg",
    "posture.reach": "toe {mm} out of reach",
    "posture.reach_lift": "toe {mm} out of reach when it is lifted",
    "posture.reach_place": "toe {mm} out of reach when it is placed",
    "posture.stance": "toe {mm} outside its stance workspace",
    "posture.stance_lift": "toe {mm} outside its stance workspace when it is lifted",
    "posture.stance_place": "toe {mm} outside its stance workspace when it is placed",
    "posture.contact_region": "toe {mm} off every contact region it may use",
    "posture.goal_com": "body {mm} further from the goal than its tolerance",
    "posture.goal_toes": "toe {mm} further from its goal than the tolerance",
    "posture.goal_rotation": "rotation {deg} further from the goal than its tolerance",
    "posture.body_free": "body {mm} into an obstacle or out of free space",
    "posture.limb_free": "limb {mm} too close to an obstacle for one side of it",
}


def explain_infeasible(scene: ClimbScene, program: Program, instance: Instance) -> Infeasible:
    """The error to raise for a posture problem that is proved infeasible."""
    conflicts = [*_stances(scene), *_distances(scene)]
    if conflicts:
        return Infeasible("no posture sequence exists", conflicts)
    found = least_violations(instance, _straight(scene, program))
    if found is not None:
        conflicts = list(_violated(scene, program, found))
    head = "no posture sequence exists under the given bounds"
    if conflicts:
        head += "; the closest one found still has"
    return Infeasible(head, conflicts)


def _stances(scene: ClimbScene) -> Iterator[Conflict]:
    """Start and goal on their own: can the limbs stand there at all?"""
    for name, stance in (("start", scene.start), ("goal", scene.goal)):
        try:
            require_reachable(scene.robot, _toes_body(stance), f"{name} posture")
        except ReachFailure as failure:
            yield Conflict(f"{name} posture", (_reach_words(failure),), in_words=True)


def _toes_body(stance: Stance) -> Array:
    return to_body(stance.com, stance.rpy, stance.toes)


def _reach_words(failure: ReachFailure) -> str:
    gap = f" by {1e3 * failure.missing:.1f} mm" if failure.missing > 0 else ""
    return f"{failure.limb} cannot reach its toe ({failure.reason}{gap})"


def _distances(scene: ClimbScene) -> Iterator[Conflict]:
    """The straight way against what the rounds can cover."""
    steps, goal = scene.spec.posture.steps, scene.spec.task.goal
    rounds = scene.spec.task.rounds
    turn = np.abs(scene.goal.rpy - scene.start.rpy).max() - np.deg2rad(goal.rotation_tolerance_deg)
    ways = [
        (
            "the body's way to the goal",
            float(np.linalg.norm(scene.goal.com - scene.start.com)) - goal.tolerance,
            steps.com_max,
        ),
        *(
            (
                f"{name}'s way to its goal",
                float(np.linalg.norm(scene.goal.toes[i] - scene.start.toes[i])) - goal.tolerance,
                steps.toe_max,
            )
            for i, name in enumerate(scene.robot.limb_names)
        ),
        ("the turn to the goal", float(turn), float(np.deg2rad(steps.rotation_max_deg))),
    ]
    for what, way, step in ways:
        needed = math.ceil(way / step - 1e-9)
        if needed > rounds:
            unit = f"{np.rad2deg(way):.1f} deg" if "turn" in what else f"{way:.3f} m"
            largest = f"{np.rad2deg(step):.0f} deg" if "turn" in what else f"{1e3 * step:.0f} mm"
            yield Conflict(
                f"{rounds} rounds",
                (f"{what}, {unit} in steps of at most {largest}, is too long",),
                (Remedy(f"rounds >= {needed}", "task.rounds", needed),),
                in_words=True,
            )


def _straight(scene: ClimbScene, program: Program) -> Array:
    """Postures on the straight way from start to goal, as a point of the program."""
    share = np.linspace(0.0, 1.0, scene.spec.task.rounds + 1)[1:]

    def mixed(start: Array, goal: Array) -> Array:
        at = share.reshape(-1, *[1] * start.ndim)
        return start + at * (goal - start)

    start, goal = scene.start, scene.goal
    return program.point(
        {
            "toe": mixed(start.toes, goal.toes),
            "com": mixed(start.com, goal.com),
            "rpy": mixed(start.rpy, goal.rpy),
        }
    )


def _violated(scene: ClimbScene, program: Program, found: Violations) -> Iterator[Conflict]:
    """The largest violations, one line each."""
    lines: list[tuple[float, str, tuple[int, ...]]] = []
    blocks = program.blocks

    def collect(name: str, shape: tuple[int, ...], values: Array) -> None:
        for index, value in np.ndenumerate(values.reshape(shape)):
            if value > _SMALL:
                lines.append((float(value), name, index))

    start = 0
    for rows in blocks.rows:
        collect(rows.name, rows.shape, found.rows[start : start + len(rows.expression)])
        start += len(rows.expression)
    for ball, values in zip(blocks.balls, found.balls, strict=True):
        collect(ball.name, ball.shape, values)
    start = 0
    for choice in blocks.choices:
        count = len(choice.alternatives)
        collect(choice.name, choice.shape, found.choices[start : start + count])
        start += count
    lines.sort(key=lambda line: -line[0])
    for value, name, index in lines[:_SHOWN]:
        yield Conflict(_place(scene, name, index), (_words(name, value),), in_words=True)


def _words(name: str, value: float) -> str:
    key = name if name in _WORDS else name.rpartition("_")[0]
    return _WORDS[key].format(mm=f"{1e3 * value:.0f} mm", deg=f"{np.rad2deg(value):.1f} deg")


def _place(scene: ClimbScene, name: str, index: tuple[int, ...]) -> str:
    """Round and limb of an entry of a block."""
    names = scene.robot.limb_names
    if name.startswith("posture.goal"):
        return f"goal, {names[index[0]]}" if name == "posture.goal_toes" else "goal"
    words = f"round {index[0] + 1}"
    per_limb = len(index) > 1 and name != "posture.rotation_step"
    return f"{words}, {names[index[1]]}" if per_limb else words
