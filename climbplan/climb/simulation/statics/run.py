"""A plan played in one world, step by step, to its end or to a fall."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.contact import AIR, SLIDES
from climbplan.climb.simulation.statics.corner import _runs_into
from climbplan.climb.simulation.statics.driving import _commanded, _sprung
from climbplan.climb.simulation.statics.links import (
    LOOSE,
    _chain,
    _free_angles,
    _pushes,
    _volume,
)
from climbplan.climb.simulation.statics.outcome import (
    BALANCE,
    CAUSE_LIMB,
    COLUMNS,
    _fell,
    _is_down,
    _look,
    _record,
)
from climbplan.climb.simulation.statics.regulation import (
    _keep,
)
from climbplan.climb.simulation.statics.rolling_contact import _rolled_on
from climbplan.climb.simulation.statics.small_algebra import _copied, _times
from climbplan.climb.simulation.statics.step import _settled
from climbplan.climb.simulation.statics.surfaces import BESIDE, _beyond, _landed, _onto
from climbplan.climb.simulation.statics.tuples import (
    Body,
    Feet,
    Ground,
    Known,
    Load,
    Machine,
    Motors,
    Pad,
    Playback,
    Springs,
    Stand,
    Touch,
)

SETTLE = 4  # steps at the first commands before the motion starts
SETTLE_SPAN = 0.25  # [s] of each
_SHORT = 0.005  # [s] of a step in which a toe may land, whatever the command does then
_SWIFT = 0.05  # [s] of a step that counts as short
_SLIDING = 0.03  # [s] of a step while a toe slides, which goes another way as it goes on
_SNAP = 2e-3  # [s] of a step in which toes may snap
_KEPT = 2048  # offsets that are remembered for a regulator that is late
FINEST = 1.0 / 512  # part of a step below which it is not divided
_THERE = 1e-5  # [m] from a surface at the start that counts as on it


@compiled
def play(plan: Playback, machine: Machine, ground: Ground, path: Array) -> Array:
    """(COLUMNS,) what becomes of a robot in one world.

    path: (S, 3 + 6 N) in which the body's place, toes [m] and forces on them [N] are left, or of no
    rows.
    """
    n, joints = plan.command.shape[1], plan.command.shape[2]
    pad = Pad(
        np.zeros((12, 3)), np.zeros((8, 3, 3)), np.zeros(6), np.zeros((6, 6)), np.zeros(6),
        np.zeros((joints, 3)), np.zeros((joints, 3)), np.zeros((joints, 3)), np.zeros((4, joints)),
        np.zeros((joints, joints)),
    )  # fmt: skip
    body = Body(plan.com[0].copy(), plan.rotation[0].copy(), np.zeros(6), np.zeros(6))
    kept = Body(plan.com[0].copy(), plan.rotation[0].copy(), np.zeros(6), np.zeros(6))
    half = machine.play / (2 * (1 - LOOSE))
    springs = Springs(
        np.zeros((n, joints)), np.zeros((n, joints)), np.zeros((n, joints)), half,
        np.zeros((n, joints)), np.zeros(n), np.zeros(n),
    )  # fmt: skip
    for i in range(n):
        _chain(plan.zero[i], machine.angles[i], pad.columns, pad.axes, pad.v[0])
        springs.volume[i] = _volume(pad.columns)
    stand = Stand(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64),
        machine.toes.copy(), np.zeros(n, np.int64), np.full((n, 2), -1),
        np.zeros(1, np.int64), np.zeros(1, np.int64),
    )  # fmt: skip
    touch = Touch(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64), machine.toes.copy(),
        np.zeros((n, 3)), np.zeros((n, 3)), machine.angles.copy(), np.zeros(n, np.int64),
    )  # fmt: skip
    load = Load(machine.mass, machine.inertia, machine.gravity, machine.offset, np.zeros(6))
    motors = Motors(
        machine.angles.copy(), machine.angles.copy(), np.zeros((n, joints)), np.zeros((n, joints))
    )
    known = Known(
        machine.toes.copy(), plan.trusted[0].copy(), plan.com[0].copy(), plan.rotation[0].copy(),
        machine.toes - plan.toes, machine.toes - plan.toes, plan.command[0].copy(),
        plan.command[0].copy(), np.zeros((n, joints)), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros((n, joints)), np.zeros((n, joints)), np.zeros(1, np.int64), np.zeros((n, 3)),
        np.zeros(_KEPT), np.zeros((_KEPT if machine.delay > 0.0 else 0, n, 3)),
        np.zeros(1, np.int64),
    )  # fmt: skip
    feet = Feet(machine.toes.copy(), np.zeros(n))
    row = np.zeros(COLUMNS)
    row[CAUSE_LIMB] = -1
    for i in range(n):
        g, f, _ = _landed(stand.anchor[i], stand.anchor[i], ground, _THERE, int(np.int64(-1)))
        if g >= 0:
            stand.touching[i], stand.solid[i], stand.face[i] = 1, g, f
            _onto(stand.anchor[i], g, f, ground, touch.normal[i])
    _played(
        plan, machine, ground, path, row, body, kept, load, springs, stand, touch, motors, known,
        feet, pad,
    )  # fmt: skip
    return row


@compiled
def _played(
    plan: Playback,
    machine: Machine,
    ground: Ground,
    path: Array,
    row: Array,
    body: Body,
    kept: Body,
    load: Load,
    springs: Springs,
    stand: Stand,
    touch: Touch,
    motors: Motors,
    known: Known,
    feet: Feet,
    pad: Pad,
) -> None:
    """The steps of `play`, which brings the room that they need."""
    fine, clock = 1.0, 0.0
    if machine.delay > 0.0:
        _keep(clock, known)
    for index in range(-SETTLE, len(plan.span)):
        s = max(index, 0)
        whole = SETTLE_SPAN if index <= 0 else plan.span[s]
        for a in range(6):
            load.wrench[a] = plan.wrench[s, a]
        for i in range(len(motors.rotor)):
            for j in range(motors.rotor.shape[1]):
                springs.weight[i, j] = plan.weight[s, i, j]
        if index > 0 and len(plan.ends):
            _rolled_on(plan, s, body, stand, ground, motors, known, feet, pad)
        _lose(machine, s, index > 0, stand)
        done = 0.0
        while done < 1.0 - 1e-9:
            part = min(fine, 1.0 - done, _SLIDING / whole if _slides(touch) else 1.0)
            if 1.0 - done - part < 1e-6:
                part = 1.0 - done
            span = part * whole
            stand.swift[0] = 1 if span < _SWIFT else 0
            stand.coarse[0] = 1 if span > _SHORT else 0
            _commanded(
                plan, machine, s, done, part, span, index > 0, clock, body, motors, known, pad
            )
            _sprung(plan, machine, span, springs, touch, motors)
            _put(body, kept)
            good = _settled(
                body, span, load, plan.zero, stand, ground, springs, touch, pad, span < _SNAP
            )
            if not good:
                _put(kept, body)
                _copied(known.before, known.offset)
                fine = part / 2
                if fine >= FINEST:
                    continue
                row[BALANCE] = 1
                _fell(s, row)
                return
            _copied(known.sent, known.told)
            _copied(known.offset, known.before)
            if machine.delay > 0.0 and index > 0:
                clock += span
                _keep(clock, known)
            done += part
            fine = min(1.0, 2 * part) if done < 1.0 - 1e-9 else min(1.0, 2 * fine)
            for a in range(6):
                body.velocity[a] = body.moved[a] / span
            _finish(plan, body, stand, ground, springs, touch, motors, span, feet, pad)
        if len(path):
            _record(body, touch, path[s])
        _look(plan, s, ground, touch, feet, row)
        if _is_down(plan, s, body, row):
            _fell(s, row)
            return


@compiled
def _slides(touch: Touch) -> bool:
    found = False
    for i in range(len(touch.state)):
        found = found or touch.state[i] == SLIDES
    return found


@compiled
def _put(one: Body, other: Body) -> None:
    """Where one body is the other is too."""
    for a in range(3):
        other.com[a] = one.com[a]
        for b in range(3):
            other.rotation[a, b] = one.rotation[a, b]


@compiled
def _lose(machine: Machine, s: int, moves: bool, stand: Stand) -> None:
    """Which toes have no friction in a step."""
    for i in range(len(stand.slippery)):
        stand.slippery[i] = 0
    for loss in range(len(machine.losses)):
        if moves and machine.losses[loss, 1] <= s < machine.losses[loss, 2]:
            stand.slippery[int(machine.losses[loss, 0])] = 1


@compiled
def _finish(
    plan: Playback,
    body: Body,
    stand: Stand,
    ground: Ground,
    springs: Springs,
    touch: Touch,
    motors: Motors,
    span: float,
    feet: Feet,
    pad: Pad,
) -> None:
    """Keep what a step has made of contacts and motors, in place."""
    angles, rotor, slid = motors.angles, motors.rotor, feet.slid
    for i in range(len(angles)):
        place = touch.place[i]
        if touch.state[i] == AIR:
            stand.corner[i, 0] = -1
            # Where the toe of a limb without force is
            _free_angles(i, springs, touch.angles[i])
            _chain(plan.zero[i], touch.angles[i], pad.columns, pad.axes, pad.v[0])
            springs.volume[i] = _volume(pad.columns)
            _times(body.rotation, pad.v[0], place)
            for a in range(3):
                place[a] += body.com[a]
            stand.touching[i] = 0
            slid[i] = 0.0
        else:
            g, f = touch.solid[i], touch.face[i]
            into, its, deep = _runs_into(i, stand, ground, touch)
            if into >= 0:
                # It stops where it came to the other surface
                far = 0.0
                for a in range(3):
                    far += (place[a] - stand.anchor[i, a]) ** 2
                for a in range(3):
                    place[a] -= deep / np.sqrt(far) * (place[a] - stand.anchor[i, a])
                stand.corner[i, 0], stand.corner[i, 1] = g, f
                g, f = into, its
            elif touch.state[i] == SLIDES:
                stand.corner[i, 0] = -1
            _onto(place, g, f, ground, touch.normal[i])
            if not stand.touching[i]:
                for a in range(3):
                    feet.set_down[i, a] = place[a]
            stand.touching[i], stand.solid[i], stand.face[i] = 1, g, f
            if _beyond(place, g, f, ground):
                g, f, _ = _landed(place, place, ground, BESIDE, int(np.int64(-1)))
                if g < 0:
                    stand.touching[i] = 0
                else:
                    stand.solid[i], stand.face[i] = g, f
                    _onto(place, g, f, ground, touch.normal[i])
            far = 0.0
            for a in range(3):
                far += (place[a] - feet.set_down[i, a]) ** 2
            slid[i] = np.sqrt(far)
        for j in range(angles.shape[1]):
            angles[i, j] = touch.angles[i, j]
            bend = angles[i, j] - springs.command[i, j]
            firm = springs.stiffness[i, j]
            torque = _pushes(bend, springs.half[i, j], springs.loose[i, j], firm)
            now = springs.command[i, j] + torque / firm
            motors.speed[i, j] = (now - rotor[i, j]) / span
            rotor[i, j] = now
        for a in range(3):
            stand.anchor[i, a] = place[a]
