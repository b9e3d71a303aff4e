"""The regulator of pose and forces and its odometry, as `regulator.py` and `odometry.py` have them.

Written for one step of many worlds; tests hold them against those two.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.links import _chain
from climbplan.climb.simulation.statics.small_algebra import (
    _add_times,
    _cross,
    _inverse,
    _rows_times,
    _times,
    _turn,
)
from climbplan.climb.simulation.statics.tuples import Known, Pad, Playback
from climbplan.control.joint_regulator import BACK, FORCE_RATE, MOST_OFFSET, RATE

CONTROL = 0.01  # [s] between readings of the regulator, as `replay.py` has it
_FEWEST = 3  # standing toes that tell a pose
_FITS = 4  # Gauss-Newton steps of the rotation, from the last pose, at most
_FITTED = 1e-6  # [rad] of a step that is the last: the next would be a millionth of it


@compiled
def _read(rotor: Array, noise: Array, span: float, known: Known) -> None:
    """What sensors tell of joints (N, J) over a step of span [s], in place.

    Corrections integrate one reading every CONTROL, so that a step's count for their mean. Where a
    toe is put down one reading tells.
    """
    once, reading = known.once, known.reading
    many = np.sqrt(CONTROL / span)
    for i in range(len(rotor)):
        for j in range(rotor.shape[1]):
            once[i, j] = reading[i, j] = rotor[i, j]
            if len(noise):
                reading[i, j] += many * noise[known.draws[0] % len(noise), i, j]
                once[i, j] += noise[(known.draws[0] + 1) % len(noise), i, j]
    known.draws[0] += 2


@compiled
def _keep(time: float, known: Known) -> None:
    """Remember what offsets are at a time [s]."""
    k = known.kept[0] % len(known.when)
    known.when[k] = time
    for i in range(len(known.offset)):
        for a in range(3):
            known.past[k, i, a] = known.offset[i, a]
    known.kept[0] += 1


@compiled
def _arrived(time: float, now: float, known: Known) -> None:
    """Leave in `late` what offsets were at a time [s] not after now, between what is kept.

    known.offset: what they are now.
    """
    after, later = now, known.offset
    for back in range(1, min(known.kept[0], len(known.when)) + 1):
        k = (known.kept[0] - back) % len(known.when)
        if known.when[k] <= time:
            share = (time - known.when[k]) / max(after - known.when[k], 1e-12)
            for i in range(len(later)):
                for a in range(3):
                    before = known.past[k, i, a]
                    known.late[i, a] = before + share * (later[i, a] - before)
            return
        after, later = known.when[k], known.past[k]
    for i in range(len(later)):
        for a in range(3):
            known.late[i, a] = later[i, a]


@compiled
def _estimate(
    plan: Playback,
    s: int,
    known: Known,
    pad: Pad,
) -> None:
    """Pose by what sensors tell, from toes believed to stand where they stood, in place."""
    angles, toes, stood = (
        known.reading, known.toes, known.stood,
    )  # fmt: skip
    com, rotation = known.com, known.rotation
    local = known.local
    count = 0
    for i in range(len(angles)):
        _chain(plan.zero[i], angles[i], pad.columns, pad.axes, local[i])
        count += 1 if plan.trusted[s, i] and stood[i] else 0
    if count >= _FEWEST:
        _fitted(plan.trusted[s], stood, local, toes, com, rotation, pad)
    for i in range(len(angles)):
        if plan.trusted[s, i] and not stood[i]:
            _chain(plan.zero[i], known.once[i], pad.columns, pad.axes, pad.v[1])
            _times(rotation, pad.v[1], pad.v[0])
            for a in range(3):
                toes[i, a] = com[a] + pad.v[0][a]
        stood[i] = plan.trusted[s, i]


@compiled
def _fitted(
    trusted: Array,
    stood: Array,
    local: Array,
    toes: Array,
    com: Array,
    rotation: Array,
    pad: Pad,
) -> None:
    """Translation and rotation that carry local (N, 3) nearest to toes (N, 3), least squares."""
    middle, there, own, away, turn = pad.v[1], pad.v[2], pad.v[3], pad.v[4], pad.v[5]
    normal, inverse = pad.m[0], pad.m[1]
    middle[:] = 0.0
    there[:] = 0.0
    count = 0
    for i in range(len(local)):
        if trusted[i] and stood[i]:
            count += 1
            for a in range(3):
                middle[a] += local[i, a]
                there[a] += toes[i, a]
    for a in range(3):
        middle[a] /= count
        there[a] /= count
    for _ in range(_FITS):
        normal[:] = 0.0
        total = pad.v[6]
        total[:] = 0.0
        for i in range(len(local)):
            if not (trusted[i] and stood[i]):
                continue
            for a in range(3):
                away[a] = local[i, a] - middle[a]
            _times(rotation, away, own)
            for a in range(3):
                away[a] = toes[i, a] - there[a]
            _cross(own, away, pad.v[7])
            size = own[0] ** 2 + own[1] ** 2 + own[2] ** 2
            for a in range(3):
                total[a] += pad.v[7][a]
                for b in range(3):
                    normal[a, b] -= own[a] * own[b]
                normal[a, a] += size
        for a in range(3):
            normal[a, a] += 1e-9  # toes in a line leave the turn about it open: the least
        _inverse(normal, inverse)
        _times(inverse, total, turn)
        _turn(rotation, turn)
        if turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2 < _FITTED**2:
            break
    _times(rotation, middle, own)
    for a in range(3):
        com[a] = there[a] - own[a]


@compiled
def _regulated(
    plan: Playback,
    s: int,
    part: float,
    span: float,
    place: bool,
    com: Array,
    rotation: Array,
    known: Known,
    pad: Pad,
) -> None:
    """Integrate departures of pose and forces over a span [s] into offsets.

    part: of the way from step s - 1 to s at which the pose is. known.lag: (N, J) of joints behind
    what they were last told, less what carries the links.
    """
    before = max(s - 1, 0)
    lag, missing, offset = known.lag, known.toe_lag, known.offset
    wanted, turn, moved, shift, turned = pad.m[0], pad.joints[0], pad.v[1], pad.v[2], pad.v[3]
    for a in range(3):
        aim = (1 - part) * plan.com[before, a] + part * plan.com[s, a]
        shift[a] = aim - com[a] if place else 0.0
        for b in range(3):
            wanted[a, b] = (1 - part) * plan.rotation[before, a, b] + part * plan.rotation[s, a, b]
    # wanted @ rotation.T, of which the odd part is the turn
    for a in range(3):
        i, j = (a + 2) % 3, (a + 1) % 3
        turned[a] = 0.0
        for b in range(3):
            turned[a] += (wanted[i, b] * rotation[j, b] - wanted[j, b] * rotation[i, b]) / 2
    n = len(lag)
    for i in range(n):
        for j in range(lag.shape[1]):
            most = plan.most[i, j]
            aim = (1 - part) * plan.bent[before, i, j] + part * plan.bent[s, i, j]
            turn[j] = aim - min(max(lag[i, j], -most), most)
        _rows_times(plan.jacobian[before, i], turn, missing[i])
    for i in range(n):
        if not plan.contact[before, i]:
            for a in range(3):
                offset[i, a] *= max(0.0, 1.0 - BACK * span)
            continue
        for a in range(3):
            total = 0.0
            for k in range(n):
                for b in range(3):
                    total += plan.sharing[before, 3 * i + a, 3 * k + b] * missing[k, b]
            offset[i, a] -= FORCE_RATE * span * total
        if plan.settled[before]:
            _cross(turned, plan.arm[before, i], moved)
            for a in range(3):
                offset[i, a] -= RATE * span * (shift[a] + moved[a])
        _shortened(offset[i], MOST_OFFSET)


@compiled
def _moved(plan: Playback, s: int, offset: Array, command: Array) -> None:
    """Add to commands (N, J) what moves toes by offsets (N, 3)."""
    for i in range(len(command)):
        _add_times(plan.turning[s, i], offset[i], command[i])


@compiled
def _shortened(vector: Array, most: float) -> None:
    length = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if length > most:
        for a in range(3):
            vector[a] *= most / length


@compiled
def _placed(plan: Playback, s: int, placement: Array, command: Array, pad: Pad) -> None:
    """Add to commands (N, J) what puts toes off where they are meant to stand."""
    off = pad.v[0]
    for i in range(len(command)):
        hold, part = plan.foothold[s, i], plan.share[s, i]
        after = min(hold + 1, placement.shape[1] - 1)
        for a in range(3):
            off[a] = (1 - part) * placement[i, hold, a] + part * placement[i, after, a]
        if off[0] != 0.0 or off[1] != 0.0 or off[2] != 0.0:
            _add_times(plan.turning[s, i], off, command[i])
