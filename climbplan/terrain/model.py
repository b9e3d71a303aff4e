"""The terrain of one task: surfaces by limb, solids, and the body's free space."""

from __future__ import annotations

import itertools
import logging
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError
from climbplan.robots.model import Robot
from climbplan.schema.terrain.panel import HoldSpec, PanelSpec, RegionHoldSpec
from climbplan.schema.terrain.terrain import BoxSpec, GroundSpec, TerrainSpec, WallsSpec
from climbplan.terrain.holds import PANEL, hold_extent, hold_of, hold_on, rectangle_on
from climbplan.terrain.nearest import bounds_of, nearest_region
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Surface, Tube

_log = logging.getLogger(__name__)
STATED = ("left", "right", "ground", "panel", "tube")  # surfaces that keys of their own state
_ON_FACE = 1e-6  # [m] a surface this close to a face of a solid lies on it


@dataclass(frozen=True)
class FreeRegion:
    """Convex free space {x : A x <= b} for the body (may be unbounded)."""

    name: str
    A: Array  # (F, 3) unit rows
    b: Array  # (F,) [m]


@dataclass(frozen=True)
class Terrain:
    """Contact surfaces, obstacles and free space of a task."""

    surfaces: tuple[Surface, ...]  # Regions, or one Tube
    allowed: BoolArray  # (N, R) limb i may stand on surface r
    obstacles: tuple[Solid, ...]
    free_choices: tuple[tuple[FreeRegion, ...], ...]  # the body is in one region of every choice
    scan: RawSurface | None = None  # in which the regions were found

    @property
    def is_curved(self) -> bool:
        """True if the surface is a tube."""
        return isinstance(self.surfaces[0], Tube)

    @cached_property
    def regions(self) -> tuple[Region, ...]:
        """The flat regions; none in a tube."""
        return tuple(s for s in self.surfaces if isinstance(s, Region))

    @cached_property
    def bounds(self) -> Array:
        """Lower and upper bounds of the coordinates of the flat regions, (2, R, 3) [m]."""
        return bounds_of(self.regions)

    @cached_property
    def stood_upon(self) -> BoolArray:
        """True (N, O) if limb i may stand on a surface on a face of the obstacle."""
        # Regions of a scan lie within its flatness of the triangles
        tolerance = _ON_FACE if self.scan is None else self.scan.flatness
        lies = [
            [lies_on(surface, solid, tolerance) for solid in self.obstacles]
            for surface in self.surfaces
        ]
        return self.allowed @ np.array(lies, bool).reshape(len(self.surfaces), len(self.obstacles))

    @property
    def _backed_regions(self) -> tuple[Region, ...]:
        """Flat regions with material behind them.

        Behind regions of a scan lies the scan itself: what is behind one may be before the next.
        """
        if self.scan is None:
            return self.regions
        return tuple(r for r in self.regions if r.name in STATED)

    @property
    def solids(self) -> tuple[Solid, ...]:
        """Obstacles and the material behind flat regions, for collision checks."""
        return (*self.obstacles, *(region.slab() for region in self._backed_regions))

    @cached_property
    def link_solids(self) -> tuple[Solid | Tube, ...]:
        """The obstacles of links: `solids`, and the walls of tubes, from inside."""
        return (*self.solids, *(s for s in self.surfaces if isinstance(s, Tube)))

    @cached_property
    def stood_solids(self) -> BoolArray:
        """True (N, S) if limb i may stand on a face of the solid of `link_solids`.

        The material behind a surface shares its plane with that of surfaces next to it.
        """
        if self.is_curved:
            same = np.ones((len(self.surfaces), 1), bool)
        else:
            normals = np.array([region.normal for region in self._backed_regions]).reshape(-1, 3)
            offsets = np.array([region.offset - region.standoff for region in self._backed_regions])
            off = [np.abs(r.material @ normals.T - offsets).max(axis=0) for r in self.regions]
            along = np.array([r.normal for r in self.regions]) @ normals.T
            same = (np.array(off) < _ON_FACE) & (along > 0)
        return np.asarray(np.hstack([self.stood_upon, self.allowed @ same]))

    def offset_surfaces(self, standoff: float) -> Terrain:
        """Return the terrain with surfaces offset into free space by `standoff` [m]."""
        surfaces = tuple(surface.add_standoff(standoff) for surface in self.surfaces)
        return replace(self, surfaces=surfaces)

    def nearest_surface(self, limb: int, point: Array) -> int:
        """Return the index of the surface nearest to a point among those the limb may use."""
        candidates = np.flatnonzero(self.allowed[limb])
        if self.is_curved:
            distances = [self.surfaces[r].distance(point) for r in candidates]
            return int(candidates[int(np.argmin(distances))])
        return nearest_region(self.regions, self.bounds, candidates, point)


