"""Explain in the robot's terms why the convex method finds no postures, and what may help.

Start and goal on their own, and the distance to the goal, are checked by arithmetic. The elastic
relaxation then gives the constraints that the closest posture sequence violates, with amounts and
spec keys. All of this is about a restriction of the problem (`BOUND_SCOPE`) and proves nothing;
proofs are in `climbplan.climb.planner.proof`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.scene.climb_scene import ClimbScene, ClimbStance, compute_toe_normals
from climbplan.errors import Conflict, ReachFailure, Remedy, Unresolved
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.robots.kinematics import require_reachable, sole_turns, to_body

if TYPE_CHECKING:
    from climbplan.solvers.elastic import ElasticSolution

_MAX_CONFLICTS = 6  # violations listed
_MIN_VIOLATION = 5e-4  # [m or rad] below which a violation is not worth a line

# The bound of the convex statement is one of that statement: exact rotations may cost less.
BOUND_SCOPE = (
    "rotations and knees linearised, workspaces as balls, body and limbs beyond one face of every "
    "obstacle in each round"
)

DEFAULT_STEPS = (
    "steps (`posture.steps`) and toes of the goal are our choice where the spec does not state them"
)

_MESSAGES = {
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
    "limbs.axis_collision": "limb {mm} too close to stay {alternative}",
}

_WEDGE_BLOCK = "workspace.turn"  # with the limb's name

SuggestChange = Callable[[ClimbScene, float], Remedy | None]


def _round_up(value: float, digits: int = 3) -> float:
    """Round a value upwards to the given number of decimals."""
    return math.ceil(value * 10**digits - 1e-6) / 10**digits


def _suggest_step(key: str) -> SuggestChange:
    def change(scene: ClimbScene, amount: float) -> Remedy:
        step_limit = _round_up(getattr(scene.spec.posture.steps, key) + amount)
        return Remedy(f"steps of {1e3 * step_limit:.0f} mm", f"posture.steps.{key}", step_limit)

    return change


def _suggest_rotation_step(scene: ClimbScene, amount: float) -> Remedy:
    value = _round_up(scene.spec.posture.steps.rotation_max_deg + float(np.rad2deg(amount)), 1)
    return Remedy(f"turns of {value:g} deg", "posture.steps.rotation_max_deg", value)


def _suggest_tolerance(scene: ClimbScene, amount: float) -> Remedy:
    value = _round_up(scene.spec.task.goal.tolerance + amount)
    return Remedy(f"a goal met to {1e3 * value:.0f} mm", "task.goal.tolerance", value)


def _suggest_rotation_tolerance(scene: ClimbScene, amount: float) -> Remedy:
    value = _round_up(scene.spec.task.goal.rotation_tolerance_deg + float(np.rad2deg(amount)), 1)
    return Remedy(f"a goal met to {value:g} deg", "task.goal.rotation_tolerance_deg", value)


def _suggest_clearance(key: str) -> SuggestChange:
    def change(scene: ClimbScene, amount: float) -> Remedy | None:
        value = math.floor(1e3 * (getattr(scene.spec.posture, key) - amount) + 1e-6) / 1e3
        if value < 0:
            return None
        return Remedy(f"{key.replace('_', ' ')} of {1e3 * value:.0f} mm", f"posture.{key}", value)

    return change


def _suggest_without(key: str, description: str) -> SuggestChange:
    return lambda scene, amount: Remedy(description, f"posture.{key}", "false")


# What in the spec stands for a block, changed by the amount that is missing. Whether it is enough
# is found out by planning with it (`climbplan.climb.planner.remedies`).
_SUGGESTIONS: dict[str, SuggestChange] = {
    "steps.com": _suggest_step("com_max"),
    "steps.toe": _suggest_step("toe_max"),
    "steps.rotation": _suggest_rotation_step,
    "goal.com": _suggest_tolerance,
    "goal.toes": _suggest_tolerance,
    "goal.rotation": _suggest_rotation_tolerance,
    "body.clearance": _suggest_clearance("body_clearance"),
    "limbs.axis_collision": _suggest_clearance("limb_clearance"),
    **{
        f"workspace.stance{when}": _suggest_without(
            "stance_workspace", "toes anywhere within reach"
        )
        for when in ("", "_lift", "_place")
    },
}


class NoPostures(Unresolved):
    """The convex statement has no solution.

    Attributes:
        changes: Changes of the spec for what the closest sequence violates; not verified.
        blocks: Names of the constraint blocks that it violates; empty where arithmetic gives the
            cause.
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
    """Return the error for a posture program that is proved to have no solution."""
    from climbplan.climb.postures.bottleneck_path import find_closed_passage
    from climbplan.climb.postures.travel_distance import find_excessive_travel
    from climbplan.solvers.elastic import minimise_violations

    for conflicts, reason in (
        (
            [*_find_unreachable_stances(scene), *find_closed_passage(scene)],
            f"method micp has {BOUND_SCOPE}",
        ),
        ([travel.conflict for travel in find_excessive_travel(scene)], DEFAULT_STEPS),
    ):
        if conflicts:
            # Each remedy meets its own conflict; if it is enough is found out by planning with it
            changes = tuple(r for c in conflicts for r in c.remedies)
            without_remedies = [replace(c, remedies=()) for c in conflicts]
            return NoPostures(
                "no posture sequence found", without_remedies, changes, because=reason
            )
    headline = "no posture sequence found under the given bounds"
    violations = minimise_violations(instance, _interpolate_postures(scene, program))
    if violations is None:
        return NoPostures(headline, [])
    conflicts = list(describe_violations(scene, program, violations))
    if conflicts:
        headline += "; violations of the closest one:"
    blocks = frozenset(
        _base_block_name(name) for _, name, _, _ in _collect_violations(program, violations)
    )
    return NoPostures(headline, conflicts, suggest_changes(scene, program, violations), blocks)


