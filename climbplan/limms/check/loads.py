"""Loads of box and modules together: at every latch, on the ground, in every joint.

Bodies are modules (each as a whole) and the boxes to deliver. Each must get the force and moment
that its motion asks for (`newton_euler.py`) from its contacts. Where these leave a choice, as
several arms or legs on one box do, loads are shared least-squares in units of what contacts hold.
A plan that keeps the limits with that sharing keeps them; one that does not might with another.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.contacts import NOBODY, Contact, contacts_of, islands
from climbplan.limms.check.dense import (
    STEP,
    Stretch,
    anchor_pose,
    carriers_first,
    stretches,
)
from climbplan.limms.check.newton_euler import (
    Demand,
    EndMotion,
    at_rest,
    demand,
    joint_torques,
    total,
)
from climbplan.limms.modules.inertia import link_bodies
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.limms.schema.module import ModuleSpec

_SLACK = 1e-9  # part of the scale with which nobody may help: what is left over is told


@dataclass(frozen=True)
class StretchLoads:
    """Loads between two events, M samples."""

    stretch: Stretch
    contacts: tuple[Contact, ...]
    wrench: Array  # (C, M, 6) force and moment on each contact's body, world frame [N, N m]
    torque: Array  # (M, L, 6) [N m]
    unheld: Array  # (M,) force [N] and moment [N m], the larger, that nothing gives


def loads_of_all(plan: LimmsPlan, module: ModuleSpec) -> Iterator[StretchLoads]:
    """Loads of a plan, stretch by stretch."""
    for stretch in stretches(plan, module):
        yield _stretch_loads(plan, module, stretch)


def _stretch_loads(plan: LimmsPlan, module: ModuleSpec, stretch: Stretch) -> StretchLoads:
    count, samples, boxes = len(plan.module_names), len(stretch.time), plan.deliveries
    needs = _demands(plan, module, stretch)
    places = np.stack(
        [*(p.position[:, 0] for p in stretch.points), *(stretch.box[:, b] for b in range(boxes))]
    )
    wanted = np.zeros((count + boxes, samples, 6))
    for m in range(count):
        wanted[m, :, :3], wanted[m, :, 3:] = total(needs[m], places[m])
    for b in range(boxes):
        rise = _box_acceleration(plan, stretch, b) + np.array([0.0, 0.0, GRAVITY])
        wanted[count + b, :, :3] = plan.box_mass[b] * rise
        wanted[count + b, :, 5] = inertia_about_vertical(plan, b) * _turning(plan, stretch, b)
    contacts = contacts_of(plan, stretch)
    wrench = np.zeros((len(contacts), samples, 6))
    unheld = np.zeros(samples)
    for bodies, own in islands(count + boxes, contacts):
        shared, left = _share(module, bodies, own, places, wanted)
        for contact, part in zip(own, shared, strict=True):
            wrench[contacts.index(contact)] = part
        unheld = np.maximum(unheld, left)
    torque = np.empty((samples, count, 6))
    for m in range(count):
        at_end = _on_last_end(m, contacts, wrench, samples)
        torque[:, m] = joint_torques(needs[m], stretch.points[m], at_end[:, :3], at_end[:, 3:])
    return StretchLoads(stretch, tuple(contacts), wrench, torque, unheld)


def _share(
    module: ModuleSpec, bodies: list[int], contacts: list[Contact], places: Array, wanted: Array
) -> tuple[Array, Array]:
    """Wrenches (C, M, 6) of contacts that hold on to `bodies`, and what is left (M,)."""
    samples = wanted.shape[1]
    size = 6 * len(bodies)
    balance = np.zeros((samples, size, 6 * len(contacts)))
    scale = np.ones(6 * len(contacts))
    for c, contact in enumerate(contacts):
        column = slice(6 * c, 6 * c + 6)
        scale[column] = contact.scale(module)
        for body, sign in ((contact.body, 1.0), (contact.other, -1.0)):
            if body == NOBODY:
                continue
            row = 6 * bodies.index(body)
            balance[:, row : row + 6, column] = sign * _moved(contact.place - places[body])
    needed = np.concatenate([wanted[b] for b in bodies], axis=1)  # (M, 6 bodies)
    weighted = balance * scale**2
    normal = weighted @ np.swapaxes(balance, 1, 2)
    normal += _SLACK * np.eye(size)
    try:
        dual = np.linalg.solve(normal, needed[..., None])
    except np.linalg.LinAlgError:  # absurd places: nothing of it is held
        dual = np.full_like(needed[..., None], np.nan)
    answer = (np.swapaxes(weighted, 1, 2) @ dual)[..., 0]
    left = needed - (balance @ answer[..., None])[..., 0]
    by_contact = np.moveaxis(answer.reshape(samples, len(contacts), 6), 1, 0)
    return by_contact, np.abs(left).max(axis=1)


def _moved(arm: Array) -> Array:
    """(M, 6, 6): force and moment at a point as force and moment at one `arm` (M, 3) before it."""
    x, y, z = arm.T
    matrix = np.tile(np.eye(6), (len(arm), 1, 1))
    matrix[:, 3, 1], matrix[:, 3, 2] = -z, y
    matrix[:, 4, 0], matrix[:, 4, 2] = z, -x
    matrix[:, 5, 0], matrix[:, 5, 1] = -y, x
    return matrix


def _on_last_end(m: int, contacts: list[Contact], wrench: Array, samples: int) -> Array:
    """Force and moment (M, 6) on a module's last end, of what holds it and of what it carries."""
    found = np.zeros((samples, 6))
    for contact, each in zip(contacts, wrench, strict=True):
        if contact.body == m and contact.end == 1:
            found += each
        if contact.other == m and contact.other_end == 1:
            found -= each
    return found


