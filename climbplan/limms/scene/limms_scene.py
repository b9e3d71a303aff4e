"""The data of a scene as arrays: free space, anchors, boxes, modules (chapter 6.3).

Boxes stay upright and turn about the vertical where their goals ask for it (assumption 1 has no box
turn). The frame of a box is the world frame turned by its yaw. The z axis of an anchor's frame is
its normal. The first end of a latched module has the anchor's frame. The last end has it turned by
pi about x, eq. (6.1). A module on the ground stands upright.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.schema.loading import LoadedLimms
from climbplan.limms.schema.module import ModuleSpec

GRAVITY = 9.81  # [m/s^2]
SIDES = ("+x", "-x", "+y", "-y")  # anchors of a box, one in the middle of each side
SIDE_NORMALS = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
FLIP = np.diag([1.0, -1.0, -1.0])  # from an anchor's frame to that of a last end on it


class FramePoses(NamedTuple):
    """Frames given by positions (..., 3) [m] and rotations to the world (..., 3, 3)."""

    position: Array
    rotation: Array


class Points(NamedTuple):
    """Frames of all points of a module: positions (..., 8, 3) [m], rotations (..., 8, 3, 3)."""

    position: Array
    rotation: Array


def anchor_frame(normal: Array) -> Array:
    """Return a rotation (3, 3) whose z axis is the unit `normal`, unique for each normal."""
    x = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.5 else np.array([1.0, 0.0, 0.0])
    y = np.cross(normal, x)
    return np.column_stack([x, y, normal])


@dataclass(frozen=True)
class GroundPatch:
    """A rectangle of ground that modules can stand on."""

    lower: Array  # (2,) smallest x and y [m]
    upper: Array  # (2,)
    height: float  # [m]

    def contains(self, points: Array, margin: float = 0.0) -> BoolArray:
        """Return which points (..., 2 or more) lie over the patch, at least `margin` from its edges
        [m].
        """
        flat = points[..., :2]
        return np.asarray(
            ((flat >= self.lower + margin) & (flat <= self.upper - margin)).all(axis=-1)
        )


@dataclass(frozen=True)
class ModuleScene:
    """The data of the planning problem; A = 4 B + W anchors, those of boxes first."""

    module: ModuleSpec
    module_names: tuple[str, ...]
    start_position: Array  # (L, 3) where modules stand at the start, NaN if latched [m]
    start_anchor: IntArray  # (L,) anchor of a module's first end at the start, -1 none
    anchor_names: tuple[str, ...]
    wall_position: Array  # (W, 3) of the anchors on walls and ground [m]
    wall_normal: Array  # (W, 3)
    box_size: Array  # (B, 3) the box to bring next first, then the others, parked ones last [m]
    box_mass: Array  # (B,) [kg]; 0 for parked boxes, whose mass does not matter
    box_start: Array  # (B, 3) [m]
    start_yaws: Array  # (B,) [rad]
    goal: Array  # (3,) of the first box [m]
    goals: Array  # (B, 3) of all, of parked ones their places [m]
    goal_yaws: Array  # (B,) [rad]
    box_number: tuple[int, ...]  # (B,) of each box in the plan
    arrival_speed: float  # [m/s]
    friction: float
    solids: Array  # (S, 2, 3) lower and upper corners of what is not free [m]
    patches: tuple[GroundPatch, ...]
    allow: tuple[str, ...]
    massless: bool = True  # modules have no mass of their own
    pace: float = 1.0  # speed of motions without the box and of steps, relative to the fastest

    @property
    def num_modules(self) -> int:
        """L, the number of modules."""
        return len(self.module_names)

    @property
    def num_boxes(self) -> int:
        """B, the number of boxes."""
        return len(self.box_size)

    @property
    def num_deliveries(self) -> int:
        """The number of boxes to deliver; the others are static obstacles without mass."""
        return int((self.box_mass > 0).sum())

    @property
    def num_wall_anchors(self) -> int:
        """W, the number of anchors on walls and ground."""
        return len(self.wall_position)

    @property
    def wall_offset(self) -> int:
        """Index of the first anchor that is not on a box."""
        return 4 * self.num_boxes

    @property
    def uses_yaw(self) -> bool:
        """True if the yaw of the first box differs from zero at the start or the goal."""
        return bool(self.start_yaws[0] != 0 or self.goal_yaws[0] != 0)

    @property
    def start_placement(self) -> Array:
        """Placement of the first box at the start, (D,), with its yaw if it turns [m, rad]."""
        return self._to_placement(self.box_start[0], self.start_yaws[0])

    @property
    def goal_placement(self) -> Array:
        """Placement of the first box at the goal, (D,), by the shorter rotation [m, rad]."""
        begin = self.start_yaws[0]
        turn = (self.goal_yaws[0] - begin + np.pi) % (2 * np.pi) - np.pi
        # Half a turn is equally short in both directions: the positive one is chosen
        return self._to_placement(self.goal, begin + (np.pi if turn == -np.pi else turn))

    def _to_placement(self, centre: Array, yaw: float) -> Array:
        return np.array([*centre, yaw]) if self.uses_yaw else centre.copy()

    @property
    def weight(self) -> float:
        """Weight of the box to deliver [N]."""
        return float(self.box_mass[0] * GRAVITY)

    def end_anchor(self, module: int, end: int) -> int:
        """Return the anchor that an end of a module (0 first, 1 last) is to other modules."""
        return len(self.anchor_names) + 2 * module + end

    def side_offset(self, box: int, side: int) -> Array:
        """Return the vector (3,) from a box's centre to one of its anchors, in its frame [m]."""
        offset: Array = SIDE_NORMALS[side] * self.box_size[box] / 2
        return offset


