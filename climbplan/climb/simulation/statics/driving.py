"""What motors are told in a step, and the springs that they are meanwhile."""

from __future__ import annotations

import numpy as np

from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.links import LOOSE, _softness
from climbplan.climb.simulation.statics.regulation import (
    _arrived,
    _estimate,
    _moved,
    _placed,
    _read,
    _regulated,
)
from climbplan.climb.simulation.statics.small_algebra import _copied
from climbplan.climb.simulation.statics.tuples import (
    BY_JOINTS,
    BY_POSE,
    NO_REGULATOR,
    Body,
    Known,
    Machine,
    Motors,
    Pad,
    Playback,
    Springs,
    Touch,
)


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
    place = machine.regulator == BY_JOINTS or machine.regulator == BY_POSE
    if machine.regulator == BY_JOINTS:
        _estimate(plan, before, known, pad)
        _regulated(plan, s, done, span, place, known.com, known.rotation, known, pad)
    else:
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
            m = machine.armature[i, j] / span**2
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
