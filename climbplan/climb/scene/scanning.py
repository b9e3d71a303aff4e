"""Terrain from a scan: contact regions and free space, found and written into the spec.

As with a start taken from another plan, the resulting text does not depend on the scan's file.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.climb.scene.ground_way import follow_ground
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.motion import MotionSpec
from climbplan.climb.schema.transition import TransitionSpec
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.errors import SpecError, SpecMistake, UsageError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.scan.body_holds import (
    NAME,
    BodyHold,
    find_body_holds,
    find_closed_bodies,
    format_body_regions,
    format_body_summary,
)
from climbplan.scan.contact_regions import FoundRegion, find_contact_regions
from climbplan.scan.file_cache import load_scan
from climbplan.scan.free_space import ConvexFreeRegion, inflate_free_space, split_path
from climbplan.scan.holds import Grasping, find_wall_holds
from climbplan.scan.orienting import orient_to_free_space
from climbplan.scan.panel import build_panel, format_wall_summary
from climbplan.scan.raw import RawScan, ScanError, select_within_box
from climbplan.schema.overrides import Override
from climbplan.schema.terrain.scan import ScanHoldsSpec, ScanSpec
from climbplan.terrain.raw_surface import RawSurface

_log = logging.getLogger(__name__)

Loaded = TypeVar("Loaded", LoadedClimb, LoadedTransition)

_SCAN_KEY = "terrain.scan"
_REACH_EXTENSION = 0.1  # [m] beyond reach that counts, too: toes swing over edges
_MAX_SCAN_DISTANCE = 20.0  # [m] from the start, where a scan is rather in another unit


def fit_scan(loaded: Loaded) -> Loaded:
    """Return the spec with contact regions and free space from its scan near the path.

    Listed regions are kept; listed free regions replace those that would be found.

    Raises:
        SpecError: The scan cannot be read, or has nothing within reach.
    """
    scan = loaded.spec.terrain.scan
    if scan is None or not scan.fit:
        return loaded
    robot = build_robot(loaded.robot)
    guide = build_guide(loaded.spec)
    if scan.holds is not None:
        return _add_holds(loaded, scan, scan.holds, robot, guide)
    foot_radius = robot.foot.radius if robot.foot is not None else 0.0
    if foot_radius > scan.toe_radius:
        scan = scan.model_copy(update={"toe_radius": foot_radius})
    try:
        raw = crop_scan(scan, loaded.directory, guide, robot)
        _log_notes(raw)
        regions_of_scan = find_contact_regions(raw, scan, foot_radius)
    except ScanError as error:
        raise _build_spec_error(loaded, f"{_SCAN_KEY}.file", str(error)) from error
    reachable = [
        r
        for r in regions_of_scan
        if _measure_distance(r, guide, compute_max_origin_depth(robot))
        <= compute_max_toe_distance(robot)
    ]
    if not reachable:
        raise _build_spec_error(
            loaded, f"{_SCAN_KEY}.file", _explain_no_region(regions_of_scan, guide, robot)
        )
    regions = [_build_region_spec(n, r, scan) for n, r in enumerate(reachable, start=1)]
    summary = (
        f"{len(reachable)} contact regions within reach, {sum(r.area for r in reachable):.3g} m^2"
    )
    ground_way = follow_ground(
        guide[0], guide[-1], reachable, float(np.ptp(robot.stance_body[:, 1])) / 2
    )
    return _add_regions(loaded, scan, raw, regions, summary, ground_way)


def _add_regions(
    loaded: Loaded,
    scan: ScanSpec,
    raw: RawScan,
    regions: list[dict[str, object]],
    summary: str,
    other_way: Array | None = None,
) -> Loaded:
    """Return the spec with regions added to its own, and free space if it states none.

    Where the straight way is not free and no points to pass are stated, those of another way (P, 3)
    are, if that is free.
    """
    _log.info("scan      %s", summary, extra={"note": True})
    stated_regions: list[dict[str, object]] = [
        r.model_dump(mode="json", exclude_unset=True) for r in loaded.spec.terrain.regions
    ]
    summary = f"found in {scan.file}"
    changes = [
        Override.of("terrain.regions", [*stated_regions, *regions], summary),
        Override.of("terrain.scan.fit", False, summary),
    ]
    if not loaded.spec.terrain.free_regions:
        spaces = _inflate_free_spaces(loaded, raw, build_guide(loaded.spec))
        blocked = _find_blocked_place(spaces)
        if blocked is not None and other_way is not None and not scan.guide:
            spaces = _inflate_free_spaces(loaded, raw, other_way, is_inclined=True)
            if _find_blocked_place(spaces) is None:
                blocked = None
                points = other_way[1:-1].round(4).tolist()
                changes.append(Override.of(f"{_SCAN_KEY}.guide", points, "along the ground"))
        if blocked is not None:
            place = ", ".join(f"{v:.2f}" for v in blocked)
            raise _build_spec_error(
                loaded,
                _SCAN_KEY,
                f"the body's way from start to goal meets the scan near ({place}); expected a way "
                f"that is free: another `task.goal.com`, or points to pass in `{_SCAN_KEY}.guide`",
            )
        free_regions = [_build_space_spec(n, space) for n, space in enumerate(spaces, start=1)]
        changes.append(Override.of("terrain.free_regions", free_regions, summary))
    return loaded.with_overrides(changes)


def _add_holds(
    loaded: Loaded, scan: ScanSpec, holds_spec: ScanHoldsSpec, robot: Robot, guide: Array
) -> Loaded:
    """Return the spec with holds for the robot's grippers.

    Closed bodies of a mesh are gripped by their sides and become regions with a hold. Any other
    scan is a wall, which becomes a panel that faces the start of the body.

    Raises:
        SpecError: The robot has no grippers, or there is no hold within reach.
    """
    opening = holds_spec.opening
    if opening is None:
        if robot.gripper is None:
            message = f"{robot.name} has no grippers; expected a robot that has, or an `opening`"
            raise _build_spec_error(loaded, f"{_SCAN_KEY}.holds", message)
        opening = robot.gripper.finger_span
    grasping = Grasping(opening, holds_spec.depth, holds_spec.steepest_back_deg)
    try:
        raw = orient_to_free_space(load_scan(scan, loaded.directory), guide[0])
        _log_notes(raw)
        if find_closed_bodies(raw).any():
            return _add_body_holds(loaded, scan, raw, grasping, robot)
        wall = find_wall_holds(raw, grasping)
    except ScanError as error:
        raise _build_spec_error(loaded, f"{_SCAN_KEY}.holds", str(error)) from error
    _log.info("scan      %s", format_wall_summary(wall, grasping), extra={"note": True})
    source_note = f"found in {scan.file}"
    return loaded.with_overrides(
        [
            Override.of("terrain.scan.fit", False, source_note),
            Override.of("terrain.panel", build_panel(wall), source_note),
        ]
    )


def _add_body_holds(
    loaded: Loaded, scan: ScanSpec, raw: RawScan, grasping: Grasping, robot: Robot
) -> Loaded:
    """Return the spec with regions where closed bodies are gripped; raise ScanError for none."""
    span = robot.gripper.finger_span if robot.gripper is not None else grasping.opening
    if grasping.opening > span:
        raise ScanError(
            f"the grippers of {robot.name} open {1e3 * span:g} mm, got an opening of "
            f"{1e3 * grasping.opening:g} mm; expected that at most, or a larger `finger_span`"
        )
    guide = build_guide(loaded.spec)
    holds = find_body_holds(raw, scan, grasping)
    distances = [_measure_distance(hold, guide, compute_max_origin_depth(robot)) for hold in holds]
    reachable = [
        hold
        for hold, distance in zip(holds, distances, strict=True)
        if distance <= compute_max_toe_distance(robot)
    ]
    if not reachable:
        raise ScanError(
            f"{len(holds)} graspable spots, the nearest {min(distances):.2f} m from the way; "
            f"the robot reaches {compute_max_toe_distance(robot):.2f} m from it"
        )
    summary = f"{format_body_summary(reachable, grasping)}, within reach"
    cropped = crop_scan(scan, loaded.directory, guide, robot)
    return _add_regions(loaded, scan, cropped, format_body_regions(reachable, scan), summary)


def build_raw_surface(spec: MotionSpec, directory: Path, robot: Robot) -> RawSurface | None:
    """Return the scan near the path, as plans carry it; None where the terrain has none."""
    scan = spec.terrain.scan
    if scan is None or (scan.holds is not None and spec.terrain.panel is not None):
        return None  # the panel stands for a wall with holds
    raw = crop_scan(scan, directory, build_guide(spec), robot)
    has_holds = any(region.hold is not None for region in spec.terrain.regions)
    depth = (scan.holds or ScanHoldsSpec()).depth if has_holds else 0.0
    return RawSurface(raw.vertices, raw.triangles, scan.flatness, scan.toe_radius, depth)


def crop_scan(scan: ScanSpec, directory: Path, guide: Array, robot: Robot) -> RawScan:
    """Return the part of a scan within reach of the path (P, 3), facing the path's free space."""
    full_scan = load_scan(scan, directory)
    oriented = orient_to_free_space(full_scan, guide[0])
    margin = compute_max_toe_distance(robot) + _REACH_EXTENSION
    raw = select_within_box(oriented, guide.min(axis=0) - margin, guide.max(axis=0) + margin)
    if not len(raw.triangles):
        distance = np.linalg.norm(full_scan.vertices - guide[0], axis=1).min()
        unit = (
            "; is its unit the metre? `scale` says otherwise"
            if distance > _MAX_SCAN_DISTANCE
            else ""
        )
        raise ScanError(
            f"{scan.file}: the scan does not come near the way, its nearest corner is "
            f"{distance:.2f} m from the start; "
            f"the robot reaches {compute_max_toe_distance(robot):.2f} m{unit}"
        )
    return raw


