"""Why the convex method has no postures, in the robot's terms, and what may help.

First what can be said by arithmetic (start and goal on their own, distance against rounds), then
the constraints that the closest posture sequence found still violates, with their amounts and the
keys of the spec that stand for them. All of this is about a restriction of the problem
(`BOUND_SCOPE`): it proves nothing. What is proved is told by `climbplan.climb.planner.proof`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.scene.climb_scene import ClimbScene, Stance, normals_under
from climbplan.errors import Conflict, NotProved, ReachFailure, Remedy
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.robots.kinematics import require_reachable, sole_turns, to_body

if TYPE_CHECKING:
    from climbplan.solvers.elastic import Violations

_SHOWN = 6  # violations listed
_SMALL = 5e-4  # [m or rad] below which a violation is not worth a line

# The bound of the convex statement is one of that statement: exact rotations may cost less.
BOUND_SCOPE = (
    "rotations and knees linearised, workspaces as balls, body and limbs beyond one face of every "
    "obstacle in each round"
)

DEFAULT_STEPS = (
    "steps (`posture.steps`) and toes of the goal are our choice where the spec does not state them"
)

_WORDS = {
    "steps.com": "body step {mm} longer than com_max",
    "steps.toe": "toe step {mm} longer than toe_max",
    "steps.first_toe": "toe step {mm} longer than toe_max",
    "steps.rotation": "turn {deg} larger than rotation_max_deg",
    "workspace.reach": "toe {mm} out of reach",
    "workspace.reach_level": "toe {mm} out of reach at any rotation allowed",
    "workspace.reach_lift": "toe {mm} out of reach when it is lifted",
    "workspace.reach_place": "toe {mm} out of reach when it is placed",
    "workspace.stance": "toe {mm} outside its stance workspace",
    "workspace.stance_lift": "toe {mm} outside its stance workspace when it is lifted",
    "workspace.stance_place": "toe {mm} outside its stance workspace when it is placed",
    "workspace.turn": "toe {mm} beyond the turn of its first joint",
    "contact.region": "toe {mm} off {alternative}, the nearest region it may use",
    "goal.com": "body {mm} further from the goal than its tolerance",
    "goal.toes": "toe {mm} further from its goal than the tolerance",
    "goal.rotation": "rotation {deg} further from the goal than its tolerance",
    "body.clearance": "body {mm} too close to pass {alternative}",
    "limbs.clearance": "limb {mm} too close to stay {alternative}",
}

_TURN = "workspace.turn"  # with the limb's name

Change = Callable[[ClimbScene, float], Remedy | None]


def _up(value: float, digits: int = 3) -> float:
    """Upwards to so many decimals."""
    return math.ceil(value * 10**digits - 1e-6) / 10**digits


def _step(key: str) -> Change:
    def change(scene: ClimbScene, amount: float) -> Remedy:
        value = _up(getattr(scene.spec.posture.steps, key) + amount)
        return Remedy(f"steps of {1e3 * value:.0f} mm", f"posture.steps.{key}", value)

    return change


def _turn(scene: ClimbScene, amount: float) -> Remedy:
    value = _up(scene.spec.posture.steps.rotation_max_deg + float(np.rad2deg(amount)), 1)
    return Remedy(f"turns of {value:g} deg", "posture.steps.rotation_max_deg", value)


def _tolerance(scene: ClimbScene, amount: float) -> Remedy:
    value = _up(scene.spec.task.goal.tolerance + amount)
    return Remedy(f"a goal met to {1e3 * value:.0f} mm", "task.goal.tolerance", value)


def _goal_turn(scene: ClimbScene, amount: float) -> Remedy:
    value = _up(scene.spec.task.goal.rotation_tolerance_deg + float(np.rad2deg(amount)), 1)
    return Remedy(f"a goal met to {value:g} deg", "task.goal.rotation_tolerance_deg", value)


def _clearance(key: str) -> Change:
    def change(scene: ClimbScene, amount: float) -> Remedy | None:
        value = math.floor(1e3 * (getattr(scene.spec.posture, key) - amount) + 1e-6) / 1e3
        if value < 0:
            return None
        return Remedy(f"{key.replace('_', ' ')} of {1e3 * value:.0f} mm", f"posture.{key}", value)

    return change


def _without(key: str, words: str) -> Change:
    return lambda scene, amount: Remedy(words, f"posture.{key}", "false")


# What in the spec stands for a block, changed by the amount that is missing. Whether it is enough
# is found out by planning with it (`climbplan.climb.planner.remedies`).
_CHANGES: dict[str, Change] = {
    "steps.com": _step("com_max"),
    "steps.toe": _step("toe_max"),
    "steps.rotation": _turn,
    "goal.com": _tolerance,
    "goal.toes": _tolerance,
    "goal.rotation": _goal_turn,
    "body.clearance": _clearance("body_clearance"),
    "limbs.clearance": _clearance("limb_clearance"),
    **{
        f"workspace.stance{when}": _without("stance_workspace", "toes anywhere within reach")
        for when in ("", "_lift", "_place")
    },
}


class NoPostures(NotProved):
    """The convex statement has no solution.

    changes: of the spec, for what the closest sequence violates; not tried yet. blocks: that it
    violates, by name; none where arithmetic says why.
    """

    def __init__(
        self,
        message: str,
        conflicts: list[Conflict],
        changes: tuple[Remedy, ...] = (),
        blocks: frozenset[str] = frozenset(),
        because: str = f"method micp has {BOUND_SCOPE}",
    ) -> None:
        super().__init__(message, conflicts, because=because, stage="posture")
        self.changes = changes
        self.blocks = blocks


def explain_infeasible(scene: ClimbScene, program: Program, instance: Instance) -> NoPostures:
    """The error to raise for a posture program that is proved to have no solution."""
    from climbplan.climb.postures.passage import closed_way
    from climbplan.climb.postures.ways import ways_too_long
    from climbplan.solvers.elastic import least_violations

    for conflicts, because in (
        ([*_stances(scene), *closed_way(scene)], f"method micp has {BOUND_SCOPE}"),
        ([way.conflict for way in ways_too_long(scene)], DEFAULT_STEPS),
    ):
        if conflicts:
            # Each remedy meets its own conflict; if it is enough is found out by planning with it
            changes = tuple(r for c in conflicts for r in c.remedies)
            bare = [replace(c, remedies=()) for c in conflicts]
            return NoPostures("no posture sequence found", bare, changes, because=because)
    head = "no posture sequence found under the given bounds"
    found = least_violations(instance, _straight(scene, program))
    if found is None:
        return NoPostures(head, [])
    conflicts = list(violated(scene, program, found))
    if conflicts:
        head += "; the closest one found still has"
    blocks = frozenset(_block(name) for _, name, _, _ in _lines(program, found))
    return NoPostures(head, conflicts, needed_changes(scene, program, found), blocks)


def _stances(scene: ClimbScene) -> Iterator[Conflict]:
    """Start and goal on their own: can the limbs stand there at all?"""
    for name, stance in (("start", scene.start), ("goal", scene.goal)):
        try:
            normal = normals_under(scene.terrain, stance.toes, stance.region)
            turns = sole_turns(scene.robot, stance.rpy, normal)
            require_reachable(scene.robot, _toes_body(stance), f"{name} posture", turns)
        except ReachFailure as failure:
            yield Conflict(f"{name} posture", (_reach_words(failure),), in_words=True)


def _toes_body(stance: Stance) -> Array:
    return to_body(stance.com, stance.rpy, stance.toes)


def _reach_words(failure: ReachFailure) -> str:
    gap = f" by {1e3 * failure.missing:.1f} mm" if failure.missing > 0 else ""
    return f"{failure.limb} cannot reach its toe ({failure.reason}{gap})"


def _straight(scene: ClimbScene, program: Program) -> Array:
    """Postures on the straight way from start to goal, as a point of the program."""
    share = np.linspace(0.0, 1.0, scene.spec.task.round_count + 1)[1:]

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


Line = tuple[float, str, tuple[int, ...], str]
"""Amount [m or rad], block, entry of the block, and the alternative that was chosen there."""


def _lines(program: Program, found: Violations) -> list[Line]:
    """All violations worth a line, largest first."""
    lines: list[Line] = []
    blocks = program.blocks

    def collect(name: str, shape: tuple[int, ...], values: Array, chosen: list[str]) -> None:
        for place, (index, value) in enumerate(np.ndenumerate(values.reshape(shape))):
            if value > _SMALL:
                lines.append((float(value), name, index, chosen[place] if chosen else ""))

    start = 0
    for rows in blocks.rows:
        collect(rows.name, rows.shape, found.rows[start : start + len(rows.expression)], [])
        start += len(rows.expression)
    for ball, values in zip(blocks.balls, found.balls, strict=True):
        collect(ball.name, ball.shape, values, [])
    start = 0
    for choice in blocks.choices:
        count = len(choice.alternatives)
        here = slice(start, start + count)
        names = [
            own[k].name for own, k in zip(choice.alternatives, found.assignment[here], strict=True)
        ]
        collect(choice.name, choice.shape, found.choices[here], names)
        start += count
    return sorted(lines, key=lambda line: -line[0])


def violated(scene: ClimbScene, program: Program, found: Violations) -> Iterator[Conflict]:
    """The largest violations, one line each."""
    for value, name, index, chosen in _lines(program, found)[:_SHOWN]:
        words = _words(scene, name, value, chosen)
        yield Conflict(_place(scene, name, index), (words,), in_words=True)


def needed_changes(scene: ClimbScene, program: Program, found: Violations) -> tuple[Remedy, ...]:
    """For every block that is violated the change of the spec that its largest amount asks for."""
    changes: dict[str, Remedy] = {}
    for value, name, _, _ in _lines(program, found):
        change = _CHANGES.get(_block(name))
        remedy = change(scene, value) if change is not None else None
        if remedy is not None:
            changes.setdefault(remedy.key, remedy)
    return tuple(changes.values())


def _block(name: str) -> str:
    """The block's name without the number of an obstacle or the name of a limb."""
    if name.startswith(_TURN):
        return _TURN
    return name if name in _WORDS else name.rpartition("_")[0]


