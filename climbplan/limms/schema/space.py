"""Free space of axis-parallel blocks: its solid complement, and positions outside of it.

Plain Python, so that a spec is checked without numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import cos, pi, radians, sin
from typing import NamedTuple

from climbplan.schema.base import Fault, Vector

Block = tuple[Vector, Vector]  # lower and upper corner [m]

SKIN = 1.0  # [m], thickness of the solid around all regions
TINY = 1e-6  # [m]


class PlacedBox(NamedTuple):
    """An upright box at a position."""

    centre: Vector  # [m]
    size: Vector  # [m]
    yaw_deg: float = 0.0  # about the vertical


@dataclass(frozen=True)
class SpaceDecomposition:
    """Blocks that cover the free space, and blocks that cover the solid around it."""

    free: tuple[Block, ...]
    solid: tuple[Block, ...]  # the complement of regions, then obstacles
    obstacles: tuple[tuple[str, Block], ...]  # by name, clipped to the regions


def build_space(
    regions: Sequence[Block], obstacles: Sequence[tuple[str, Block]] = ()
) -> SpaceDecomposition:
    """Return regions without obstacles; obstacles may reach into walls and into each other."""
    free = [_to_floats(block) for block in regions]
    solid = compute_solid_blocks(free)
    bounds = (
        _vector(min(low[axis] for low, _ in free) for axis in range(3)),
        _vector(max(high[axis] for _, high in free) for axis in range(3)),
    )
    clipped = [(name, _intersect(_to_floats(block), bounds)) for name, block in obstacles]
    inside = [(name, block) for name, block in clipped if _has_volume(block)]
    if inside:
        blocks = [block for _, block in inside]
        free = _merge_cells(
            _list_face_coordinates([*free, *blocks]),
            lambda point: _inside_any(point, free) and not _inside_any(point, blocks),
        )
        solid = [*solid, *blocks]
    return SpaceDecomposition(tuple(free), tuple(solid), tuple(inside))


def compute_solid_blocks(free: Sequence[Block]) -> list[Block]:
    """Return the complement of free blocks in an enclosing block thicker by `SKIN`."""
    edges = [[inner[0] - SKIN, *inner, inner[-1] + SKIN] for inner in _list_face_coordinates(free)]
    return _merge_cells(edges, lambda point: not _inside_any(point, free))


def reaches_free_space(block: Block, free: Sequence[Block]) -> bool:
    """Return whether a block covers some of the free blocks."""
    return any(_has_volume(_intersect(block, free_block)) for free_block in free)


def _list_face_coordinates(blocks: Sequence[Block]) -> list[list[float]]:
    """Return the coordinates of all faces, axis by axis."""
    return [sorted({b[side][axis] for b in blocks for side in (0, 1)}) for axis in range(3)]


def _merge_cells(edges: list[list[float]], is_selected: Callable[[Vector], bool]) -> list[Block]:
    """Return selected cells between face coordinates, merged along x, then y, then z."""
    cells = {
        index
        for index in product(*(range(len(e) - 1) for e in edges))
        if is_selected(_compute_middle(edges, index))
    }
    blocks = []
    while cells:
        first = min(cells)
        high = list(first)
        for axis in (0, 1, 2):
            while _list_layer(first, high, axis) <= cells:
                high[axis] += 1
        cells -= set(product(*(range(a, b + 1) for a, b in zip(first, high, strict=True))))
        blocks.append(
            (
                _vector(edges[a][first[a]] for a in range(3)),
                _vector(edges[a][high[a] + 1] for a in range(3)),
            )
        )
    return blocks


def _intersect(first: Block, second: Block) -> Block:
    """Return the intersection of two blocks; a lower corner beyond the upper one if it is empty."""
    return (
        _vector(max(a, b) for a, b in zip(first[0], second[0], strict=True)),
        _vector(min(a, b) for a, b in zip(first[1], second[1], strict=True)),
    )


def _has_volume(block: Block) -> bool:
    return all(high - low > TINY for low, high in zip(*block, strict=True))


def find_block_faults(
    key: str, what: str, box: PlacedBox, space: SpaceDecomposition
) -> list[Fault]:
    """Return faults for a box in walls or obstacles, with its depth."""
    walls = space.solid[: len(space.solid) - len(space.obstacles)]
    depth = max((_compute_depth(box, _to_box(block)) for block in walls), default=0.0)
    faults, centre = [], box.centre
    if not _inside_any(centre, space.free, TINY) and not _inside_any(centre, space.solid):
        faults.append(Fault(key, f"{what} is outside the space"))
    elif depth > TINY:
        faults.append(Fault(key, f"{what} reaches {1e3 * depth:.0f} mm out of the free space"))
    for name, block in space.obstacles:
        depth = _compute_depth(box, _to_box(block))
        if depth > TINY:
            message = f"{what} reaches {1e3 * depth:.0f} mm into obstacle {name!r}"
            faults.append(Fault(key, message))
    return faults


def _to_box(block: Block) -> PlacedBox:
    centre = _vector((a + b) / 2 for a, b in zip(*block, strict=True))
    return PlacedBox(centre, _vector(b - a for a, b in zip(*block, strict=True)))


def _compute_depth(first: PlacedBox, second: PlacedBox) -> float:
    """Return how far a box reaches into another one [m]; negative if apart.

    The depth is the least along the vertical and the normals of edges (separating axis theorem).
    """
    offset = [b - a for a, b in zip(first.centre, second.centre, strict=True)]
    depths = [(first.size[2] + second.size[2]) / 2 - abs(offset[2])]
    yaws = (0.0,) if first.yaw_deg == second.yaw_deg == 0 else (first.yaw_deg, second.yaw_deg)
    for axis in (radians(yaw) + quarter for yaw in yaws for quarter in (0.0, pi / 2)):
        half_widths = [
            (
                box.size[0] * abs(cos(radians(box.yaw_deg) - axis))
                + box.size[1] * abs(sin(radians(box.yaw_deg) - axis))
            )
            / 2
            for box in (first, second)
        ]
        depths.append(sum(half_widths) - abs(offset[0] * cos(axis) + offset[1] * sin(axis)))
    return min(depths)


def find_anchor_faults(
    key: str, name: str, position: Vector, normal: Vector, space: SpaceDecomposition
) -> list[Fault]:
    """Return a fault unless an anchor is on a face with free space along its normal."""
    ahead = _vector(p + 1e-3 * n for p, n in zip(position, normal, strict=True))
    behind = _vector(p - 1e-3 * n for p, n in zip(position, normal, strict=True))
    free, solid = space.free, space.solid
    if not _inside_any(position, free, TINY):
        return [Fault(key, f"anchor {name!r} is outside the free space")]
    if not _inside_any(ahead, free) or not _inside_any(behind, solid):
        return [Fault(key, f"anchor {name!r} is not on a face with free space along its normal")]
    return []


def find_stand_faults(key: str, name: str, point: Vector, space: SpaceDecomposition) -> list[Fault]:
    """Return a fault unless a point is on the ground."""
    above = (point[0], point[1], point[2] + TINY)
    below = (point[0], point[1], point[2] - TINY)
    if _inside_any(above, space.free) and _inside_any(below, space.solid):
        return []
    return [Fault(key, f"{name} does not stand on the ground there: no solid right below")]


def overlaps(first: PlacedBox, second: PlacedBox) -> bool:
    """Return whether two boxes overlap."""
    return _compute_depth(first, second) > TINY


def _inside_any(point: Vector, blocks: Sequence[Block], slack: float = 0.0) -> bool:
    return any(
        all(a - slack <= p <= b + slack for p, a, b in zip(point, low, high, strict=True))
        for low, high in blocks
    )


def _list_layer(first: tuple[int, ...], high: list[int], axis: int) -> set[tuple[int, ...]]:
    """Return the cells next to a block on its upper side along `axis`."""
    spans = [range(a, b + 1) for a, b in zip(first, high, strict=True)]
    spans[axis] = range(high[axis] + 1, high[axis] + 2)
    return set(product(*spans))


def _compute_middle(edges: list[list[float]], index: tuple[int, ...]) -> Vector:
    spans = [list(pairwise(edge))[i] for edge, i in zip(edges, index, strict=True)]
    return _vector((a + b) / 2 for a, b in spans)


def _to_floats(block: Block) -> Block:
    return _vector(float(v) for v in block[0]), _vector(float(v) for v in block[1])


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = values
    return (x, y, z)
