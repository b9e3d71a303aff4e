"""Initial clearance of the modules of a LIMMS spec, straight from ground or anchor.

Plain Python, so that a spec is checked without numpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, hypot, radians, sin

from climbplan.limms.schema.model import LimmsSpec
from climbplan.limms.schema.module import ModuleSpec
from climbplan.limms.schema.space import TINY, Block, PlacedBox
from climbplan.schema.base import Vector
from climbplan.schema.document import Finding

_NUM_BISECTIONS = 60  # iterations of the ternary search for the nearest point of a line


def find_placing_faults(spec: LimmsSpec, module: ModuleSpec) -> list[Finding]:
    """Return one finding for each module that is in something at the start."""
    space = spec.terrain.space()
    walls = space.solid[: len(space.solid) - len(space.obstacles)]
    boxes = [
        ("the box at its start" if spec.box else f"box {i} at its start", b.at_start)
        for i, b in enumerate(spec.deliveries)
    ]
    boxes += [
        (f"parked box {i}", PlacedBox(box.position, box.size))
        for i, box in enumerate(spec.static_boxes)
    ]
    lines = list(_iterate_lines(spec, module))
    findings = []
    for i, (key, line) in enumerate(lines):
        inside = [
            "what is solid" for block in walls if _distance(line, block) < module.radius - TINY
        ]
        inside += [
            f"obstacle {name!r}"
            for name, block in space.obstacles
            if _distance(line, block) < module.radius - TINY
        ]
        inside += [
            name for name, box in boxes if _distance_to_box(line, box) < module.radius - TINY
        ]
        inside += [
            f"module {spec.modules[earlier].name!r}"
            for earlier in range(i)
            if _distance(line, lines[earlier][1]) < 2 * module.radius - TINY
        ]
        if inside:
            name = spec.modules[i].name
            long = f"{sum(module.link_lengths):.2f} m long"
            said = f"module {name!r}, straight and {long}, is in {inside[0]} at the start"
            findings.append(Finding(("modules", i, key), said))
    return findings


def _iterate_lines(spec: LimmsSpec, module: ModuleSpec) -> Iterator[tuple[str, Block]]:
    """Yield axes of the modules, one radius short of either end, and the key of their place."""
    anchors = {anchor.name: anchor for anchor in spec.terrain.anchors}
    for stand in spec.modules:
        position, direction = stand.position, (0.0, 0.0, 1.0)
        if position is None:
            anchor = anchors[str(stand.anchor)]
            position, direction = anchor.position, anchor.normal
        first, last = (
            tuple(p + reach * d for p, d in zip(position, direction, strict=True))
            for reach in (module.radius, sum(module.link_lengths) - module.radius)
        )
        low = tuple(min(a, b) for a, b in zip(first, last, strict=True))
        high = tuple(max(a, b) for a, b in zip(first, last, strict=True))
        yield "anchor" if stand.position is None else "position", (_vector(low), _vector(high))


def _vector(values: tuple[float, ...]) -> Vector:
    x, y, z = values
    return (x, y, z)


def _distance_to_box(line: Block, box: PlacedBox) -> float:
    """Return the distance of an axis-parallel line from a box [m]."""
    c, s = cos(radians(box.yaw_deg)), sin(radians(box.yaw_deg))

    def distance(fraction: float) -> float:
        x, y, z = (a + fraction * (b - a) - m for a, b, m in zip(*line, box.centre, strict=True))
        local = (c * x + s * y, c * y - s * x, z)  # in the box's frame
        return hypot(*(max(abs(v) - e / 2, 0.0) for v, e in zip(local, box.size, strict=True)))

    low, high = 0.0, 1.0
    for _ in range(_NUM_BISECTIONS):  # convex along the line
        left, right = (2 * low + high) / 3, (low + 2 * high) / 3
        low, high = (low, right) if distance(left) <= distance(right) else (left, high)
    return distance((low + high) / 2)


def _distance(first: Block, second: Block) -> float:
    """Return the distance between two blocks [m]; the axis of a straight module has no width."""
    return hypot(
        *(max(low - b, a - high, 0.0) for low, high, a, b in zip(*first, *second, strict=True))
    )
