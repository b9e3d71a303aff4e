"""Contacts of motions whose files have none, by distance from the terrain and by speed.

A foot is in contact while one of its points is within `Rule.distance` of the terrain and slower
than `Rule.speed`. The measures of the motion then tell how exact its contacts are.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.motions.terrain_distance import measure_distances
from climbplan.motions.tracked_motion import ContactSamples, TerrainMesh, TrackedMotion
from climbplan.schema.robots.urdf.tree import UrdfTree
from climbplan.schema.robots.xml import (
    Element,
    parse_xml,
    read_number_attribute,
    read_vector_attribute,
)

_GROUND_MARGIN = 5.0  # [m] of level ground beyond the motion


@dataclass(frozen=True)
class Rule:
    """When a foot counts as being in contact."""

    distance: float = 0.02  # [m] of a point from the terrain
    speed: float = 0.15  # [m/s] of that point


@dataclass(frozen=True)
class FootShape:
    """Points that a foot may touch with, in the frame of its link."""

    points: Array  # (K, 3) [m]
    radius: float  # [m] of spheres about them


def compute_contact_points(motion: TrackedMotion, contacts: ContactSamples) -> Array:
    """Return the points (T, C, K, 3) of contacts as their links move, world frame [m]."""
    rotation = motion.body_rotation[:, contacts.body]
    points = np.einsum("tcij,ckj->tcki", rotation, contacts.offset)
    return np.asarray(points + motion.body_position[:, contacts.body][:, :, None])


def build_level_ground(motion: TrackedMotion, height: float) -> TerrainMesh:
    """Return a level rectangle below a whole motion, at a height [m]."""
    xy = motion.body_position[..., :2].reshape(-1, 2)
    low, high = xy.min(axis=0) - _GROUND_MARGIN, xy.max(axis=0) + _GROUND_MARGIN
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return TerrainMesh(
        np.array([(x, y, height) for x, y in corners]), np.array([[0, 1, 2], [0, 2, 3]])
    )


def add_contacts(motion: TrackedMotion, feet: dict[str, FootShape], rule: Rule) -> TrackedMotion:
    """Return a motion with contacts of its feet by a rule.

    Args:
        motion: A motion with a terrain.
        feet: Shapes by the names of bodies that may touch.
        rule: When they do.

    Raises:
        UsageError: The motion has no such body.
    """
    assert motion.terrain is not None
    missing = [name for name in feet if name not in motion.body_names]
    if missing:
        raise UsageError(
            f"{motion.name}: no body {missing[0]!r}; --feet: expected some of "
            f"{', '.join(motion.body_names)}"
        )
    points = max(len(shape.points) for shape in feet.values())
    samples, count = len(motion.time), len(feet)
    contacts = ContactSamples(
        names=tuple(feet),
        body=np.array([motion.body_names.index(name) for name in feet]),
        offset=np.stack([_repeat_points(shape.points, points) for shape in feet.values()]),
        radius=np.array([shape.radius for shape in feet.values()]),
        is_touching=np.zeros((samples, count), bool),
        surface=np.full((samples, count), -1),
        force=None,
        position=np.zeros((samples, count, 3)),
        normal=np.zeros((samples, count, 3)),
    )
    world = compute_contact_points(motion, contacts)
    distance = measure_distances(world.reshape(-1, 3), motion.terrain).reshape(world.shape[:-1])
    speed = np.linalg.norm(np.gradient(world, 1 / motion.fps, axis=0), axis=-1)
    is_near = distance - contacts.radius[:, None] <= rule.distance
    touching = (is_near & (speed <= rule.speed)).any(axis=-1)
    lowest = distance.argmin(axis=-1)[..., None, None]
    position = np.take_along_axis(world, lowest, axis=2)[:, :, 0]
    return replace(motion, contacts=replace(contacts, is_touching=touching, position=position))


def _repeat_points(points: Array, count: int) -> Array:
    """Return points (count, 3): the given ones, the last one repeated."""
    return np.concatenate([points, np.repeat(points[-1:], count - len(points), axis=0)])


def read_foot_shapes(
    urdf: UrdfTree | None, names: list[str], radius: float | None
) -> dict[str, FootShape]:
    """Return the shapes of feet: of collision boxes, spheres and cylinders, else their origins.

    Args:
        urdf: The robot; None takes the origins of the bodies.
        names: Bodies that may touch.
        radius: Radius of a sphere about the origin of each body [m], in place of its shape.
    """
    if urdf is None or radius is not None:
        return {name: FootShape(np.zeros((1, 3)), radius or 0.0) for name in names}
    links = {e.attributes.get("name", ""): e for e in parse_xml(urdf.text).all("link")}
    shapes = {}
    for name in names:
        collision_shapes = [] if name not in links else _read_shapes(links[name])
        if not collision_shapes:
            raise UsageError(
                f"{urdf.path.name}: link {name!r} has no box, sphere, cylinder or capsule; "
                "expected --foot-radius, with which the origin of the link counts"
            )
        same = {shape.radius for shape in collision_shapes}
        points = np.concatenate([shape.points for shape in collision_shapes])
        if len(same) > 1:
            raise UsageError(
                f"{urdf.path.name}: link {name!r} has shapes of several radii; "
                "expected --foot-radius"
            )
        shapes[name] = FootShape(points, same.pop())
    return shapes


def _read_shapes(link: Element) -> list[FootShape]:
    """Return the collision shapes of a link; meshes are left out."""
    shapes = []
    for collision in link.all("collision"):
        geometry, origin = collision.first("geometry"), collision.first("origin")
        shape = geometry.children[0] if geometry is not None and geometry.children else None
        if shape is None or shape.tag == "mesh":
            continue
        place = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if origin is not None:
            place = (
                read_vector_attribute(origin, "xyz") or place[0],
                read_vector_attribute(origin, "rpy") or place[1],
            )
        local = _read_shape(shape)
        points = Rotation.from_euler("xyz", place[1]).apply(local.points) + np.array(place[0])
        shapes.append(FootShape(points, local.radius))
    return shapes


def _read_shape(shape: Element) -> FootShape:
    """Return corners of a box, points on the rims of a cylinder, ends of a capsule, a centre."""
    if shape.tag == "box":
        half = np.array(read_vector_attribute(shape, "size") or (0.0, 0.0, 0.0)) / 2
        return FootShape(np.array(list(itertools.product((-1, 1), repeat=3))) * half, 0.0)
    radius = read_number_attribute(shape, "radius") or 0.0
    half_length = (read_number_attribute(shape, "length") or 0.0) / 2
    if shape.tag == "sphere":
        return FootShape(np.zeros((1, 3)), radius)
    ends = np.array([[0.0, 0.0, -half_length], [0.0, 0.0, half_length]])
    if shape.tag == "capsule":
        return FootShape(ends, radius)
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rim = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return FootShape((ends[:, None] + rim).reshape(-1, 3), 0.0)
