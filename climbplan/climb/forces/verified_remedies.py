"""Remedies of the force stage that are verified: with each of them all instants have forces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np

from climbplan.climb.forces.sole_margins import solve_with_sole_margins
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene, compute_load_wrench
from climbplan.errors import Remedy

_MAX_ENLARGEMENTS = 3  # steps outwards of a remedy that was tried and did not hold


def keep_verified_remedies(
    scene: MotionScene, instants: Instants, remedies: tuple[Remedy, ...]
) -> tuple[Remedy, ...]:
    """Return the remedies with which all instants have forces.

    A remedy that fails by rounding is enlarged by a step of its last digit, up to
    `_MAX_ENLARGEMENTS` times. Remedies without a key of the spec are amounts only, and stay.
    """
    verified = []
    for remedy in remedies:
        candidate: Remedy | None = remedy
        for _ in range(_MAX_ENLARGEMENTS + 1):
            if candidate is None or not candidate.key or _is_sufficient(scene, instants, candidate):
                break
            candidate = _enlarge_remedy(candidate)
        else:
            candidate = None
        if candidate is not None:
            verified.append(candidate)
    return tuple(verified)


def _is_sufficient(scene: MotionScene, instants: Instants, remedy: Remedy) -> bool:
    """Return whether all instants have forces with a change of the spec."""
    spec, value = scene.spec, remedy.value
    assert isinstance(value, float)
    if remedy.key == "terrain.friction":
        instants = replace(instants, mu=np.full_like(instants.mu, value))
    elif remedy.key == "task.payload.mass":
        payload = spec.task.payload.model_copy(update={"mass": value})
        task = cast("Any", spec.task).model_copy(update={"payload": payload})
        scene = _replace_spec(scene, task=task)
        load = compute_load_wrench(scene.spec, scene.robot, instants.rpy)
        instants = replace(instants, external_wrench=load)
    else:
        name = remedy.key.removeprefix("force.")
        scene = _replace_spec(scene, force=spec.force.model_copy(update={name: value}))
    _, margined = solve_with_sole_margins(scene, instants, scene.spec.solver.force_solver)
    return not len(margined.solved.missing) and not len(margined.solved.unbalanced)


def _replace_spec(scene: MotionScene, **updates: object) -> MotionScene:
    """Return the scene with other parts of its spec."""
    return cast(
        "MotionScene", replace(cast("Any", scene), spec=scene.spec.model_copy(update=updates))
    )


def _enlarge_remedy(remedy: Remedy) -> Remedy | None:
    """Return the remedy with its third digit one step further; None where that has no sense."""
    value = remedy.value
    assert isinstance(value, float)
    digit = 10.0 ** (np.floor(np.log10(value)) - 2)
    is_increase = remedy.key == "terrain.friction"
    enlarged = float(f"{value + (digit if is_increase else -digit):.4g}")
    if enlarged <= 0 or (remedy.key.startswith("force.") and enlarged < 1):
        return None
    return replace(
        remedy, words=remedy.words.replace(f"{value:.4g}", f"{enlarged:.4g}"), value=enlarged
    )