def _demands(plan: LimmsPlan, module: ModuleSpec, stretch: Stretch) -> dict[int, Demand]:
    """What each module's links ask for, those that carry others first."""
    motion, first = plan.motion, stretch.first
    count, anchors = len(plan.module_names), len(plan.anchor_names)
    bodies = link_bodies(module)
    turns = _accelerations(plan, stretch)
    found: dict[int, Demand] = {}
    for m in carriers_first(plan, first):
        held = (int(motion.base_anchor[first, m]), int(motion.tip_anchor[first, m]))
        ground = int(motion.ground_end[first, m])
        root, moved = max(ground, 0), _driven(plan, stretch, m, max(ground, 0))
        for end, anchor in enumerate(held):
            if 0 <= anchor < 4 * plan.deliveries:
                root, moved = end, _on_box(plan, stretch, anchor)
            elif 4 <= anchor < anchors:
                root, moved = end, at_rest(len(stretch.time))
                break
            elif anchor >= anchors and (anchor - anchors) // 2 in found:
                parent, its_end = divmod(anchor - anchors, 2)
                root, moved = end, found[parent].ends[its_end]
                break
        found[m] = demand(bodies, stretch.points[m], root, moved, stretch.rates[:, m], turns[:, m])
    return {m: found[m] for m in range(count)}


def inertia_about_vertical(plan: LimmsPlan, b: int) -> float:
    """Moment of inertia of a box, as heavy all through, about the vertical [kg m^2]."""
    x, y, _ = plan.box_size[b]
    return float(plan.box_mass[b] * (x**2 + y**2) / 12)


def _on_box(plan: LimmsPlan, stretch: Stretch, anchor: int) -> EndMotion:
    """How an end on a box moves that moves and turns."""
    b = anchor // 4
    spin, spin_rate = np.zeros((len(stretch.time), 3)), np.zeros((len(stretch.time), 3))
    spin[:, 2], spin_rate[:, 2] = stretch.yaw_rate[:, b], _turning(plan, stretch, b)
    arm = anchor_pose(plan, anchor, 0, stretch.box, stretch.yaw).position - stretch.box[:, b]
    carried = np.cross(spin_rate, arm) + np.cross(spin, np.cross(spin, arm))
    return EndMotion(spin, spin_rate, _box_acceleration(plan, stretch, b) + carried)


def _turning(plan: LimmsPlan, stretch: Stretch, b: int) -> Array:
    """(M,) yaw accelerations of a box: linear between samples, as stored [rad/s^2]."""
    span = slice(stretch.first, stretch.last + 1)
    values = plan.motion.box_yaw_acceleration[span, b]
    return np.asarray(np.interp(stretch.time, plan.motion.time[span], values))


def _box_acceleration(plan: LimmsPlan, stretch: Stretch, b: int) -> Array:
    """(M, 3) of a box to deliver: linear between samples, as stored."""
    span = slice(stretch.first, stretch.last + 1)
    time, values = plan.motion.time[span], plan.motion.box_acceleration[span, b]
    return np.stack([np.interp(stretch.time, time, values[:, i]) for i in range(3)], axis=-1)


def _accelerations(plan: LimmsPlan, stretch: Stretch) -> Array:
    """(M, L, 6) joint accelerations of the cubics between samples [rad/s^2].

    Between two samples those of their cubic; at a sample the mean of both sides.
    """
    span = slice(stretch.first, stretch.last + 1)
    time = plan.motion.time[span]
    q, v = plan.motion.joint_angles[span], plan.motion.joint_velocity[span]
    h = np.diff(time)[:, None, None]
    chord = np.diff(q, axis=0) / h
    begin = (6 * chord - 4 * v[:-1] - 2 * v[1:]) / h
    end = (-6 * chord + 2 * v[:-1] + 4 * v[1:]) / h
    at = np.concatenate([begin[:1], (end[:-1] + begin[1:]) / 2, end[-1:]])
    k = np.clip(np.searchsorted(time, stretch.time, side="right") - 1, 0, len(time) - 2)
    share = ((stretch.time - time[k]) / np.diff(time)[k])[:, None, None]
    inside = (1 - share) * begin[k] + share * end[k]
    sample = np.searchsorted(time, stretch.time)
    exact = np.abs(time[np.minimum(sample, len(time) - 1)] - stretch.time) < STEP * 1e-6
    inside[exact] = at[sample[exact]]
    return np.asarray(inside)


def _driven(plan: LimmsPlan, stretch: Stretch, m: int, end: int) -> EndMotion:
    """How an end on the ground moves: the second differences of its stored way."""
    span = slice(stretch.first, stretch.last + 1)
    time, path = plan.motion.time[span], plan.motion.joint_position[span, m, 7 * end]
    still = at_rest(len(stretch.time))
    if len(time) < 3 or np.ptp(path, axis=0).max() < 1e-12:
        return still
    slope = np.diff(path, axis=0) / np.diff(time)[:, None]
    middle = (time[1:] + time[:-1]) / 2
    second = np.diff(slope, axis=0) / np.diff(middle)[:, None]
    second = np.vstack([second[:1], second, second[-1:]])
    values = [np.interp(stretch.time, time, second[:, i]) for i in range(3)]
    return still._replace(acceleration=np.stack(values, axis=-1))
