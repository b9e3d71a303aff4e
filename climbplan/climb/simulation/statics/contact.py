"""A toe on terrain: whether it sticks, slides or comes off.

A toe in contact is tried where it last stood (the anchor): it comes off if it would have to
be pulled, and slides against its friction until that holds it, as stresses return to the yield
surface in plasticity.

Where pressure grows as a toe slides Coulomb's law has several answers or none. Short steps
(`swift`) therefore take the point of the cone that is nearest in the metric of the limb's
compliance, which is unique and changes steadily: the toe is lifted by mu times the little that it
slides in such a step, and put back on its surface at its end. MuJoCo's contacts do the same.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.friction_cone import _nearest_edge
from climbplan.climb.simulation.statics.limb import _held
from climbplan.climb.simulation.statics.small_algebra import (
    _both_sides,
    _dot,
    _inverse,
    _times,
    _transposed_times,
)
from climbplan.climb.simulation.statics.surfaces import _onto
from climbplan.climb.simulation.statics.tuples import Body, Ground, Pad, Springs, Touch

AIR, STICKS, SLIDES, FAILED = 0, 1, 2, 3
_SLIDES = 4  # tries to find where friction holds a toe again
_FARTHEST = 0.03  # [m] of one of them
_STRAIGHT = 0.02  # shear by pull of a toe that comes off without sliding
_JAMS = 0.3  # least resistance against sliding, of that without a change of pressure
_SETTLED = 1e-7  # [m] to which a sliding toe of a short step is found
_ENOUGH = 1e-3  # of the friction, to which it is found


@compiled
def _pushed(body: Body, zero: Array, limb: int, springs: Springs, touch: Touch, pad: Pad) -> bool:
    """Force on a toe held at its place, left in `touch`, and the limb's stiffness in pad.m[7].

    The stiffness is the world's, G = R K R^T. False if the limb does not reach there.
    """
    away, local, own, slope = pad.v[6], pad.v[7], pad.v[8], pad.m[5]
    for i in range(3):
        away[i] = touch.place[limb, i] - body.com[i]
    _transposed_times(body.rotation, away, local)
    if not _held(zero, limb, local, springs, touch.angles[limb], own, slope, pad):
        return False
    _times(body.rotation, own, touch.force[limb])
    _both_sides(body.rotation, slope, pad.m[0], pad.m[7])
    return True


@compiled
def _swift_touch(
    body: Body, zero: Array, limb: int, mu: float, springs: Springs, touch: Touch, pad: Pad
) -> int:
    """As `_touch`, in a short step: the cone's point that is nearest in the limb's compliance."""
    place, normal, force = touch.place[limb], touch.normal[limb], touch.force[limb]
    follow, firm, soft = pad.m[6], pad.m[7], pad.m[0]
    away, own, tried, edge = pad.v[6], pad.v[8], pad.v[9], pad.v[10]
    first, second, free = pad.v[0], pad.v[1], pad.v[2]
    s0, s1, s2 = place[0], place[1], place[2]
    for attempt in range(_SLIDES + 1):
        if not _pushed(body, zero, limb, springs, touch, pad):
            return FAILED
        if not _inverse(firm, soft) > 0.0:
            return FAILED
        # The force with the toe at its anchor, and where it would go if nothing held it
        away[0], away[1], away[2] = s0 - place[0], s1 - place[1], s2 - place[2]
        _times(firm, away, tried)
        for i in range(3):
            tried[i] += force[i]
        _times(soft, tried, free)
        lifts = -_dot(free, normal)
        slid = 0.0
        for i in range(3):
            slid += (free[i] + lifts * normal[i]) ** 2
        if lifts >= mu * np.sqrt(slid):
            return AIR
        press = _dot(tried, normal)
        shear = np.sqrt(max(_dot(tried, tried) - press * press, 0.0))
        if shear <= mu * press:
            if (away[0] == 0.0 and away[1] == 0.0 and away[2] == 0.0) or attempt == _SLIDES:
                for i in range(3):
                    force[i] = tried[i]
                    for j in range(3):
                        follow[i, j] = 1.0 if i == j else 0.0
                return STICKS
            place[0], place[1], place[2] = s0, s1, s2
            continue
        _nearest_edge(tried, normal, mu, soft, first, second, edge, free)
        # Where the toe is then
        for i in range(3):
            away[i] = edge[i] - tried[i]
        _times(soft, away, free)
        moved = max(
            abs(s0 + free[0] - place[0]), abs(s1 + free[1] - place[1]), abs(s2 + free[2] - place[2])
        )
        if moved < _SETTLED or attempt == _SLIDES:
            break
        place[0], place[1], place[2] = s0 + free[0], s1 + free[1], s2 + free[2]
    press = _dot(edge, normal)
    for i in range(3):
        force[i] = edge[i]
        # Normal to the cone: against the shear, and off the surface
        away[i] = mu * normal[i] - (edge[i] - press * normal[i]) / max(mu * press, 1e-12)
    _times(firm, away, own)
    resist = max(_dot(away, own), 1e-9)
    for i in range(3):
        for j in range(3):
            follow[i, j] = (1.0 if i == j else 0.0) - own[i] * away[j] / resist
            firm[i, j] -= own[i] * own[j] / resist
    return SLIDES


@compiled
def _touch(
    body: Body,
    zero: Array,
    limb: int,
    mu: float,
    swift: bool,
    ground: Ground,
    springs: Springs,
    touch: Touch,
    pad: Pad,
) -> int:
    """Contact of a limb's toe that stood at `place` of its surface; place and angles are put right.

    zero: (2n + 1, 3) of the limb. swift: in a short step. Leaves the force on the toe in `touch`,
    and in pad.m[6], pad.m[7] the matrices P and G of its change when the body moves by (dc, dw):
    dF = -G dc + (G [r]x - P [f]x) dw. Returns AIR, STICKS, SLIDES or FAILED.
    """
    if swift:
        return _swift_touch(body, zero, limb, mu, springs, touch, pad)
    place, normal, force = touch.place[limb], touch.normal[limb], touch.force[limb]
    solid, face = touch.solid[limb], touch.face[limb]
    follow, firm, fixed = pad.m[6], pad.m[7], pad.m[0]
    way, pushed = pad.v[9], pad.v[10]
    slid = False
    for attempt in range(_SLIDES + 1):
        if not _pushed(body, zero, limb, springs, touch, pad):
            return FAILED
        press = _dot(force, normal)
        # A toe that would have to be pulled where it stands may still press where it slides to
        if press <= 0.0 and attempt > 1:
            return AIR
        across0 = force[0] - press * normal[0]
        across1 = force[1] - press * normal[1]
        across2 = force[2] - press * normal[2]
        shear = np.sqrt(across0**2 + across1**2 + across2**2)
        if press <= 0.0 and shear < _STRAIGHT * -press:
            return AIR
        excess = shear - mu * press
        if not slid and excess <= 0.0:
            for i in range(3):
                for j in range(3):
                    follow[i, j] = 1.0 if i == j else 0.0
            return STICKS
        least = max(shear, 1e-12)
        way[0], way[1], way[2] = -across0 / least, -across1 / least, -across2 / least
        _times(firm, way, pushed)
        along = _dot(way, pushed)
        resist = along + mu * _dot(normal, pushed)
        # Pressure that grows as a toe slides may hold it of itself: it then slides bit by bit
        resist = max(resist, _JAMS * abs(along) + 1e-6)
        if attempt == _SLIDES or abs(excess) < _ENOUGH * (mu * abs(press) + 0.01):
            # P = I - G e (e + mu n)^T / resist, G = P G
            for i in range(3):
                for j in range(3):
                    fixed[i, j] = firm[i, j]
                    follow[i, j] = (1.0 if i == j else 0.0) - pushed[i] * (
                        way[j] + mu * normal[j]
                    ) / resist
            for i in range(3):
                for j in range(3):
                    firm[i, j] = (
                        follow[i, 0] * fixed[0, j]
                        + follow[i, 1] * fixed[1, j]
                        + follow[i, 2] * fixed[2, j]
                    )
            return SLIDES
        slid = True
        length = min(max(excess / resist, -_FARTHEST), _FARTHEST)
        for i in range(3):
            place[i] += length * way[i]
        _onto(place, solid, face, ground, normal)
    return FAILED
