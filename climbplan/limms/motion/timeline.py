"""A plan under construction: stretches with constant modes, densely sampled, in sequence."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.modules.chain import forward
from climbplan.limms.modules.contact import link_segments
from climbplan.limms.scene.limms_scene import FramePoses, ModuleScene, Points

STEP = 0.01  # [s] between samples, at most

STABLE, FREE, MANIPULATED, QUADRUPED = 1, 2, 3, 4  # of a box
DRIVES, ARM, ADDED_ARM, LEG, ADDED_LEG = 1, 2, 3, 4, 5  # of a module
NOWHERE = -1


@dataclass(frozen=True)
class Stretch:
    """A stretch of time with constant modes over (n,) samples, both ends included."""

    name: str
    time: Array  # (n,) from 0 [s]
    box: Array  # (n, 3) [m]
    velocity: Array  # (n, 3) [m/s]
    acceleration: Array  # (n, 3) [m/s^2]
    turning: Array  # (n, 3) of the box: yaw, its rate and acceleration [rad, rad/s, rad/s^2]
    box_mode: int
    base_position: Array  # (n, L, 3) of first ends [m]
    base_rotation: Array  # (n, L, 3, 3)
    angles: Array  # (n, L, 6) [rad]
    rates: Array  # (n, L, 6) [rad/s]
    mode: IntArray  # (L,)
    base_anchor: IntArray  # (L,)
    tip_anchor: IntArray  # (L,)
    grounded: IntArray  # (L,) end that stands on the ground: 0, 1, or -1 none
    force: Array  # (n, 4, 3) on the box at its anchors [N]
    box_number: tuple[int, ...]  # (B,) boxes by their number in the plan, the moved one first
    other_positions: Array  # (B - 1, 3) of boxes that stand [m]
    other_yaws: Array  # (B - 1,) [rad]

    def place(self, module: int, base: FramePoses, angles: Array, rates: Array) -> None:
        """Write the motion of one module: its first end (n, 3) and (n, 3, 3), joints (n, 6)."""
        self.angles[:, module] = angles
        self.rates[:, module] = rates
        self.base_position[:, module] = base.position
        self.base_rotation[:, module] = base.rotation


@dataclass
class PartialPlan:
    """The state of planning: where everything is now, and the stretches planned so far."""

    scene: ModuleScene
    box: Array  # (3,)
    yaw: float  # of the box [rad]
    box_mode: int
    base_position: Array  # (L, 3)
    base_rotation: Array  # (L, 3, 3)
    angles: Array  # (L, 6)
    mode: IntArray
    base_anchor: IntArray
    tip_anchor: IntArray
    grounded: IntArray
    stretches: list[Stretch] = field(default_factory=list)

    @classmethod
    def at_start(cls, scene: ModuleScene, poses: tuple[Array, Array], angles: Array) -> PartialPlan:
        """Return the state at the start: modules stand upright or are latched to anchors."""
        num_modules = scene.num_modules
        is_latched = scene.start_anchor >= 0
        return cls(
            scene=scene,
            box=scene.box_start[0].copy(),
            yaw=float(scene.start_yaws[0]),
            box_mode=STABLE,
            base_position=poses[0].copy(),
            base_rotation=poses[1].copy(),
            angles=angles.copy(),
            mode=np.where(is_latched, ARM, DRIVES),
            base_anchor=scene.start_anchor.copy(),
            tip_anchor=np.full(num_modules, NOWHERE),
            grounded=np.where(is_latched, NOWHERE, 0),
        )

    def copy(self) -> PartialPlan:
        """Return an independent copy."""
        return PartialPlan(
            self.scene,
            self.box.copy(),
            self.yaw,
            self.box_mode,
            self.base_position.copy(),
            self.base_rotation.copy(),
            self.angles.copy(),
            self.mode.copy(),
            self.base_anchor.copy(),
            self.tip_anchor.copy(),
            self.grounded.copy(),
            list(self.stretches),
        )

    @property
    def place(self) -> Array:
        """Placement of the box (D,), with its yaw if it turns [m, rad]."""
        return np.array([*self.box, self.yaw]) if self.scene.uses_yaw else self.box

    @property
    def centres(self) -> Array:
        """Centres of all boxes (B, 3) [m]."""
        return np.vstack([self.box, self.scene.box_start[1:]])

    @property
    def yaws(self) -> Array:
        """Yaws of all boxes (B,) [rad]."""
        return np.array([self.yaw, *self.scene.start_yaws[1:]])

    def points(self, module: int) -> Points:
        """Return the points of a module now."""
        base = FramePoses(self.base_position[module], self.base_rotation[module])
        return forward(self.scene.module, base, self.angles[module])

    def segments(self, module: int) -> Array:
        """Return the link segments of a module now (4, 2, 3) [m]."""
        return link_segments(self.points(module), self.scene.module.radius)

    def build_rest(self, name: str, time: Array) -> Stretch:
        """Return a stretch in which nothing moves; motion is written into its arrays afterwards."""
        n = len(time)
        return Stretch(
            name=name,
            time=time,
            box=np.tile(self.box, (n, 1)),
            velocity=np.zeros((n, 3)),
            acceleration=np.zeros((n, 3)),
            turning=np.tile([self.yaw, 0.0, 0.0], (n, 1)),
            box_mode=self.box_mode,
            base_position=np.tile(self.base_position, (n, 1, 1)),
            base_rotation=np.tile(self.base_rotation, (n, 1, 1, 1)),
            angles=np.tile(self.angles, (n, 1, 1)),
            rates=np.zeros((n, self.scene.num_modules, 6)),
            mode=self.mode.copy(),
            base_anchor=self.base_anchor.copy(),
            tip_anchor=self.tip_anchor.copy(),
            grounded=self.grounded.copy(),
            force=np.zeros((n, 4, 3)),
            box_number=self.scene.box_number,
            other_positions=self.scene.box_start[1:],
            other_yaws=self.scene.start_yaws[1:],
        )

    def add(self, stretch: Stretch) -> None:
        """Append a stretch; its last sample becomes the current state."""
        self.stretches.append(stretch)
        self.box, self.yaw = stretch.box[-1].copy(), float(stretch.turning[-1, 0])
        self.box_mode = stretch.box_mode
        self.base_position = stretch.base_position[-1].copy()
        self.base_rotation = stretch.base_rotation[-1].copy()
        self.angles = stretch.angles[-1].copy()

    @property
    def duration(self) -> float:
        """Duration planned so far [s]."""
        return float(sum(s.time[-1] for s in self.stretches))


def sample_times(duration: float) -> Array:
    """Return times (n,) from 0 to duration, at most `STEP` apart [s]."""
    return np.linspace(0.0, duration, max(int(np.ceil(duration / STEP)), 2) + 1)
