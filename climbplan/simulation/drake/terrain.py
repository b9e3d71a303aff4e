"""Convex solids that a plan's terrain is made of, read from the plan file's own arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from climbplan.arrays import Array

THICKNESS = 0.05  # [m] of the material behind a flat surface
_ON_FACE = 1e-6  # [m] surfaces this close to a face of an obstacle are that face
_BOX_CORNERS = 8
_SQUARE = 1e-9  # cosine of two edges that are at right angles
_STAVES = 180  # flat pieces of a tube


@dataclass(frozen=True)
class TerrainSolid:
    """A convex solid."""

    name: str
    corners: Array  # (V, 3) world frame [m]
    friction: float

    def as_box(self) -> tuple[Array, Array, Array] | None:
        """Return axes (3, 3), middle (3,) and size (3,) [m] of a box, None of other solids."""
        if len(self.corners) != _BOX_CORNERS:
            return None
        middle = self.corners.mean(axis=0)
        offsets = self.corners - self.corners[0]
        nearest = offsets[np.argsort((offsets**2).sum(axis=1))[1:]]
        edges = [nearest[0]]
        for edge in nearest[1:]:
            square = all(
                abs(edge @ known_edge) < _SQUARE * _multiply_lengths(edge, known_edge)
                for known_edge in edges
            )
            if square and len(edges) < 3:
                edges.append(edge)
        if len(edges) < 3:
            return None
        size = np.linalg.norm(edges, axis=1)
        axes = (np.array(edges) / size[:, None]).T
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        inside = np.abs((self.corners - middle) @ axes) - size / 2
        return (axes, middle, size) if np.abs(inside).max() < _ON_FACE else None


def _multiply_lengths(first: Array, second: Array) -> float:
    return float(np.linalg.norm(first) * np.linalg.norm(second))


def read_terrain(plan: Path) -> tuple[tuple[TerrainSolid, ...], tuple[str, ...]]:
    """Read surfaces and obstacles of a plan file, and name what of the terrain is left out.

    Flat surfaces are plates with their face where the material ends; surfaces that are a face of an
    obstacle give that obstacle their friction.
    """
    with h5py.File(plan, "r") as file:
        terrain = file["terrain"]
        surfaces = [terrain["surfaces"][key] for key in sorted(terrain["surfaces"])]
        obstacles = [terrain["obstacles"][key] for key in sorted(terrain["obstacles"])]
        friction = min(float(surface.attrs["friction"]) for surface in surfaces)
        frictions = {_read_name(obstacle): friction for obstacle in obstacles}
        solids = []
        for surface in surfaces:
            if _read_attribute(surface, "kind") == "tube":
                solids += _build_staves(surface)
                continue
            face = next((o for o in obstacles if _is_face(surface, o)), None)
            if face is None:
                solids.append(_build_plate(surface))
            else:
                frictions[_read_name(face)] = float(surface.attrs["friction"])
        solids += [
            TerrainSolid(_read_name(o), o["vertices"][()], frictions[_read_name(o)])
            for o in obstacles
        ]
        left_out = ("what a scan has between its flat regions",) if "scan" in terrain else ()
    return tuple(solids), left_out


def _read_attribute(group: Any, name: str) -> str:
    value = group.attrs[name]
    return value.decode("utf-8") if isinstance(value, bytes) else str(value)


def _read_name(group: Any) -> str:
    return _read_attribute(group, "name")


def _compute_face_corners(surface: Any) -> Array:
    """Return (V, 3) corners of the material's face; stored ones are where centres of feet stand."""
    standoff = float(surface.attrs.get("standoff", 0.0))
    return np.asarray(surface["vertices"][()] - standoff * surface["normal"][()])


def _build_plate(surface: Any) -> TerrainSolid:
    face = _compute_face_corners(surface)
    behind = face - THICKNESS * surface["normal"][()]
    return TerrainSolid(
        _read_name(surface), np.concatenate([face, behind]), float(surface.attrs["friction"])
    )


def _is_face(surface: Any, obstacle: Any) -> bool:
    distance = _compute_face_corners(surface) @ obstacle["A"][()].T - obstacle["b"][()]  # (V, F)
    on_face = np.abs(distance).max(axis=0) < _ON_FACE
    outward = obstacle["A"][()] @ surface["normal"][()] > 0
    return bool((distance < _ON_FACE).all() and (on_face & outward).any())


def _build_staves(tube: Any) -> list[TerrainSolid]:
    """Return plates that touch the inside of a tube about z in their middles."""
    standoff = float(tube.attrs.get("standoff", 0.0))
    radius = float(tube.attrs["radius"]) + standoff
    low, high = (float(tube.attrs[end]) for end in ("lower", "upper"))
    center = np.append(tube["center"][()], 0.0)
    half = radius * np.tan(np.pi / _STAVES)
    built = []
    for angle in np.arange(_STAVES) * 2 * np.pi / _STAVES:
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        tangent = np.array([-outward[1], outward[0], 0.0])
        corners = [
            center + depth * outward + side * tangent + [0.0, 0.0, z]
            for depth in (radius, radius + THICKNESS)
            for side in (-half, half)
            for z in (low, high)
        ]
        built.append(TerrainSolid("tube", np.array(corners), float(tube.attrs["friction"])))
    return built
