"""A simulated walk held against its plan: path, contact forces, friction, corrections, slips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, spans_of
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.measures import SLIP, planned_tilt, rolled
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.replay import WalkRun
from climbplan.walking.task.task import ANGLES, POSITION

LEAST_LOAD = 1.0  # [N] planned pressures below are left out of friction and lost contacts
LOST = 0.02  # [s] without contact, longer than a toe that touches down a little late needs


@dataclass(frozen=True)
class WalkSlip:
    """A standing toe that slid, or one that should press and did not touch."""

    leg: int
    time: float  # [s]
    amount: float  # [m] slid, or [s] without contact


@dataclass(frozen=True)
class WalkComparison:
    """Simulated beside planned at the samples reached (S); intervals between them (S - 1)."""

    off: Array  # (S,) distance of the body from its plan [m]
    tilt: Array  # (S,) angle between planned and simulated body [rad]
    loaded: BoolArray  # (S - 1, L) legs that the plan presses
    force_error: Array  # |ground's force - planned| of loaded legs, in weights of the robot
    friction: Array  # (S - 1, L) simulated shear over pressure, 0 where not loaded
    friction_planned: Array  # (S - 1, L)
    mu: float  # of the simulated ground
    correction: Array  # |correction| of loaded legs, in weights of the robot
    overreach: float  # furthest that a standing toe was out of its workspace [m]
    slips: tuple[WalkSlip, ...]
    losses: tuple[WalkSlip, ...]


def compare_walk(plan: WalkPlan, run: WalkRun) -> WalkComparison:
    """Hold a run against its plan."""
    last = max(run.samples - 1, 0)
    found, weight = plan.trajectory, plan.task.weight
    planned = found.force[:last]
    loaded = found.gait.contact[:last] & (planned[..., 2] > LEAST_LOAD)
    friction, friction_planned = np.zeros(loaded.shape), np.zeros(loaded.shape)
    there = loaded & (run.pressure[:last] > 0)
    np.divide(run.shear[:last], run.pressure[:last], out=friction, where=there)
    shear = np.linalg.norm(planned[..., :2], axis=-1)
    np.divide(shear, planned[..., 2], out=friction_planned, where=loaded)
    off = run.com - found.state[: run.samples, POSITION]
    wanted = rotation_world_body(found.state[: run.samples, ANGLES])
    return WalkComparison(
        off=np.linalg.norm(off, axis=1),
        tilt=planned_tilt(run.rotation, wanted),
        loaded=loaded,
        force_error=np.linalg.norm(run.force[:last] - planned, axis=-1)[loaded] / weight,
        friction=friction,
        friction_planned=friction_planned,
        mu=plan.task.ground.friction * run.conditions.friction,
        correction=np.linalg.norm(run.correction[:last], axis=-1)[loaded] / weight,
        overreach=float(run.overreach.max(initial=0.0)),
        slips=_slips(plan, run),
        losses=_losses(plan, run, loaded),
    )


def _slips(plan: WalkPlan, run: WalkRun) -> tuple[WalkSlip, ...]:
    """Toes that slid by more than SLIP from where they touched down; spherical feet may roll."""
    out = []
    contact = plan.trajectory.gait.contact[: run.samples]
    for leg in range(plan.task.body.leg_count):
        for first, after in spans_of(contact[:, leg]):
            touched = np.flatnonzero(run.touching[first:after, leg] > 0)
            if not len(touched):
                continue
            # The sample after an interval with contact is where the toe stood through it.
            stood = np.minimum(first + touched + 1, run.samples - 1)
            shift = run.toes[stood, leg] - run.toes[stood[0], leg]
            if run.foot and run.links is not None:
                ground = plan.task.ground.frame[plan.trajectory.gait.region[first, leg]]
                every = slice(int(stood[0]), int(stood[-1]) + 1)
                moved = rolled(run.foot, run.links[every, leg], ground[2])
                shift = shift - moved[stood - stood[0]]
            slid = np.linalg.norm(shift, axis=1)
            if slid.max(initial=0.0) > SLIP:
                when = stood[int(np.argmax(slid > SLIP))]
                out.append(WalkSlip(leg, float(run.time[when]), float(slid.max())))
    return tuple(sorted(out, key=lambda slip: slip.time))


def _losses(plan: WalkPlan, run: WalkRun, loaded: BoolArray) -> tuple[WalkSlip, ...]:
    """Legs that the plan presses and that do not touch for more than LOST."""
    step, out = plan.task.step, []
    missing = np.where(loaded, step * (1.0 - run.touching[: len(loaded)]), 0.0)
    for leg in range(plan.task.body.leg_count):
        for first, after in spans_of(missing[:, leg] > 0):
            lasted = float(missing[first:after, leg].sum())
            if lasted > LOST:
                out.append(WalkSlip(leg, float(run.time[first]), lasted))
    return tuple(sorted(out, key=lambda slip: slip.time))
