"""Terrain from a scan: contact regions and free space found and written into the spec.

As with a start taken from another plan, the spec's text then says the same without the file.
"""

from __future__ import annotations

import itertools
import logging
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from climbplan.arrays import Array
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
from climbplan.scan.free_space import FreeSpace, inflate_free_space, split_path
from climbplan.scan.holds import Grasping, find_wall_holds
from climbplan.scan.orienting import orient_to_free_space
from climbplan.scan.panel import build_panel, format_wall_summary
from climbplan.scan.raw import RawScan, ScanError, select_within_box
from climbplan.scan.reading import read_scan
from climbplan.schema.overrides import Override
from climbplan.schema.terrain.scan import ScanHoldsSpec, ScanSpec
from climbplan.terrain.raw_surface import RawSurface

_log = logging.getLogger(__name__)

Loaded = TypeVar("Loaded", LoadedClimb, LoadedTransition)

_KEY = "terrain.scan"
_BESIDE = 0.1  # [m] beyond reach that counts, too: toes swing over edges
_FAR = 20.0  # [m] from the start, where a scan is rather in another unit


def scanned(loaded: Loaded) -> Loaded:
    """The spec with what its scan has near the way: contact regions, and free space for the body.

    Listed regions are kept; listed free regions are taken instead of what would be found. Raises
    SpecError for a scan that cannot be read, or has nothing within reach.
    """
    scan = loaded.spec.terrain.scan
    if scan is None or not scan.fit:
        return loaded
    robot = build_robot(loaded.robot)
    guide = guide_of(loaded.spec)
    if scan.holds is not None:
        return _with_holds(loaded, scan, scan.holds, robot, guide)
    if robot.foot is not None and robot.foot.radius > scan.toe_radius:
        scan = scan.model_copy(update={"toe_radius": robot.foot.radius})
    try:
        raw = near_scan(scan, loaded.directory, guide, robot)
        _tell(raw)
        found = find_contact_regions(raw, scan)
    except ScanError as error:
        raise _refused(loaded, f"{_KEY}.file", str(error)) from error
    reached = [r for r in found if _distance(r, guide, around(robot)) <= farthest(robot)]
    if not reached:
        raise _refused(loaded, f"{_KEY}.file", _nothing(found, guide, robot))
    regions = [_as_spec(n, r, scan) for n, r in enumerate(reached, start=1)]
    told = f"{len(reached)} contact regions within reach, {sum(r.area for r in reached):.3g} m^2"
    return _on_regions(loaded, scan, raw, regions, told)


def _on_regions(
    loaded: Loaded, scan: ScanSpec, raw: RawScan, regions: list[dict[str, object]], told: str
) -> Loaded:
    """The spec with regions beside those that it lists, and free space if it states none."""
    _log.info("scan      %s", told, extra={"note": True})
    listed: list[dict[str, object]] = [
        r.model_dump(mode="json", exclude_unset=True) for r in loaded.spec.terrain.regions
    ]
    told = f"found in {scan.file}"
    changes = [
        Override.of("terrain.regions", [*listed, *regions], told),
        Override.of("terrain.scan.fit", False, told),
    ]
    if not loaded.spec.terrain.free_regions:
        spaces = [_space(n, s) for n, s in enumerate(_spaces(loaded, raw), start=1)]
        changes.append(Override.of("terrain.free_regions", spaces, told))
    return loaded.with_overrides(changes)


def _with_holds(
    loaded: Loaded, scan: ScanSpec, asked: ScanHoldsSpec, robot: Robot, guide: Array
) -> Loaded:
    """The spec with what the robot's grippers can hold.

    Closed bodies of a mesh are gripped where their sides are; they become regions with a hold. Any
    other scan is a wall, which becomes a panel that faces the start of the body. Raises SpecError
    for a robot without grippers, and where there is no hold within reach.
    """
    opening = asked.opening
    if opening is None:
        if robot.gripper is None:
            message = f"{robot.name} has no grippers; expected a robot that has, or an `opening`"
            raise _refused(loaded, f"{_KEY}.holds", message)
        opening = robot.gripper.finger_span
    grasping = Grasping(opening, asked.depth, asked.steepest_back_deg)
    try:
        raw = orient_to_free_space(_whole_scan(scan, loaded.directory), guide[0])
        _tell(raw)
        if find_closed_bodies(raw).any():
            return _on_bodies(loaded, scan, raw, grasping, robot)
        wall = find_wall_holds(raw, grasping)
    except ScanError as error:
        raise _refused(loaded, f"{_KEY}.holds", str(error)) from error
    _log.info("scan      %s", format_wall_summary(wall, grasping), extra={"note": True})
    told = f"found in {scan.file}"
    return loaded.with_overrides(
        [
            Override.of("terrain.scan.fit", False, told),
            Override.of("terrain.panel", build_panel(wall), told),
        ]
    )