def _log_notes(raw: RawScan) -> None:
    """Log the notes of a scan."""
    for note in raw.notes:
        _log.info("scan      %s", note, extra={"note": True})


def build_guide(spec: MotionSpec) -> Array:
    """Return the body's path (P, 3) from the start by the scan's guide points to the goal."""
    scan = spec.terrain.scan
    waypoints = list(scan.guide) if scan is not None else []
    points = [spec.task.start.com, *waypoints, spec.task.goal.com]
    if isinstance(spec, TransitionSpec) and spec.climb is not None:
        points.append(spec.climb.goal.com)
    return np.array(points, float)


def compute_max_toe_distance(robot: Robot) -> float:
    """Return the largest distance of a toe from the body's origin [m]."""
    return float(np.linalg.norm(robot.shoulder_body, axis=1).max() + robot.reach)


def _sample_path(guide: Array) -> Array:
    """Return points (K, 3) of the path, at most 5 cm apart."""
    pieces = []
    for start, end in itertools.pairwise(guide):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / 0.05)))
        pieces.append(start + np.linspace(0, 1, count + 1)[:, None] * (end - start))
    return np.concatenate(pieces)


def compute_max_origin_depth(robot: Robot) -> float:
    """Return how far behind a face the body's origin can be while a toe presses on it [m].

    The last link is then in front of the face, and so is the joint at its beginning. That joint is
    at most this far from the body's origin.
    """
    shoulder = np.linalg.norm(robot.shoulder_body, axis=1)
    if isinstance(robot.limbs, FiveBar):
        return float((shoulder + robot.reach).max())
    return float((shoulder + robot.longest_links[:, :-1].sum(axis=1)).max())


