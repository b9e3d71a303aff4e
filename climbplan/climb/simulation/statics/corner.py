"""A toe in a corner, where it slid on one surface into another: both hold it.

It stays as long as its force is a sum of two, one of each surface's friction cone; else it goes on
along the surface that it came to last.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.contact import SLIDES, _pushed
from climbplan.climb.simulation.statics.small_algebra import _dot
from climbplan.climb.simulation.statics.surfaces import ON, TUBE, _landed, _onto
from climbplan.climb.simulation.statics.tuples import Body, Ground, Pad, Springs, Stand, Touch

_TURNS = 30  # of alternating projections
_LEFT = 1e-3  # of a force that they may leave


@compiled
def _cornered(
    body: Body,
    zero: Array,
    limb: int,
    mu: float,
    stand: Stand,
    ground: Ground,
    springs: Springs,
    touch: Touch,
    pad: Pad,
) -> bool:
    """Whether both surfaces hold a toe at its anchor; then as `_touch` for one that sticks."""
    if not _pushed(body, zero, limb, springs, touch, pad):
        return False
    solid, face = stand.corner[limb, 0], stand.corner[limb, 1]
    there, other, first, second = pad.v[6], pad.v[7], pad.v[8], pad.v[9]
    for a in range(3):
        there[a] = touch.place[limb, a]
        first[a] = second[a] = 0.0
    _onto(there, solid, face, ground, other)
    grip = 0.0
    if not stand.slippery[limb]:
        grip = ground.tube_friction[solid] if face == TUBE else ground.friction[solid]
    force, rest = touch.force[limb], pad.v[10]
    for _ in range(_TURNS):
        for a in range(3):
            rest[a] = force[a] - second[a]
        _onto_cone(rest, touch.normal[limb], mu, first)
        for a in range(3):
            rest[a] = force[a] - first[a]
        _onto_cone(rest, other, grip, second)
        left = 0.0
        for a in range(3):
            left += (force[a] - first[a] - second[a]) ** 2
        if left <= _LEFT**2 * _dot(force, force):
            for i in range(3):
                for j in range(3):
                    pad.m[6][i, j] = 1.0 if i == j else 0.0
            return True
    return False


@compiled
def _onto_cone(vector: Array, normal: Array, mu: float, out: Array) -> None:
    """The nearest force of a friction cone."""
    press = _dot(vector, normal)
    shear = 0.0
    for a in range(3):
        shear += (vector[a] - press * normal[a]) ** 2
    shear = np.sqrt(shear)
    if shear <= mu * press:
        for a in range(3):
            out[a] = vector[a]
        return
    size = (press + mu * shear) / (1 + mu * mu)
    if size <= 0.0:
        for a in range(3):
            out[a] = 0.0
        return
    for a in range(3):
        across = (vector[a] - press * normal[a]) / shear
        out[a] = size * (normal[a] + mu * across)


@compiled
def _runs_into(limb: int, stand: Stand, ground: Ground, touch: Touch) -> tuple[int, int, float]:
    """Solid and face into which a toe has slid in a step, -1 if none; and how deep [m]."""
    if touch.state[limb] != SLIDES or touch.face[limb] == TUBE:
        return -1, -1, 0.0
    before, now = stand.anchor[limb], touch.place[limb]
    if not stand.touching[limb]:
        return -1, -1, 0.0
    solid, face, part = _landed(before, now, ground, -ON, touch.solid[limb])
    far = 0.0
    for a in range(3):
        far += ((1 - part) * (now[a] - before[a])) ** 2
    return solid, face, np.sqrt(far) if solid >= 0 else 0.0
