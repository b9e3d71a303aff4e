"""Estimate contact forces, the body's pose, friction and load from what a robot measures.

Forces f of toes follow from motor torques t less those that carry the links, f = -(J^T)^+ t. The
body's pose follows from the joint angles of toes that are measured to be loaded. A toe that moves
against the others has slipped: what it bore then is the friction of its surface, or nearly so.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.executive.schedule import Gate, MotionSchedule
from climbplan.climb.simulation.executive.settings import ExecutiveSettings
from climbplan.control.joint_regulator import BodyPoseEstimate, RegulatorTables, build_chains
from climbplan.mechanics.stiffness import joint_softness

_SLIDING_FRACTION = (
    0.95  # of the friction that a slipping toe had, which is taken for its surface's
)
_LARGEST_LOSS = 0.7  # of the friction before, in one slip: forces are measured while they change
_MIN_TOES = 3  # that fix the body's pose
_LOADED_FRACTION = 0.5  # of the force of a touch, with which a toe still counts as standing


class MeasuredContacts:
    """Contacts of a robot in execution, N limbs of J joints."""

    def __init__(
        self,
        plan: ClimbPlan,
        tables: RegulatorTables,
        schedule: MotionSchedule,
        settings: ExecutiveSettings,
        toes: Array | None,
    ) -> None:
        """Start at the beginning of a plan; toes: (N, 3) as far as is known; None: as planned."""
        self._plan, self._tables, self._schedule = plan, tables, schedule
        self._settings = settings
        self._chains = build_chains(tables)
        self._softness = joint_softness(plan.robot)
        self.weight = plan.robot.mass * plan.robot.gravity  # [N]
        self.pose = BodyPoseEstimate(tables, toes)
        n = plan.robot.limb_count
        self.force = np.zeros((n, 3))  # on the toes [N], filtered
        self.deflection = np.zeros((n, plan.robot.joint_count))  # of joints, by contacts [rad]
        self.friction = np.ones(len(plan.terrain.surfaces))  # factors on the planned coefficients
        self.load = np.zeros(6)  # beside the planned one [N, N m]
        self._slip_time = np.full(len(self.friction), -np.inf)  # [s] when slips showed friction

    @property
    def touch_force(self) -> float:
        """Force of a toe that has met its surface [N]."""
        return self._settings.touch_force * self.weight

    def measure_forces(self, index: int, contact_torque: Array, seconds: float) -> None:
        """Update forces by torques (N, J) less those of the links [N m], at a sample."""
        self.deflection = -self._softness * contact_torque
        force = -np.einsum("nji,nj->ni", self._tables.turning[index], contact_torque)
        weight = min(seconds / self._settings.filter_time, 1.0)
        self.force += weight * (force - self.force)

    def measure_pose(self, index: int, sample: int, angles: Array, touched: BoolArray) -> None:
        """Update the body's pose by angles (N, J) of toes that have touched and are loaded.

        Toes whose load changes as planned are left out, as long as three others fix the pose.
        """
        pressure = (self.force * self._schedule.normal[index]).sum(axis=1)
        is_loaded = touched & (pressure > _LOADED_FRACTION * self.touch_force)
        trusted = self._tables.trusted[sample] * is_loaded
        if trusted.sum() < _MIN_TOES:
            trusted = is_loaded.astype(np.float64)
        self.pose.update(sample, self._chains.place(angles), trusted)

    def measure_load(self, index: int, touched: BoolArray) -> None:
        """Update the load beside the planned one: the weight that toes bear, filtered."""
        borne = float(self.force[touched, 2].sum())
        planned = self._plan.instants.external_wrench[self._schedule.instant[index], 2]
        limit = self._settings.load_limit * self.weight
        measured = self.weight - float(planned) - borne
        change = self._settings.load_weight * (measured - self.load[2])
        self.load[2] = float(np.clip(self.load[2] + change, -limit, limit))

    def split_force(self, limb: int, normal: Array) -> tuple[float, float]:
        """Return pressure and shear of a toe on a surface with a normal (3,) [N]."""
        pressure = float(self.force[limb] @ normal)
        return pressure, float(np.linalg.norm(self.force[limb] - pressure * normal))

    def find_slips(self) -> list[int]:
        """Find limbs whose toes have moved against the others."""
        return [int(limb) for limb in np.flatnonzero(self.pose.errors > self._settings.slip)]

    def notice_slip(self, limb: int, index: int, time: float) -> bool:
        """Take the place of a toe anew; return whether its surface shows less friction.

        Args:
            limb: The limb.
            index: Sample of the plan.
            time: Since the start [s].
        """
        self.pose.forget(limb)
        pressure, shear = self.split_force(limb, self._schedule.normal[index, limb])
        region = int(self._schedule.region[index, limb])
        is_recent = time < self._slip_time[region] + self._settings.slip_time
        if pressure < self.touch_force or is_recent:
            return False
        self._slip_time[region] = time
        before = self.friction[region]
        ratio = _SLIDING_FRACTION * shear / (pressure * float(self._schedule.mu[index, limb]))
        self.friction[region] = np.clip(ratio, _LARGEST_LOSS * before, _SLIDING_FRACTION * before)
        return True

    def is_unloaded(self, limb: int) -> bool:
        """Return whether a limb bears so little that it may lift."""
        force = float(np.linalg.norm(self.force[limb]))
        return force <= self._settings.unloaded_force * self.weight

    def find_objection(self, gate: Gate, standing: IntArray) -> str:
        """Return why the limbs of a gate must not lift now; "" if they may.

        standing: Limbs on their surfaces, those of the gate among them.
        """
        settings, schedule, names = self._settings, self._schedule, self._plan.robot.limb_names
        for limb in gate.limbs:
            if not self.is_unloaded(int(limb)):
                return f"{names[limb]} still carries {np.linalg.norm(self.force[limb]):.0f} N"
        for limb in standing:
            if limb in gate.limbs:
                continue
            pressure, shear = self.split_force(int(limb), schedule.normal[gate.sample, limb])
            mu = float(schedule.mu[gate.sample, limb])
            if pressure < settings.min_pressure * self.weight:
                return f"{names[limb]} presses with {pressure:.0f} N"
            if shear > settings.friction_use * mu * pressure:
                return f"{names[limb]} is near slipping, shear {shear:.0f} of {pressure:.0f} N"
        return ""
