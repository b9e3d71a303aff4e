"""Checks of the data that all others rely on: text, numbers, robot and terrain."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import QhullError

from climbplan.arrays import Array
from climbplan.climb.check.convex import build_hull, compute_polygon_edges, compute_polygon_normal
from climbplan.climb.plan.climb_plan import ClimbPlan, StepLimits
from climbplan.robots.foot import Foot
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.robots.ranges import LENGTH, MASS, SPEED, STIFFNESS, THICKNESS, TORQUE
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region, Tube
from climbplan.verification.check import Check, check_faults, judge

_PLANE_TOLERANCE = 1e-6  # [m] and as a difference of unit normals
_MIN_AREA = 1e-8  # [m^2]


def check_spec_hash(plan: ClimbPlan) -> Check:
    """Check that the spec's text is the one the plan was made for."""
    digest = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    differs = digest != plan.spec_sha256
    place = f"stored {plan.spec_sha256[:12]}..., text {digest[:12]}..." if differs else ""
    return judge("file.spec_hash", float(differs), place)


def check_finite(not_finite: Sequence[str]) -> Check:
    """Check that there is no NaN, and infinity only as a safety factor."""
    return check_faults("file.finite", not_finite)


_MAX_DISTANCE = 10 * LENGTH.high  # [m] of a part of a robot from its body


def check_robot(robot: Robot) -> Check:
    """Check lengths, masses, torques and stiffnesses against plausible ranges."""
    return check_faults("robot.data", list(_find_robot_faults(robot)))


def check_terrain(terrain: Terrain, robot: Robot) -> Check:
    """Check that surfaces and solids agree with their corners and with the standoff of the feet."""
    faults = list(_find_terrain_faults(terrain))
    if robot.gripper is None:
        radius = 0.0 if robot.foot is None else robot.foot.radius
        faults += [
            f"{surface.name!r} does not stand off by the radius of the feet, {radius:g} m"
            for index, surface in enumerate(terrain.surfaces)
            if terrain.allowed[:, index].any() and abs(surface.standoff - radius) > _PLANE_TOLERANCE
        ]
    return check_faults("terrain.data", faults)


def check_limits(limits: StepLimits) -> Check:
    """Check that the stored bounds can be satisfied at all."""
    faults = [
        f"{name} {value:g} is not above zero"
        for name, value in (
            ("com_max", limits.com_max),
            ("toe_max", limits.toe_max),
            ("rotation_max", limits.rotation_max),
            ("goal_tolerance", limits.goal_tolerance),
            ("goal_rotation_tolerance", limits.goal_rotation_tolerance),
            ("safety_friction", limits.safety_friction),
            ("safety_torque", limits.safety_torque),
        )
        if not value > 0
    ]
    faults += [
        f"{name} {value:g} is negative"
        for name, value in (
            ("com_min", limits.com_min),
            ("toe_min", limits.toe_min),
            ("shift_max", limits.shift_max),
            ("body_clearance", limits.body_clearance),
        )
        if not value >= 0
    ]
    return check_faults("limits.data", faults)


def _find_robot_faults(robot: Robot) -> Iterator[str]:
    # Joints of a chain may lie on one another.
    """Yield the faults of a robot's data."""
    lengths = {} if robot.mechanism is not None else {"link_lengths": (robot.link_lengths, LENGTH)}
    ranges = lengths | {
        "max_torque": (robot.max_torque, TORQUE),
        "joint_stiffness": (robot.joint_stiffness, STIFFNESS),
        "max_joint_speed": (robot.max_joint_speed, SPEED),
    }
    for name, (values, allowed_range) in ranges.items():
        is_outside = ~((values >= allowed_range.low) & (values <= allowed_range.high)).all(axis=1)
        for limb in np.flatnonzero(is_outside):
            yield f"{name} of {robot.limb_names[limb]} is not {allowed_range.expected}"
    for limb in np.flatnonzero(~(robot.joint_upper > robot.joint_lower).all(axis=1)):
        yield f"joint_upper - joint_lower of {robot.limb_names[limb]} is not above zero"
    for name in ("shoulder_body", "stance_body", "body_hull"):
        if not (np.abs(vars(robot)[name]) <= _MAX_DISTANCE).all():
            yield f"{name} lies more than {_MAX_DISTANCE:g} m from the body"
    if not MASS.holds(robot.mass):
        yield f"mass {robot.mass:g} kg is not {MASS.expected}"
    if not robot.gravity >= 0:
        yield f"gravity {robot.gravity:g} is negative"
    if not 0 <= robot.structural_compliance_share < 1:
        yield f"structural_compliance_share {robot.structural_compliance_share:g} is not in [0, 1)"
    if len(set(robot.limb_names)) < robot.limb_count:
        yield "limb names are not unique"
    if not _has_volume(robot.body_hull):
        yield "body_hull spans no volume"
    extents = [np.abs(body_part).max(initial=0.0) for body_part in robot.body_parts]
    if not all(extent <= _MAX_DISTANCE for extent in extents) or not all(
        map(_has_volume, robot.body_parts)
    ):
        yield "body_parts: expected bodies near the robot that span a volume"
    radii = [robot.limb_radius] if robot.capsules is None else robot.capsules.radius.ravel()
    if not all(THICKNESS.holds(float(radius)) for radius in radii):
        yield f"limb_radius or a radius of its capsules is not {THICKNESS.expected}"
    if robot.foot is not None:
        yield from _find_foot_faults(robot, robot.foot)
        if not isinstance(robot.mechanism, SerialChain) or robot.gripper is not None:
            yield "foot: expected limbs that are chains of joints, without grippers"
    if isinstance(robot.mechanism, SerialChain):
        yield from _find_chain_faults(robot, robot.mechanism)