def lies_on(surface: Surface, solid: Solid, tolerance: float = _ON_FACE) -> bool:
    """Return whether a flat surface covers part of a face of a solid.

    tolerance: distance [m] within which they coincide.
    """
    if not isinstance(surface, Region):
        return False
    distance = surface.material @ solid.A.T - solid.b  # (V, F)
    on_face = np.abs(distance).max(axis=0) < tolerance
    inside = bool((distance < tolerance).all())
    return inside and bool((on_face & (solid.A @ surface.normal > 0)).any())


def _build_walls(walls: WallsSpec, friction: float) -> tuple[Region, Region]:
    """Return the left and right wall as regions; with an angle they open towards +y."""
    tilt = np.deg2rad(walls.angle_deg) / 2
    along, up = np.array(walls.along), np.array(walls.up)
    built = []
    for name, side in (("left", -1.0), ("right", 1.0)):
        direction = np.array([side * np.sin(tilt), np.cos(tilt), 0.0])
        origin = np.array([side * walls.gap / 2, 0.0, 0.0])
        # Ends are given along y; the wall itself is longer by 1 / cos(tilt).
        ends = [origin + direction * (y / np.cos(tilt)) for y in along]
        corners = [ends[0] + [0, 0, up[0]], ends[1] + [0, 0, up[0]]]
        corners += [ends[1] + [0, 0, up[1]], ends[0] + [0, 0, up[1]]]
        if side > 0:  # anticlockwise seen from between the walls
            corners.reverse()
        built.append(Region.from_vertices(name, np.array(corners), friction))
    return built[0], built[1]


