"""A scene in numbers: free space, anchors, boxes, modules (chapter 6.3).

Boxes stay upright, and turn about the vertical where their goals ask for it (assumption 1 has none
of them turn): a box's frame is the world's turned by its yaw. An anchor's frame has its normal as z
axis. The first end of a latched module has the anchor's frame; the last end has it turned by pi
about x, eq. (6.1). A module that stands on the ground stands upright.
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


class Pose(NamedTuple):
    """Frames: position (..., 3) [m] and rotation to the world (..., 3, 3)."""

    position: Array
    rotation: Array


class Points(NamedTuple):
    """All points of a module: position (..., 8, 3) [m], rotation (..., 8, 3, 3)."""

    position: Array
    rotation: Array


def anchor_frame(normal: Array) -> Array:
    """A rotation (3, 3) whose z axis is the unit `normal`; always the same for the same normal."""
    x = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.5 else np.array([1.0, 0.0, 0.0])
    y = np.cross(normal, x)
    return np.column_stack([x, y, normal])


@dataclass(frozen=True)
class Patch:
    """A rectangle of ground that can be stood on."""

    lower: Array  # (2,) least x and y [m]
    upper: Array  # (2,)
    height: float  # [m]

    def inside(self, points: Array, margin: float = 0.0) -> BoolArray:
        """Which points (..., 2 or more) lie over it, at least `margin` from its edges."""
        flat = points[..., :2]
        return np.asarray(
            ((flat >= self.lower + margin) & (flat <= self.upper - margin)).all(axis=-1)
        )


@dataclass(frozen=True)
class Scene:
    """Everything a plan has to respect; A = 4 B + W anchors, those of boxes first."""

    module: ModuleSpec
    module_names: tuple[str, ...]
    stand: Array  # (L, 3) where modules stand at the start, NaN if latched [m]
    held: IntArray  # (L,) anchor that a module's first end is latched to at the start, -1 none
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
    number: tuple[int, ...]  # (B,) of each box in the plan
    arrival_speed: float  # [m/s]
    friction: float
    solids: Array  # (S, 2, 3) lower and upper corners of what is not free [m]
    patches: tuple[Patch, ...]
    allow: tuple[str, ...]
    massless: bool = True  # modules have no mass of their own
    pace: float = 1.0  # of ways without the box and of steps, as part of the fastest: for less load

    @property
    def count(self) -> int:
        """L, the number of modules."""
        return len(self.module_names)

    @property
    def boxes(self) -> int:
        """B, the number of boxes."""
        return len(self.box_size)

    @property
    def deliveries(self) -> int:
        """How many boxes are to be delivered; the others are parked and have no mass."""
        return int((self.box_mass > 0).sum())

    @property
    def walls(self) -> int:
        """W, the number of anchors on walls and ground."""
        return len(self.wall_position)

    @property
    def wall_offset(self) -> int:
        """Index of the first anchor that is not on a box."""
        return 4 * self.boxes

    @property
    def turns(self) -> bool:
        """Whether the first box stands turned or is to be turned: placements of it have a yaw."""
        return bool(self.start_yaws[0] != 0 or self.goal_yaws[0] != 0)

    @property
    def start_place(self) -> Array:
        """Where the first box stands, (D,) with its yaw if it turns [m, rad]."""
        return self._placed(self.box_start[0], self.start_yaws[0])

    @property
    def goal_place(self) -> Array:
        """Where it is to be, (D,); the yaw is told the near way round [m, rad]."""
        begin = self.start_yaws[0]
        turn = (self.goal_yaws[0] - begin + np.pi) % (2 * np.pi) - np.pi
        # Of half a turn both ways are as near
        return self._placed(self.goal, begin + (np.pi if turn == -np.pi else turn))

    def _placed(self, centre: Array, yaw: float) -> Array:
        return np.array([*centre, yaw]) if self.turns else centre.copy()

    @property
    def weight(self) -> float:
        """Weight of the box to deliver [N]."""
        return float(self.box_mass[0] * GRAVITY)

    def end_anchor(self, module: int, end: int) -> int:
        """The anchor that an end of a module (0 first, 1 last) is to other modules."""
        return len(self.anchor_names) + 2 * module + end

    def side_offset(self, box: int, side: int) -> Array:
        """From a box's centre to one of its anchors (3,), in the box's frame [m]."""
        offset: Array = SIDE_NORMALS[side] * self.box_size[box] / 2
        return offset


def stands_at_goal(scene: Scene, box: int) -> bool:
    """Whether a box is where it is to be from the start."""
    turn = (scene.goal_yaws[box] - scene.start_yaws[box] + np.pi) % (2 * np.pi) - np.pi
    away = np.abs(scene.box_start[box] - scene.goals[box]).max()
    return bool(away < 1e-9 and abs(turn) < 1e-9)


def with_box_first(scene: Scene, box: int, places: Array, goal: Array, speed: float) -> Scene:
    """The scene in which one box is brought to a goal while all others stand where they are.

    box: its number in `scene`, which has boxes in the order of the plan; places: (B, 4) where they
    are now, and goal: (4,), centre and yaw [m, rad]; speed: at which it may arrive [m/s].
    """
    order = [box, *(b for b in range(scene.boxes) if b != box)]
    names = [scene.anchor_names[4 * b + side] for b in order for side in range(4)]
    return replace(
        scene,
        anchor_names=(*names, *scene.anchor_names[scene.wall_offset :]),
        box_size=scene.box_size[order],
        box_mass=scene.box_mass[order],
        box_start=places[order, :3],
        start_yaws=places[order, 3],
        goal=goal[:3],
        goals=scene.goals[order],
        goal_yaws=np.array([goal[3], *scene.goal_yaws[order[1:]]]),
        number=tuple(order),
        arrival_speed=speed,
    )


def without_others(scene: Scene) -> Scene:
    """The scene with its first box and the parked ones only: others may be anywhere by then."""
    kept = [b for b in range(scene.boxes) if b == 0 or scene.box_mass[b] == 0]
    names = [scene.anchor_names[4 * b + side] for b in kept for side in range(4)]
    gone = 4 * (scene.boxes - len(kept))
    return replace(
        scene,
        anchor_names=(*names, *scene.anchor_names[scene.wall_offset :]),
        held=np.where(scene.held >= 0, scene.held - gone, scene.held),
        box_size=scene.box_size[kept],
        box_mass=scene.box_mass[kept],
        box_start=scene.box_start[kept],
        start_yaws=scene.start_yaws[kept],
        goals=scene.goals[kept],
        goal_yaws=scene.goal_yaws[kept],
        number=tuple(range(len(kept))),
    )


def scene_of(loaded: LoadedLimms) -> Scene:
    """The scene that a spec describes."""
    spec = loaded.spec
    space = spec.terrain.space()
    solids = np.array(space.solid, float)
    anchors = spec.terrain.anchors
    own, parked = spec.deliveries, spec.parked
    boxes = [*(box.size for box in own), *(box.size for box in parked)]
    places = [box.position for box in parked]
    names = ["box"] if len(own) == 1 else [f"box {i}" for i in range(len(own))]
    names += [f"parked {i}" for i in range(len(parked))]
    wall_names = [anchor.name for anchor in anchors]
    offset = 4 * len(boxes)
    nowhere = (np.nan, np.nan, np.nan)
    return Scene(
        module=loaded.module,
        module_names=tuple(m.name for m in spec.modules),
        stand=np.array([m.stand or nowhere for m in spec.modules], float),
        held=np.array(
            [-1 if m.anchor is None else offset + wall_names.index(m.anchor) for m in spec.modules]
        ),
        anchor_names=(*(f"{name} {side}" for name in names for side in SIDES), *wall_names),
        wall_position=np.array([a.position for a in anchors], float).reshape(-1, 3),
        wall_normal=np.array([a.normal for a in anchors], float).reshape(-1, 3),
        box_size=np.array(boxes, float),
        box_mass=np.array([*(box.mass for box in own), *(0.0 for _ in parked)]),
        box_start=np.array([*(box.start for box in own), *places], float),
        start_yaws=np.radians([*(box.start_yaw_deg for box in own), *(0.0 for _ in parked)]),
        goal=np.array(own[0].goal, float),
        goals=np.array([*(box.goal for box in own), *places], float),
        goal_yaws=np.radians([*(box.goal_yaw_deg for box in own), *(0.0 for _ in parked)]),
        number=tuple(range(len(boxes))),
        arrival_speed=own[-1].arrival_speed,
        friction=spec.terrain.friction,
        solids=solids,
        patches=ground_patches(np.array(space.free, float), solids),
        allow=spec.task.allow,
        massless=spec.massless,
    )


def ground_patches(free: Array, solids: Array) -> tuple[Patch, ...]:
    """Largest rectangles of ground among those between all face coordinates.

    free: (F, 2, 3); solids: (S, 2, 3) [m].
    """
    xs = np.unique(free[:, :, 0])
    ys = np.unique(free[:, :, 1])
    patches = []
    for height in np.unique(free[:, 0, 2]):
        ground = np.array(
            [
                [
                    _covered((x0 + x1) / 2, (y0 + y1) / 2, height + 1e-4, free)
                    and _covered((x0 + x1) / 2, (y0 + y1) / 2, height - 1e-4, solids)
                    for y0, y1 in itertools.pairwise(ys)
                ]
                for x0, x1 in itertools.pairwise(xs)
            ]
        )
        found = [
            (a, b, c, d)
            for a in range(len(xs) - 1)
            for b in range(a + 1, len(xs))
            for c in range(len(ys) - 1)
            for d in range(c + 1, len(ys))
            if ground[a:b, c:d].all()
        ]
        patches += [
            Patch(np.array([xs[a], ys[c]]), np.array([xs[b], ys[d]]), float(height))
            for a, b, c, d in found
            if not any(
                o != (a, b, c, d) and o[0] <= a and o[1] >= b and o[2] <= c and o[3] >= d
                for o in found
            )
        ]
    return tuple(patches)


def _covered(x: float, y: float, z: float, blocks: Array) -> bool:
    point = np.array([x, y, z])
    return bool(((blocks[:, 0] <= point) & (point <= blocks[:, 1])).all(axis=1).any())
