"""Contact surfaces: flat convex polygons and the inside of a round tube."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.terrain.holds import Hold
from climbplan.terrain.solids import Solid

FLATNESS = 1e-6  # [m] largest distance of a region's corners from its plane
SLAB_THICKNESS = 0.05  # [m] depth of the material behind a region, for collision checks


class Surface(Protocol):
    """The interface of surfaces that toes stand on."""

    @property
    def name(self) -> str:
        """Name used in reports."""

    @property
    def friction(self) -> float:
        """Friction coefficient."""

    @property
    def standoff(self) -> float:
        """The distance of toes from the material [m]."""

    def add_standoff(self, standoff: float) -> Self:
        """Return the positions of toes that stay so far off it [m]."""

    def normal_at(self, points: Array) -> Array:
        """Return unit normals (..., 3) at points (..., 3) on the surface, into free space."""

    def distance(self, point: Array) -> float:
        """Return the distance of a point (3,) from the surface [m], boundary included."""

    def project(self, point: Array) -> Array:
        """Return the surface point (3,) nearest to a point."""


@dataclass(frozen=True)
class Region:
    """A flat convex polygon {p : A p <= b, normal . p = offset}."""

    name: str
    vertices: Array  # (K, 3) corners, anticlockwise seen from free space [m]
    normal: Array  # (3,) unit, into free space
    offset: float  # normal . p on the plane [m]
    A: Array  # (K, 3) unit outward normals of the edges, in the plane
    b: Array  # (K,) [m]
    friction: float
    # [m] by which it lies before the material: where wrists hold grippers, and feet their centres
    standoff: float = 0.0
    hold: Hold | None = None  # how it can be gripped; None: as a plane

    @classmethod
    def from_vertices(cls, name: str, vertices: Array, friction: float) -> Self:
        """Build a polygon from its corners.

        Raises:
            UsageError: It is not flat, convex and non-empty.
        """
        vertices = np.asarray(vertices, float)
        edges = np.roll(vertices, -1, axis=0) - vertices
        area_vector = 0.5 * np.cross(vertices - vertices[0], edges).sum(axis=0)
        area = float(np.linalg.norm(area_vector))
        if area < 1e-8:
            raise UsageError(f"region {name!r} is empty: its corners span no area")
        normal = area_vector / area
        offset = float(normal @ vertices.mean(axis=0))
        if np.abs(vertices @ normal - offset).max() > FLATNESS:
            raise UsageError(f"region {name!r} is not flat: its corners leave their plane")
        lengths = np.linalg.norm(edges, axis=1)
        if lengths.min() < 1e-9:
            raise UsageError(f"region {name!r} has the same corner twice")
        A = np.cross(edges / lengths[:, None], normal)
        b = np.einsum("ij,ij->i", A, vertices)
        if (vertices @ A.T - b).max() > FLATNESS:
            raise UsageError(f"region {name!r} is not convex, or its corners are out of order")
        return cls(name, vertices, normal, offset, A, b, friction)

    @classmethod
    def from_rectangle(
        cls, name: str, center: Array, normal: Array, width: float, height: float, friction: float
    ) -> Self:
        """Build a rectangle whose width is horizontal (along x if the normal is vertical)."""
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            raise UsageError(f"region {name!r}: its normal has no length")
        n = np.asarray(normal, float) / length
        across = np.cross([0.0, 0.0, 1.0], n)
        if np.linalg.norm(across) < 1e-9:
            across = np.array([1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        up = np.cross(n, across)
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
        corners = np.asarray(center) + signs @ np.stack([width * across, height * up])
        return cls.from_vertices(name, corners, friction)

    def normal_at(self, points: Array) -> Array:
        """Return the plane's unit normal, the same everywhere."""
        return np.broadcast_to(self.normal, points.shape)

    def distance(self, point: Array) -> float:
        """Return the distance from the polygon [m]."""
        return float(np.linalg.norm(point - self.project(point)))

    def project(self, point: Array) -> Array:
        """Return the nearest point of the polygon."""
        foot = point - (self.normal @ point - self.offset) * self.normal
        if (self.A @ foot <= self.b).all():
            return np.asarray(foot)
        edges = np.roll(self.vertices, -1, axis=0) - self.vertices
        along = np.einsum("ij,ij->i", foot - self.vertices, edges) / (edges**2).sum(axis=1)
        feet = self.vertices + np.clip(along, 0, 1)[:, None] * edges
        return np.asarray(feet[np.argmin(((feet - foot) ** 2).sum(axis=1))])

    @property
    def material(self) -> Array:
        """Corners (K, 3) of the material, behind the positions of toes that stay off it [m]."""
        return self.vertices - self.standoff * self.normal if self.standoff else self.vertices

    def slab(self) -> Solid:
        """Return the material behind the region."""
        front, offset = self.material, self.offset - self.standoff
        behind = front - SLAB_THICKNESS * self.normal
        return Solid(
            name=self.name,
            vertices=np.vstack([front, behind]),
            A=np.vstack([self.normal, -self.normal, self.A]),
            b=np.concatenate([[offset, SLAB_THICKNESS - offset], self.b]),
        )

    def add_standoff(self, standoff: float) -> Self:
        """Return the positions of toes (wrists, centres of feet) that far off this region [m]."""
        return replace(
            self,
            vertices=self.vertices + standoff * self.normal,
            offset=self.offset + standoff,
            standoff=standoff,
        )


@dataclass(frozen=True)
class Tube:
    """The inside of a round upright tube."""

    name: str
    center: Array  # (2,) axis position [m]
    radius: float  # at which toes stand [m]
    lower: float  # z from [m]
    upper: float  # z to [m]
    friction: float
    standoff: float = 0.0  # [m] by which the wall lies beyond it

    @property
    def wall(self) -> float:
        """Radius of the material [m]."""
        return self.radius + self.standoff

    def add_standoff(self, standoff: float) -> Self:
        """Return the positions of toes that stay so far off the wall [m]."""
        if not self.radius > standoff:
            raise UsageError(
                f"tube {self.name!r} of radius {self.radius:g} m: expected more than the "
                f"{standoff:g} m that toes stay off it"
            )
        return replace(self, radius=self.radius - standoff, standoff=standoff)

    def normal_at(self, points: Array) -> Array:
        """Return unit normals towards the axis."""
        inward = np.zeros_like(points)
        inward[..., :2] = self.center - points[..., :2]
        return inward / np.linalg.norm(inward, axis=-1, keepdims=True)

    def distance(self, point: Array) -> float:
        """Return the distance from the tube's wall [m]."""
        return float(np.linalg.norm(point - self.project(point)))

    def project(self, point: Array) -> Array:
        """Return the nearest point of the wall."""
        outward = point[:2] - self.center
        length = float(np.linalg.norm(outward))
        direction = outward / length if length > 1e-12 else np.array([1.0, 0.0])
        z = np.clip(point[2], self.lower, self.upper)
        return np.append(self.center + self.radius * direction, z)