def _build_level_region(
    name: str, across: tuple[float, float], along: tuple[float, float], z: float, friction: float
) -> Region:
    """Return a level rectangle seen from above."""
    corners = [(across[i], along[j], z) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return Region.from_vertices(name, np.array(corners, float), friction)


def _build_ground(ground: GroundSpec, friction: float) -> Region:
    """Return the ground as a region."""
    return _build_level_region("ground", ground.across, ground.along, ground.height, friction)


def _build_panel(panel: PanelSpec, friction: float) -> Region:
    """Return the panel itself, on which no limb stands."""
    return Region.from_vertices(PANEL, rectangle_on(panel, panel.across, panel.along), friction)


def _build_hold_region(spec: TerrainSpec, panel: PanelSpec, name: str, hold: HoldSpec) -> Region:
    """Return a hold of the panel as a region."""
    friction = panel.friction if hold.friction is None else hold.friction
    corners = rectangle_on(panel, *hold_extent(hold))
    region = Region.from_vertices(name, corners, _choose_friction(friction, spec))
    return replace(region, hold=hold_of(panel, hold))


def _add_hold(region: Region, hold: RegionHoldSpec) -> Region:
    """Return the region with its hold."""
    try:
        return replace(region, hold=hold_on(region.normal, hold))
    except UsageError as error:
        raise UsageError(f"region {region.name!r}: {error}") from error


def _build_box_top(box: BoxSpec, friction: float) -> Region:
    """Return the top of a box as a region."""
    sides = zip(box.lower[:2], box.upper[:2], strict=True)
    across, along = sides
    return _build_level_region(box.name, across, along, box.upper[2], friction)


def _warn_of_hidden_patches(surfaces: list[Surface]) -> None:
    """Warn where regions of one plane overlap and differ in friction: either may be picked."""
    flat = [s for s in surfaces if isinstance(s, Region)]
    if len({region.friction for region in flat}) == 1:
        return  # of a scan there may be a thousand
    for first, second in itertools.combinations(flat, 2):
        same_plane = (
            first.normal @ second.normal > 1 - 1e-9 and abs(first.offset - second.offset) < 1e-6
        )
        if not same_plane or first.friction == second.friction:
            continue
        # Convex polygons overlap unless an edge of one has the other beyond it.
        separation = max(
            (second.vertices @ first.A.T - first.b).min(axis=0).max(),
            (first.vertices @ second.A.T - second.b).min(axis=0).max(),
        )
        if separation < -1e-6:
            _log.warning(
                "regions %r and %r overlap in one plane with different friction: toes there may be "
                "planned with either; if one is a patch, leave it out of the other",
                first.name,
                second.name,
            )


def _list_free_choices(
    spec: TerrainSpec, obstacles: tuple[Solid, ...]
) -> tuple[tuple[FreeRegion, ...], ...]:
    """Return the stated free regions, or for each obstacle the half-spaces beyond its faces."""
    if spec.free_regions:
        solids = [Solid.from_spec(s) for s in spec.free_regions]
        return (tuple(FreeRegion(s.name, s.A, s.b) for s in solids),)
    return tuple(
        tuple(
            FreeRegion(f"{solid.name} face {k}", -solid.A[k : k + 1], -solid.b[k : k + 1])
            for k in range(len(solid.b))
        )
        for solid in obstacles
    )


def _choose_friction(stated: float | None, spec: TerrainSpec) -> float:
    """Return the friction of a surface: its own, else the terrain's."""
    return spec.friction if stated is None else stated


def build_terrain(spec: TerrainSpec, robot: Robot) -> Terrain:
    """Build the terrain of a spec for a robot.

    Raises:
        UsageError: A region is empty, not flat or not convex, or a solid is flat.
    """
    surfaces: list[Surface] = []
    allowed: list[list[bool]] = []
    if spec.tube is not None:
        tube = spec.tube
        surfaces.append(
            Tube("tube", np.array(tube.center), tube.radius, *tube.up, friction=spec.friction)
        )
        allowed.append([True] * robot.limb_count)
    if spec.walls is not None:
        for region in _build_walls(spec.walls, _choose_friction(spec.walls.friction, spec)):
            surfaces.append(region)
            allowed.append([side in (region.name, "any") for side in robot.sides])
    if spec.ground is not None:
        surfaces.append(_build_ground(spec.ground, _choose_friction(spec.ground.friction, spec)))
        allowed.append([True] * robot.limb_count)
    for box in spec.boxes:
        surfaces.append(_build_box_top(box, _choose_friction(box.friction, spec)))
        allowed.append([box.limbs is None or name in box.limbs for name in robot.limb_names])
    if spec.panel is not None:
        for name, hold in spec.panel.holds.items():
            surfaces.append(_build_hold_region(spec, spec.panel, name, hold))
            allowed.append([hold.limbs is None or limb in hold.limbs for limb in robot.limb_names])
    for item in spec.regions:
        friction = _choose_friction(item.friction, spec)
        if item.rectangle is not None:
            flat = item.rectangle
            region = Region.from_rectangle(
                item.name,
                np.array(flat.center),
                np.array(flat.normal),
                flat.width,
                flat.height,
                friction,
            )
        else:
            region = Region.from_vertices(item.name, np.array(item.vertices), friction)
        if item.hold is not None:
            region = _add_hold(region, item.hold)
        surfaces.append(region)
        allowed.append([item.limbs is None or name in item.limbs for name in robot.limb_names])
    if robot.standoff:
        surfaces = [surface.add_standoff(robot.standoff) for surface in surfaces]
    if spec.panel is not None:
        panel = _build_panel(spec.panel, _choose_friction(spec.panel.friction, spec))
        surfaces.insert(0, panel)
        allowed.insert(0, [False] * robot.limb_count)
    _warn_of_hidden_patches(surfaces)
    boxes = [Solid.from_box(b.name, np.array(b.lower), np.array(b.upper)) for b in spec.boxes]
    obstacles = (*(Solid.from_spec(s) for s in spec.obstacles), *boxes)
    return Terrain(
        surfaces=tuple(surfaces),
        allowed=np.array(allowed, bool).T,
        obstacles=obstacles,
        free_choices=_list_free_choices(spec, obstacles),
    )
