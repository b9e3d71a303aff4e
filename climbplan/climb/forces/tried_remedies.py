"""Remedies of the force stage that were tried: with each of them all instants have forces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np

from climbplan.climb.forces.soles import solve_on_feet
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene, load_wrench
from climbplan.errors import Remedy

_MOVES = 3  # steps outwards of a remedy that was tried and did not hold


def tried(
    scene: MotionScene, instants: Instants, remedies: tuple[Remedy, ...]
) -> tuple[Remedy, ...]:
    """Return the remedies with which all instants were found to have forces.

    One that is off by rounding is moved outwards by a step of its last digit, up to `_MOVES` times.
    Those that no key of the spec stands for are amounts only, and stay.
    """
    held = []
    for remedy in remedies:
        moved: Remedy | None = remedy
        for _ in range(_MOVES + 1):
            if moved is None or not moved.key or _holds(scene, instants, moved):
                break
            moved = _further(moved)
        else:
            moved = None
        if moved is not None:
            held.append(moved)
    return tuple(held)


def _holds(scene: MotionScene, instants: Instants, remedy: Remedy) -> bool:
    """Whether all instants have forces with a change of the spec."""
    spec, value = scene.spec, remedy.value
    assert isinstance(value, float)
    if remedy.key == "terrain.friction":
        instants = replace(instants, mu=np.full_like(instants.mu, value))
    elif remedy.key == "task.payload.mass":
        payload = spec.task.payload.model_copy(update={"mass": value})
        task = cast("Any", spec.task).model_copy(update={"payload": payload})
        scene = _with_spec(scene, task=task)
        load = load_wrench(scene.spec, scene.robot, instants.rpy)
        instants = replace(instants, external_wrench=load)
    else:
        name = remedy.key.removeprefix("force.")
        scene = _with_spec(scene, force=spec.force.model_copy(update={name: value}))
    _, found = solve_on_feet(scene, instants, scene.spec.solver.force)
    return not len(found.solved.missing) and not len(found.solved.unbalanced)


def _with_spec(scene: MotionScene, **parts: object) -> MotionScene:
    """Return the scene with other parts of its spec."""
    return cast(
        "MotionScene", replace(cast("Any", scene), spec=scene.spec.model_copy(update=parts))
    )


def _further(remedy: Remedy) -> Remedy | None:
    """Return the remedy with its third digit one step further; None where that has no sense."""
    value = remedy.value
    assert isinstance(value, float)
    step = 10.0 ** (np.floor(np.log10(value)) - 2)
    more = remedy.key == "terrain.friction"
    moved = float(f"{value + (step if more else -step):.4g}")
    if moved <= 0 or (remedy.key.startswith("force.") and moved < 1):
        return None
    return replace(remedy, words=remedy.words.replace(f"{value:.4g}", f"{moved:.4g}"), value=moved)
