"""A walking task as plain values, for files that must be readable without the spec."""

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

_COMPONENTS: dict[str, type[Any]] = {
    "body": RigidBody,
    "ground": Ground,
    "reference": Reference,
    "weights": Weights,
}
_SHAPES = ("slope", "corners")
_STORED_NAMES = {  # attribute of a task, by its name in stored libraries and datasets
    "knots": "knots",
    "step": "dt",
    "integrator": "integrator",
    "lift": "swing_clearance",
    "least_contacts": "min_contacts",
    "whole_stance": "workspace_over_stance",
}
_TEXTS = ("name", "leg_names", "names")


def build_facts(task: WalkTask) -> dict[str, Any]:
    """Return all values of a task but its start."""
    facts: dict[str, Any] = {
        name: vars(task)[attribute] for name, attribute in _STORED_NAMES.items()
    }
    for component in _COMPONENTS:
        facts[component] = {
            field.name: _to_plain(getattr(vars(task)[component], field.name))
            for field in fields(vars(task)[component])
            if field.name != "scan"  # what plans are checked against, and no libraries
        }
    if not task.ground.slope.any() and not task.ground.corners.size:
        for name in _SHAPES:  # level rectangles have neither
            del facts["ground"][name]
    for name in ("edge", "standoff"):
        if not vars(task.ground)[name]:
            del facts["ground"][name]
    for name in ("region_friction", "allowed"):
        if not vars(task.ground)[name].size:
            del facts["ground"][name]
    if task.goal.is_set:
        facts["goal"] = [task.goal.lower.tolist(), task.goal.upper.tolist()]
    return facts


def read_facts(facts: Mapping[str, Any]) -> WalkTask:
    """Return the task of stored values, at rest at the origin.

    Raises:
        KeyError, TypeError, ValueError: the values are not those of a task.
    """
    if not all(isinstance(facts[component], Mapping) for component in _COMPONENTS):
        raise TypeError("a part of the task is no mapping")
    count = np.size(facts["ground"]["height"])
    defaults = {"slope": np.zeros((count, 2)), "corners": np.zeros((count, 0, 2)), "edge": 0.0}
    facts = {**facts, "ground": {**defaults, **facts["ground"]}}
    components = {
        component: component_type(
            **{name: _from_plain(name, value) for name, value in facts[component].items()}
        )
        for component, component_type in _COMPONENTS.items()
    }
    knots = int(facts["knots"])
    shapes = (
        (components["body"].inertia, (3, 3)),
        (components["body"].toe_center, (components["body"].leg_count, 3)),
        (components["body"].toe_half, (3,)),
        (components["reference"].velocity, (knots, 3)),
        (components["reference"].euler, (knots, 3)),
        (components["reference"].height, (knots,)),
        (components["weights"].velocity, (3,)),
        (components["weights"].angles, (3,)),
    )
    if any(np.shape(value) != shape for value, shape in shapes):
        raise ValueError("an array of the task has another shape")
    rest_state = np.zeros(STATE)
    rest_state[2] = components["reference"].height[0]
    goal = Goal.anywhere()
    if "goal" in facts:
        goal = Goal(*np.array(facts["goal"], float).reshape(2, 2))
    return WalkTask(
        goal=goal,
        **{attribute: facts[name] for name, attribute in _STORED_NAMES.items()},
        **components,
        start=Start(rest_state, np.zeros((components["body"].leg_count, 3))),
    )


def _to_plain(value: Any) -> Any:
    """Return an array or a tuple as a list."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _from_plain(name: str, value: Any) -> Any:
    """Return the array, number or text of a stored value."""
    if isinstance(value, np.ndarray):
        return value
    if name in _TEXTS:
        return tuple(value) if isinstance(value, list) else str(value)
    return np.array(value, float) if isinstance(value, list) else float(value)
