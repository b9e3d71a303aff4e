"""One step of a braced robot in time: the equilibrium of springs, dampers and inertia at its end.

Backward Euler: a motor's torque k (theta - command) + c dtheta/dt + I d2theta/dt2 is that of a
spring of stiffness k + c/h + I/h^2 about another command, so that every step is an equilibrium of
springs with contacts. Long steps are statics, short ones dynamics: what has no equilibrium falls.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.contact import AIR, FAILED, STICKS, _touch
from climbplan.climb.simulation.statics.corner import _cornered, _runs_into
from climbplan.climb.simulation.statics.links import _chain, _free_angles
from climbplan.climb.simulation.statics.small_algebra import _cross, _solve_firm, _times, _turn
from climbplan.climb.simulation.statics.surfaces import TUBE, _landed, _onto
from climbplan.climb.simulation.statics.tuples import (
    Body,
    Ground,
    Load,
    Pad,
    Springs,
    Stand,
    Touch,
)

_ITERATIONS = 30
_BALANCED = 2e-4  # of the weight [N], and at a lever of 0.3 m
_NEARLY = 500.0  # times what is balanced, for a moment
_LEVER = 0.3  # [m]
_LONGEST, _MOST_TURNED = 0.03, 0.06  # [m], [rad] of a Newton step
_LANDING = 5e-4  # [m] by which a toe may be commanded on in the step in which it lands
_HALVINGS = 5  # of a Newton step that makes things worse


@compiled
def _wrench(
    body: Body,
    zero: Array,
    stand: Stand,
    ground: Ground,
    springs: Springs,
    touch: Touch,
    pad: Pad,
) -> bool:
    """Forces and moments of all limbs on a body, and the stiffness against its motion, in `pad`.

    zero: (N, 2J + 1, 3). False where a limb does not reach where its toe
    stands, or where it lands in a step that is too long to tell where.
    """
    wrench, matrix = pad.wrench, pad.matrix
    wrench[:] = 0.0
    matrix[:] = 0.0
    local, arm, moment = pad.v[0], pad.v[1], pad.v[2]
    swift = stand.swift[0] == 1
    for i in range(len(zero)):
        place = touch.place[i]
        if stand.touching[i]:
            g, f = stand.solid[i], stand.face[i]
            for a in range(3):
                place[a] = stand.anchor[i, a]
        else:
            _free_angles(i, springs, touch.angles[i])
            _chain(zero[i], touch.angles[i], pad.columns, pad.axes, local)
            _times(body.rotation, local, place)
            for a in range(3):
                place[a] += body.com[a]
            g, f, part = _landed(stand.anchor[i], place, ground, 0.0, int(np.int64(-1)))
            if g < 0:
                touch.state[i] = AIR
                touch.force[i] = 0.0
                continue
            beyond = 0.0  # [m] that the command goes on after the toe has landed
            for a in range(3):
                beyond += ((1 - part) * (place[a] - stand.anchor[i, a])) ** 2
            if stand.coarse[0] and beyond > _LANDING**2:
                return False
        touch.solid[i], touch.face[i] = g, f
        _onto(place, g, f, ground, touch.normal[i])
        grip = ground.tube_friction[g] if f == TUBE else ground.friction[g]
        if stand.slippery[i]:
            grip = 0.0
        if stand.corner[i, 0] >= 0 and _cornered(
            body, zero[i], i, grip, stand, ground, springs, touch, pad
        ):
            state = STICKS
        else:
            state = _touch(body, zero[i], i, grip, swift, ground, springs, touch, pad)
        if state == FAILED:
            return False
        touch.state[i] = state
        if state == AIR:
            touch.force[i] = 0.0
            continue
        force = touch.force[i]
        for a in range(3):
            arm[a] = place[a] - body.com[a]
            wrench[a] += force[a]
        _cross(arm, force, moment)
        for a in range(3):
            wrench[3 + a] += moment[a]
        _add_stiffness(arm, force, pad.m[7], pad.m[6], pad.m[0], matrix)
    return True


@compiled
def _add_stiffness(
    arm: Array, force: Array, firm: Array, follow: Array, block: Array, matrix: Array
) -> None:
    """Add -d(force, moment) / d(body) of a limb: dF = -G dc + (G [r]x - P [f]x) dw.

    dM = r x dF + f x dc.
    """
    r0, r1, r2 = arm[0], arm[1], arm[2]
    f0, f1, f2 = force[0], force[1], force[2]
    for i in range(3):
        g0, g1, g2 = firm[i, 0], firm[i, 1], firm[i, 2]
        p0, p1, p2 = follow[i, 0], follow[i, 1], follow[i, 2]
        # Row of G [r]x - P [f]x
        block[i, 0] = g1 * r2 - g2 * r1 - (p1 * f2 - p2 * f1)
        block[i, 1] = g2 * r0 - g0 * r2 - (p2 * f0 - p0 * f2)
        block[i, 2] = g0 * r1 - g1 * r0 - (p0 * f1 - p1 * f0)
    for j in range(3):
        for i in range(3):
            matrix[i, j] += firm[i, j]
            matrix[i, 3 + j] -= block[i, j]
        # -(r x column): of -G for dc, of the block for dw
        matrix[3, j] += r1 * firm[2, j] - r2 * firm[1, j]
        matrix[4, j] += r2 * firm[0, j] - r0 * firm[2, j]
        matrix[5, j] += r0 * firm[1, j] - r1 * firm[0, j]
        matrix[3, 3 + j] -= r1 * block[2, j] - r2 * block[1, j]
        matrix[4, 3 + j] -= r2 * block[0, j] - r0 * block[2, j]
        matrix[5, 3 + j] -= r0 * block[1, j] - r1 * block[0, j]
    # -[f]x of the moment by dc
    matrix[3, 1] += f2
    matrix[3, 2] -= f1
    matrix[4, 0] -= f2
    matrix[4, 2] += f0
    matrix[5, 0] += f1
    matrix[5, 1] -= f0


@compiled
def _ran_in(stand: Stand, ground: Ground, touch: Touch) -> bool:
    """Whether a toe has slid so deep into a solid that only a shorter step tells where it stops."""
    deepest = 0.0
    for i in range(len(touch.state)):
        deepest = max(deepest, _runs_into(i, stand, ground, touch)[2])
    return deepest > _LANDING


@compiled
def _settled(
    body: Body,
    span: float,
    load: Load,
    zero: Array,
    stand: Stand,
    ground: Ground,
    springs: Springs,
    touch: Touch,
    pad: Pad,
    rough: bool,
) -> bool:
    """Move a body to its equilibrium at the end of a step of span [s], in place.

    springs: those that motors are in this step. rough: whether what is nearly balanced will do,
    where a toe snaps from one place to another and nothing between balances. False where no
    equilibrium is found, or where the body would not stand firm.
    """
    com, rotation, velocity, moved = body.com, body.rotation, body.velocity, body.moved
    wrench, matrix, lever, moment, down = pad.wrench, pad.matrix, pad.v[0], pad.v[1], pad.v[11]
    down[0], down[1], down[2] = 0.0, 0.0, -load.mass * load.gravity
    enough = _BALANCED * load.mass * load.gravity
    # Where the motion so far would carry it
    for a in range(3):
        moved[a] = min(max(velocity[a] * span, -0.005), 0.005)
        moved[3 + a] = min(max(velocity[3 + a] * span, -0.01), 0.01)
        com[a] += moved[a]
    _turn(rotation, moved[3:])
    heavy, wide = load.mass / span**2, load.inertia / span**2
    off, before, halved = np.inf, np.inf, 0
    taken, room = pad.taken, pad.v[3]
    for _ in range(_ITERATIONS):
        if not _wrench(body, zero, stand, ground, springs, touch, pad):
            return False
        _times(rotation, load.offset, lever)
        _cross(lever, down, moment)
        for a in range(3):
            wrench[a] += load.wrench[a] + down[a] + heavy * (velocity[a] * span - moved[a])
            wrench[3 + a] += (
                load.wrench[3 + a] + moment[a] + wide * (velocity[3 + a] * span - moved[3 + a])
            )
            matrix[a, a] += heavy
            matrix[3 + a, 3 + a] += wide
        # (dw x q) x W = q (dw . W) - dw (q . W)
        for a in range(3):
            matrix[3 + a, 5] -= lever[a] * down[2]
            matrix[3 + a, 3 + a] += lever[2] * down[2]
        off = 0.0
        for a in range(3):
            off = max(off, abs(wrench[a]), abs(wrench[3 + a]) / _LEVER)
        if off < enough:
            return not (stand.coarse[0] and _ran_in(stand, ground, touch))
        if off > before and halved < _HALVINGS:
            # Half of the way back: contacts and play have kinks that a whole step overshoots
            halved += 1
            for a in range(6):
                taken[a] *= 0.5
                moved[a] -= taken[a]
            for a in range(3):
                com[a] -= taken[a]
                room[a] = -taken[3 + a]
            _turn(rotation, room)
            continue
        before, halved = off, 0
        if not _solve_firm(matrix, wrench):
            return False
        most = 0.0
        for a in range(3):
            most = max(most, abs(wrench[a]) / _LONGEST, abs(wrench[3 + a]) / _MOST_TURNED)
        part = 1.0 if most <= 1.0 else 1.0 / most
        for a in range(6):
            wrench[a] *= part
            moved[a] += wrench[a]
            taken[a] = wrench[a]
        for a in range(3):
            com[a] += wrench[a]
        _turn(rotation, wrench[3:])
    return rough and off < _NEARLY * enough
