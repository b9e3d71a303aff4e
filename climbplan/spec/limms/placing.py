"""Whether modules have room where a LIMMS spec puts them, straight out from ground or anchor.

Plain Python, so that a spec is checked without numpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot

from climbplan.spec.base import Vector
from climbplan.spec.document import Finding
from climbplan.spec.limms.model import LimmsSpec
from climbplan.spec.limms.module import ModuleSpec
from climbplan.spec.limms.space import TINY, Block


def placing_findings(spec: LimmsSpec, module: ModuleSpec) -> list[Finding]:
    """One finding for each module that is in something at the start."""
    space = spec.terrain.space()
    walls = space.solid[: len(space.solid) - len(space.obstacles)]
    boxes = [(f"obstacle {name!r}", block) for name, block in space.obstacles]
    boxes += [
        ("the box at its start" if spec.box else f"box {i} at its start", _block(b.start, b.size))
        for i, b in enumerate(spec.deliveries)
    ]
    boxes += [
        (f"parked box {i}", _block(box.position, box.size)) for i, box in enumerate(spec.parked)
    ]
    lines = list(_lines(spec, module))
    findings = []
    for i, (key, line) in enumerate(lines):
        inside = ["what is solid" for block in walls if _apart(line, block) < module.radius - TINY]
        inside += [name for name, block in boxes if _apart(line, block) < module.radius - TINY]
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
        place, along = stand.stand, (0.0, 0.0, 1.0)
        if place is None:
            anchor = anchors[str(stand.anchor)]
            place, along = anchor.position, anchor.normal
        near, far = (
            tuple(p + reach * d for p, d in zip(place, along, strict=True))
            for reach in (module.radius, sum(module.link_lengths) - module.radius)
        )
        low = tuple(min(a, b) for a, b in zip(near, far, strict=True))
        high = tuple(max(a, b) for a, b in zip(near, far, strict=True))
        yield "anchor" if stand.stand is None else "stand", (_vector(low), _vector(high))


def _vector(values: tuple[float, ...]) -> Vector:
    x, y, z = values
    return (x, y, z)


def _block(centre: Vector, size: Vector) -> Block:
    low = tuple(c - s / 2 for c, s in zip(centre, size, strict=True))
    high = tuple(c + s / 2 for c, s in zip(centre, size, strict=True))
    return (_vector(low), _vector(high))


def _apart(one: Block, other: Block) -> float:
    """Distance between two blocks; the axis of a straight module is one without width."""
    return hypot(
        *(max(low - b, a - high, 0.0) for low, high, a, b in zip(*one, *other, strict=True))
    )
