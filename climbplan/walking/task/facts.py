"""A walking task as plain values, for files that have to be understood from themselves alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import (
    STATE,
    Goal,
    Reference,
    RigidBody,
    Start,
    WalkTask,
    Weights,
)

_PARTS: dict[str, type[Any]] = {
    "body": RigidBody,
    "ground": Ground,
    "reference": Reference,
    "weights": Weights,
}
_SHAPES = ("slope", "corners")
_PLAIN = ("knots", "step", "integrator", "lift", "least_contacts", "whole_stance")
_WORDS = ("name", "leg_names", "names")


def facts_of(task: WalkTask) -> dict[str, Any]:
    """All but the start."""
    facts: dict[str, Any] = {name: vars(task)[name] for name in _PLAIN}
    for part in _PARTS:
        facts[part] = {
            field.name: _plain(getattr(vars(task)[part], field.name))
            for field in fields(vars(task)[part])
        }
    if not task.ground.slope.any() and not task.ground.corners.size:
        for name in _SHAPES:  # level rectangles say nothing of slopes and corners
            del facts["ground"][name]
    for name in ("edge", "standoff"):
        if not vars(task.ground)[name]:
            del facts["ground"][name]
    if task.goal.stated:
        facts["goal"] = [task.goal.lower.tolist(), task.goal.upper.tolist()]
    return facts


def task_of(facts: Mapping[str, Any]) -> WalkTask:
    """The task of such facts, at rest at the origin; raises KeyError, TypeError or ValueError."""
    if not all(isinstance(facts[part], Mapping) for part in _PARTS):
        raise TypeError("a part of the task is no mapping")
    count = np.size(facts["ground"]["height"])
    plain = {"slope": np.zeros((count, 2)), "corners": np.zeros((count, 0, 2)), "edge": 0.0}
    facts = {**facts, "ground": {**plain, **facts["ground"]}}
    parts = {
        part: made(**{name: _read(name, value) for name, value in facts[part].items()})
        for part, made in _PARTS.items()
    }
    knots = int(facts["knots"])
    shapes = (
        (parts["body"].inertia, (3, 3)),
        (parts["body"].toe_center, (parts["body"].leg_count, 3)),
        (parts["body"].toe_half, (3,)),
        (parts["reference"].velocity, (knots, 3)),
        (parts["reference"].euler, (knots, 3)),
        (parts["reference"].height, (knots,)),
        (parts["weights"].velocity, (3,)),
        (parts["weights"].angles, (3,)),
    )
    if any(np.shape(value) != shape for value, shape in shapes):
        raise ValueError("an array of the task has another shape")
    rest = np.zeros(STATE)
    rest[2] = parts["reference"].height[0]
    goal = Goal.anywhere()
    if "goal" in facts:
        goal = Goal(*np.array(facts["goal"], float).reshape(2, 2))
    return WalkTask(
        goal=goal,
        **{name: facts[name] for name in _PLAIN},
        **parts,
        start=Start(rest, np.zeros((parts["body"].leg_count, 3))),
    )


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _read(name: str, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value
    if name in _WORDS:
        return tuple(value) if isinstance(value, list) else str(value)
    return np.array(value, float) if isinstance(value, list) else float(value)
