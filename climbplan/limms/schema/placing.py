"""Whether modules have room where a LIMMS spec puts them, straight out from ground or anchor.

Plain Python, so that a spec is checked without numpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, hypot, radians, sin

from climbplan.limms.schema.model import LimmsSpec
from climbplan.limms.schema.module import ModuleSpec
from climbplan.limms.schema.space import TINY, Block, Placed
from climbplan.schema.base import Vector
from climbplan.schema.document import Finding

_ROUNDS = 60  # of a search for the place on a line that is nearest to a box


def placing_findings(spec: LimmsSpec, module: ModuleSpec) -> list[Finding]:
    """One finding for each module that is in something at the start."""
    space = spec.terrain.space()
    walls = space.solid[: len(space.solid) - len(space.obstacles)]
    boxes = [
        ("the box at its start" if spec.box else f"box {i} at its start", b.at_start)
        for i, b in enumerate(spec.deliveries)
    ]
    boxes += [
        (f"parked box {i}", Placed(box.position, box.size))
        for i, box in enumerate(spec.static_boxes)
    ]
    lines = list(_lines(spec, module))
    findings = []
    for i, (key, line) in enumerate(lines):
        inside = ["what is solid" for block in walls if _apart(line, block) < module.radius - TINY]
        inside += [
            f"obstacle {name!r}"
            for name, block in space.obstacles
            if _apart(line, block) < module.radius - TINY
        ]
        inside += [name for name, box in boxes if _off_box(line, box) < module.radius - TINY]
        inside += [
            f"module {spec.modules[other].name!r}"
            for other in range(i)
            if _apart(line, lines[other][1]) < 2 * module.radius - TINY
        ]
        if inside:
            name = spec.modules[i].name
            long = f"{sum(module.link_lengths):.2f} m long"
            said = f"module {name!r}, straight and {long}, is in {inside[0]} at the start"
            findings.append(Finding(("modules", i, key), said))
    return findings


def _lines(spec: LimmsSpec, module: ModuleSpec) -> Iterator[tuple[str, Block]]:
    """Axes of the modules, one radius short of either end, and the key that says where."""
    anchors = {anchor.name: anchor for anchor in spec.terrain.anchors}
    for stand in spec.modules:
        place, along = stand.position, (0.0, 0.0, 1.0)
        if place is None:
            anchor = anchors[str(stand.anchor)]
            place, along = anchor.position, anchor.normal
        near, far = (
            tuple(p + reach * d for p, d in zip(place, along, strict=True))
            for reach in (module.radius, sum(module.link_lengths) - module.radius)
        )
        low = tuple(min(a, b) for a, b in zip(near, far, strict=True))
        high = tuple(max(a, b) for a, b in zip(near, far, strict=True))
        yield "anchor" if stand.position is None else "position", (_vector(low), _vector(high))


def _vector(values: tuple[float, ...]) -> Vector:
    x, y, z = values
    return (x, y, z)


def _off_box(line: Block, box: Placed) -> float:
    """Distance of a line along an axis, from its lower to its upper end, from a box [m]."""
    c, s = cos(radians(box.yaw_deg)), sin(radians(box.yaw_deg))

    def distance(share: float) -> float:
        x, y, z = (a + share * (b - a) - m for a, b, m in zip(*line, box.centre, strict=True))
        own = (c * x + s * y, c * y - s * x, z)  # in the box's frame
        return hypot(*(max(abs(v) - e / 2, 0.0) for v, e in zip(own, box.size, strict=True)))

    low, high = 0.0, 1.0
    for _ in range(_ROUNDS):  # convex along the line
        one, other = (2 * low + high) / 3, (low + 2 * high) / 3
        low, high = (low, other) if distance(one) <= distance(other) else (one, high)
    return distance((low + high) / 2)


def _apart(one: Block, other: Block) -> float:
    """Distance between two blocks; the axis of a straight module is one without width."""
    return hypot(
        *(max(low - b, a - high, 0.0) for low, high, a, b in zip(*one, *other, strict=True))
    )
