"""A toe on terrain: where it lands, whether it sticks, slides or comes off.

Terrain is convex solids {A x <= b}, the slabs behind flat regions and obstacles alike, and round
tubes. A toe in contact is tried where it last stood (the anchor): it comes off if it would have to
be pulled, and slides against its friction until that holds it, as stresses return to the yield
surface in plasticity.

Where pressure grows as a toe slides Coulomb's law has several answers or none. Short steps
(`swift`) therefore take the point of the cone that is nearest in the metric of the limb's
compliance, which is unique and changes steadily: the toe is lifted by mu times the little that it
slides in such a step, and put back on its surface at its end. MuJoCo's contacts do the same.
"""

from __future__ import annotations

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.simulation.statics.compiling import compiled
from climbplan.simulation.statics.limb import _held
from climbplan.simulation.statics.small_algebra import (
    _cross,
    _dot,
    _inverse,
    _times,
    _transposed_times,
)
from climbplan.simulation.statics.tuples import Body, Ground, Pad, Springs, Touch

AIR, STICKS, SLIDES, FAILED = 0, 1, 2, 3
TUBE = -2  # number of the "face" of a tube
_ON = 1e-5  # [m] within which a toe counts as on a face
_BESIDE = 2e-3  # [m] within which the next solid goes on where one ends
_SLIDES = 4  # tries to find where friction holds a toe again
_FARTHEST = 0.03  # [m] of one of them
_STRAIGHT = 0.02  # shear by pull of a toe that comes off without sliding
_JAMS = 0.3  # least resistance against sliding, of that without a change of pressure
_SETTLED = 1e-7  # [m] to which a sliding toe of a short step is found
_EDGES, _SECTIONS, _GOLDEN = 12, 22, (np.sqrt(5.0) - 1) / 2
_ENOUGH = 1e-3  # of the friction, to which it is found


@compiled
def _landed(before: Array, now: Array, ground: Ground, within: float) -> tuple[int, int, float]:
    """Solid, face and part of the way at which a toe meets them from before to now; -1 if none.

    within: [m] by which solids are taken for larger.
    """
    solids, tubes = ground.solids, ground.tubes
    solid, face, first = -1, -1, 2.0
    for g in range(len(solids)):
        # Where the way enters and leaves the solid, face by face
        found, enters, leaves = -1, 0.0, 1.0
        shallow, nearest = 0, -np.inf
        for f in range(solids.shape[1]):
            row = solids[g, f]
            end = row[0] * now[0] + row[1] * now[1] + row[2] * now[2] - row[3] - within
            start = row[0] * before[0] + row[1] * before[1] + row[2] * before[2] - row[3] - within
            if start > -_ON:
                if end >= 0.0:
                    leaves = -1.0
                    break
                part = start / (start - end) if start > 0.0 else 0.0
                if found < 0 or part > enters:
                    found, enters = f, part
            elif end > 0.0:
                leaves = min(leaves, start / (start - end))
            if start > nearest:
                shallow, nearest = f, start
        if enters > leaves or enters >= first:
            continue
        solid, first = g, enters
        face = found if found >= 0 else shallow
    if solid >= 0:
        return solid, face, first
    for u in range(len(tubes)):
        tube = tubes[u]
        if tube[3] <= now[2] <= tube[4]:
            away = np.hypot(now[0] - tube[0], now[1] - tube[1])
            if away > tube[2] - within:
                first = np.hypot(before[0] - tube[0], before[1] - tube[1])
                part = (tube[2] - first) / (away - first) if away > first else 0.0
                return u, TUBE, min(max(part, 0.0), 1.0)
    return -1, -1, 0.0


@compiled
def _onto(place: Array, solid: int, face: int, ground: Ground, normal: Array) -> None:
    """Move a place onto its surface, in place, and tell the normal there, into free space."""
    if face == TUBE:
        tube = ground.tubes[solid]
        x, y = place[0] - tube[0], place[1] - tube[1]
        away = np.hypot(x, y)
        normal[0], normal[1], normal[2] = -x / away, -y / away, 0.0
        place[0], place[1] = tube[0] + x / away * tube[2], tube[1] + y / away * tube[2]
        return
    row = ground.solids[solid, face]
    for i in range(3):
        normal[i] = row[i]
    deep = row[0] * place[0] + row[1] * place[1] + row[2] * place[2] - row[3]
    for i in range(3):
        place[i] -= deep * row[i]


@compiled
def _beyond(place: Array, solid: int, face: int, ground: Ground) -> bool:
    """Whether a place on a surface has left its bounds."""
    if face == TUBE:
        return not ground.tubes[solid, 3] <= place[2] <= ground.tubes[solid, 4]
    for f in range(ground.solids.shape[1]):
        if f != face:
            row = ground.solids[solid, f]
            if row[0] * place[0] + row[1] * place[1] + row[2] * place[2] - row[3] > _ON:
                return True
    return False


@compiled
def _both_sides(rotation: Array, inner: Array, room: Array, out: Array) -> None:
    """out = rotation inner rotation^T."""
    for i in range(3):
        for j in range(3):
            room[i, j] = (
                inner[i, 0] * rotation[j, 0]
                + inner[i, 1] * rotation[j, 1]
                + inner[i, 2] * rotation[j, 2]
            )
    for i in range(3):
        for j in range(3):
            out[i, j] = (
                rotation[i, 0] * room[0, j]
                + rotation[i, 1] * room[1, j]
                + rotation[i, 2] * room[2, j]
            )