def _find_foot_faults(robot: Robot, foot: Foot) -> Iterator[str]:
    """Yield sizes of feet out of range, and axes of soles that are not orthonormal."""
    if foot.sole is None:
        if not LENGTH.holds(foot.radius):
            yield f"foot: radius {foot.radius:g} m is not {LENGTH.expected}"
        return
    for name, size in (("length", foot.sole.length), ("width", foot.sole.width)):
        if not LENGTH.holds(size):
            yield f"foot: {name} {size:g} m is not {LENGTH.expected}"
    axes = foot.sole.axes_zero
    is_orthonormal = np.abs(np.swapaxes(axes, -1, -2) @ axes - np.eye(3)).max() <= _PLANE_TOLERANCE
    if not (is_orthonormal and (np.linalg.det(axes) > 0).all()):
        yield "foot: axes_zero are not right-handed and square"
    if robot.joint_count < 6:
        yield f"foot: flat feet on limbs of {robot.joint_count} joints"


def _find_chain_faults(robot: Robot, chain: SerialChain) -> Iterator[str]:
    """Yield contradictions between the robot's data and its chains."""
    ends = np.concatenate([chain.joint_zero, chain.toe_zero[:, None]], axis=1)
    lengths = np.linalg.norm(np.diff(ends, axis=1), axis=-1)
    for name, stored, chain_value in (
        ("shoulder_body", robot.shoulder_body, chain.joint_zero[:, 0]),
        ("link_lengths", robot.link_lengths, lengths),
    ):
        error = np.abs(stored - chain_value).max(axis=1)
        for limb in np.flatnonzero(~(error <= _PLANE_TOLERANCE)):
            yield f"{name} of {robot.limb_names[limb]} is not that of its chain"


def _find_terrain_faults(terrain: Terrain) -> Iterator[str]:
    """Yield the faults of surfaces, obstacles and free regions."""
    for surface in terrain.surfaces:
        if not surface.friction > 0:
            yield f"friction {surface.friction:g} of {surface.name!r} is not above zero"
        if isinstance(surface, Region):
            yield from _find_region_faults(surface)
        elif isinstance(surface, Tube) and not (
            surface.radius > 0 and surface.lower < surface.upper
        ):
            yield f"tube {surface.name!r} is empty"
    for solid in terrain.obstacles:
        if not _has_volume(solid.vertices):
            yield f"obstacle {solid.name!r} spans no volume"
            continue
        hull = build_hull(solid.name, solid.vertices)
        stored = np.column_stack([solid.A, solid.b])
        built = np.column_stack([hull.normals, hull.offsets])
        distance = np.abs(stored[:, None] - built[None, :]).max(axis=-1)  # (stored, built)
        if not (
            distance.size
            and max(distance.min(axis=0).max(), distance.min(axis=1).max()) <= _PLANE_TOLERANCE
        ):
            yield f"half-spaces of obstacle {solid.name!r} are not those of its corners"
    for choice in terrain.free_choices:
        for free in choice:
            if not np.allclose(np.linalg.norm(free.A, axis=1), 1.0, rtol=0, atol=_PLANE_TOLERANCE):
                yield f"half-spaces of free region {free.name!r} are not of unit length"


def _find_region_faults(region: Region) -> Iterator[str]:
    """Yield the faults of a flat region: area, flatness, convexity, planes."""
    corners = region.vertices
    sides = np.roll(corners, -1, axis=0) - corners
    area = np.linalg.norm(np.cross(corners - corners[0], sides).sum(axis=0)) / 2
    max_side = np.linalg.norm(sides, axis=1).max()
    if not (area > _MIN_AREA and np.linalg.norm(sides, axis=1).min() > _PLANE_TOLERANCE):
        yield f"surface {region.name!r} spans no area"
        return
    normal = compute_polygon_normal(corners)
    if not np.abs((corners - corners[0]) @ normal).max() <= _PLANE_TOLERANCE:
        yield f"surface {region.name!r} is not flat"
    corner_products = np.cross(np.roll(sides, 1, axis=0), sides) @ normal
    if not corner_products.min() >= -_PLANE_TOLERANCE * max_side:
        yield f"surface {region.name!r} is not convex"
    outward, offsets = compute_polygon_edges(corners, normal)
    differences = (
        region.normal - normal,
        region.offset - corners[0] @ normal,
        region.A - outward,
        region.b - offsets,
    )
    if not max(float(np.abs(d).max()) for d in differences) <= _PLANE_TOLERANCE:
        yield f"planes of surface {region.name!r} are not those of its corners"


def _has_volume(points: Array) -> bool:
    """Return whether points span a volume."""
    if len(points) < 4:
        return False
    try:
        build_hull("", points)
    except QhullError:
        return False
    return True
