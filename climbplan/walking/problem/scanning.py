"""Terrain of walks from a scan: foothold regions near the path, written into the spec.

Regions are found as for climbs. Those within reach of the path enter the problem: the path goes
from the start by `terrain.scan.guide` to the goal, or as far as the reference velocity gets in the
horizon, and a region counts if a toe's box comes near it from somewhere on the path.
"""

from __future__ import annotations

import logging

import numpy as np
import shapely

from climbplan.arrays import Array
from climbplan.errors import SpecError, SpecMistake, UsageError
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.scan.contact_regions import FoundRegion, find_contact_regions
from climbplan.scan.file_cache import load_scan
from climbplan.scan.orienting import orient_to_free_space
from climbplan.scan.raw import RawScan, ScanError, select_within_box
from climbplan.schema.overrides import Override
from climbplan.schema.terrain.scan import ScanSpec
from climbplan.terrain.raw_surface import RawSurface
from climbplan.walking.problem.problem import Walker, build_walker
from climbplan.walking.schema.loading import LoadedMpc
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import RigidBody

_log = logging.getLogger(__name__)

_FILE_KEY = "terrain.scan.file"
_MAX_SLOPE_DEG = 45.0  # of regions that are walked on
_REACH_EXTENSION = 0.2  # [m] beyond the boxes of toes: bodies leave the straight path, toes swing
_ABOVE = 1.0  # [m] of free space above the scan
_MAX_SCAN_DISTANCE = 20.0  # [m] from the start, where a scan is rather in another unit


def fit_walk_scan(loaded: LoadedMpc) -> LoadedMpc:
    """Return the spec with foothold regions from its scan near the path; listed ones are kept.

    Raises:
        SpecError: The scan cannot be read, or has no region within reach.
    """
    scan = loaded.spec.terrain.scan
    if scan is None or not scan.fit:
        return loaded
    walker = build_walker(loaded.robot)
    path, reach = build_path(loaded.spec), compute_level_reach(walker.body)
    try:
        raw = _crop_scan(loaded, scan, path, reach)
        for note in raw.notes:
            _log.info("scan      %s", note, extra={"note": True})
        regions = find_contact_regions(raw, _limit_scan(scan, walker), walker.foot)
        reachable = select_regions(regions, path, reach)
        if not reachable:
            raise ScanError(_explain_no_region(regions, path, reach))
    except ScanError as error:
        mistake = SpecMistake(_FILE_KEY, str(error))
        raise loaded.locate(SpecError(loaded.source, [mistake])) from error
    area = sum(region.area for region in reachable)
    _log.info(
        "scan      %d foothold regions within reach, %.3g m^2",
        len(reachable),
        area,
        extra={"note": True},
    )
    stated = [
        region.model_dump(mode="json", exclude_unset=True) for region in loaded.spec.terrain.regions
    ]
    origin = f"found in {scan.file}"
    regions_of_spec = [
        _build_region_spec(n, region, scan) for n, region in enumerate(reachable, start=1)
    ]
    return loaded.with_overrides(
        [
            Override.of("terrain.regions", [*stated, *regions_of_spec], origin),
            Override.of("terrain.scan.fit", False, origin),
        ]
    )


def load_walk_surface(loaded: LoadedMpc) -> RawSurface | None:
    """Return the raw surface near the path, in the axes of the spec; None without a scan.

    Raises:
        UsageError: the file is not readable any more.
    """
    scan = loaded.spec.terrain.scan
    if scan is None:
        return None
    walker = build_walker(loaded.robot)
    path, reach = build_path(loaded.spec), compute_level_reach(walker.body)
    try:
        raw = _crop_scan(loaded, scan, path, reach)
    except ScanError as error:
        raise UsageError(str(error)) from error
    toe_radius = _limit_scan(scan, walker).toe_radius
    return RawSurface(raw.vertices, raw.triangles, scan.flatness, toe_radius)