def _find_unreachable_stances(scene: ClimbScene) -> Iterator[Conflict]:
    """Yield a conflict for start and goal postures that the limbs cannot reach."""
    for name, stance in (("start", scene.start), ("goal", scene.goal)):
        try:
            normal = compute_toe_normals(scene.terrain, stance.toes, stance.region)
            turns = sole_turns(scene.robot, stance.rpy, normal)
            require_reachable(
                scene.robot, _transform_toes_to_body(stance), f"{name} posture", turns
            )
        except ReachFailure as failure:
            yield Conflict(f"{name} posture", (_describe_unreachable_toe(failure),), in_words=True)


def _transform_toes_to_body(stance: ClimbStance) -> Array:
    """Return the toes (N, 3) of a stance in the body frame."""
    return to_body(stance.com, stance.rpy, stance.toes)


def _describe_unreachable_toe(failure: ReachFailure) -> str:
    """Describe a toe that is out of reach."""
    gap = f" by {1e3 * failure.missing:.1f} mm" if failure.missing > 0 else ""
    return f"{failure.limb} cannot reach its toe ({failure.reason}{gap})"


def _interpolate_postures(scene: ClimbScene, program: Program) -> Array:
    """Return postures on the straight line from start to goal, as a point of the program."""
    fraction = np.linspace(0.0, 1.0, scene.spec.task.round_count + 1)[1:]

    def interpolate(start: Array, goal: Array) -> Array:
        weight = fraction.reshape(-1, *[1] * start.ndim)
        return start + weight * (goal - start)

    start, goal = scene.start, scene.goal
    return program.point(
        {
            "toe": interpolate(start.toes, goal.toes),
            "com": interpolate(start.com, goal.com),
            "rpy": interpolate(start.rpy, goal.rpy),
        }
    )


ViolationEntry = tuple[float, str, tuple[int, ...], str]
"""Amount [m or rad], block, entry of the block, and the alternative that was chosen there."""


def _collect_violations(program: Program, violations: ElasticSolution) -> list[ViolationEntry]:
    """Return all violations above the reporting threshold, largest first."""
    entries: list[ViolationEntry] = []
    blocks = program.blocks

    def collect(name: str, shape: tuple[int, ...], values: Array, chosen_names: list[str]) -> None:
        for flat_index, (index, value) in enumerate(np.ndenumerate(values.reshape(shape))):
            if value > _MIN_VIOLATION:
                entries.append(
                    (float(value), name, index, chosen_names[flat_index] if chosen_names else "")
                )

    start = 0
    for rows in blocks.rows:
        collect(rows.name, rows.shape, violations.rows[start : start + len(rows.expression)], [])
        start += len(rows.expression)
    for ball, values in zip(blocks.balls, violations.balls, strict=True):
        collect(ball.name, ball.shape, values, [])
    start = 0
    for choice in blocks.choices:
        count = len(choice.alternatives)
        entry_slice = slice(start, start + count)
        names = [
            alternatives[k].name
            for alternatives, k in zip(
                choice.alternatives, violations.assignment[entry_slice], strict=True
            )
        ]
        collect(choice.name, choice.shape, violations.choices[entry_slice], names)
        start += count
    return sorted(entries, key=lambda line: -line[0])


