"""Specs of walks in the axes of climbs (`forward: y`), converted to those of walking.

World vectors are turned about z by a quarter. Attitudes are those of a body with y forward, as in
climbs: with T from these axes to those of walking, R becomes T R T'.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.schema.base import Vector
from climbplan.walking.plan.axes import to_walking_axes
from climbplan.walking.schema.loop import WalkLoopSpec
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.task import WalkTaskSpec

_FORWARD_IN_CLIMBS = (1, 0, 2)  # components of weights on x, y, z and on roll, pitch, yaw


def convert_to_walking_axes(spec: MpcSpec) -> MpcSpec:
    """Return a spec with x forward, but for its terrain, which is converted as numbers."""
    if spec.forward == "x":
        return spec
    weights = spec.weights
    swapped = {
        name: tuple(getattr(weights, name)[k] for k in _FORWARD_IN_CLIMBS)
        for name in ("velocity", "angles")
    }
    return spec.model_copy(
        update={
            "forward": "x",
            "task": _convert_task(spec.task),
            "weights": weights.model_copy(update=swapped),
            "loop": _convert_loop(spec.loop),
        }
    )


def _convert_task(task: WalkTaskSpec) -> WalkTaskSpec:
    """Return start, reference and goal with x forward."""
    start, reference, goal = task.start, task.reference, task.goal
    new_start = {
        "position": _convert(start.position),
        "velocity": _convert(start.velocity),
        "rpy_deg": _convert_attitude(start.rpy_deg),
        "angular_velocity": _convert(start.angular_velocity),
        "toes": {leg: _convert(place) for leg, place in start.toes.items()},
    }
    new_reference: dict[str, tuple[float, ...]] = {"rpy_deg": _convert_attitude(reference.rpy_deg)}
    if "velocity" in reference.model_fields_set:  # else the default, which is forward
        new_reference["velocity"] = _convert(reference.velocity)
    update = {
        "start": start.model_copy(update=new_start),
        "reference": reference.model_copy(update=new_reference),
    }
    if goal is not None:
        place = {"position": _convert(goal.position)}
        return task.model_copy(update={**update, "goal": goal.model_copy(update=place)})
    return task.model_copy(update=update)


def _convert_loop(loop: WalkLoopSpec) -> WalkLoopSpec:
    """Return the closed loop with pushes in axes with x forward."""
    pushes = tuple(
        push.model_copy(update={"velocity": _convert(push.velocity)}) for push in loop.pushes
    )
    return loop.model_copy(update={"pushes": pushes})


def _convert(vector: tuple[float, ...]) -> tuple[float, ...]:
    """Return a world vector with x forward."""
    return tuple(to_walking_axes(np.array(vector, float)).tolist())


def _convert_attitude(rpy_deg: Vector) -> Vector:
    """Return roll, pitch and yaw [deg] of the body with x forward."""
    roll, pitch, yaw = rpy_deg
    if roll == 0 and pitch == 0:
        return rpy_deg
    R: Array = TO_WALKING @ rotation_world_body(np.deg2rad(rpy_deg)) @ TO_WALKING.T
    angles = (
        np.arctan2(R[2, 1], R[2, 2]),
        np.arcsin(np.clip(-R[2, 0], -1.0, 1.0)),
        np.arctan2(R[1, 0], R[0, 0]),
    )
    roll, pitch, yaw = np.rad2deg(angles).tolist()
    return (roll, pitch, yaw)