def build_path(spec: MpcSpec) -> Array:
    """Return the path (P, 2) of the body in the axes of the spec [m]."""
    task, scan = spec.task, spec.terrain.scan
    start = np.array(task.start.position, float)
    guide = [np.array(point[:2], float) for point in (scan.guide if scan is not None else ())]
    if task.goal is not None:
        end = np.array(task.goal.position, float)
    else:
        velocity = np.array(task.reference.velocity, float)
        if spec.forward == "y" and "velocity" not in task.reference.model_fields_set:
            velocity = TO_WALKING.T @ velocity
        online = spec.solver.method == "online"
        duration = spec.loop.duration if online else task.knots * task.dt
        end = start + duration * velocity[:2]
    return np.array([start, *guide, end])


def compute_level_reach(body: RigidBody) -> float:
    """Return the largest level distance of a toe from the body, in a level attitude [m]."""
    corner = np.abs(body.toe_center[:, :2]) + body.toe_half[:2]
    return float(np.linalg.norm(corner, axis=1).max())


def select_regions(
    regions: tuple[FoundRegion, ...], path: Array, reach: float
) -> list[FoundRegion]:
    """Return the regions within reach [m] of a path (P, 2), in their order."""
    if not regions:
        return []
    outlines = shapely.polygons([shapely.linearrings(r.vertices[:, :2]) for r in regions])
    is_reachable = shapely.distance(outlines, _build_line(path)) <= reach + _REACH_EXTENSION
    return [region for region, keep in zip(regions, is_reachable, strict=True) if keep]


def _build_line(path: Array) -> shapely.Geometry:
    """Return a path (P, 2) as a geometry, a point if it does not move."""
    if np.ptp(path, axis=0).max() < 1e-9:
        return shapely.points(path[0])
    return shapely.linestrings(path)


def _limit_scan(scan: ScanSpec, walker: Walker) -> ScanSpec:
    """Return a scan whose regions are not too steep, with room for the feet."""
    update = {
        "steepest_deg": min(scan.steepest_deg, _MAX_SLOPE_DEG),
        "toe_radius": max(scan.toe_radius, walker.foot),
    }
    return scan.model_copy(update=update)


def _crop_scan(loaded: LoadedMpc, scan: ScanSpec, path: Array, reach: float) -> RawScan:
    """Return the part of a scan near a path (P, 2), facing the free space above it."""
    full_scan = load_scan(scan, loaded.directory)
    low, high = full_scan.vertices.min(axis=0), full_scan.vertices.max(axis=0)
    oriented = orient_to_free_space(full_scan, np.append(path[0], high[2] + _ABOVE))
    margin = reach + _REACH_EXTENSION
    raw = select_within_box(
        oriented,
        np.append(path.min(axis=0) - margin, low[2]),
        np.append(path.max(axis=0) + margin, high[2]),
    )
    if len(raw.triangles):
        return raw
    distance = float(np.linalg.norm(full_scan.vertices[:, :2] - path[0], axis=1).min())
    unit = (
        "; is its unit the metre? `scale` says otherwise" if distance > _MAX_SCAN_DISTANCE else ""
    )
    raise ScanError(
        f"{scan.file}: the scan does not come near the path, its nearest corner is "
        f"{distance:.2f} m from the start; toes reach {reach:.2f} m{unit}"
    )


def _explain_no_region(regions: tuple[FoundRegion, ...], path: Array, reach: float) -> str:
    """Explain why no region is within reach."""
    if not regions:
        return (
            "no foothold region in it near the path, expected flat places at least `min_size` "
            f"wide within `flatness`, at most {_MAX_SLOPE_DEG:g} degrees steep"
        )
    outlines = shapely.polygons([shapely.linearrings(r.vertices[:, :2]) for r in regions])
    nearest = float(shapely.distance(outlines, _build_line(path)).min())
    return (
        f"{len(regions)} foothold regions, the nearest {nearest:.2f} m from the path; toes reach "
        f"{reach:.2f} m"
    )


def _build_region_spec(number: int, region: FoundRegion, scan: ScanSpec) -> dict[str, object]:
    """Return a region as a spec states it."""
    spec: dict[str, object] = {"name": f"scan {number}", "vertices": region.vertices.tolist()}
    if region.label in scan.friction:
        spec["friction"] = scan.friction[region.label]
    return spec
