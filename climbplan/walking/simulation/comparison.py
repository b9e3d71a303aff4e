"""Comparison of a simulated walk with its plan: path, forces, friction, corrections, slips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, spans_of
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.measures import SLIP, compute_tilt, integrate_rolling
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.replay import WalkRun
from climbplan.walking.task.task import ANGLES, POSITION

MIN_LOAD = 1.0  # [N] planned normal force below which friction and lost contacts do not count
MIN_LOSS_TIME = 0.02  # [s] without contact; a late touchdown is shorter


@dataclass(frozen=True)
class WalkSlip:
    """A standing toe that slid, or one with planned load that did not touch."""

    leg: int
    time: float  # [s]
    amount: float  # [m] slid, or [s] without contact


@dataclass(frozen=True)
class WalkComparison:
    """Simulated against planned values at S samples and in the S - 1 intervals between them."""

    position_error: Array  # (S,) distance of the body from its plan [m]
    tilt: Array  # (S,) angle between planned and simulated body [rad]
    loaded: BoolArray  # (S - 1, L) legs with planned load
    force_error: Array  # contact force minus planned one, of loaded legs, in weights of the robot
    friction: Array  # (S - 1, L) simulated shear over pressure, 0 where not loaded
    friction_planned: Array  # (S - 1, L)
    mu: float  # of the simulated ground
    correction: Array  # |correction| of loaded legs, in weights of the robot
    overreach: float  # largest workspace violation of a standing toe [m]
    slips: tuple[WalkSlip, ...]
    losses: tuple[WalkSlip, ...]


def compare_walk(plan: WalkPlan, run: WalkRun) -> WalkComparison:
    """Compare a simulated walk with its plan."""
    last = max(run.samples - 1, 0)
    trajectory, weight = plan.trajectory, plan.task.weight
    planned = trajectory.force[:last]
    loaded = trajectory.gait.contact[:last] & (planned[..., 2] > MIN_LOAD)
    friction, friction_planned = np.zeros(loaded.shape), np.zeros(loaded.shape)
    touching = loaded & (run.pressure[:last] > 0)
    np.divide(run.shear[:last], run.pressure[:last], out=friction, where=touching)
    shear = np.linalg.norm(planned[..., :2], axis=-1)
    np.divide(shear, planned[..., 2], out=friction_planned, where=loaded)
    position_offset = run.com - trajectory.state[: run.samples, POSITION]
    planned_rotation = rotation_world_body(trajectory.state[: run.samples, ANGLES])
    return WalkComparison(
        position_error=np.linalg.norm(position_offset, axis=1),
        tilt=compute_tilt(run.rotation, planned_rotation),
        loaded=loaded,
        force_error=np.linalg.norm(run.force[:last] - planned, axis=-1)[loaded] / weight,
        friction=friction,
        friction_planned=friction_planned,
        mu=plan.task.ground.min_friction * run.conditions.friction,
        correction=np.linalg.norm(run.correction[:last], axis=-1)[loaded] / weight,
        overreach=float(run.overreach.max(initial=0.0)),
        slips=_find_slips(plan, run),
        losses=_find_losses(plan, run, loaded),
    )


def _find_slips(plan: WalkPlan, run: WalkRun) -> tuple[WalkSlip, ...]:
    """Return toes that slid by more than SLIP from their touchdown; spherical feet may roll."""
    slips = []
    contact = plan.trajectory.gait.contact[: run.samples]
    for leg in range(plan.task.body.leg_count):
        for first, after in spans_of(contact[:, leg]):
            touching = np.flatnonzero(run.touching[first:after, leg] > 0)
            if not len(touching):
                continue
            # The sample after an interval with contact is where the toe stood through it.
            contact_samples = np.minimum(first + touching + 1, run.samples - 1)
            shift = run.toes[contact_samples, leg] - run.toes[contact_samples[0], leg]
            if run.foot and run.links is not None:
                ground = plan.task.ground.frame[plan.trajectory.gait.region[first, leg]]
                stance = slice(int(contact_samples[0]), int(contact_samples[-1]) + 1)
                rolling = integrate_rolling(run.foot, run.links[stance, leg], ground[2])
                shift = shift - rolling[contact_samples - contact_samples[0]]
            slid = np.linalg.norm(shift, axis=1)
            if slid.max(initial=0.0) > SLIP:
                when = contact_samples[int(np.argmax(slid > SLIP))]
                slips.append(WalkSlip(leg, float(run.time[when]), float(slid.max())))
    return tuple(sorted(slips, key=lambda slip: slip.time))


def _find_losses(plan: WalkPlan, run: WalkRun, loaded: BoolArray) -> tuple[WalkSlip, ...]:
    """Return legs with planned load that do not touch for more than MIN_LOSS_TIME."""
    step, losses = plan.task.dt, []
    missing = np.where(loaded, step * (1.0 - run.touching[: len(loaded)]), 0.0)
    for leg in range(plan.task.body.leg_count):
        for first, after in spans_of(missing[:, leg] > 0):
            duration = float(missing[first:after, leg].sum())
            if duration > MIN_LOSS_TIME:
                losses.append(WalkSlip(leg, float(run.time[first]), duration))
    return tuple(sorted(losses, key=lambda slip: slip.time))
