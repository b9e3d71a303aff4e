"""Comparison of the terrain in a plan file with that of its spec, corner by corner."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.motion import MotionSpec
from climbplan.schema.terrain.panel import HoldSpec, PanelSpec
from climbplan.schema.terrain.terrain import (
    BoxSpec,
    GroundSpec,
    RegionSpec,
    SolidSpec,
    TerrainSpec,
    TubeSpec,
    WallsSpec,
)
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region, Surface, Tube
from climbplan.verification.differences import Difference, check_equality, measure_difference


def compare_terrain(plan: ClimbPlan, spec: MotionSpec) -> Iterator[Difference]:
    """Yield the differences between the plan's terrain and that of its spec."""
    terrain, terrain_spec = plan.terrain, spec.terrain
    panel = terrain_spec.panel
    names = _list_surface_names(terrain_spec)
    stored = [surface.name for surface in terrain.surfaces]
    yield check_equality("terrain: surfaces", stored == names)
    yield check_equality(
        "terrain.obstacles: names",
        [s.name for s in terrain.obstacles]
        == [*(s.name for s in terrain_spec.obstacles), *(box.name for box in terrain_spec.boxes)],
    )
    if stored != names:
        return
    by_name = dict(zip(names, range(len(names)), strict=True))
    if terrain_spec.tube is not None:
        surface = terrain.surfaces[by_name["tube"]]
        yield from _compare_tube(surface, terrain_spec.tube, terrain_spec.friction)
    if terrain_spec.walls is not None:
        yield from _compare_walls(plan, terrain_spec.walls, by_name, terrain_spec.friction)
    yield from _compare_level_surfaces(plan, terrain_spec, by_name)
    if panel is not None:
        yield from _compare_panel(plan, panel, terrain_spec.friction)
    for number, region in enumerate(terrain_spec.regions):
        key = f"terrain.regions.{number}"
        surface = terrain.surfaces[by_name[region.name]]
        yield _compare_corners(key, surface, _build_region_corners(region))
        friction = terrain_spec.friction if region.friction is None else region.friction
        yield measure_difference(f"{key}.friction", surface.friction, friction)
        yield _compare_limbs(f"{key}.limbs", plan, by_name[region.name], region.limbs)
        yield _compare_region_hold(key, surface, region)
    boxes = [SolidSpec(name=b.name, lower=b.lower, upper=b.upper) for b in terrain_spec.boxes]
    yield from _compare_solids(
        terrain, [*terrain_spec.obstacles, *boxes], terrain_spec.free_regions
    )


def _list_surface_names(terrain_spec: TerrainSpec) -> list[str]:
    """Return the names of all surfaces of a spec in the order of plan files."""
    walls = ("left", "right") if terrain_spec.walls is not None else ()
    tops = [*(["ground"] if terrain_spec.ground else []), *(box.name for box in terrain_spec.boxes)]
    panel = terrain_spec.panel
    return [
        *(["panel"] if panel else []),
        *(["tube"] if terrain_spec.tube else []),
        *walls,
        *tops,
        *(panel.holds if panel else ()),
        *(r.name for r in terrain_spec.regions),
    ]


def _compare_tube(surface: Surface, spec: TubeSpec, friction: float) -> Iterator[Difference]:
    """Yield the differences of the tube."""
    yield check_equality("terrain.tube", isinstance(surface, Tube))
    if isinstance(surface, Tube):
        stored = (*surface.center, surface.wall, surface.lower, surface.upper, surface.friction)
        stated = (*spec.center, spec.radius, *spec.up, friction)
        yield measure_difference("terrain.tube", stored, stated)


def _compare_walls(
    plan: ClimbPlan, walls: WallsSpec, by_name: dict[str, int], friction: float
) -> Iterator[Difference]:
    """Yield the differences of both walls; `friction` is that of walls that state none."""
    for side, name in ((-1, "left"), (1, "right")):
        surface = plan.terrain.surfaces[by_name[name]]
        yield _compare_corners(f"terrain.walls: {name}", surface, _build_wall_corners(walls, side))
        wall_friction = friction if walls.friction is None else walls.friction
        yield measure_difference("terrain.friction", surface.friction, wall_friction)
        is_allowed = [where in (name, "any") for where in plan.robot.sides]
        yield measure_difference(
            f"terrain.walls: {name}, limbs", plan.terrain.allowed[:, by_name[name]], is_allowed
        )