def describe_violations(
    scene: ClimbScene, program: Program, violations: ElasticSolution
) -> Iterator[Conflict]:
    """Yield the largest violations as conflicts, one line each.

    Args:
        scene: The climb.
        program: The posture program.
        violations: Violations of the closest point, from the elastic relaxation.
    """
    for value, name, index, alternative in _collect_violations(program, violations)[
        :_MAX_CONFLICTS
    ]:
        description = _describe_violation(scene, name, value, alternative)
        yield Conflict(_describe_place(scene, name, index), (description,), in_words=True)


def suggest_changes(
    scene: ClimbScene, program: Program, violations: ElasticSolution
) -> tuple[Remedy, ...]:
    """Return one change of the spec per violated block, sufficient for its largest violation."""
    changes: dict[str, Remedy] = {}
    for value, name, _, _ in _collect_violations(program, violations):
        change = _SUGGESTIONS.get(_base_block_name(name))
        remedy = change(scene, value) if change is not None else None
        if remedy is not None:
            changes.setdefault(remedy.key, remedy)
    return tuple(changes.values())


def _base_block_name(name: str) -> str:
    """Return a block's name without the number of an obstacle or the name of a limb."""
    if name.startswith(_WEDGE_BLOCK):
        return _WEDGE_BLOCK
    return name if name in _MESSAGES else name.rpartition("_")[0]


def _describe_violation(scene: ClimbScene, name: str, value: float, chosen_name: str) -> str:
    """Describe one violation with its amount and the chosen alternative."""
    template = _MESSAGES[_base_block_name(name)]
    alternative = repr(chosen_name)
    if _base_block_name(name) in ("body.clearance", "limbs.axis_collision"):
        alternative = describe_side(scene, chosen_name)
    return template.format(
        mm=f"{1e3 * value:.0f} mm", deg=f"{np.rad2deg(value):.1f} deg", alternative=alternative
    )


_SIDE_NORMALS = (
    ("right of", (1, 0, 0)),
    ("left of", (-1, 0, 0)),
    ("in front of", (0, 1, 0)),
    ("behind", (0, -1, 0)),
    ("above", (0, 0, 1)),
    ("below", (0, 0, -1)),
)


def describe_side(scene: ClimbScene, alternative: str) -> str:
    """Describe an alternative such as `beam face 5` by its side: "below 'beam' (face 5)".

    Free regions are described by their names.
    """
    name, separator, number = alternative.rpartition(" face ")
    if not separator:
        return f"in free region {alternative!r}"
    solid = next((s for s in scene.terrain.obstacles if s.name == name), None)
    if solid is None:
        return repr(alternative)
    normal = solid.A[int(number)]
    for side, axis in _SIDE_NORMALS:
        if normal @ np.array(axis) > 0.95:
            return f"{side} {name!r} (face {number})"
    components = ", ".join(f"{v:.2f}" for v in normal)
    return f"beyond face {number} of {name!r} (normal {components})"


def _describe_place(scene: ClimbScene, name: str, index: tuple[int, ...]) -> str:
    """Describe the round and the limb of an entry of a block."""
    names = scene.robot.limb_names
    if name.startswith("goal."):
        return f"goal, {names[index[0]]}" if name == "goal.toes" else "goal"
    if name == "steps.first_toe":
        return "round 1"
    round_label = f"round {index[0] + 1}"
    if _base_block_name(name) == _WEDGE_BLOCK:
        return f"{round_label}, {name.removeprefix(_WEDGE_BLOCK + '_')}"
    has_limb_index = len(index) > 1 and name != "steps.rotation"
    return f"{round_label}, {names[index[1]]}" if has_limb_index else round_label
