"""Checks of the loads of boxes and modules on latches, ground and joints together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import DenseStretch
from climbplan.limms.check.kinematics import compute_yaw_rotation
from climbplan.limms.check.limits import judge
from climbplan.limms.check.loads import StretchLoads, compute_loads
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import ModuleSpec
from climbplan.verification.check import Check, mark_unjudged

MASSLESS = "massless modules"
_NOT_JUDGED = MASSLESS
_BALANCE_TOLERANCE = 1e-4  # [N, N m]
_MAX_RATE_JUMP = (
    0.1  # [rad/s] from one stretch to the next: more is a blow, less is how samples are followed
)


@dataclass
class _WorstLoad:
    """The worst load of one check: its excess, where it is, and the values."""

    excess: float = -np.inf
    where: str = ""
    message: str = ""
    holds: float | None = None  # capacity at the worst sample
    needed: float | None = None

    def update(
        self, time: Array, needed: Array, limit: Array | float, label: str, unit: str
    ) -> None:
        """Compare loads (M,) with their limits (M,); NaN counts as the worst."""
        excess = needed - limit
        k = int(np.argmax(np.where(np.isnan(excess), np.inf, excess)))
        if np.isnan(excess[k]) or excess[k] > self.excess:
            available = float(np.broadcast_to(limit, excess.shape)[k])
            self.excess, self.where = float(excess[k]), f"{time[k]:.3f} s, {label}"
            self.message = f"{label} holds {available:.3g} {unit}, {needed[k]:.3g} {unit} needed"
            self.holds, self.needed = available, float(needed[k])


@dataclass
class WorstLoads:
    """The worst loads of a plan with masses, by check."""

    by_check: dict[str, _WorstLoad] = field(default_factory=dict)

    def select(self, name: str) -> _WorstLoad:
        """Return the worst load of a check so far."""
        return self.by_check.setdefault(name, _WorstLoad())


def find_worst_loads(plan: LimmsPlan, module: ModuleSpec) -> WorstLoads:
    """Compare the loads of a plan with masses with the capacities of its hardware."""
    worst_loads = WorstLoads()
    previous: StretchLoads | None = None
    for loads in compute_loads(plan, module):
        _check_balance(loads, worst_loads)
        if previous is not None:
            _check_impacts(plan, previous.stretch, loads.stretch, worst_loads)
        previous = loads
        _check_contacts(plan, module, loads, worst_loads)
        _check_joints(plan, module, loads, worst_loads)
    return worst_loads


def check_masses(plan: LimmsPlan, module: ModuleSpec) -> Iterator[Check]:
    """Yield all checks with masses; for a plan without masses they are informational."""
    worst_loads = find_worst_loads(plan, module)
    for name in ("load.balance", "load.force", "load.moment", "load.friction", "load.tipping"):
        yield _check(plan, name, worst_loads.select(name))
    yield _check(plan, "load.torque", worst_loads.select("load.torque"))


def _check(plan: LimmsPlan, name: str, worst: _WorstLoad) -> Check:
    """Return the check of a worst load."""
    excess = worst.excess if worst.where else 0.0
    check = judge(name, excess, worst.where, worst.message)
    check = replace(check, holds=worst.holds, needed=worst.needed)
    if not plan.massless:
        return check
    return mark_unjudged(check, _NOT_JUDGED, MASSLESS, f"with masses, {worst.message}")


def _check_balance(loads: StretchLoads, worst_loads: WorstLoads) -> None:
    """Update the check that contacts balance all loads."""
    time = loads.stretch.time
    worst = worst_loads.select("load.balance")
    excess = worst.excess
    worst.update(time, loads.imbalance, 0.0, "box and modules", "")
    if worst.excess > excess or np.isnan(worst.excess):
        is_small = worst.excess <= _BALANCE_TOLERANCE
        worst.message = "" if is_small else f"nothing gives {worst.excess:.3g} N or N m"


def _check_impacts(
    plan: LimmsPlan, before: DenseStretch, after: DenseStretch, worst_loads: WorstLoads
) -> None:
    """Update the check that joint speeds are continuous between stretches (no impulsive force)."""
    jump = np.abs(after.rates[0] - before.rates[-1])  # (L, 6)
    module, joint = np.unravel_index(int(np.argmax(jump)), jump.shape)
    rate_jump, worst = float(jump[module, joint]), worst_loads.select("load.balance")
    if rate_jump <= _MAX_RATE_JUMP or rate_jump <= worst.excess:
        return
    joint_name = f"joint {joint + 1} of {plan.module_names[module]}"
    worst.excess, worst.needed, worst.holds = rate_jump, rate_jump, 0.0
    worst.where = f"{after.time[0]:.3f} s, {joint_name}"
    worst.message = (
        f"nothing gives the blow by which {joint_name} turns {rate_jump:.3g} rad/s faster at once"
    )


def _check_contacts(
    plan: LimmsPlan, module: ModuleSpec, loads: StretchLoads, worst_loads: WorstLoads
) -> None:
    """Update the checks of contact forces and moments."""
    time = loads.stretch.time
    for contact, wrench in zip(loads.contacts, loads.wrench, strict=True):
        force, moment = wrench[:, :3], wrench[:, 3:]
        force_size, moment_size = np.linalg.norm(force, axis=1), np.linalg.norm(moment, axis=1)
        if contact.kind != "box":
            worst_loads.select("load.force").update(
                time, force_size, module.max_force, contact.name, "N"
            )
        if contact.kind == "latch":
            worst_loads.select("load.moment").update(
                time, moment_size, module.latch_moment, contact.name, "N m"
            )
            continue
        # Ground pushes within its friction cone, at points under the body
        tangential, normal_force = np.hypot(force[:, 0], force[:, 1]), force[:, 2]
        worst_loads.select("load.friction").update(
            time, tangential, plan.friction * normal_force, contact.name, "N"
        )
        if contact.kind == "ground":
            capacity = module.radius * np.maximum(normal_force, 0) + module.ground_moment
            tilt_moment = np.hypot(moment[:, 0], moment[:, 1])
            worst_loads.select("load.tipping").update(
                time, tilt_moment, capacity, contact.name, "N m"
            )
            continue
        # Tipping about the edges of the box
        b = contact.body - len(plan.module_names)
        tilt = np.abs(
            np.swapaxes(compute_yaw_rotation(loads.stretch.yaw[:, b]), 1, 2) @ moment[..., None]
        )[..., 0]
        for axis in (0, 1):
            half = plan.box_size[b, 1 - axis] / 2
            capacity = half * np.maximum(normal_force, 0)
            worst_loads.select("load.tipping").update(
                time, tilt[:, axis], capacity, contact.name, "N m"
            )


def _check_joints(
    plan: LimmsPlan, module: ModuleSpec, loads: StretchLoads, worst_loads: WorstLoads
) -> None:
    """Update the check of joint torques."""
    torque = np.abs(loads.torque)
    for m, name in enumerate(plan.module_names):
        for joint in range(torque.shape[2]):
            label = f"joint {joint + 1} of {name}"
            limit = module.max_torque
            worst_loads.select("load.torque").update(
                loads.stretch.time, torque[:, m, joint], limit, label, "N m"
            )