def _compare_limbs(
    key: str, plan: ClimbPlan, surface: int, limbs: Collection[str] | None
) -> Difference:
    """Compare which limbs may stand on a surface; None stands for all."""
    is_allowed = [limbs is None or limb in limbs for limb in plan.robot.limb_names]
    return measure_difference(key, plan.terrain.allowed[:, surface], is_allowed)


def _compare_level_surfaces(
    plan: ClimbPlan, terrain_spec: TerrainSpec, by_name: dict[str, int]
) -> Iterator[Difference]:
    """Yield the differences of the ground and of the tops of boxes."""
    level_surfaces: list[tuple[str, str, Array, GroundSpec | BoxSpec]] = []
    if terrain_spec.ground is not None:
        ground = terrain_spec.ground
        corners = _build_level_corners(ground.across, ground.along, ground.height)
        level_surfaces.append(("terrain.ground", "ground", corners, ground))
    for number, brick in enumerate(terrain_spec.boxes):
        (x0, y0, _), (x1, y1, top) = brick.lower, brick.upper
        corners = _build_level_corners((x0, x1), (y0, y1), top)
        level_surfaces.append((f"terrain.boxes.{number}", brick.name, corners, brick))
    for key, name, corners, level in level_surfaces:
        surface = plan.terrain.surfaces[by_name[name]]
        yield _compare_corners(key, surface, corners)
        friction = terrain_spec.friction if level.friction is None else level.friction
        yield measure_difference(f"{key}.friction", surface.friction, friction)
        limbs = level.limbs if isinstance(level, BoxSpec) else None
        yield _compare_limbs(f"{key}.limbs", plan, by_name[name], limbs)


def _compare_solids(
    terrain: Terrain, obstacles: Sequence[SolidSpec], free: Sequence[SolidSpec]
) -> Iterator[Difference]:
    """Yield the differences of obstacles and free regions."""
    for number, (solid, spec) in enumerate(zip(terrain.obstacles, obstacles, strict=False)):
        yield _compare_support(f"terrain.obstacles.{number}", solid.A, solid.b, _list_points(spec))
    if free:
        key = "terrain.free_regions"
        choices = terrain.free_choices
        yield check_equality(key, len(choices) == 1 and len(choices[0]) == len(free))
        for number, (space, spec) in enumerate(
            zip(itertools.chain(*choices[:1]), free, strict=False)
        ):
            yield _compare_support(f"{key}.{number}", space.A, space.b, _list_points(spec))


def _compare_support(key: str, A: Array, b: Array, points: Array) -> Difference:
    """Return how far half-spaces are from touching the hull of points."""
    return measure_difference(key, (points @ A.T).max(axis=0), b)


def _compare_corners(key: str, surface: Surface, corners: Array) -> Difference:
    """Return the largest distance between corresponding corners, in any order."""
    if not isinstance(surface, Region) or len(surface.vertices) != len(corners):
        return Difference(key, math.inf)
    corners = corners + surface.standoff * surface.normal
    distance = np.linalg.norm(surface.vertices[:, None] - corners[None, :], axis=-1)
    return Difference(key, float(max(distance.min(axis=0).max(), distance.min(axis=1).max())))


