"""Free space made of axis-parallel blocks: what is solid, and what lies where it cannot.

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

SKIN = 1.0  # [m] thickness of the solid round all regions
TINY = 1e-6  # [m]


class Placed(NamedTuple):
    """A box somewhere, upright."""

    centre: Vector  # [m]
    size: Vector  # [m]
    yaw_deg: float = 0.0  # about the vertical


@dataclass(frozen=True)
class StateSpace:
    """Blocks that cover the free space, and those that cover the solid round it."""

    free: tuple[Block, ...]
    solid: tuple[Block, ...]  # what regions leave out, then obstacles
    obstacles: tuple[tuple[str, Block], ...]  # by name, as far as they are among the regions


def space_of(regions: Sequence[Block], obstacles: Sequence[tuple[str, Block]] = ()) -> StateSpace:
    """Regions without the obstacles in them; obstacles may reach into walls and into each other."""
    free = [_floats_of(block) for block in regions]
    solid = solid_blocks(free)
    bounds = (
        _vector(min(low[axis] for low, _ in free) for axis in range(3)),
        _vector(max(high[axis] for _, high in free) for axis in range(3)),
    )
    kept = [(name, _common(_floats_of(block), bounds)) for name, block in obstacles]
    inside = [(name, block) for name, block in kept if _has_room(block)]
    if inside:
        blocks = [block for _, block in inside]
        free = _merged(
            _edges([*free, *blocks]),
            lambda point: _inside_any(point, free) and not _inside_any(point, blocks),
        )
        solid = [*solid, *blocks]
    return StateSpace(tuple(free), tuple(solid), tuple(inside))


def solid_blocks(free: Sequence[Block]) -> list[Block]:
    """What the free blocks leave out of a block that encloses them all by `SKIN`."""
    edges = [[inner[0] - SKIN, *inner, inner[-1] + SKIN] for inner in _edges(free)]
    return _merged(edges, lambda point: not _inside_any(point, free))


def reaches_free_space(block: Block, free: Sequence[Block]) -> bool:
    """Whether a block covers some of the free blocks."""
    return any(_has_room(_common(block, other)) for other in free)


def _edges(blocks: Sequence[Block]) -> list[list[float]]:
    """Coordinates of all faces, axis by axis."""
    return [sorted({b[side][axis] for b in blocks for side in (0, 1)}) for axis in range(3)]


def _merged(edges: list[list[float]], taken: Callable[[Vector], bool]) -> list[Block]:
    """Cells between face coordinates whose middles are `taken`, merged along x, then y, then z."""
    cells = {
        index
        for index in product(*(range(len(e) - 1) for e in edges))
        if taken(_middle(edges, index))
    }
    blocks = []
    while cells:
        first = min(cells)
        high = list(first)
        for axis in (0, 1, 2):
            while _layer(first, high, axis) <= cells:
                high[axis] += 1
        cells -= set(product(*(range(a, b + 1) for a, b in zip(first, high, strict=True))))
        blocks.append(
            (
                _vector(edges[a][first[a]] for a in range(3)),
                _vector(edges[a][high[a] + 1] for a in range(3)),
            )
        )
    return blocks


def _common(one: Block, other: Block) -> Block:
    """What two blocks share; with a lower corner beyond the upper one if it is nothing."""
    return (
        _vector(max(a, b) for a, b in zip(one[0], other[0], strict=True)),
        _vector(min(a, b) for a, b in zip(one[1], other[1], strict=True)),
    )


def _has_room(block: Block) -> bool:
    return all(high - low > TINY for low, high in zip(*block, strict=True))


def block_fault(key: str, what: str, box: Placed, space: StateSpace) -> list[Fault]:
    """That a box reaches into walls or obstacles, and how deep."""
    walls = space.solid[: len(space.solid) - len(space.obstacles)]
    depth = max((_depth(box, _placed(block)) for block in walls), default=0.0)
    faults, centre = [], box.centre
    if not _inside_any(centre, space.free, TINY) and not _inside_any(centre, space.solid):
        faults.append(Fault(key, f"{what} is outside the space"))
    elif depth > TINY:
        faults.append(Fault(key, f"{what} reaches {1e3 * depth:.0f} mm out of the free space"))
    for name, block in space.obstacles:
        depth = _depth(box, _placed(block))
        if depth > TINY:
            said = f"{what} reaches {1e3 * depth:.0f} mm into obstacle {name!r}"
            faults.append(Fault(key, said))
    return faults


def _placed(block: Block) -> Placed:
    centre = _vector((a + b) / 2 for a, b in zip(*block, strict=True))
    return Placed(centre, _vector(b - a for a, b in zip(*block, strict=True)))


def _depth(one: Placed, other: Placed) -> float:
    """How far a box reaches into another one [m]; < 0: apart.

    Along the vertical or a normal of an edge of either, whichever is least.
    """
    apart = [b - a for a, b in zip(one.centre, other.centre, strict=True)]
    depths = [(one.size[2] + other.size[2]) / 2 - abs(apart[2])]
    turns = (0.0,) if one.yaw_deg == other.yaw_deg == 0 else (one.yaw_deg, other.yaw_deg)
    for axis in (radians(turn) + quarter for turn in turns for quarter in (0.0, pi / 2)):
        spans = [
            (
                box.size[0] * abs(cos(radians(box.yaw_deg) - axis))
                + box.size[1] * abs(sin(radians(box.yaw_deg) - axis))
            )
            / 2
            for box in (one, other)
        ]
        depths.append(sum(spans) - abs(apart[0] * cos(axis) + apart[1] * sin(axis)))
    return min(depths)


def anchor_fault(
    key: str, name: str, position: Vector, normal: Vector, space: StateSpace
) -> list[Fault]:
    """That an anchor is not on a face that its normal leaves into free space."""
    ahead = _vector(p + 1e-3 * n for p, n in zip(position, normal, strict=True))
    behind = _vector(p - 1e-3 * n for p, n in zip(position, normal, strict=True))
    free, solid = space.free, space.solid
    if not _inside_any(position, free, TINY):
        return [Fault(key, f"anchor {name!r} is outside the free space")]
    if not _inside_any(ahead, free) or not _inside_any(behind, solid):
        return [Fault(key, f"anchor {name!r} is not on a face with free space along its normal")]
    return []


def stand_fault(key: str, name: str, point: Vector, space: StateSpace) -> list[Fault]:
    """That a point is not on the ground."""
    above = (point[0], point[1], point[2] + TINY)
    below = (point[0], point[1], point[2] - TINY)
    if _inside_any(above, space.free) and _inside_any(below, space.solid):
        return []
    return [Fault(key, f"{name} does not stand on the ground there: no solid right below")]


def overlaps(one: Placed, other: Placed) -> bool:
    """Whether two boxes overlap."""
    return _depth(one, other) > TINY


def _inside_any(point: Vector, blocks: Sequence[Block], slack: float = 0.0) -> bool:
    return any(
        all(a - slack <= p <= b + slack for p, a, b in zip(point, low, high, strict=True))
        for low, high in blocks
    )


def _layer(first: tuple[int, ...], high: list[int], axis: int) -> set[tuple[int, ...]]:
    """The cells next to a block on its upper side along `axis`."""
    spans = [range(a, b + 1) for a, b in zip(first, high, strict=True)]
    spans[axis] = range(high[axis] + 1, high[axis] + 2)
    return set(product(*spans))


def _middle(edges: list[list[float]], index: tuple[int, ...]) -> Vector:
    spans = [list(pairwise(edge))[i] for edge, i in zip(edges, index, strict=True)]
    return _vector((a + b) / 2 for a, b in spans)


def _floats_of(block: Block) -> Block:
    return _vector(float(v) for v in block[0]), _vector(float(v) for v in block[1])


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = values
    return (x, y, z)