def _measure_distance(region: FoundRegion | BodyHold, guide: Array, max_depth: float) -> float:
    """Return the distance of a region from the path; infinite if all of the path is behind it."""
    path_points = _sample_path(guide)
    height = (path_points - region.vertices[0]) @ region.normal
    is_in_front = height > -max_depth
    if not is_in_front.any():
        return float("inf")
    path_points, height = path_points[is_in_front], height[is_in_front]
    projections = path_points - height[:, None] * region.normal
    corners = region.vertices
    edges = np.roll(corners, -1, axis=0) - corners
    edge_normals = np.cross(edges, region.normal)
    inside = ((projections[:, None] - corners) * edge_normals).sum(axis=-1).max(axis=1) <= 0
    fraction = ((projections[:, None] - corners) * edges).sum(axis=-1) / (edges**2).sum(axis=-1)
    nearest = corners + np.clip(fraction, 0, 1)[..., None] * edges
    edge_distance = np.linalg.norm(projections[:, None] - nearest, axis=-1).min(axis=1)
    return float(np.hypot(np.where(inside, 0.0, edge_distance), height).min())


def _explain_no_region(regions: tuple[FoundRegion, ...], guide: Array, robot: Robot) -> str:
    """Explain why no contact region is within reach."""
    reach = f"the robot reaches {compute_max_toe_distance(robot):.2f} m from its body's way"
    if not regions:
        return (
            f"no contact region in it near the way, expected flat places at least `min_size` "
            f"wide within `flatness`; {reach}"
        )
    nearest = min(_measure_distance(r, guide, compute_max_origin_depth(robot)) for r in regions)
    if np.isinf(nearest):
        return (
            f"{len(regions)} contact regions near the way, none of which faces it: the way lies "
            f"behind or within the surface"
        )
    return f"{len(regions)} contact regions, the nearest {nearest:.2f} m from the way; {reach}"