def _compare_panel(plan: ClimbPlan, panel: PanelSpec, friction: float) -> Iterator[Difference]:
    """Yield the differences of the panel's corners and of its holds."""
    terrain = plan.terrain
    by_name = {surface.name: index for index, surface in enumerate(terrain.surfaces)}
    angle = math.radians(panel.angle_deg)
    heading = math.radians(panel.heading_deg)
    sideways = np.array([math.cos(heading), math.sin(heading), 0.0])
    horizontal_up = np.array([-math.sin(heading), math.cos(heading), 0.0])
    up = math.cos(angle) * horizontal_up + np.array([0.0, 0.0, math.sin(angle)])

    def corners(across: tuple[float, float], along: tuple[float, float]) -> Array:
        ends = itertools.product(across, along)
        return np.array([panel.center + u * sideways + v * up for u, v in ends])

    panel_friction = friction if panel.friction is None else panel.friction
    surface = terrain.surfaces[by_name["panel"]]
    yield _compare_corners("terrain.panel", surface, corners(panel.across, panel.along))
    yield measure_difference(
        "terrain.panel.limbs", terrain.allowed[:, by_name["panel"]], [0] * len(terrain.allowed)
    )
    for name, spec in panel.holds.items():
        key = f"terrain.panel.holds.{name}"
        surface = terrain.surfaces[by_name[name]]
        (u, v), half = spec.at, (spec.width / 2, spec.height / 2)
        hold_corners = corners((u - half[0], u + half[0]), (v - half[1], v + half[1]))
        yield _compare_corners(key, surface, hold_corners)
        yield measure_difference(
            f"{key}.friction",
            surface.friction,
            panel_friction if spec.friction is None else spec.friction,
        )
        yield _compare_limbs(f"{key}.limbs", plan, by_name[name], spec.limbs)
        yield _compare_hold(key, surface, spec, up, sideways)


def _compare_hold(
    key: str, surface: Surface, spec: HoldSpec, up: Array, sideways: Array
) -> Difference:
    """Compare axis, undercut and orientation of a hold."""
    if not isinstance(surface, Region) or surface.hold is None:
        return Difference(key, math.inf)
    turn, hold = math.radians(spec.axis_deg), surface.hold
    axis = math.cos(turn) * up + math.sin(turn) * sideways
    stored = [*hold.axis, hold.undercut, *hold.orientation]
    stated = [*axis, math.radians(spec.undercut_deg), *np.deg2rad(spec.orientation_deg)]
    return measure_difference(f"{key}: axis_deg, undercut_deg, orientation_deg", stored, stated)


def _compare_region_hold(key: str, surface: Surface, region: RegionSpec) -> Difference:
    """Compare how a region can be gripped, with the axis projected into its plane."""
    stored = surface.hold if isinstance(surface, Region) else None
    if region.hold is None or stored is None or not isinstance(surface, Region):
        return check_equality(f"{key}.hold", (region.hold is None) == (stored is None))
    hold_spec = region.hold
    projected = np.cross(np.cross(surface.normal, hold_spec.axis), surface.normal)
    axis = projected / np.linalg.norm(projected)
    stated = [*axis, math.radians(hold_spec.undercut_deg), *np.deg2rad(hold_spec.orientation_deg)]
    return measure_difference(
        f"{key}.hold", [*stored.axis, stored.undercut, *stored.orientation], stated
    )


def _build_wall_corners(walls: WallsSpec, side: int) -> Array:
    """Return the corners of a wall: half the gap from the middle at y = 0, opening by half the
    angle.
    """
    slope = math.tan(math.radians(walls.angle_deg) / 2)
    corners = itertools.product(walls.along, walls.up)
    return np.array([(side * (walls.gap / 2 + y * slope), y, z) for y, z in corners])


def _build_level_corners(
    across: tuple[float, float], along: tuple[float, float], z: float
) -> Array:
    """Return the corners of a level rectangle."""
    return np.array([(x, y, z) for x in across for y in along])


def _build_region_corners(region: RegionSpec) -> Array:
    """Return the corners of a region as its spec states them."""
    if region.rectangle is None:
        return np.array(region.vertices, float)
    flat = region.rectangle
    x, y, z = np.array(flat.normal) / np.linalg.norm(flat.normal)
    level = math.hypot(x, y)
    across = np.array([-y, x, 0.0]) / level if level > 1e-9 else np.array([1.0, 0.0, 0.0])
    up = np.cross((x, y, z), across)
    ends = itertools.product((-0.5, 0.5), repeat=2)
    return np.array([flat.center + s * flat.width * across + t * flat.height * up for s, t in ends])


def _list_points(solid: SolidSpec) -> Array:
    """Return the corners of a solid."""
    if solid.lower is not None and solid.upper is not None:
        return np.array(list(itertools.product(*zip(solid.lower, solid.upper, strict=True))))
    return np.array(solid.vertices, float)
