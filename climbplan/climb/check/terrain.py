"""The terrain in a plan file against the one its spec states, corner by corner."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.motion import MotionSpec
from climbplan.schema.terrain.panel import HoldSpec, PanelSpec
from climbplan.schema.terrain.terrain import BoxSpec, GroundSpec, RegionSpec, SolidSpec, WallsSpec
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region, Surface, Tube
from climbplan.verification.differences import Difference, apart, same


def terrain_differences(plan: ClimbPlan, spec: MotionSpec) -> Iterator[Difference]:
    terrain, asked = plan.terrain, spec.terrain
    walls = ("left", "right") if asked.walls is not None else ()
    tops = [*(["ground"] if asked.ground else []), *(box.name for box in asked.boxes)]
    panel = asked.panel
    names = [
        *(["panel"] if panel else []),
        *(["tube"] if asked.tube else []),
        *walls,
        *tops,
        *(panel.holds if panel else ()),
        *(r.name for r in asked.regions),
    ]
    stored = [surface.name for surface in terrain.surfaces]
    yield same("terrain: surfaces", stored == names)
    yield same(
        "terrain.obstacles: names",
        [s.name for s in terrain.obstacles]
        == [*(s.name for s in asked.obstacles), *(box.name for box in asked.boxes)],
    )
    if stored != names:
        return
    by_name = dict(zip(names, range(len(names)), strict=True))
    limbs = plan.robot.limb_names

    if asked.tube is not None:
        tube = terrain.surfaces[by_name["tube"]]
        yield same("terrain.tube", isinstance(tube, Tube))
        if isinstance(tube, Tube):
            held = (*tube.center, tube.wall, tube.lower, tube.upper, tube.friction)
            want = (*asked.tube.center, asked.tube.radius, *asked.tube.up, asked.friction)
            yield apart("terrain.tube", held, want)
    if asked.walls is not None:
        for side, name in ((-1, "left"), (1, "right")):
            surface = terrain.surfaces[by_name[name]]
            yield _corners_apart(f"terrain.walls: {name}", surface, _wall(asked.walls, side))
            wall = asked.friction if asked.walls.friction is None else asked.walls.friction
            yield apart("terrain.friction", surface.friction, wall)
            may = [where in (name, "any") for where in plan.robot.sides]
            yield apart(f"terrain.walls: {name}, limbs", terrain.allowed[:, by_name[name]], may)
    flats: list[tuple[str, str, Array, GroundSpec | BoxSpec]] = []
    if asked.ground is not None:
        ground = asked.ground
        corners = _level(ground.across, ground.along, ground.height)
        flats.append(("terrain.ground", "ground", corners, ground))
    for number, brick in enumerate(asked.boxes):
        (x0, y0, _), (x1, y1, top) = brick.lower, brick.upper
        corners = _level((x0, x1), (y0, y1), top)
        flats.append((f"terrain.boxes.{number}", brick.name, corners, brick))
    for key, name, corners, level in flats:
        surface = terrain.surfaces[by_name[name]]
        yield _corners_apart(key, surface, corners)
        friction = asked.friction if level.friction is None else level.friction
        yield apart(f"{key}.friction", surface.friction, friction)
        limbs_allowed = level.limbs if isinstance(level, BoxSpec) else None
        may = [limbs_allowed is None or limb in limbs_allowed for limb in limbs]
        yield apart(f"{key}.limbs", terrain.allowed[:, by_name[name]], may)
    if panel is not None:
        yield from _panel(plan, panel, asked.friction)
    for number, region in enumerate(asked.regions):
        key = f"terrain.regions.{number}"
        surface = terrain.surfaces[by_name[region.name]]
        yield _corners_apart(key, surface, _region(region))
        friction = asked.friction if region.friction is None else region.friction
        yield apart(f"{key}.friction", surface.friction, friction)
        may = [region.limbs is None or name in region.limbs for name in limbs]
        yield apart(f"{key}.limbs", terrain.allowed[:, by_name[region.name]], may)
        yield _region_hold_apart(key, surface, region)
    boxes = [SolidSpec(name=b.name, lower=b.lower, upper=b.upper) for b in asked.boxes]
    yield from _solids(terrain, [*asked.obstacles, *boxes], asked.free_regions)


def _solids(
    terrain: Terrain, obstacles: Sequence[SolidSpec], free: Sequence[SolidSpec]
) -> Iterator[Difference]:
    for number, (solid, spec) in enumerate(zip(terrain.obstacles, obstacles, strict=False)):
        yield _support_apart(f"terrain.obstacles.{number}", solid.A, solid.b, _points(spec))
    if free:
        key = "terrain.free_regions"
        choices = terrain.free_choices
        yield same(key, len(choices) == 1 and len(choices[0]) == len(free))
        for number, (space, spec) in enumerate(
            zip(itertools.chain(*choices[:1]), free, strict=False)
        ):
            yield _support_apart(f"{key}.{number}", space.A, space.b, _points(spec))


def _support_apart(key: str, A: Array, b: Array, points: Array) -> Difference:
    """How far half-spaces are from touching the hull of points."""
    return apart(key, (points @ A.T).max(axis=0), b)


def _corners_apart(key: str, surface: Surface, corners: Array) -> Difference:
    """Largest distance between corners that belong together, in whatever order."""
    if not isinstance(surface, Region) or len(surface.vertices) != len(corners):
        return Difference(key, math.inf)
    corners = corners + surface.standoff * surface.normal
    apart = np.linalg.norm(surface.vertices[:, None] - corners[None, :], axis=-1)
    return Difference(key, float(max(apart.min(axis=0).max(), apart.min(axis=1).max())))


def _panel(plan: ClimbPlan, panel: PanelSpec, friction: float) -> Iterator[Difference]:
    """The panel's corners, and where its holds are and how they can be gripped."""
    terrain = plan.terrain
    by_name = {surface.name: index for index, surface in enumerate(terrain.surfaces)}
    angle = math.radians(panel.angle_deg)
    heading = math.radians(panel.heading_deg)
    sideways = np.array([math.cos(heading), math.sin(heading), 0.0])
    level = np.array([-math.sin(heading), math.cos(heading), 0.0])
    up = math.cos(angle) * level + np.array([0.0, 0.0, math.sin(angle)])

    def corners(across: tuple[float, float], along: tuple[float, float]) -> Array:
        ends = itertools.product(across, along)
        return np.array([panel.center + u * sideways + v * up for u, v in ends])

    own = friction if panel.friction is None else panel.friction
    surface = terrain.surfaces[by_name["panel"]]
    yield _corners_apart("terrain.panel", surface, corners(panel.across, panel.along))
    yield apart(
        "terrain.panel.limbs", terrain.allowed[:, by_name["panel"]], [0] * len(terrain.allowed)
    )
    for name, spec in panel.holds.items():
        key = f"terrain.panel.holds.{name}"
        surface = terrain.surfaces[by_name[name]]
        (u, v), half = spec.at, (spec.width / 2, spec.height / 2)
        room = corners((u - half[0], u + half[0]), (v - half[1], v + half[1]))
        yield _corners_apart(key, surface, room)
        yield apart(
            f"{key}.friction", surface.friction, own if spec.friction is None else spec.friction
        )
        may = [spec.limbs is None or limb in spec.limbs for limb in plan.robot.limb_names]
        yield apart(f"{key}.limbs", terrain.allowed[:, by_name[name]], may)
        yield _hold_apart(key, surface, spec, up, sideways)


