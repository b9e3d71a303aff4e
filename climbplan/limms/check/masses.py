"""Checks of what box and modules ask of latches, ground and joints together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import Stretch
from climbplan.limms.check.kinematics import turned
from climbplan.limms.check.limits import judge
from climbplan.limms.check.loads import StretchLoads, loads_of_all
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import ModuleSpec
from climbplan.verification.check import Check, unjudged

MASSLESS = "massless modules"
_NOT_JUDGED = MASSLESS
_ROUNDING = 1e-4  # [N, N m]
_JUMP = (
    0.1  # [rad/s] from one stretch to the next: more is a blow, less is how samples are followed
)


@dataclass
class _Need:
    """The worst of one check: by how much it is over, and what is needed where."""

    over: float = -np.inf
    where: str = ""
    words: str = ""
    holds: float | None = None  # where it is worst
    needed: float | None = None

    def look(self, time: Array, needed: Array, limit: Array | float, what: str, unit: str) -> None:
        """Needed (M,) against what there is (M,); NaN counts as the worst."""
        over = needed - limit
        k = int(np.argmax(np.where(np.isnan(over), np.inf, over)))
        if np.isnan(over[k]) or over[k] > self.over:
            there = float(np.broadcast_to(limit, over.shape)[k])
            self.over, self.where = float(over[k]), f"{time[k]:.3f} s, {what}"
            self.words = f"{what} holds {there:.3g} {unit}, {needed[k]:.3g} {unit} needed"
            self.holds, self.needed = there, float(needed[k])


@dataclass
class Needs:
    """What a plan with masses asks for, the worst of each check."""

    found: dict[str, _Need] = field(default_factory=dict)

    def of(self, name: str) -> _Need:
        """The worst so far of one check."""
        return self.found.setdefault(name, _Need())


def needs_of(plan: LimmsPlan, module: ModuleSpec) -> Needs:
    """Loads of a plan with masses beside what its hardware holds."""
    needs = Needs()
    before: StretchLoads | None = None
    for loads in loads_of_all(plan, module):
        _unheld(loads, needs)
        if before is not None:
            _blows(plan, before.stretch, loads.stretch, needs)
        before = loads
        _contacts(plan, module, loads, needs)
        _joints(plan, module, loads, needs)
    return needs


def mass_checks(plan: LimmsPlan, module: ModuleSpec) -> Iterator[Check]:
    """All checks with masses; of a plan without them they are told and decide nothing."""
    needs = needs_of(plan, module)
    for name in ("load.balance", "load.force", "load.moment", "load.ground", "load.tip"):
        yield _check(plan, name, needs.of(name))
    yield _check(plan, "load.torque", needs.of("load.torque"))


def _check(plan: LimmsPlan, name: str, worst: _Need) -> Check:
    over = worst.over if worst.where else 0.0
    check = judge(name, over, worst.where, worst.words)
    check = replace(check, holds=worst.holds, needed=worst.needed)
    if not plan.massless:
        return check
    return unjudged(check, _NOT_JUDGED, MASSLESS, f"with masses, {worst.words}")


def _unheld(loads: StretchLoads, needs: Needs) -> None:
    time = loads.stretch.time
    worst = needs.of("load.balance")
    over = worst.over
    worst.look(time, loads.unheld, 0.0, "box and modules", "")
    if worst.over > over or np.isnan(worst.over):
        small = worst.over <= _ROUNDING
        worst.words = "" if small else f"nothing gives {worst.over:.3g} N or N m"


def _blows(plan: LimmsPlan, before: Stretch, after: Stretch, needs: Needs) -> None:
    """What has mass changes its speed by forces: at once, as between two stretches, by none."""
    jump = np.abs(after.rates[0] - before.rates[-1])  # (L, 6)
    module, joint = np.unravel_index(int(np.argmax(jump)), jump.shape)
    size, worst = float(jump[module, joint]), needs.of("load.balance")
    if size <= _JUMP or size <= worst.over:
        return
    who = f"joint {joint + 1} of {plan.module_names[module]}"
    worst.over, worst.needed, worst.holds = size, size, 0.0
    worst.where = f"{after.time[0]:.3f} s, {who}"
    worst.words = f"nothing gives the blow by which {who} turns {size:.3g} rad/s faster at once"


def _contacts(plan: LimmsPlan, module: ModuleSpec, loads: StretchLoads, needs: Needs) -> None:
    time = loads.stretch.time
    for contact, wrench in zip(loads.contacts, loads.wrench, strict=True):
        force, moment = wrench[:, :3], wrench[:, 3:]
        size, turn = np.linalg.norm(force, axis=1), np.linalg.norm(moment, axis=1)
        if contact.kind != "box":
            needs.of("load.force").look(time, size, module.max_force, contact.name, "N")
        if contact.kind == "latch":
            needs.of("load.moment").look(time, turn, module.latch_moment, contact.name, "N m")
            continue
        # Ground pushes, within its friction cone, and where the body is over it
        aside, push = np.hypot(force[:, 0], force[:, 1]), force[:, 2]
        needs.of("load.ground").look(time, aside, plan.friction * push, contact.name, "N")
        if contact.kind == "ground":
            held = module.radius * np.maximum(push, 0) + module.ground_moment
            tilting = np.hypot(moment[:, 0], moment[:, 1])
            needs.of("load.tip").look(time, tilting, held, contact.name, "N m")
            continue
        # About the box's own edges
        b = contact.body - len(plan.module_names)
        tilt = np.abs(np.swapaxes(turned(loads.stretch.yaw[:, b]), 1, 2) @ moment[..., None])[
            ..., 0
        ]
        for axis in (0, 1):
            half = plan.box_size[b, 1 - axis] / 2
            held = half * np.maximum(push, 0)
            needs.of("load.tip").look(time, tilt[:, axis], held, contact.name, "N m")


def _joints(plan: LimmsPlan, module: ModuleSpec, loads: StretchLoads, needs: Needs) -> None:
    size = np.abs(loads.torque)
    for m, name in enumerate(plan.module_names):
        for joint in range(size.shape[2]):
            what = f"joint {joint + 1} of {name}"
            limit = module.max_torque
            needs.of("load.torque").look(loads.stretch.time, size[:, m, joint], limit, what, "N m")
