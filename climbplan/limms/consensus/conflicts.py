"""Why the mixed-integer block reaches no goal: which rows, relaxed one at a time, allow it.

Limits of the spec come first, then blocks of rows that no single number relaxes.
"""

from __future__ import annotations

import time
from dataclasses import replace

from climbplan.errors import Conflict
from climbplan.limms.consensus.mixed_integer import GOAL_TOLERANCE, Behaviour, MixedIntegerBlock
from climbplan.limms.consensus.problem import ConsensusProblem, build_problem

KINDS = {"arms": "arms", "stand": "quadruped that stands", "leap": "quadruped that leaps"}
TRIAL_CALLBACKS = 100  # limit checks of HiGHS for each relaxed block
_HORIZON = "horizon"  # no check has this name
# Limits of the spec by the name of their check: description, key of the module, factor
_RELAXED_LIMITS = {
    "force.limit": ("force limit (max_force)", "max_force", 10.0),
    "latch.moment": ("latch moment (latch_moment)", "latch_moment", 20.0),
    "speed.limit": ("joint speed (max_joint_speed)", "max_joint_speed", 5.0),
    "ground.speed": ("speed on the ground (ground_speed)", "ground_speed", 5.0),
}
# Blocks of rows that no single number relaxes
_RELAXED_BLOCKS = {
    "box.collision": "free space of the box",
    "limbs.collision": "free space of modules",
    "kinematics.forward": "lengths of links",
    "kinematics.joint_bounds": "joint ranges",
    "support.sides": "sides that feet stand on",
}


def explain_conflicts(
    problem: ConsensusProblem, nearest: dict[Behaviour, float], deadline: float
) -> list[Conflict]:
    """Return one conflict for each behaviour: its best distance, and what prevents the goal.

    Args:
        problem: The problem.
        nearest: Smallest distance to the goal of each behaviour [m].
        deadline: Time after which nothing more is relaxed, as `time.monotonic` [s].
    """
    conflicts = []
    for kind, distance in nearest.items():
        text = f"the box is proved to miss its goal, {distance:.2f} m off in the best plan seen"
        limits = _find_conflicting_limits(problem, kind, deadline)
        if limits:
            text += "; it conflicts with the " + " and the ".join(limits.values())
        names = ("goal.position", *(name for name in limits if name != _HORIZON))
        conflicts.append(Conflict(KINDS[kind], (text,), in_words=True, names=names))
    return conflicts


def _find_conflicting_limits(
    problem: ConsensusProblem, kind: Behaviour, deadline: float
) -> dict[str, str]:
    """Return descriptions of the rows whose relaxation reaches the goal, by names of checks."""

    def reaches(block: MixedIntegerBlock) -> bool:
        block.fix_behaviour(kind)
        return block.find_feasible(TRIAL_CALLBACKS, deadline).goal_error <= GOAL_TOLERANCE

    limits: dict[str, str] = {}
    scene, intervals, formulation = problem.scene, problem.intervals, problem.formulation
    trials = [
        (
            name,
            description,
            replace(scene, module=scene.module.model_copy(update={key: factor * value})),
        )
        for name, (description, key, factor) in _RELAXED_LIMITS.items()
        if (value := float(vars(scene.module)[key]))
    ]
    if kind != "arms":
        rough_scene = replace(scene, friction=10.0 * scene.friction)
        trials.append(("force.friction", "friction of the ground (terrain.friction)", rough_scene))
    trials.append((_HORIZON, f"horizon (solver.admm.intervals = {intervals})", scene))
    for name, description, relaxed_scene in trials:
        if time.monotonic() > deadline:
            return limits
        factor_of_horizon = 2 if name == _HORIZON else 1
        if reaches(
            MixedIntegerBlock(
                build_problem(relaxed_scene, factor_of_horizon * intervals, formulation)
            )
        ):
            limits[name] = description
    block = MixedIntegerBlock(problem)
    for name in (name for name in block.rows.names.names if name in _RELAXED_BLOCKS):
        if time.monotonic() > deadline:
            return limits
        block.relax_rows(name)
        if reaches(block):
            limits[name] = _RELAXED_BLOCKS[name]
        block.restore_rows(name)
    return limits