def is_at_goal(scene: ModuleScene, box: int) -> bool:
    """Return whether a box stands at its goal from the start."""
    rotation = (scene.goal_yaws[box] - scene.start_yaws[box] + np.pi) % (2 * np.pi) - np.pi
    distance = np.abs(scene.box_start[box] - scene.goals[box]).max()
    return bool(distance < 1e-9 and abs(rotation) < 1e-9)


def put_box_first(
    scene: ModuleScene, box: int, placements: Array, goal: Array, speed: float
) -> ModuleScene:
    """Return the scene that brings one box to a goal while all others stand where they are.

    Args:
        scene: The scene with boxes in the order of the plan.
        box: Number of the box in `scene`.
        placements: Centre and yaw of all boxes now (B, 4) [m, rad].
        goal: Centre and yaw of the goal (4,) [m, rad].
        speed: Speed at which the box may arrive [m/s].
    """
    order = [box, *(b for b in range(scene.num_boxes) if b != box)]
    names = [scene.anchor_names[4 * b + side] for b in order for side in range(4)]
    return replace(
        scene,
        anchor_names=(*names, *scene.anchor_names[scene.wall_offset :]),
        box_size=scene.box_size[order],
        box_mass=scene.box_mass[order],
        box_start=placements[order, :3],
        start_yaws=placements[order, 3],
        goal=goal[:3],
        goals=scene.goals[order],
        goal_yaws=np.array([goal[3], *scene.goal_yaws[order[1:]]]),
        box_number=tuple(order),
        arrival_speed=speed,
    )


def remove_other_boxes(scene: ModuleScene) -> ModuleScene:
    """Return the scene without the other boxes to deliver, which may be anywhere later."""
    kept_boxes = [b for b in range(scene.num_boxes) if b == 0 or scene.box_mass[b] == 0]
    names = [scene.anchor_names[4 * b + side] for b in kept_boxes for side in range(4)]
    num_removed = 4 * (scene.num_boxes - len(kept_boxes))
    return replace(
        scene,
        anchor_names=(*names, *scene.anchor_names[scene.wall_offset :]),
        start_anchor=np.where(
            scene.start_anchor >= 0, scene.start_anchor - num_removed, scene.start_anchor
        ),
        box_size=scene.box_size[kept_boxes],
        box_mass=scene.box_mass[kept_boxes],
        box_start=scene.box_start[kept_boxes],
        start_yaws=scene.start_yaws[kept_boxes],
        goals=scene.goals[kept_boxes],
        goal_yaws=scene.goal_yaws[kept_boxes],
        box_number=tuple(range(len(kept_boxes))),
    )


