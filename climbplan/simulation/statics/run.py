"""A plan played in one world, step by step, to its end or to a fall."""

from __future__ import annotations

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.simulation.falls import FALLEN, TUMBLED
from climbplan.simulation.statics.compiling import compiled
from climbplan.simulation.statics.contact import AIR, SLIDES, STICKS
from climbplan.simulation.statics.corner import _runs_into
from climbplan.simulation.statics.links import (
    LOOSE,
    _chain,
    _free_angles,
    _pushes,
    _softness,
    _volume,
)
from climbplan.simulation.statics.regulation import (
    _arrived,
    _estimate,
    _keep,
    _moved,
    _placed,
    _read,
    _regulated,
)
from climbplan.simulation.statics.small_algebra import _dot, _times
from climbplan.simulation.statics.step import _settled
from climbplan.simulation.statics.surfaces import BESIDE, TUBE, _beyond, _landed, _onto
from climbplan.simulation.statics.tuples import (
    BY_JOINTS,
    BY_POSE,
    NO_REGULATOR,
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

# What a run tells of itself: columns of its row
FELL, FELL_STEP, CAUSE, CAUSE_LIMB, CAUSE_STEP, SLIPS, LOST, FARTHEST, BALANCE, USED, SLID = range(
    11
)
COLUMNS = 11
NOTHING, LOSES, SLIPS_OFF, TOO_WEAK, UNBALANCED = range(5)  # causes
# USED: share of a held toe's friction at most in use; SLID: farthest that one slid [m]
_SLIP = 0.005  # [m]
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
        g, f, _ = _landed(stand.anchor[i], stand.anchor[i], ground, _THERE, -1)
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
def _copied(one: Array, other: Array) -> None:
    """What stands in one (N, n) stands in the other too."""
    for i in range(len(one)):
        for a in range(one.shape[1]):
            other[i, a] = one[i, a]


@compiled
def _lose(machine: Machine, s: int, moves: bool, stand: Stand) -> None:
    """Which toes have no friction in a step."""
    for i in range(len(stand.slippery)):
        stand.slippery[i] = 0
    for loss in range(len(machine.losses)):
        if moves and machine.losses[loss, 1] <= s < machine.losses[loss, 2]:
            stand.slippery[int(machine.losses[loss, 0])] = 1


@compiled
def _commanded(
    plan: Playback,
    machine: Machine,
    s: int,
    done: float,
    part: float,
    span: float,
    moves: bool,
    clock: float,
    body: Body,
    motors: Motors,
    known: Known,
    pad: Pad,
) -> None:
    """What motors are told at the end of part of a step: plan, missed footholds, regulator.

    clock: time since the motion began at its start [s].
    """
    before, share = max(s - 1, 0), done + part
    wanted = motors.wanted
    for i in range(len(wanted)):
        for j in range(wanted.shape[1]):
            wanted[i, j] = (1 - share) * plan.command[before, i, j] + (
                share * plan.command[s, i, j]
            )
    _placed(plan, s, machine.placement, wanted, pad)
    if machine.regulator == NO_REGULATOR:
        return
    if not moves:
        _moved(plan, s, known.offset, wanted)
        _copied(wanted, known.sent)
        return
    _read(motors.rotor, machine.noise, span, known)
    for i in range(len(wanted)):
        for j in range(wanted.shape[1]):
            carrying = plan.carrying[before, i, j]
            known.lag[i, j] = known.reading[i, j] - known.told[i, j] + carrying
    if machine.regulator == BY_JOINTS:
        _estimate(plan, before, known, pad)
        _regulated(plan, s, done, span, True, known.com, known.rotation, known, pad)
    else:
        place = machine.regulator == BY_POSE
        _regulated(plan, s, done, span, place, body.com, body.rotation, known, pad)
    if machine.delay > 0.0:
        _arrived(clock + span - machine.delay, clock + span, known)
        _moved(plan, before, known.late, wanted)
    else:
        _moved(plan, before, known.offset, wanted)
    _copied(wanted, known.sent)


@compiled
def _sprung(
    plan: Playback,
    machine: Machine,
    span: float,
    springs: Springs,
    touch: Touch,
    motors: Motors,
) -> None:
    """Motors as the springs of a step of span [s]."""
    rotor, wanted = motors.rotor, motors.wanted
    for i in range(len(wanted)):
        springs.soft[i] = _softness(plan.zero[i], wanted.shape[1], springs.volume[i])
        touch.saturated[i] = 0
        for j in range(wanted.shape[1]):
            k, c = machine.stiffness[i, j], machine.damping[i, j] / span
            m = machine.armature / span**2
            firm = k + c + m
            # A motor pushes with its largest torque at most, by where it was last
            most = machine.strongest[i, j] / k
            lead = rotor[i, j] - wanted[i, j]
            if abs(lead) > most:
                touch.saturated[i] = 1
                wanted[i, j] = rotor[i, j] - np.copysign(most, lead)
            springs.stiffness[i, j], springs.loose[i, j] = firm, LOOSE * firm
            springs.command[i, j] = (
                k * wanted[i, j] + c * rotor[i, j] + m * (rotor[i, j] + span * motors.speed[i, j])
            ) / firm
            touch.angles[i, j] = motors.angles[i, j]


@compiled
def _record(body: Body, touch: Touch, path: Array) -> None:
    """Leave body, toes and forces in a row of a path."""
    n = len(touch.state)
    for a in range(3):
        path[a] = body.com[a]
        for i in range(n):
            path[3 + 3 * i + a] = touch.place[i, a]
            path[3 + 3 * n + 3 * i + a] = touch.force[i, a]


@compiled
def _is_down(plan: Playback, s: int, body: Body, row: Array) -> bool:
    """Whether a body is so low, or so tilted, that it counts as fallen (`replay.py`)."""
    departure, trace = 0.0, 0.0
    for a in range(3):
        departure += (plan.com[s, a] - body.com[a]) ** 2
        for b in range(3):
            trace += plan.rotation[s, a, b] * body.rotation[a, b]
    row[FARTHEST] = max(row[FARTHEST], np.sqrt(departure))
    return plan.com[s, 2] - body.com[2] > FALLEN or (trace - 1) / 2 < np.cos(TUMBLED)


@compiled
def _fell(s: int, row: Array) -> None:
    row[FELL], row[FELL_STEP] = 1, s
    if row[CAUSE] == NOTHING:
        row[CAUSE], row[CAUSE_STEP] = UNBALANCED, s


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
                g, f, _ = _landed(place, place, ground, BESIDE, -1)
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


@compiled
def _used(limb: int, ground: Ground, touch: Touch) -> float:
    """Share of a toe's friction that is in use, 1 of one that slides or has come off."""
    if touch.state[limb] != STICKS:
        return 1.0
    g, force, normal = touch.solid[limb], touch.force[limb], touch.normal[limb]
    mu = ground.tube_friction[g] if touch.face[limb] == TUBE else ground.friction[g]
    press = _dot(force, normal)
    shear = np.sqrt(max(_dot(force, force) - press * press, 0.0))
    return min(shear / max(mu * press, 1e-9), 1.0)


@compiled
def _look(plan: Playback, s: int, ground: Ground, touch: Touch, feet: Feet, row: Array) -> None:
    """Note the first thing that went wrong since all was well."""
    cause, limb = NOTHING, -1
    slips = 0.0
    for i in range(len(touch.state)):
        if feet.slid[i] > _SLIP and plan.stands[s, i]:
            slips += 1.0
        if not plan.stands[s, i]:
            continue
        row[USED] = max(row[USED], _used(i, ground, touch))
        row[SLID] = max(row[SLID], feet.slid[i])
        if touch.state[i] == AIR:
            row[LOST] = 1
            if cause == NOTHING:
                cause, limb = LOSES, i
        elif touch.state[i] == SLIDES:
            if cause != SLIPS_OFF:
                cause, limb = SLIPS_OFF, i
        elif touch.saturated[i] and cause == NOTHING:
            cause, limb = TOO_WEAK, i
    row[SLIPS] = max(row[SLIPS], slips)
    if cause == NOTHING:
        row[CAUSE], row[CAUSE_LIMB] = NOTHING, -1
    elif row[CAUSE] == NOTHING:
        row[CAUSE], row[CAUSE_LIMB], row[CAUSE_STEP] = cause, limb, s
