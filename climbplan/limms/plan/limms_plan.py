"""A LIMMS plan in memory, with the content of its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from climbplan.arrays import Array, IntArray
from climbplan.limms.plan.convergence import Convergence
from climbplan.store.root_attributes import PlanHeader

BOX_MODES = {1: "stable", 2: "free", 3: "manipulated", 4: "quadruped"}
MODULE_MODES = {1: "free", 2: "arm", 3: "added arm", 4: "leg", 5: "added leg"}


@dataclass(frozen=True)
class ModuleMotion:
    """Dense samples (T). Where modes change, a time occurs twice: before and after."""

    time: Array  # (T,) [s]
    box_position: Array  # (T, B, 3) [m]
    box_velocity: Array  # (T, B, 3) [m/s]
    box_acceleration: Array  # (T, B, 3) [m/s^2]
    box_yaw: Array  # (T, B) about the vertical, box to world; boxes stay upright [rad]
    box_yaw_rate: Array  # (T, B) [rad/s]
    box_yaw_acceleration: Array  # (T, B) [rad/s^2]
    box_mode: IntArray  # (T, B)
    joint_position: Array  # (T, L, 8, 3) [m]
    joint_rotation: Array  # (T, L, 8, 3, 3)
    joint_angles: Array  # (T, L, 6) [rad]
    joint_velocity: Array  # (T, L, 6) [rad/s]
    mode: IntArray  # (T, L)
    base_anchor: IntArray  # (T, L) at the first end, -1 none
    tip_anchor: IntArray  # (T, L) at the last end
    ground_end: IntArray  # (T, L) end that stands on the ground, -1 none
    anchor_position: Array  # (T, A, 3) [m]
    force: Array  # (T, B, 4, 3) on boxes at their anchors [N]


@dataclass(frozen=True, kw_only=True)
class LimmsPlan(PlanHeader):
    """Motion, scene and origin of a plan."""

    title: str
    method: str
    status: str
    motion: ModuleMotion
    anchor_names: tuple[str, ...]
    anchor_normal: Array  # (A, 3) of those on boxes in the box's frame
    box_size: Array  # (B, 3) [m]
    box_mass: Array  # (B,) [kg]
    goal: Array  # (B, 3) [m]
    goal_yaw: Array  # (B,) [rad]
    arrival_speed: float  # [m/s]
    friction: float
    solids: Array  # (S, 2, 3) [m]
    module: dict[str, Any]  # fields of the module's spec
    module_names: tuple[str, ...]
    massless: bool = True  # modules have no mass of their own
    stages: tuple[tuple[str, float, float], ...]  # name, start, end [s]
    sequence: str
    objective: float  # [m] distance of the box from its goal at the end
    convergence: Convergence | None = None
    module_text: str = ""  # of the module's file, empty for a built-in one

    @property
    def deliveries(self) -> int:
        """The number of boxes to deliver, in order; static boxes have no mass."""
        return max(int((self.box_mass > 0).sum()), 1)