def build_scene(loaded: LoadedLimms) -> ModuleScene:
    """Build the scene of a loaded spec."""
    spec = loaded.spec
    space = spec.terrain.space()
    solids = np.array(space.solid, float)
    anchors = spec.terrain.anchors
    deliveries, parked = spec.deliveries, spec.static_boxes
    boxes = [*(box.size for box in deliveries), *(box.size for box in parked)]
    parked_positions = [box.position for box in parked]
    names = ["box"] if len(deliveries) == 1 else [f"box {i}" for i in range(len(deliveries))]
    names += [f"parked {i}" for i in range(len(parked))]
    wall_names = [anchor.name for anchor in anchors]
    offset = 4 * len(boxes)
    nowhere = (np.nan, np.nan, np.nan)
    return ModuleScene(
        module=loaded.module,
        module_names=tuple(m.name for m in spec.modules),
        start_position=np.array([m.position or nowhere for m in spec.modules], float),
        start_anchor=np.array(
            [-1 if m.anchor is None else offset + wall_names.index(m.anchor) for m in spec.modules]
        ),
        anchor_names=(*(f"{name} {side}" for name in names for side in SIDES), *wall_names),
        wall_position=np.array([a.position for a in anchors], float).reshape(-1, 3),
        wall_normal=np.array([a.normal for a in anchors], float).reshape(-1, 3),
        box_size=np.array(boxes, float),
        box_mass=np.array([*(box.mass for box in deliveries), *(0.0 for _ in parked)]),
        box_start=np.array([*(box.start for box in deliveries), *parked_positions], float),
        start_yaws=np.radians([*(box.start_yaw_deg for box in deliveries), *(0.0 for _ in parked)]),
        goal=np.array(deliveries[0].goal, float),
        goals=np.array([*(box.goal for box in deliveries), *parked_positions], float),
        goal_yaws=np.radians([*(box.goal_yaw_deg for box in deliveries), *(0.0 for _ in parked)]),
        box_number=tuple(range(len(boxes))),
        arrival_speed=deliveries[-1].arrival_speed,
        friction=spec.terrain.friction,
        solids=solids,
        patches=find_ground_patches(np.array(space.free, float), solids),
        allow=spec.task.allow,
        massless=spec.massless,
    )


def find_ground_patches(free: Array, solids: Array) -> tuple[GroundPatch, ...]:
    """Return the maximal rectangles of ground on the grid of all face coordinates.

    Args:
        free: Free blocks (F, 2, 3) [m].
        solids: Solid blocks (S, 2, 3) [m].
    """
    xs = np.unique(free[:, :, 0])
    ys = np.unique(free[:, :, 1])
    patches = []
    for height in np.unique(free[:, 0, 2]):
        ground = np.array(
            [
                [
                    _is_covered((x0 + x1) / 2, (y0 + y1) / 2, height + 1e-4, free)
                    and _is_covered((x0 + x1) / 2, (y0 + y1) / 2, height - 1e-4, solids)
                    for y0, y1 in itertools.pairwise(ys)
                ]
                for x0, x1 in itertools.pairwise(xs)
            ]
        )
        rectangles = [
            (a, b, c, d)
            for a in range(len(xs) - 1)
            for b in range(a + 1, len(xs))
            for c in range(len(ys) - 1)
            for d in range(c + 1, len(ys))
            if ground[a:b, c:d].all()
        ]
        patches += [
            GroundPatch(np.array([xs[a], ys[c]]), np.array([xs[b], ys[d]]), float(height))
            for a, b, c, d in rectangles
            if not any(
                larger != (a, b, c, d)
                and larger[0] <= a
                and larger[1] >= b
                and larger[2] <= c
                and larger[3] >= d
                for larger in rectangles
            )
        ]
    return tuple(patches)


def _is_covered(x: float, y: float, z: float, blocks: Array) -> bool:
    """Return whether any of the blocks (n, 2, 3) contains a point."""
    point = np.array([x, y, z])
    return bool(((blocks[:, 0] <= point) & (point <= blocks[:, 1])).all(axis=1).any())
