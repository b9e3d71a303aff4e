"""The reference motion for the whole robot as functions of time: body, swing toes, forces, normals.

Landings are adapted by the capture point: where position or velocity of the body deviates,
swinging toes land with an offset, as far as their region extends. Where a toe would hit a riser it
first moves up alone, or at last down alone, as long as is necessary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.walking.plan.body_motion import PlannedBody, interpolate_body
from climbplan.walking.plan.swing_trajectory import SwingTrajectory, choose_vertical_fractions
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.walk_reference import build_walk_reference

_MAX_LANDING_OFFSET = 2.0  # of a landing, in half extents of the box
_CAPTURE_GAIN = 1.1  # of the capture point's offset; more than 1 brings the body back
_FIXED_LANDING_FRACTION = 0.9  # of a swing, after which its landing is fixed
_TOUCHDOWN_DEPTH = 0.01  # [m] below the ground, the target of swings


@dataclass(frozen=True)
class SwingState:
    """The state of a swinging toe at a time."""

    position: Array  # (3,)
    velocity: Array  # (3,)
    acceleration: Array  # (3,)
    fraction: float  # of the swing


class WholeBodyReference:
    """A plan as functions of time, with landings that depend on the simulated state."""

    def __init__(self, plan: WalkPlan, foot: float = 0.0) -> None:
        """Prepare the reference of a plan; foot: radius of spherical feet [m]."""
        self.plan, self.task, self.foot = plan, plan.task, foot
        self.base = build_walk_reference(plan)
        self.time, self.contact = self.base.time, self.base.contact
        # (T, L) region of the stance, of swinging toes that of the landing
        self.region: IntArray = plan.trajectory.gait.region
        self.normal: Array = self.task.ground.frame[self.region][..., 2, :]  # (T, L, 3)
        height = self.task.reference.height[0] - self.task.ground.standoff
        self.pendulum = float(np.sqrt(height / self.task.body.gravity))
        self.lift_off: list[Array | None] = [
            None
        ] * self.task.body.leg_count  # where swinging toes came from
        self.landing_offset = np.zeros_like(self.task.body.toe_center)
        self.vertical_fractions = [
            (0.0, 0.0)
        ] * self.task.body.leg_count  # shares of swings, first and last

    def find_sample(self, time: float) -> int:
        """Return the last sample before a time."""
        last = len(self.time) - 2
        return int(np.clip(np.searchsorted(self.time, time + 1e-9, side="right") - 1, 0, last))

    def interpolate_body(self, time: float) -> PlannedBody:
        """Return the body's motion at a time: linear velocities, consistent positions."""
        n = self.find_sample(time)
        return interpolate_body(self.plan, n, float(np.clip(time, self.time[n], self.time[n + 1])))

    def compute_swing(self, leg: int, time: float, toe: Array, capture_offset: Array) -> SwingState:
        """Return the reference of a swinging toe.

        Args:
            leg: index of the leg.
            time: [s].
            toe: (3,) actual position at lift-off [m].
            capture_offset: (3,) of the body's capture point from the plan [m].
        """
        swings = self.base.swings[leg]
        swing = next((candidate for candidate in swings if time < candidate.end), swings[-1])
        span = max(swing.end - swing.start, 1e-6)
        fraction = float(np.clip((time - swing.start) / span, 0.0, 1.0))
        lift_off = self.lift_off[leg]
        if lift_off is None:
            lift_off = self.lift_off[leg] = toe.copy()
            self.landing_offset[leg] = 0.0
            self.vertical_fractions[leg] = choose_vertical_fractions(
                self.task.ground,
                lift_off,
                swing.touchdown,
                _compute_apex_height(swing.clearance, lift_off, swing.touchdown),
                self.foot,
            )
        if fraction < _FIXED_LANDING_FRACTION:
            limit = _MAX_LANDING_OFFSET * self.task.body.toe_half
            # Growth of the capture point's offset until the landing
            growth = _CAPTURE_GAIN * np.exp((1.0 - fraction) * span / self.pendulum)
            offset = np.append(np.clip(growth * capture_offset, -limit, limit)[:2], 0.0)
            self.landing_offset[leg] = self._limit_to_region(
                self.find_sample(time), leg, swing.touchdown, offset
            )
        landing = swing.touchdown + self.landing_offset[leg] - [0.0, 0.0, _TOUCHDOWN_DEPTH]
        first, last = self.vertical_fractions[leg]
        curve = SwingTrajectory(
            lift_off, landing, _compute_apex_height(swing.clearance, lift_off, landing), first, last
        )
        place, velocity, acceleration = curve.evaluate(fraction)
        return SwingState(place, velocity / span, acceleration / span**2, fraction)

    def _limit_to_region(self, sample: int, leg: int, planned: Array, offset: Array) -> Array:
        """Return a landing offset (3,) limited to the leg's region and on its plane."""
        ground, region = self.task.ground, self.region[sample, leg]
        target = planned[:2] + offset[:2]
        spot = ground.project(region, target)
        rise = ground.compute_height(region, spot) - ground.compute_height(region, planned[:2])
        limited: Array = offset + np.append(spot - target, rise)
        return limited

    def mark_touchdown(self, leg: int) -> None:
        """Mark a leg as standing: its next swing begins at its toe."""
        self.lift_off[leg] = None

    def select_planned_force(self, sample: int) -> Array:
        """Return planned forces (L, 3) of standing legs until the next sample [N]."""
        force = self.plan.trajectory.force[sample]
        return np.where(self.contact[sample][:, None], force, 0.0)


def _compute_apex_height(clearance: float, lift_off: Array, touchdown: Array) -> float:
    """Return the height of a swing's middle above the straight line [m]."""
    return clearance + abs(float(touchdown[2] - lift_off[2])) / 2 + _TOUCHDOWN_DEPTH
