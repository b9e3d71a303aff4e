"""Free space made of axis-parallel blocks: what is solid, and what lies where it cannot.

Plain Python, so that a spec is checked without numpy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise, product

from climbplan.spec.base import Fault, Vector

Block = tuple[Vector, Vector]  # lower and upper corner [m]

SKIN = 1.0  # [m] thickness of the solid round all regions
TINY = 1e-6  # [m]


def free_blocks(regions: Sequence[Block]) -> list[Block]:
    """Regions as blocks of floats."""
    return [(_floats(low), _floats(high)) for low, high in regions]


def solid_blocks(free: Sequence[Block]) -> list[Block]:
    """What the free blocks leave out of a block that encloses them all by `SKIN`.

    Cells between all face coordinates, merged along x, then y, then z.
    """
    edges = []
    for axis in range(3):
        inner = sorted({b[side][axis] for b in free for side in (0, 1)})
        edges.append([inner[0] - SKIN, *inner, inner[-1] + SKIN])
    cells = {
        index
        for index in product(*(range(len(e) - 1) for e in edges))
        if not _inside_any(_middle(edges, index), free)
    }
    blocks = []
    while cells:
        first = min(cells)
        high = list(first)
        for axis in (0, 1, 2):
            while _layer(first, high, axis) <= cells:
                high[axis] += 1
        taken = set(product(*(range(a, b + 1) for a, b in zip(first, high, strict=True))))
        cells -= taken
        blocks.append(
            (
                _vector(edges[a][first[a]] for a in range(3)),
                _vector(edges[a][high[a] + 1] for a in range(3)),
            )
        )
    return blocks


def block_fault(
    key: str, what: str, centre: Vector, size: Vector, solid: Sequence[Block]
) -> list[Fault]:
    """That a block reaches into what is solid, and how deep."""
    depth = 0.0
    for low, high in solid:
        into = min(
            min(c + s / 2 - a, b - c + s / 2)
            for c, s, a, b in zip(centre, size, low, high, strict=True)
        )
        depth = max(depth, into)
    if depth <= TINY:
        return []
    return [Fault(key, f"{what} reaches {1e3 * depth:.0f} mm out of the free space")]


def anchor_fault(
    key: str,
    name: str,
    position: Vector,
    normal: Vector,
    free: Sequence[Block],
    solid: Sequence[Block],
) -> list[Fault]:
    """That an anchor is not on a face that its normal leaves into free space."""
    ahead = _vector(p + 1e-3 * n for p, n in zip(position, normal, strict=True))
    behind = _vector(p - 1e-3 * n for p, n in zip(position, normal, strict=True))
    if not _inside_any(position, free, TINY):
        return [Fault(key, f"anchor {name!r} is outside the free space")]
    if not _inside_any(ahead, free) or not _inside_any(behind, solid):
        return [Fault(key, f"anchor {name!r} is not on a face with free space along its normal")]
    return []


def stand_fault(
    key: str, name: str, point: Vector, free: Sequence[Block], solid: Sequence[Block]
) -> list[Fault]:
    """That a point is not on the ground."""
    above = (point[0], point[1], point[2] + TINY)
    below = (point[0], point[1], point[2] - TINY)
    if _inside_any(above, free) and _inside_any(below, solid):
        return []
    return [Fault(key, f"{name} does not stand on the ground there: no solid right below")]


def overlaps(centre: Vector, size: Vector, other: Vector, extent: Vector) -> bool:
    """Whether two blocks overlap."""
    return all(
        abs(a - b) < (s + e) / 2 - TINY
        for a, b, s, e in zip(centre, other, size, extent, strict=True)
    )


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


def _floats(values: Sequence[float]) -> Vector:
    return _vector(float(v) for v in values)


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = values
    return (x, y, z)
