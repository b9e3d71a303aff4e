"""Simulation of modules in MuJoCo: servos follow the plan; latches close, open and break.

Servos get the planned angles and speeds, with the torques that the plan's checker computes as
feed-forward. A latch closes where its end is when the plan closes it, unless that is too far off.
Its load is read from its constraint. With masses, a latch breaks under more than its capacity, and
an end on the ground detaches when it is pulled, pushed sideways or tipped. Without masses nothing
breaks, since the plan ignores the capacity of hardware.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.contacts import NOBODY, Contact
from climbplan.limms.check.kinematics import compute_yaw_rotation
from climbplan.limms.check.loads import StretchLoads, compute_loads
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import JOINTS, ModuleSpec
from climbplan.limms.simulation.holding import (
    ClosedContact,
    ContactArrays,
    build_contact_arrays,
    compute_contact_wrenches,
    find_overloads,
)
from climbplan.limms.simulation.model import (
    DAMPING,
    STIFFNESS,
    TIME_STEP,
    Weld,
    box_name,
    build_mjcf,
    build_simulated_module,
    end_link,
    link_name,
)
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.mujoco_loading import load_mujoco

SAMPLE_STEPS = 20  # steps between recorded samples
MAX_MISS = 0.02  # [m]; an end further from its anchor does not latch
MAX_BOX_ERROR = 0.15  # [m]; a box further from its plan is lost
FILTER_TIME = 0.01  # [s], time constant of the load filter before something breaks


@dataclass(frozen=True)
class Bearing:
    """Loads of one contact while it is closed, planned and simulated (S samples)."""

    name: str
    kind: str  # "latch", "ground"
    time: Array  # (S,) [s]
    planned: Array  # (S, 6) force and moment on the module's end, world frame [N, N m]
    found: Array  # (S, 6)


@dataclass(frozen=True)
class Broken:
    """A contact that broke or did not close."""

    name: str
    time: float  # [s]
    words: str


@dataclass(frozen=True)
class ModuleRun:
    """The result of a run (S samples, up to the end or the loss of a box)."""

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
    """Simulate a plan.

    Args:
        plan: The plan.
        conditions: Physical conditions.
        progress: Receives the fraction of time simulated.
        watch: Called with number, model and data at every recorded sample, for pictures.

    Raises:
        MissingSolver: MuJoCo is not installed.
    """
    mujoco = load_mujoco()
    module = build_simulated_module(plan)
    loads = list(compute_loads(plan, module))
    welds = sorted(
        {
            _find_weld(plan, c)
            for stretch_loads in loads
            for c in stretch_loads.contacts
            if c.kind != "box"
        }
    )
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, module, welds, conditions))
    simulation = _ModuleSimulation(
        mujoco,
        model,
        mujoco.MjData(model),
        plan=plan,
        module=module,
        conditions=conditions,
        holds=tuple(welds),
    )
    return simulation.play(loads, progress, watch)


def _find_weld(plan: LimmsPlan, contact: Contact) -> Weld:
    """Return the weld of a contact."""
    body, count = "world", len(plan.module_names)
    if contact.other >= count:
        body = box_name(contact.other - count)
    elif contact.other != NOBODY:
        body = link_name(contact.other, end_link(contact.other_end))
    return Weld(contact.body, contact.end, body)


class _ModuleSimulation:
    """The simulation of a plan."""

    def __init__(
        self,
        mujoco: ModuleType,
        model: Any,
        data: Any,
        *,
        plan: LimmsPlan,
        module: ModuleSpec,
        conditions: Conditions,
        holds: tuple[Weld, ...],
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
        self.joint_addresses = np.array([[joint.qposadr[0] for joint in row] for row in joints])
        self.closed: dict[Weld, ClosedContact] = {}
        self.arrays: ContactArrays | None = None  # of what is closed, None where that has changed
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
        """Simulate all stretches."""
        self._set_initial_state(loads[0])
        duration = float(self.plan.motion.time[-1])
        lost = False
        for stretch_loads in loads:
            self._switch_contacts(stretch_loads)
            lost = self._run_stretch(stretch_loads, watch)
            if progress is not None:
                progress(float(stretch_loads.stretch.time[-1]) / duration)
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

    def _set_initial_state(self, first: StretchLoads) -> None:
        """Set everything to the start of the plan."""
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
            data.qpos[self.joint_addresses[m]] = first.stretch.angles[0, m]
        self.mujoco.mj_forward(self.model, data)

    def _switch_contacts(self, loads: StretchLoads) -> None:
        """Open and close contacts as planned."""
        time = float(loads.stretch.time[0])
        broken_names = {broken.name for broken in self.broken}
        planned = {_find_weld(self.plan, c): c for c in loads.contacts if c.kind != "box"}
        for hold in [hold for hold in self.closed if hold not in planned]:
            self._open(hold)
        for hold, contact in planned.items():
            current = self.closed.get(hold)
            if current is not None and current.contact.kind == contact.kind:
                current.contact, self.arrays = contact, None
            elif contact.name not in broken_names:
                self._close(hold, contact, loads, time)

    def _open(self, hold: Weld) -> None:
        """Open a contact."""
        self.arrays = None
        self.data.eq_active[self.closed.pop(hold).number] = 0

    def _close(self, hold: Weld, contact: Contact, loads: StretchLoads, time: float) -> None:
        """Weld an end to its body at the current relative pose, unless it is too far off."""
        data, number = self.data, self.holds.index(hold)
        link = int(self.ends[hold.module, hold.end])
        end_offset = np.array([0.0, 0.0, self.module.link_lengths[-1] if hold.end else 0.0])
        position = data.xpos[link] + data.xmat[link].reshape(3, 3) @ end_offset
        body = self.model.body(hold.body).id
        body_rotation = data.xmat[body].reshape(3, 3)
        local_position = body_rotation.T @ (position - data.xpos[body])
        goal = contact.place[0]
        count = len(self.plan.module_names)
        if contact.other >= count:
            b = contact.other - count
            offset = goal - loads.stretch.box[0, b]
            miss_vector = local_position - compute_yaw_rotation(-loads.stretch.yaw[0, b]) @ offset
        elif contact.other != NOBODY:
            tip = self.module.link_lengths[-1] if contact.other_end else 0.0
            miss_vector = local_position - np.array([0.0, 0.0, tip])
        else:
            miss_vector = position - goal
        miss = float(np.linalg.norm(miss_vector))
        self.misses.append(miss)
        if miss > MAX_MISS:
            message = f"{contact.name} closes {1e3 * miss:.0f} mm off"
            self.broken.append(Broken(contact.name, time, message))
            return
        back, relative = np.empty(4), np.empty(4)
        self.mujoco.mju_negQuat(back, data.xquat[body])
        self.mujoco.mju_mulQuat(relative, back, data.xquat[link])
        self.model.eq_data[number, :3] = end_offset
        self.model.eq_data[number, 3:6] = local_position
        self.model.eq_data[number, 6:10] = relative
        data.eq_active[number] = 1
        self.closed[hold] = ClosedContact(contact, number, miss_vector, np.zeros(6))
        self.arrays = None

    def _run_stretch(
        self, loads: StretchLoads, watch: Callable[[int, Any, Any], None] | None
    ) -> bool:
        """Simulate the steps between two events, and return whether a box is lost."""
        stretch, data = loads.stretch, self.data
        start, end = float(stretch.time[0]), float(stretch.time[-1])
        steps = max(int(np.ceil((end - start) / TIME_STEP - 1e-9)), 1)
        self.model.opt.timestep = (end - start) / steps
        times = start + (np.arange(steps) + 1) * self.model.opt.timestep
        angles, rates = _interpolate(stretch.time, stretch.angles, times), stretch.rates
        rates = _interpolate(stretch.time, rates, times)
        torque = _interpolate(stretch.time, loads.torque, times)
        box = _interpolate(stretch.time, stretch.box[:, : len(self.boxes)], times)
        frames = compute_yaw_rotation(
            _interpolate(stretch.time, stretch.yaw[:, : len(self.boxes)], times)
        )
        places = [_interpolate(stretch.time, c.place, times) for c in loads.contacts]
        planned = [_interpolate(stretch.time, w, times) for w in loads.wrench]
        commands = angles + (DAMPING * rates + torque) / (STIFFNESS * self.conditions.gain)
        numbers = {id(contact): k for k, contact in enumerate(loads.contacts)}
        rows_by_contact: dict[str, list[tuple[float, Array, Array]]] = {}
        lost = False
        for k in range(steps):
            data.ctrl[:] = commands[k].ravel()
            for closed in self.closed.values():
                if closed.contact.other == NOBODY:
                    place = places[numbers[id(closed.contact)]][k]
                    self.model.eq_data[closed.number, 3:6] = place + closed.offset
            self.mujoco.mj_step(self.model, data)
            arrays = self._update_arrays()
            wrenches = compute_contact_wrenches(self.model, self.data, arrays)
            self._break_overloads(arrays, wrenches, float(times[k]))
            box_error = float(np.linalg.norm(data.xpos[self.boxes] - box[k], axis=1).max())
            lost = not box_error <= MAX_BOX_ERROR  # NaN as well
            if k % SAMPLE_STEPS and k + 1 < steps and not lost:
                continue
            for hold, wrench in zip(arrays.holds, wrenches, strict=True):
                if hold in self.closed:
                    contact = self.closed[hold].contact
                    row = (float(times[k]), planned[numbers[id(contact)]][k], wrench)
                    rows_by_contact.setdefault(contact.name, []).append(row)
            self._record(float(times[k]), box[k], frames[k], angles[k], torque[k])
            if watch is not None:
                watch(len(self.rows) - 1, self.model, data)
            if lost:
                break
        kinds = {contact.name: contact.kind for contact in loads.contacts}
        for name, rows in rows_by_contact.items():
            time, planned_rows, simulated_rows = (
                np.array(values) for values in zip(*rows, strict=True)
            )
            self.bearings.append(Bearing(name, kinds[name], time, planned_rows, simulated_rows))
        return lost

    def _update_arrays(self) -> ContactArrays:
        """Return arrays of closed contacts, rebuilt after changes."""
        if self.arrays is None:
            self.arrays = build_contact_arrays(self.closed, self.root, self.ends, self.module)
        return self.arrays

    def _break_overloads(self, arrays: ContactArrays, wrenches: Array, time: float) -> None:
        """Filter the loads, and open overloaded contacts."""
        arrays.filtered += min(self.model.opt.timestep / FILTER_TIME, 1.0) * (
            wrenches - arrays.filtered
        )
        if self.plan.massless:
            return
        friction = self.plan.friction * self.conditions.friction
        for k, message in find_overloads(arrays, self.module, friction):
            hold = arrays.holds[k]
            name = self.closed[hold].contact.name
            self.broken.append(Broken(name, time, f"{name} {message}"))
            self._open(hold)

    def _record(self, time: float, box: Array, frames: Array, angles: Array, torque: Array) -> None:
        """Record a sample."""
        data = self.data
        rotation_error = data.xmat[self.boxes].reshape(-1, 3, 3) @ np.swapaxes(frames, 1, 2)
        cosine = np.clip((np.trace(rotation_error, axis1=1, axis2=2) - 1) / 2, -1, 1)
        self.rows.append(
            {
                "time": time,
                "box": data.xpos[self.boxes].copy(),
                "planned_box": box,
                "tilt": np.arccos(cosine),
                "bend": np.abs(data.qpos[self.joint_addresses] - angles).max(axis=1),
                "torque": data.actuator_force.reshape(-1, JOINTS).copy(),
                "planned_torque": torque,
            }
        )


def _interpolate(time: Array, values: Array, times: Array) -> Array:
    """Return values (M, ...) at times (n,), linear between samples."""
    k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, len(time) - 2)
    fraction = ((times - time[k]) / (time[k + 1] - time[k])).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1 - fraction) * values[k] + fraction * values[k + 1])