def _on_bodies(
    loaded: Loaded, scan: ScanSpec, raw: RawScan, grasping: Grasping, robot: Robot
) -> Loaded:
    """The spec with regions from which closed bodies are gripped; raises ScanError for none."""
    span = robot.gripper.finger_span if robot.gripper is not None else grasping.opening
    if grasping.opening > span:
        raise ScanError(
            f"the grippers of {robot.name} open {1e3 * span:g} mm, got an opening of "
            f"{1e3 * grasping.opening:g} mm; expected that at most, or a larger `finger_span`"
        )
    guide = guide_of(loaded.spec)
    found = find_body_holds(raw, scan, grasping)
    away = [_distance(hold, guide, around(robot)) for hold in found]
    reached = [hold for hold, far in zip(found, away, strict=True) if far <= farthest(robot)]
    if not reached:
        raise ScanError(
            f"{len(found)} graspable spots, the nearest {min(away):.2f} m from the way; the robot "
            f"reaches {farthest(robot):.2f} m from it"
        )
    told = f"{format_body_summary(reached, grasping)}, within reach"
    near = near_scan(scan, loaded.directory, guide, robot)
    return _on_regions(loaded, scan, near, format_body_regions(reached, scan), told)


def raw_surface(spec: MotionSpec, directory: Path, robot: Robot) -> RawSurface | None:
    """The scan near the way, as plans carry it; None where the terrain has none."""
    scan = spec.terrain.scan
    if scan is None or (scan.holds is not None and spec.terrain.panel is not None):
        return None  # the panel stands for a wall with holds
    raw = near_scan(scan, directory, guide_of(spec), robot)
    gripped = any(region.hold is not None for region in spec.terrain.regions)
    depth = (scan.holds or ScanHoldsSpec()).depth if gripped else 0.0
    return RawSurface(raw.vertices, raw.triangles, scan.flatness, scan.toe_radius, depth)


def near_scan(scan: ScanSpec, directory: Path, guide: Array, robot: Robot) -> RawScan:
    """What of a scan lies within reach of the way (P, 3), facing the way's free space."""
    whole = _whole_scan(scan, directory)
    turned = orient_to_free_space(whole, guide[0])
    near = farthest(robot) + _BESIDE
    raw = select_within_box(turned, guide.min(axis=0) - near, guide.max(axis=0) + near)
    if not len(raw.triangles):
        away = np.linalg.norm(whole.vertices - guide[0], axis=1).min()
        unit = "; is its unit the metre? `scale` says otherwise" if away > _FAR else ""
        raise ScanError(
            f"{scan.file}: the scan does not come near the way, its nearest corner is {away:.2f} m "
            f"from the start; the robot reaches {farthest(robot):.2f} m{unit}"
        )
    return raw


def _whole_scan(scan: ScanSpec, directory: Path) -> RawScan:
    """All of a scan, mended; read once."""
    text = scan.model_dump_json(
        exclude={"fit", "flatness", "min_size", "toe_radius", "guide", "steepest_deg", "holds"}
    )
    return _whole(text, directory, _stamp(directory / scan.file))


@lru_cache(maxsize=4)
def _whole(scan: str, directory: Path, stamp: tuple[int, ...]) -> RawScan:
    return read_scan(ScanSpec.model_validate_json(scan), directory)


def _stamp(path: Path) -> tuple[int, ...]:
    try:
        found = path.stat()
    except OSError:
        return ()
    return (found.st_mtime_ns, found.st_size)


def _tell(raw: RawScan) -> None:
    for note in raw.notes:
        _log.info("scan      %s", note, extra={"note": True})


def guide_of(spec: MotionSpec) -> Array:
    """The body's way (P, 3): from the start by the points of the scan's guide to the goal."""
    scan = spec.terrain.scan
    between = list(scan.guide) if scan is not None else []
    points = [spec.task.start.com, *between, spec.task.goal.com]
    if isinstance(spec, TransitionSpec) and spec.climb is not None:
        points.append(spec.climb.goal.com)
    return np.array(points, float)


def farthest(robot: Robot) -> float:
    """How far from the body's origin a toe can be [m]."""
    return float(np.linalg.norm(robot.shoulder_body, axis=1).max() + robot.reach)


