"""A LIMMS plan as its file keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.limms.convergence import Convergence
from climbplan.limms.modules.chain import Points, Pose, forward
from climbplan.limms.scene import Array, Index
from climbplan.limms.timeline import Stretch
from climbplan.plans.root_attributes import PlanHeader

BOX_MODES = {1: "stable", 2: "free", 3: "manipulated", 4: "quadruped"}
MODULE_MODES = {1: "free", 2: "arm", 3: "added arm", 4: "leg", 5: "added leg"}


@dataclass(frozen=True)
class Motion:
    """Dense samples (T). Where modes change a time is there twice: before and after."""

    time: Array  # (T,) [s]
    box_position: Array  # (T, B, 3) [m]
    box_velocity: Array  # (T, B, 3) [m/s]
    box_acceleration: Array  # (T, B, 3) [m/s^2]
    box_mode: Index  # (T, B)
    joint_position: Array  # (T, L, 8, 3) [m]
    joint_rotation: Array  # (T, L, 8, 3, 3)
    joint_angles: Array  # (T, L, 6) [rad]
    joint_velocity: Array  # (T, L, 6) [rad/s]
    mode: Index  # (T, L)
    base_anchor: Index  # (T, L) at the first end, -1 none
    tip_anchor: Index  # (T, L) at the last end
    ground_end: Index  # (T, L) end that stands on the ground, -1 none
    anchor_position: Array  # (T, A, 3) [m]
    force: Array  # (T, B, 4, 3) on boxes at their anchors [N]


@dataclass(frozen=True, kw_only=True)
class LimmsPlan(PlanHeader):
    """Motion, scene and how it came about."""

    title: str
    method: str
    status: str
    motion: Motion
    anchor_names: tuple[str, ...]
    anchor_normal: Array  # (A, 3)
    box_size: Array  # (B, 3) [m]
    box_mass: Array  # (B,) [kg]
    goal: Array  # (B, 3) [m]
    arrival_speed: float  # [m/s]
    friction: float
    solids: Array  # (S, 2, 3) [m]
    module: dict[str, Any]  # fields of the module's spec
    module_names: tuple[str, ...]
    stages: tuple[tuple[str, float, float], ...]  # name, begin, end [s]
    sequence: str
    objective: float  # [m] distance of the box from its goal at the end
    convergence: Convergence | None = None
    module_text: str = ""  # of the module's file, empty for a built-in one


def motion_of(
    stretches: Sequence[Stretch],
    module: Any,
    wall_position: Array,
    box_size: Array,
    box_start: Array,
) -> tuple[Motion, tuple[tuple[str, float, float], ...]]:
    """Stretches put end to end, and the times of each; parked boxes rest."""
    begins = np.concatenate([[0.0], np.cumsum([s.time[-1] for s in stretches])])
    joined: dict[str, list[Any]] = {key: [] for key in Motion.__annotations__}
    parked = box_start[1:]
    for stretch, begin in zip(stretches, begins[:-1], strict=True):
        n = len(stretch.time)
        base = Pose(stretch.base_position, stretch.base_rotation)
        points: Points = forward(module, base, stretch.angles)
        box = np.concatenate([stretch.box[:, None], np.tile(parked, (n, 1, 1))], axis=1)
        still = np.zeros((n, len(parked), 3))
        sides = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
        offsets = sides[None] * box_size[:, None] / 2  # (B, 4, 3)
        on_boxes = (box[:, :, None] + offsets).reshape(n, -1, 3)
        parts = {
            "time": begin + stretch.time,
            "box_position": box,
            "box_velocity": np.concatenate([stretch.velocity[:, None], still], axis=1),
            "box_acceleration": np.concatenate([stretch.acceleration[:, None], still], axis=1),
            "box_mode": np.tile([stretch.box_mode, *([1] * len(parked))], (n, 1)),
            "joint_position": points.position,
            "joint_rotation": points.rotation,
            "joint_angles": stretch.angles,
            "joint_velocity": stretch.rates,
            "mode": np.tile(stretch.mode, (n, 1)),
            "base_anchor": np.tile(stretch.base_anchor, (n, 1)),
            "tip_anchor": np.tile(stretch.tip_anchor, (n, 1)),
            "ground_end": np.tile(stretch.grounded, (n, 1)),
            "anchor_position": np.concatenate(
                [on_boxes, np.tile(wall_position, (n, 1, 1))], axis=1
            ),
            "force": np.concatenate(
                [stretch.force[:, None], np.zeros((n, len(parked), 4, 3))], axis=1
            ),
        }
        for key, value in parts.items():
            joined[key].append(value)
    motion = Motion(**{key: np.concatenate(values) for key, values in joined.items()})
    stages: list[tuple[str, float, float]] = []
    for stretch, begin, end in zip(stretches, begins[:-1], begins[1:], strict=True):
        if stages and stages[-1][0] == stretch.name:
            stages[-1] = (stretch.name, stages[-1][1], float(end))
        else:
            stages.append((stretch.name, float(begin), float(end)))
    return motion, tuple(stages)
