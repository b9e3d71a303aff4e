"""One run of modules in MuJoCo: servos follow the planned joints, latches close, open and break.

Servos get the planned angles and speeds, and beside them the torques that the plan's checker finds
for the motion. A latch closes where its end is when the plan closes it, unless that is too far
off. What it bears is read from its constraint. With masses a latch that bears more than it holds
breaks, and an end on the ground that is pulled, pushed aside or tipped lets go; without masses
nothing breaks, since the plan does not ask what hardware holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.contacts import NOBODY, Contact
from climbplan.limms.check.kinematics import turned
from climbplan.limms.check.loads import StretchLoads, loads_of_all
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import JOINTS, ModuleSpec
from climbplan.limms.simulation.holding import Closed, Order, borne, order_of, too_much
from climbplan.limms.simulation.model import (
    DAMPING,
    STIFF,
    TIME_STEP,
    Hold,
    box_name,
    build_mjcf,
    end_link,
    link_name,
    simulated_module,
)
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.mujoco_loading import load_mujoco

SAMPLE = 20  # steps between samples that are kept
REACHED = 0.02  # [m] an end further than that from where it is to latch misses
LOST = 0.15  # [m] the box off its plan that counts as lost
SMOOTH = 0.01  # [s] over which a load is felt before something breaks


@dataclass(frozen=True)
class Bearing:
    """What one contact bears while it is closed, planned and simulated (S samples)."""

    name: str
    kind: str  # "latch", "ground"
    time: Array  # (S,) [s]
    planned: Array  # (S, 6) force and moment on the module's end, world frame [N, N m]
    found: Array  # (S, 6)


@dataclass(frozen=True)
class Broken:
    """A contact that did not hold, or did not come about."""

    name: str
    time: float  # [s]
    words: str


@dataclass(frozen=True)
class ModuleRun:
    """What happened (S samples, up to the end or until a box is lost)."""

    conditions: Conditions
    module: ModuleSpec  # as simulated
    time: Array  # (S,) [s]
    box: Array  # (S, D, 3) of the boxes that are delivered [m]
    planned_box: Array  # (S, D, 3)
    tilt: Array  # (S, D) [rad] of them off their planned attitude
    bend: Array  # (S, L) worst joint off its plan [rad]
    torque: Array  # (S, L, 6) [N m]
    planned_torque: Array  # (S, L, 6)
    bearings: tuple[Bearing, ...]
    misses: Array  # (n,) of latches as they close [m]
    broken: tuple[Broken, ...]
    lost: bool  # a box


def simulate_modules(
    plan: LimmsPlan,
    conditions: Conditions,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[int, Any, Any], None] | None = None,
) -> ModuleRun:
    """Play a plan. watch: called with number, model and data at every kept sample, for pictures.

    Raises MissingSolver without MuJoCo.
    """
    mujoco = load_mujoco()
    module = simulated_module(plan)
    loads = list(loads_of_all(plan, module))
    holds = sorted({_hold(plan, c) for each in loads for c in each.contacts if c.kind != "box"})
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, module, holds, conditions))
    world = _World(mujoco, model, mujoco.MjData(model), plan, module, conditions, tuple(holds))
    return world.play(loads, progress, watch)


def _hold(plan: LimmsPlan, contact: Contact) -> Hold:
    body, count = "world", len(plan.module_names)
    if contact.other >= count:
        body = box_name(contact.other - count)
    elif contact.other != NOBODY:
        body = link_name(contact.other, end_link(contact.other_end))
    return Hold(contact.body, contact.end, body)


class _World:
    """One model on its way through a plan."""

    def __init__(
        self,
        mujoco: ModuleType,
        model: Any,
        data: Any,
        plan: LimmsPlan,
        module: ModuleSpec,
        conditions: Conditions,
        holds: tuple[Hold, ...],
    ) -> None:
        self.mujoco, self.model, self.data = mujoco, model, data
        self.plan, self.module, self.conditions, self.holds = plan, module, conditions, holds
        count = len(plan.module_names)
        self.boxes = [model.body(box_name(b)).id for b in range(plan.deliveries)]
        self.ends = np.array(
            [[model.body(link_name(m, end_link(e))).id for e in (0, 1)] for m in range(count)]
        )
        self.root = np.array([model.body_dofadr[self.ends[m, 0]] for m in range(count)])
        joints = [[model.joint(link_name(m, k + 1)) for k in range(JOINTS)] for m in range(count)]
        self.at = np.array([[joint.qposadr[0] for joint in row] for row in joints])
        self.closed: dict[Hold, Closed] = {}
        self.order: Order | None = None  # of what is closed, None where that has changed
        self.misses: list[float] = []
        self.broken: list[Broken] = []
        self.rows: list[dict[str, Any]] = []
        self.bearings: list[Bearing] = []

    def play(
        self,
        loads: list[StretchLoads],
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
    ) -> ModuleRun:
        self._stand(loads[0])
        whole = float(self.plan.motion.time[-1])
        lost = False
        for each in loads:
            self._switch(each)
            lost = self._stretch(each, watch)
            if progress is not None:
                progress(float(each.stretch.time[-1]) / whole)
            if lost:
                break
        stacked = {name: np.array([row[name] for row in self.rows]) for name in self.rows[0]}
        return ModuleRun(
            conditions=self.conditions,
            module=self.module,
            bearings=tuple(self.bearings),
            misses=np.array(self.misses),
            broken=tuple(self.broken),
            lost=lost,
            **stacked,
        )

    def _stand(self, first: StretchLoads) -> None:
        """Everything where the plan begins."""
        data = self.data
        for b, body in enumerate(self.boxes):
            box = self.model.jnt_qposadr[self.model.body_jntadr[body]]
            data.qpos[box : box + 3] = first.stretch.box[0, b]
            half = first.stretch.yaw[0, b] / 2
            data.qpos[box + 3 : box + 7] = np.cos(half), 0.0, 0.0, np.sin(half)
        quat = np.empty(4)
        for m in range(len(self.plan.module_names)):
            points = first.stretch.points[m]
            adr = self.model.jnt_qposadr[self.model.body_jntadr[self.ends[m, 0]]]
            data.qpos[adr : adr + 3] = points.position[0, 0]
            self.mujoco.mju_mat2Quat(quat, points.rotation[0, 0].ravel())
            data.qpos[adr + 3 : adr + 7] = quat
            data.qpos[self.at[m]] = first.stretch.angles[0, m]
        self.mujoco.mj_forward(self.model, data)

    def _switch(self, loads: StretchLoads) -> None:
        """Open what the plan opens, and close what it closes."""
        time = float(loads.stretch.time[0])
        gone = {broken.name for broken in self.broken}
        wanted = {_hold(self.plan, c): c for c in loads.contacts if c.kind != "box"}
        for hold in [hold for hold in self.closed if hold not in wanted]:
            self._open(hold)
        for hold, contact in wanted.items():
            before = self.closed.get(hold)
            if before is not None and before.contact.kind == contact.kind:
                before.contact, self.order = contact, None
            elif contact.name not in gone:
                self._close(hold, contact, loads, time)

    def _open(self, hold: Hold) -> None:
        self.order = None
        self.data.eq_active[self.closed.pop(hold).number] = 0

    def _close(self, hold: Hold, contact: Contact, loads: StretchLoads, time: float) -> None:
        """Weld an end to what it has come to, as it is now."""
        data, number = self.data, self.holds.index(hold)
        link = int(self.ends[hold.module, hold.end])
        own = np.array([0.0, 0.0, self.module.link_lengths[-1] if hold.end else 0.0])
        place = data.xpos[link] + data.xmat[link].reshape(3, 3) @ own
        other = self.model.body(hold.body).id
        turn = data.xmat[other].reshape(3, 3)
        there = turn.T @ (place - data.xpos[other])
        goal = contact.place[0]
        count = len(self.plan.module_names)
        if contact.other >= count:
            b = contact.other - count
            off = goal - loads.stretch.box[0, b]
            missed = there - turned(-loads.stretch.yaw[0, b]) @ off
        elif contact.other != NOBODY:
            tip = self.module.link_lengths[-1] if contact.other_end else 0.0
            missed = there - np.array([0.0, 0.0, tip])
        else:
            missed = place - goal
        miss = float(np.linalg.norm(missed))
        self.misses.append(miss)
        if miss > REACHED:
            words = f"{contact.name} closes {1e3 * miss:.0f} mm off"
            self.broken.append(Broken(contact.name, time, words))
            return
        back, relative = np.empty(4), np.empty(4)
        self.mujoco.mju_negQuat(back, data.xquat[other])
        self.mujoco.mju_mulQuat(relative, back, data.xquat[link])
        self.model.eq_data[number, :3] = own
        self.model.eq_data[number, 3:6] = there
        self.model.eq_data[number, 6:10] = relative
        data.eq_active[number] = 1
        self.closed[hold] = Closed(contact, number, missed, np.zeros(6))
        self.order = None

    def _stretch(self, loads: StretchLoads, watch: Callable[[int, Any, Any], None] | None) -> bool:
        """Steps between two events; whether a box is lost."""
        stretch, data = loads.stretch, self.data
        begin, end = float(stretch.time[0]), float(stretch.time[-1])
        steps = max(int(np.ceil((end - begin) / TIME_STEP - 1e-9)), 1)
        self.model.opt.timestep = (end - begin) / steps
        at = begin + (np.arange(steps) + 1) * self.model.opt.timestep
        angles, rates = _between(stretch.time, stretch.angles, at), stretch.rates
        rates = _between(stretch.time, rates, at)
        torque = _between(stretch.time, loads.torque, at)
        box = _between(stretch.time, stretch.box[:, : len(self.boxes)], at)
        frames = turned(_between(stretch.time, stretch.yaw[:, : len(self.boxes)], at))
        places = [_between(stretch.time, c.place, at) for c in loads.contacts]
        planned = [_between(stretch.time, w, at) for w in loads.wrench]
        given = angles + (DAMPING * rates + torque) / (STIFF * self.conditions.gain)
        numbers = {id(contact): k for k, contact in enumerate(loads.contacts)}
        kept: dict[str, list[tuple[float, Array, Array]]] = {}
        lost = False
        for k in range(steps):
            data.ctrl[:] = given[k].ravel()
            for closed in self.closed.values():
                if closed.contact.other == NOBODY:
                    place = places[numbers[id(closed.contact)]][k]
                    self.model.eq_data[closed.number, 3:6] = place + closed.off
            self.mujoco.mj_step(self.model, data)
            order = self._ordered()
            found = borne(self.model, self.data, order)
            self._break(order, found, float(at[k]))
            off = float(np.linalg.norm(data.xpos[self.boxes] - box[k], axis=1).max())
            lost = not off <= LOST  # NaN as well
            if k % SAMPLE and k + 1 < steps and not lost:
                continue
            for hold, wrench in zip(order.holds, found, strict=True):
                if hold in self.closed:
                    contact = self.closed[hold].contact
                    row = (float(at[k]), planned[numbers[id(contact)]][k], wrench)
                    kept.setdefault(contact.name, []).append(row)
            self._keep(float(at[k]), box[k], frames[k], angles[k], torque[k])
            if watch is not None:
                watch(len(self.rows) - 1, self.model, data)
            if lost:
                break
        kinds = {contact.name: contact.kind for contact in loads.contacts}
        for name, rows in kept.items():
            time, one, other = (np.array(values) for values in zip(*rows, strict=True))
            self.bearings.append(Bearing(name, kinds[name], time, one, other))
        return lost

    def _ordered(self) -> Order:
        """Arrays of what is closed, made where that has changed."""
        if self.order is None:
            self.order = order_of(self.closed, self.root, self.ends, self.module)
        return self.order

    def _break(self, order: Order, found: Array, time: float) -> None:
        """Feel the loads, and let go of what bears too much."""
        order.felt += min(self.model.opt.timestep / SMOOTH, 1.0) * (found - order.felt)
        if self.plan.massless:
            return
        friction = self.plan.friction * self.conditions.friction
        for k, words in too_much(order, self.module, friction):
            hold = order.holds[k]
            name = self.closed[hold].contact.name
            self.broken.append(Broken(name, time, f"{name} {words}"))
            self._open(hold)

    def _keep(self, time: float, box: Array, frames: Array, angles: Array, torque: Array) -> None:
        data = self.data
        off = data.xmat[self.boxes].reshape(-1, 3, 3) @ np.swapaxes(frames, 1, 2)
        cosine = np.clip((np.trace(off, axis1=1, axis2=2) - 1) / 2, -1, 1)
        self.rows.append(
            {
                "time": time,
                "box": data.xpos[self.boxes].copy(),
                "planned_box": box,
                "tilt": np.arccos(cosine),
                "bend": np.abs(data.qpos[self.at] - angles).max(axis=1),
                "torque": data.actuator_force.reshape(-1, JOINTS).copy(),
                "planned_torque": torque,
            }
        )


def _between(time: Array, values: Array, at: Array) -> Array:
    """Values (M, ...) at times (n,), straight between samples."""
    k = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    share = ((at - time[k]) / (time[k + 1] - time[k])).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1 - share) * values[k] + share * values[k + 1])