def _along(guide: Array) -> Array:
    """Points (K, 3) of the way, 5 cm apart at most."""
    pieces = []
    for start, end in itertools.pairwise(guide):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / 0.05)))
        pieces.append(start + np.linspace(0, 1, count + 1)[:, None] * (end - start))
    return np.concatenate(pieces)


def around(robot: Robot) -> float:
    """How far behind a face the body's origin can be while a toe presses on it [m].

    The last link then is before the face, and so is the joint that it begins at: this far from
    the body's origin at most.
    """
    shoulder = np.linalg.norm(robot.shoulder_body, axis=1)
    if isinstance(robot.limbs, FiveBar):
        return float((shoulder + robot.reach).max())
    return float((shoulder + robot.longest_links[:, :-1].sum(axis=1)).max())


def _distance(region: FoundRegion | BodyHold, guide: Array, behind: float) -> float:
    """Least distance of a region from the way; infinite for one that is `behind` [m] all along."""
    places = _along(guide)
    height = (places - region.vertices[0]) @ region.normal
    before = height > -behind
    if not before.any():
        return float("inf")
    places, height = places[before], height[before]
    feet = places - height[:, None] * region.normal
    corners = region.vertices
    edges = np.roll(corners, -1, axis=0) - corners
    out = np.cross(edges, region.normal)
    inside = ((feet[:, None] - corners) * out).sum(axis=-1).max(axis=1) <= 0
    share = ((feet[:, None] - corners) * edges).sum(axis=-1) / (edges**2).sum(axis=-1)
    nearest = corners + np.clip(share, 0, 1)[..., None] * edges
    flat = np.linalg.norm(feet[:, None] - nearest, axis=-1).min(axis=1)
    return float(np.hypot(np.where(inside, 0.0, flat), height).min())


def _nothing(found: tuple[FoundRegion, ...], guide: Array, robot: Robot) -> str:
    reach = f"the robot reaches {farthest(robot):.2f} m from its body's way"
    if not found:
        return (
            f"no contact region in it near the way, expected flat places at least `min_size` "
            f"wide within `flatness`; {reach}"
        )
    nearest = min(_distance(r, guide, around(robot)) for r in found)
    if np.isinf(nearest):
        return (
            f"{len(found)} contact regions near the way, none of which faces it: the way lies "
            f"behind or within the surface"
        )
    return f"{len(found)} contact regions, the nearest {nearest:.2f} m from the way; {reach}"


def _as_spec(number: int, region: FoundRegion, scan: ScanSpec) -> dict[str, object]:
    out: dict[str, object] = {"name": f"{NAME} {number}", "vertices": region.vertices.tolist()}
    if region.label in scan.friction:
        out["friction"] = scan.friction[region.label]
    return out


def _spaces(loaded: LoadedClimb | LoadedTransition, raw: RawScan) -> list[FreeSpace]:
    """Free space along the way; raises SpecError where the body does not pass."""
    spec, guide, robot = loaded.spec, guide_of(loaded.spec), build_robot(loaded.robot)
    hulls = [
        robot.body_hull @ rotation_world_body(np.deg2rad(rpy)).T
        for rpy in (spec.task.start.rpy_deg, spec.task.goal.rpy_deg)
    ]
    hull = np.concatenate(hulls) if not np.allclose(hulls[0], hulls[1]) else hulls[0]
    spaces = [inflate_free_space(ends, hull, raw.corners) for ends in split_path(guide)]
    for space in spaces:
        if space.min_clearance <= 0 or len(space.vertices) < 4:
            place = ", ".join(f"{v:.2f}" for v in space.place)
            raise _refused(
                loaded,
                _KEY,
                f"the body's way from start to goal meets the scan near ({place}); expected a way "
                f"that is free: another `task.goal.com`, or points to pass in `{_KEY}.guide`",
            )
    return spaces


def _space(number: int, space: FreeSpace) -> dict[str, object]:
    return {"name": f"free {number}", "vertices": space.vertices.tolist()}


def _refused(loaded: LoadedClimb | LoadedTransition, key: str, message: str) -> SpecError:
    return loaded.placed(SpecError(loaded.source, [SpecMistake(key, message)]))


def with_surface(spec: MotionSpec, directory: Path, robot: Robot) -> RawSurface | None:
    """As `raw_surface`; raises UsageError for a file that cannot be read any more."""
    try:
        return raw_surface(spec, directory, robot)
    except ScanError as error:
        raise UsageError(str(error)) from error