def _words(scene: ClimbScene, name: str, value: float, chosen: str) -> str:
    words = _WORDS[_block(name)]
    alternative = repr(chosen)
    if _block(name) in ("body.clearance", "limbs.clearance"):
        alternative = side_words(scene, chosen)
    return words.format(
        mm=f"{1e3 * value:.0f} mm", deg=f"{np.rad2deg(value):.1f} deg", alternative=alternative
    )


_SIDES = (
    ("right of", (1, 0, 0)),
    ("left of", (-1, 0, 0)),
    ("in front of", (0, 1, 0)),
    ("behind", (0, -1, 0)),
    ("above", (0, 0, 1)),
    ("below", (0, 0, -1)),
)


def side_words(scene: ClimbScene, alternative: str) -> str:
    """`beam face 5` in the robot's terms: "below 'beam' (face 5)"; free regions by their names."""
    name, found, number = alternative.rpartition(" face ")
    if not found:
        return f"in free region {alternative!r}"
    solid = next((s for s in scene.terrain.obstacles if s.name == name), None)
    if solid is None:
        return repr(alternative)
    normal = solid.A[int(number)]
    for words, axis in _SIDES:
        if normal @ np.array(axis) > 0.95:
            return f"{words} {name!r} (face {number})"
    shown = ", ".join(f"{v:.2f}" for v in normal)
    return f"beyond face {number} of {name!r} (normal {shown})"


def _place(scene: ClimbScene, name: str, index: tuple[int, ...]) -> str:
    """Round and limb of an entry of a block."""
    names = scene.robot.limb_names
    if name.startswith("goal."):
        return f"goal, {names[index[0]]}" if name == "goal.toes" else "goal"
    if name == "steps.first_toe":
        return "round 1"
    words = f"round {index[0] + 1}"
    if _block(name) == _TURN:
        return f"{words}, {name.removeprefix(_TURN + '_')}"
    per_limb = len(index) > 1 and name != "steps.rotation"
    return f"{words}, {names[index[1]]}" if per_limb else words