def _hold_apart(
    key: str, surface: Surface, spec: HoldSpec, up: Array, sideways: Array
) -> Difference:
    """Axis, undercut and orientation of a hold."""
    if not isinstance(surface, Region) or surface.hold is None:
        return Difference(key, math.inf)
    turn, hold = math.radians(spec.axis_deg), surface.hold
    axis = math.cos(turn) * up + math.sin(turn) * sideways
    stored = [*hold.axis, hold.undercut, *hold.orientation]
    asked = [*axis, math.radians(spec.undercut_deg), *np.deg2rad(spec.orientation_deg)]
    return apart(f"{key}: axis_deg, undercut_deg, orientation_deg", stored, asked)


def _region_hold_apart(key: str, surface: Surface, region: RegionSpec) -> Difference:
    """How a region can be gripped: its axis without what is along the normal."""
    stored = surface.hold if isinstance(surface, Region) else None
    if region.hold is None or stored is None or not isinstance(surface, Region):
        return same(f"{key}.hold", (region.hold is None) == (stored is None))
    asked = region.hold
    across = np.cross(np.cross(surface.normal, asked.axis), surface.normal)
    axis = across / np.linalg.norm(across)
    want = [*axis, math.radians(asked.undercut_deg), *np.deg2rad(asked.orientation_deg)]
    return apart(f"{key}.hold", [*stored.axis, stored.undercut, *stored.orientation], want)


def _wall(walls: WallsSpec, side: int) -> Array:
    """Corners of a wall: half the gap from the middle at y = 0, opening by half the angle."""
    slope = math.tan(math.radians(walls.angle_deg) / 2)
    corners = itertools.product(walls.along, walls.up)
    return np.array([(side * (walls.gap / 2 + y * slope), y, z) for y, z in corners])


def _level(across: tuple[float, float], along: tuple[float, float], z: float) -> Array:
    """Corners of a level rectangle."""
    return np.array([(x, y, z) for x in across for y in along])


def _region(region: RegionSpec) -> Array:
    """Corners of a region as its spec states them."""
    if region.rectangle is None:
        return np.array(region.vertices, float)
    flat = region.rectangle
    x, y, z = np.array(flat.normal) / np.linalg.norm(flat.normal)
    level = math.hypot(x, y)
    across = np.array([-y, x, 0.0]) / level if level > 1e-9 else np.array([1.0, 0.0, 0.0])
    up = np.cross((x, y, z), across)
    ends = itertools.product((-0.5, 0.5), repeat=2)
    return np.array([flat.center + s * flat.width * across + t * flat.height * up for s, t in ends])


def _points(solid: SolidSpec) -> Array:
    if solid.lower is not None and solid.upper is not None:
        return np.array(list(itertools.product(*zip(solid.lower, solid.upper, strict=True))))
    return np.array(solid.vertices, float)
