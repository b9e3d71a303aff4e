"""The controller in a loop with the nonlinear rigid body, in continuous time, under pushes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.mpc.compiled_body import moved
from climbplan.mpc.compiled_feet import worst_standing
from climbplan.mpc.measurement import Situation
from climbplan.mpc.online import Command, OnlineController
from climbplan.mpc.task import (
    ANGLES,
    LEGS,
    POSITION,
    SPIN,
    STATE,
    VELOCITY,
    Array,
    Flags,
    Gait,
    WalkTask,
    WalkTrajectory,
)
from climbplan.robots.rotations import rotation_world_body

SUBSTEPS = 16  # Runge-Kutta steps in a knot: 5 ms at 80 ms
_LANDING_MARGIN = 0.01  # [m]
FALLEN_TILT, FALLEN_HEIGHT = 1.05, 0.08  # [rad], [m] of a body that fell


@dataclass(frozen=True)
class Push:
    """A sudden change of the body's velocity."""

    time: float  # [s]
    velocity: Array  # (3,) [m/s]


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what the controller is told."""

    velocity: float = 0.0  # [m/s]
    angles: float = 0.0  # [rad]
    spin: float = 0.0  # [rad/s]
    position: float = 0.0  # [m] of height and of toes against the body


@dataclass(frozen=True)
class Loop:
    """What happened: samples every 5 ms, commands at every knot."""

    trajectory: WalkTrajectory  # T samples; forces from each to the next
    pushed: Array  # (T, 3) change of velocity at each sample, before its force acts
    commands: tuple[Command, ...]  # (ticks,)
    fell: float | None  # [s]
    overreach: float  # [m] furthest that a standing toe was out of its box within a knot

    @property
    def ticks(self) -> int:
        """Ticks of the controller."""
        return len(self.commands)


def run_loop(
    controller: OnlineController,
    start: WalkTask,
    duration: float,
    pushes: Sequence[Push] = (),
    noise: Noise | None = None,
    seed: int = 0,
    report: Callable[[float], None] | None = None,
) -> Loop:
    """Walk from the start of a task until the end, or until the body falls."""
    task, rng = controller.task, np.random.default_rng(seed)
    body, inverse = task.body, np.linalg.inv(task.body.inertia).astype(float)
    dt = task.step / SUBSTEPS
    ticks = round(duration / task.step)
    state, toes = start.start.state.copy(), start.start.toes.copy()
    before, stood = toes.copy(), np.ones(LEGS, bool)
    rows: list[tuple[Array, Array, Array, Flags, Array]] = []
    commands: list[Command] = []
    fell, overreach, due = None, 0.0, sorted(pushes, key=lambda push: push.time)
    for tick in range(ticks):
        seen = measured(Situation(state, toes, before, stood), noise, rng)
        command = controller.tick(seen)
        commands.append(command)
        plan = command.trajectory
        contact, force = plan.gait.contact[0], plan.force[0]
        landing = plan.toes[1]
        first = toes.copy()
        for part in range(SUBSTEPS):
            now = tick * task.step + part * dt
            jump = np.zeros(3)
            while due and due[0].time <= now + 1e-9:
                jump = jump + due.pop(0).velocity
            state[VELOCITY] += jump
            shown = _swung(first, landing, contact, part / SUBSTEPS, task.lift)
            rows.append((state.copy(), shown, force, contact, jump))
            state = moved(body.mass, body.gravity, body.inertia, inverse, dt, 1, state, toes, force)
            overreach = max(
                overreach, worst_standing(body.toe_center, body.toe_half, state, toes, contact)
            )
            if fallen(state):
                fell = now + dt
                break
        if report is not None:
            report((tick + 1) / ticks)
        if fell is not None:
            break
        before, stood = toes, contact
        toes = np.where(contact[:, None], toes, landed(task, state, landing))
    rows.append((state.copy(), toes.copy(), np.zeros((LEGS, 3)), stood, np.zeros(3)))
    states, feet, forces, contacts, jumps = (np.stack(part) for part in zip(*rows, strict=True))
    gait = Gait(contacts.astype(bool), np.zeros(contacts.shape, np.int64))
    walk = WalkTrajectory(states, feet, forces, gait)
    return Loop(walk, jumps, tuple(commands), fell, overreach)


def landed(task: WalkTask, state: Array, landing: Array) -> Array:
    """Where swinging toes (4, 3) come down: where planned, or as near as legs reach by then."""
    body, R = task.body, rotation_world_body(state[ANGLES])
    spots = (landing - state[POSITION]) @ R
    half = body.toe_half[:2] - _LANDING_MARGIN
    center = body.toe_center[:, :2]
    spots[:, :2] = np.clip(spots[:, :2], center - half, center + half)
    result: Array = (state[POSITION] + spots @ R.T) * [1.0, 1.0, 0.0]
    return result


def fallen(state: Array) -> bool:
    """Whether the body lies down, or is nowhere."""
    if not np.isfinite(state).all():
        return True
    return bool(np.abs(state[6:8]).max() > FALLEN_TILT or state[2] < FALLEN_HEIGHT)


def measured(true: Situation, noise: Noise | None, rng: np.random.Generator) -> Situation:
    """What sensors would say."""
    if noise is None:
        return true
    off = np.zeros(STATE)
    off[2] = rng.normal(0, noise.position) if noise.position else 0.0
    off[VELOCITY] = noise.velocity * rng.normal(size=3)
    off[ANGLES] = noise.angles * rng.normal(size=3)
    off[SPIN] = noise.spin * rng.normal(size=3)
    shift = np.zeros((LEGS, 3))
    shift[:, :2] = noise.position * rng.normal(size=(LEGS, 2))
    return replace(true, state=true.state + off, toes=true.toes + shift)


def sampled_task(task: WalkTask, samples: int) -> WalkTask:
    """The task of a loop's record: so many Runge-Kutta steps after the first sample."""
    reference = task.reference
    return replace(
        task,
        knots=samples,
        step=task.step / SUBSTEPS,
        integrator="rk4",
        reference=replace(
            reference,
            velocity=np.tile(reference.velocity[-1], (samples, 1)),
            euler=np.tile(reference.euler[-1], (samples, 1)),
            height=np.full(samples, reference.height[-1]),
        ),
    )


def recovered(loop: Loop, task: WalkTask, within: float = 0.25) -> bool:
    """Whether the body kept up, and its mean velocity over the last 0.48 s is the reference's."""
    if loop.fell is not None:
        return False
    dt = task.step / SUBSTEPS
    last = round(0.48 / dt)
    mean = loop.trajectory.state[-last:, VELOCITY].mean(axis=0)
    return bool(np.linalg.norm((mean - task.reference.velocity[-1])[:2]) < within)


def _swung(first: Array, landing: Array, contact: Flags, share: float, lift: float) -> Array:
    """Toes (4, 3) on the way: swinging ones straight on, lifted as half a sine."""
    toes = first.copy()
    moving = ~contact
    toes[moving, :2] += share * (landing[moving, :2] - first[moving, :2])
    toes[moving, 2] = lift * np.sin(np.pi * share)
    return toes