def _build_region_spec(number: int, region: FoundRegion, scan: ScanSpec) -> dict[str, object]:
    """Return a region as a spec states it."""
    region_spec: dict[str, object] = {
        "name": f"{NAME} {number}",
        "vertices": region.vertices.tolist(),
    }
    if region.label in scan.friction:
        region_spec["friction"] = scan.friction[region.label]
    return region_spec


def _find_blocked_place(spaces: Sequence[ConvexFreeRegion]) -> Array | None:
    """Return the first place (3,) where the body does not pass; None where it passes."""
    blocked = (s for s in spaces if s.min_clearance <= 0 or len(s.vertices) < 4)
    return next((space.place for space in blocked), None)


def _inflate_free_spaces(
    loaded: LoadedClimb | LoadedTransition, raw: RawScan, guide: Array, is_inclined: bool = False
) -> list[ConvexFreeRegion]:
    """Return free space along the pieces of a path (P, 3), with the body inclined as they rise."""
    spec, robot = loaded.spec, build_robot(loaded.robot)
    hulls = [
        robot.body_hull @ rotation_world_body(np.deg2rad(rpy)).T
        for rpy in (spec.task.start.rpy_deg, spec.task.goal.rpy_deg)
    ]
    hull = np.concatenate(hulls) if not np.allclose(hulls[0], hulls[1]) else hulls[0]
    limit = np.deg2rad(spec.posture.rotation_limit_deg) if is_inclined else 0.0
    return [
        inflate_free_space(ends, hull @ _incline(ends, limit).T, raw.corners)
        for ends in split_path(guide)
    ]


def _incline(ends: Array, limit: float) -> Array:
    """Return the rotation (3, 3) by which a piece of a path (2, 3) rises, at most by a limit."""
    along = ends[1] - ends[0]
    level = float(np.hypot(along[0], along[1]))
    if level < 1e-9:
        return np.eye(3)
    rise = float(np.clip(np.arctan2(along[2], level), -limit, limit))
    axis = np.array([along[1], -along[0], 0.0]) / level
    return np.asarray(Rotation.from_rotvec(rise * axis).as_matrix())


def _build_space_spec(number: int, space: ConvexFreeRegion) -> dict[str, object]:
    """Return a free space as a spec states it."""
    return {"name": f"free {number}", "vertices": space.vertices.tolist()}


def _build_spec_error(loaded: LoadedClimb | LoadedTransition, key: str, message: str) -> SpecError:
    """Return the error of a key of the spec, with its line."""
    return loaded.locate(SpecError(loaded.source, [SpecMistake(key, message)]))


def load_raw_surface(spec: MotionSpec, directory: Path, robot: Robot) -> RawSurface | None:
    """Return the raw surface near the path; raise UsageError for a file that is not readable any
    more.
    """
    try:
        return build_raw_surface(spec, directory, robot)
    except ScanError as error:
        raise UsageError(str(error)) from error