@compiled
def _swift_touch(
    body: Body, zero: Array, limb: int, mu: float, springs: Springs, touch: Touch, pad: Pad
) -> int:
    """As `_touch`, in a short step: the cone's point that is nearest in the limb's compliance."""
    place, normal, force = touch.place[limb], touch.normal[limb], touch.force[limb]
    follow, firm, slope, soft = pad.m[6], pad.m[7], pad.m[5], pad.m[0]
    away, local, own, tried, edge = pad.v[6], pad.v[7], pad.v[8], pad.v[9], pad.v[10]
    first, second, free = pad.v[0], pad.v[1], pad.v[2]
    s0, s1, s2 = place[0], place[1], place[2]
    for attempt in range(_SLIDES + 1):
        for i in range(3):
            away[i] = place[i] - body.com[i]
        _transposed_times(body.rotation, away, local)
        if not _held(zero, limb, local, springs, touch.angles[limb], own, slope, pad):
            return FAILED
        _times(body.rotation, own, force)
        _both_sides(body.rotation, slope, soft, firm)
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
def _nearest_edge(
    tried: Array,
    normal: Array,
    mu: float,
    soft: Array,
    first: Array,
    second: Array,
    edge: Array,
    room: Array,
) -> None:
    """Edge of a friction cone's surface nearest to a force in a metric (3, 3), and there the point.

    Along an edge d = n + mu e the nearest point is d (d C f) / (d C d): the best edge has the
    largest (d C f)^2 / (d C d). Found by comparing _EDGES of them and then by golden section.
    """
    a = 0 if abs(normal[0]) < 0.6 else 1
    for i in range(3):
        first[i] = (1.0 if i == a else 0.0) - normal[a] * normal[i]
    size = np.sqrt(_dot(first, first))
    for i in range(3):
        first[i] /= size
    _cross(normal, first, second)
    best, most = 0.0, -np.inf
    for k in range(_EDGES):
        angle = 2 * np.pi * k / _EDGES
        worth = _worth(angle, tried, normal, mu, soft, first, second, edge, room)
        if worth > most:
            best, most = angle, worth
    low, high = best - 2 * np.pi / _EDGES, best + 2 * np.pi / _EDGES
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    a_left = _worth(left, tried, normal, mu, soft, first, second, edge, room)
    a_right = _worth(right, tried, normal, mu, soft, first, second, edge, room)
    for _ in range(_SECTIONS):
        if a_left > a_right:
            high, right, a_right = right, left, a_left
            left = high - _GOLDEN * (high - low)
            a_left = _worth(left, tried, normal, mu, soft, first, second, edge, room)
        else:
            low, left, a_left = left, right, a_right
            right = low + _GOLDEN * (high - low)
            a_right = _worth(right, tried, normal, mu, soft, first, second, edge, room)
    _worth((low + high) / 2, tried, normal, mu, soft, first, second, edge, room)


@compiled
def _worth(
    angle: float,
    tried: Array,
    normal: Array,
    mu: float,
    soft: Array,
    first: Array,
    second: Array,
    edge: Array,
    room: Array,
) -> float:
    """How near the edge at an angle comes; the point on it is left in `edge`."""
    co, si = mu * np.cos(angle), mu * np.sin(angle)
    for i in range(3):
        edge[i] = normal[i] + co * first[i] + si * second[i]
    _times(soft, edge, room)
    met, own = _dot(room, tried), _dot(room, edge)
    if not (met > 0.0 and own > 0.0):
        return -1.0
    for i in range(3):
        edge[i] *= met / own
    return float(met * met / own)


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

    zero: (7, 3) of the limb. swift: in a short step. Leaves the force on the toe in `touch`, and in
    pad.m[6], pad.m[7] the matrices P and G of its change when the body moves by (dc, dw):
    dF = -G dc + (G [r]x - P [f]x) dw. Returns AIR, STICKS, SLIDES or FAILED.
    """
    if swift:
        return _swift_touch(body, zero, limb, mu, springs, touch, pad)
    com, rotation = body.com, body.rotation
    place, normal, force = touch.place[limb], touch.normal[limb], touch.force[limb]
    solid, face = touch.solid[limb], touch.face[limb]
    follow, firm, slope, fixed = pad.m[6], pad.m[7], pad.m[5], pad.m[0]
    away, local, own, way, pushed = pad.v[6], pad.v[7], pad.v[8], pad.v[9], pad.v[10]
    slid = False
    for attempt in range(_SLIDES + 1):
        for i in range(3):
            away[i] = place[i] - com[i]
        _transposed_times(rotation, away, local)
        if not _held(zero, limb, local, springs, touch.angles[limb], own, slope, pad):
            return FAILED
        _times(rotation, own, force)
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
        _both_sides(rotation, slope, fixed, firm)  # G = R K R^T
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
                    total = 0.0
                    for a in range(3):
                        total += follow[i, a] * fixed[a, j]
                    firm[i, j] = total
            return SLIDES
        slid = True
        length = min(max(excess / resist, -_FARTHEST), _FARTHEST)
        for i in range(3):
            place[i] += length * way[i]
        _onto(place, solid, face, ground, normal)
    return FAILED
