"""Surfaces whose standable area is known: all that keeps the toe's radius from edges."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.scan.raw import RawScan, build_mesh

ROOM = 0.01  # [m]


class Known(NamedTuple):
    """A surface and what toes can stand on."""

    raw: RawScan
    area: float  # [m^2]


def grid(across: Array, along: Array, height: Callable[[Array, Array], Array]) -> RawScan:
    """A sheet over a grid, facing up."""
    u, v = np.meshgrid(across, along, indexing="ij")
    points = np.stack([u, v, height(u, v)], axis=-1).reshape(-1, 3)
    return build_mesh(points, sheet(len(across), len(along)))


def sheet(rows: int, columns: int) -> IntArray:
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    pairs = ((a, b, d), (a, d, c))
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in pairs])


def joined(*parts: RawScan) -> RawScan:
    counts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    return build_mesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.triangles + n for p, n in zip(parts, counts, strict=False)]),
    )


def quad(corners: list[tuple[float, float, float]]) -> RawScan:
    """Four corners, anticlockwise seen from free space."""
    return build_mesh(np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]]))


def box(lower: tuple[float, float, float], upper: tuple[float, float, float]) -> RawScan:
    (x, y, z), (X, Y, Z) = lower, upper
    return joined(
        quad([(x, y, Z), (X, y, Z), (X, Y, Z), (x, Y, Z)]),
        quad([(x, Y, z), (X, Y, z), (X, y, z), (x, y, z)]),
        quad([(x, y, z), (X, y, z), (X, y, Z), (x, y, Z)]),
        quad([(X, Y, z), (x, Y, z), (x, Y, Z), (X, Y, Z)]),
        quad([(X, y, z), (X, Y, z), (X, Y, Z), (X, y, Z)]),
        quad([(x, Y, z), (x, y, z), (x, y, Z), (x, Y, Z)]),
    )


def inner(*sides: float) -> float:
    """Area of a rectangle without a border as wide as the room."""
    return float(np.prod([max(s - 2 * ROOM, 0.0) for s in sides]))


def plate() -> Known:
    line = np.linspace(0, 1, 21)
    raw = grid(line, line, lambda u, v: 0 * u)
    turn = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    return Known(build_mesh(raw.vertices @ turn.T, raw.triangles), inner(1, 1))


def stairs() -> Known:
    parts = []
    for k in range(5):
        y, z = 0.3 * k, 0.15 * k
        parts.append(quad([(0, y, z), (1, y, z), (1, y + 0.3, z), (0, y + 0.3, z)]))
        y += 0.3
        parts.append(quad([(0, y, z), (1, y, z), (1, y, z + 0.15), (0, y, z + 0.15)]))
    return Known(joined(*parts), 5 * inner(0.3, 1) + 5 * inner(0.15, 1))


def block() -> Known:
    return Known(
        box((0, 0, 0), (0.5, 0.4, 0.3)),
        2 * (inner(0.5, 0.4) + inner(0.5, 0.3) + inner(0.4, 0.3)),
    )


def angle() -> Known:
    """A plate like an L."""
    raw = joined(
        quad([(0, 0, 0), (1, 0, 0), (1, 0.4, 0), (0, 0.4, 0)]),
        quad([(0, 0.4, 0), (0.4, 0.4, 0), (0.4, 1, 0), (0, 1, 0)]),
    )
    return Known(raw, inner(1, 0.4) + inner(0.4, 1) - inner(0.4, 0.4))


def holed() -> Known:
    """A plate with a round hole of 0.3 m."""
    turn = np.linspace(0, 2 * np.pi, 65)[:, None]
    way = np.concatenate([np.cos(turn), np.sin(turn)], axis=1)
    rim, border = 0.3 * way, way / np.abs(way).max(axis=1, keepdims=True)
    points = np.stack([rim + s * (border - rim) for s in np.linspace(0, 1, 9)], axis=1)
    flat = np.concatenate([points, np.zeros((*points.shape[:2], 1))], axis=-1).reshape(-1, 3)
    triangles = sheet(65, 9)[:, ::-1]
    return Known(build_mesh(flat, triangles), inner(2, 2) - np.pi * (0.3 + ROOM) ** 2)


def tube() -> Known:
    """The inside of a round tube, finely triangulated."""
    turn, z = np.linspace(0, 2 * np.pi, 121), np.linspace(0, 1, 31)
    t, h = np.meshgrid(turn, z, indexing="ij")
    points = np.stack([0.6 * np.cos(t), 0.6 * np.sin(t), h], axis=-1).reshape(-1, 3)
    return Known(build_mesh(points, sheet(121, 31)[:, ::-1]), 2 * np.pi * 0.6 * (1 - 2 * ROOM))


def octagon() -> Known:
    """The inside of a tube of eight plane panels."""
    turn = np.linspace(0, 2 * np.pi, 9)
    points = [(0.6 * np.cos(t), 0.6 * np.sin(t), z) for t in turn for z in (0.0, 1.0)]
    side = 2 * 0.6 * np.sin(np.pi / 8)
    return Known(build_mesh(np.array(points), sheet(9, 2)[:, ::-1]), 8 * inner(side, 1))


def waves() -> Known:
    """A rolling height map."""
    line = np.linspace(0, 2, 81)
    raw = grid(line, line, lambda u, v: 0.05 * np.sin(2 * u) * np.cos(3 * v))
    return Known(raw, inner(2, 2) * float(np.mean([1.003])))


def noisy() -> Known:
    """A plate as a depth camera sees it: corners off by a millimetre."""
    line = np.linspace(0, 1, 51)
    off = np.random.default_rng(3).normal(0, 1e-3, (51, 51))
    return Known(grid(line, line, lambda u, v: off), inner(1, 1))


def sunk() -> Known:
    """A block a few centimetres in the ground, to which its triangles are not joined."""
    ground = quad([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    grown = (0.5 + 2 * ROOM) * (0.4 + 2 * ROOM)
    sides = 2 * (0.5 - 2 * ROOM + 0.4 - 2 * ROOM) * (0.3 - 2 * ROOM)
    return Known(
        joined(ground, box((0, 0, -0.05), (0.5, 0.4, 0.3))),
        inner(2, 2) - grown + sides + inner(0.5, 0.4),
    )


def dome() -> Known:
    """The outside of a part of a sphere of 1 m."""
    tilt, turn = np.linspace(0.2, 1.2, 41), np.linspace(0, 2 * np.pi, 121)
    a, t = np.meshgrid(tilt, turn, indexing="ij")
    points = np.stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.cos(a)], axis=-1)
    area = 2 * np.pi * (np.cos(0.2 + ROOM) - np.cos(1.2 - ROOM))
    return Known(build_mesh(points.reshape(-1, 3), sheet(41, 121)), area)


SURFACES = (plate, stairs, block, angle, holed, tube, octagon, waves, noisy, sunk, dome)


def rough_sheet(
    origin: tuple[float, float, float],
    spans: tuple[tuple[float, float, float], tuple[float, float, float]],
    counts: tuple[int, int],
    rough: float,
    rng: np.random.Generator,
) -> RawScan:
    """A grid of corners off their plane by up to `rough` [m]; it faces across its spans."""
    u, v = np.array(spans, float)
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    i, j = np.meshgrid(*(np.linspace(0, 1, n) for n in counts), indexing="ij")
    points = np.array(origin) + i[..., None] * u + j[..., None] * v
    points = points + rough * rng.uniform(-1, 1, counts)[..., None] * normal
    return build_mesh(points.reshape(-1, 3), sheet(*counts))


def rough_chimney() -> RawScan:
    """Two walls 1.23 m apart in triangles 16 cm wide: `specs/rough_chimney.stl`."""
    rng = np.random.default_rng(1)
    return joined(
        rough_sheet((-0.615, -0.8, -0.6), ((0, 1.6, 0), (0, 0, 1.6)), (11, 11), 0.015, rng),
        rough_sheet((0.615, -0.8, -0.6), ((0, 0, 1.6), (0, 1.6, 0)), (11, 11), 0.015, rng),
    )


def rough_shaft() -> RawScan:
    """A floor and two walls in triangles 20 cm wide: `specs/rough_shaft.stl`."""
    rng = np.random.default_rng(2)
    return joined(
        rough_sheet((-0.615, -0.8, 0), ((0, 1.6, 0), (0, 0, 1.6)), (9, 9), 0.008, rng),
        rough_sheet((0.615, -0.8, 0), ((0, 0, 1.6), (0, 1.6, 0)), (9, 9), 0.008, rng),
        rough_sheet((-0.615, -0.8, 0), ((1.23, 0, 0), (0, 1.6, 0)), (7, 9), 0.004, rng),
    )
