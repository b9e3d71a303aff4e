"""Loads of boxes and modules together: at every latch, on the ground, in every joint.

Bodies are modules (each as a whole) and the boxes to deliver. Contacts must exert the force and
moment that the motion of each body requires (`newton_euler.py`). Where contacts are redundant, as
with several arms or legs on one box, loads are shared by weighted least squares in units of their
capacities. A plan within the limits under this sharing is feasible. A plan beyond them might be
feasible under another sharing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.contacts import NOBODY, Contact, find_contacts, group_bodies
from climbplan.limms.check.dense import (
    STEP,
    DenseStretch,
    compute_anchor_pose,
    iterate_stretches,
    order_carriers_first,
)
from climbplan.limms.check.newton_euler import (
    EndMotion,
    InertialLoad,
    compute_demand,
    compute_joint_torques,
    create_rest_motion,
    sum_demand,
)
from climbplan.limms.modules.inertia import build_link_bodies
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.limms.schema.module import ModuleSpec

_REGULARISATION = 1e-9  # relative; the remaining imbalance is reported


@dataclass(frozen=True)
class StretchLoads:
    """Loads between two events at M samples."""

    stretch: DenseStretch
    contacts: tuple[Contact, ...]
    wrench: Array  # (C, M, 6) force and moment on each contact's body, world frame [N, N m]
    torque: Array  # (M, L, 6) [N m]
    imbalance: Array  # (M,) larger of force [N] and moment [N m] without a contact


def compute_loads(plan: LimmsPlan, module: ModuleSpec) -> Iterator[StretchLoads]:
    """Yield the loads of a plan, stretch by stretch."""
    for stretch in iterate_stretches(plan, module):
        yield _compute_stretch_loads(plan, module, stretch)


def _compute_stretch_loads(
    plan: LimmsPlan, module: ModuleSpec, stretch: DenseStretch
) -> StretchLoads:
    """Return the loads of a stretch."""
    count, samples, boxes = len(plan.module_names), len(stretch.time), plan.deliveries
    demands = _compute_demands(plan, module, stretch)
    positions = np.stack(
        [*(p.position[:, 0] for p in stretch.points), *(stretch.box[:, b] for b in range(boxes))]
    )
    needed = np.zeros((count + boxes, samples, 6))
    for m in range(count):
        needed[m, :, :3], needed[m, :, 3:] = sum_demand(demands[m], positions[m])
    for b in range(boxes):
        proper_acceleration = _interpolate_acceleration(plan, stretch, b) + np.array(
            [0.0, 0.0, GRAVITY]
        )
        needed[count + b, :, :3] = plan.box_mass[b] * proper_acceleration
        needed[count + b, :, 5] = inertia_about_vertical(plan, b) * _interpolate_yaw_acceleration(
            plan, stretch, b
        )
    contacts = find_contacts(plan, stretch)
    wrench = np.zeros((len(contacts), samples, 6))
    imbalance = np.zeros(samples)
    for bodies, group_contacts in group_bodies(count + boxes, contacts):
        shared, residual = _share_loads(module, bodies, group_contacts, positions, needed)
        for contact, contact_wrench in zip(group_contacts, shared, strict=True):
            wrench[contacts.index(contact)] = contact_wrench
        imbalance = np.maximum(imbalance, residual)
    torque = np.empty((samples, count, 6))
    for m in range(count):
        end_wrench = _sum_on_last_end(m, contacts, wrench, samples)
        torque[:, m] = compute_joint_torques(
            demands[m], stretch.points[m], end_wrench[:, :3], end_wrench[:, 3:]
        )
    return StretchLoads(stretch, tuple(contacts), wrench, torque, imbalance)


def _share_loads(
    module: ModuleSpec, bodies: list[int], contacts: list[Contact], positions: Array, needed: Array
) -> tuple[Array, Array]:
    """Return wrenches (C, M, 6) of the contacts of some bodies, and the imbalance (M,)."""
    samples = needed.shape[1]
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
            balance[:, row : row + 6, column] = sign * _build_transport(
                contact.place - positions[body]
            )
    right_side = np.concatenate([needed[b] for b in bodies], axis=1)  # (M, 6 bodies)
    weighted = balance * scale**2
    normal = weighted @ np.swapaxes(balance, 1, 2)
    normal += _REGULARISATION * np.eye(size)
    try:
        dual = np.linalg.solve(normal, right_side[..., None])
    except np.linalg.LinAlgError:  # invalid positions: loads are undefined
        dual = np.full_like(right_side[..., None], np.nan)
    solution = (np.swapaxes(weighted, 1, 2) @ dual)[..., 0]
    residual = right_side - (balance @ solution[..., None])[..., 0]
    by_contact = np.moveaxis(solution.reshape(samples, len(contacts), 6), 1, 0)
    return by_contact, np.abs(residual).max(axis=1)


def _build_transport(lever_arm: Array) -> Array:
    """Return matrices (M, 6, 6) that move a wrench from a point back by a lever arm (M, 3)."""
    x, y, z = lever_arm.T
    matrix = np.tile(np.eye(6), (len(lever_arm), 1, 1))
    matrix[:, 3, 1], matrix[:, 3, 2] = -z, y
    matrix[:, 4, 0], matrix[:, 4, 2] = z, -x
    matrix[:, 5, 0], matrix[:, 5, 1] = -y, x
    return matrix


def _sum_on_last_end(m: int, contacts: list[Contact], wrench: Array, samples: int) -> Array:
    """Return force and moment (M, 6) on a module's last end, from its contacts."""
    wrench_on_end = np.zeros((samples, 6))
    for contact, contact_wrench in zip(contacts, wrench, strict=True):
        if contact.body == m and contact.end == 1:
            wrench_on_end += contact_wrench
        if contact.other == m and contact.other_end == 1:
            wrench_on_end -= contact_wrench
    return wrench_on_end


def _compute_demands(
    plan: LimmsPlan, module: ModuleSpec, stretch: DenseStretch
) -> dict[int, InertialLoad]:
    """Return the inertial loads of each module's links, carriers first."""
    motion, first = plan.motion, stretch.first
    count, anchors = len(plan.module_names), len(plan.anchor_names)
    bodies = build_link_bodies(module)
    accelerations = _compute_joint_accelerations(plan, stretch)
    demands: dict[int, InertialLoad] = {}
    for m in order_carriers_first(plan, first):
        anchors_of_ends = (int(motion.base_anchor[first, m]), int(motion.tip_anchor[first, m]))
        ground = int(motion.ground_end[first, m])
        root, root_motion = (
            max(ground, 0),
            _compute_driving_motion(plan, stretch, m, max(ground, 0)),
        )
        for end, anchor in enumerate(anchors_of_ends):
            if 0 <= anchor < 4 * plan.deliveries:
                root, root_motion = end, _compute_motion_on_box(plan, stretch, anchor)
            elif 4 <= anchor < anchors:
                root, root_motion = end, create_rest_motion(len(stretch.time))
                break
            elif anchor >= anchors and (anchor - anchors) // 2 in demands:
                parent, parent_end = divmod(anchor - anchors, 2)
                root, root_motion = end, demands[parent].ends[parent_end]
                break
        demands[m] = compute_demand(
            bodies, stretch.points[m], root, root_motion, stretch.rates[:, m], accelerations[:, m]
        )
    return {m: demands[m] for m in range(count)}


def inertia_about_vertical(plan: LimmsPlan, b: int) -> float:
    """Return the moment of inertia of a homogeneous box about the vertical [kg m^2]."""
    x, y, _ = plan.box_size[b]
    return float(plan.box_mass[b] * (x**2 + y**2) / 12)


def _compute_motion_on_box(plan: LimmsPlan, stretch: DenseStretch, anchor: int) -> EndMotion:
    """Return the motion of an end on a box that moves and turns."""
    b = anchor // 4
    angular_velocity, angular_acceleration = (
        np.zeros((len(stretch.time), 3)),
        np.zeros((len(stretch.time), 3)),
    )
    angular_velocity[:, 2], angular_acceleration[:, 2] = (
        stretch.yaw_rate[:, b],
        _interpolate_yaw_acceleration(plan, stretch, b),
    )
    lever_arm = (
        compute_anchor_pose(plan, anchor, 0, stretch.box, stretch.yaw).position - stretch.box[:, b]
    )
    relative = np.cross(angular_acceleration, lever_arm) + np.cross(
        angular_velocity, np.cross(angular_velocity, lever_arm)
    )
    return EndMotion(
        angular_velocity,
        angular_acceleration,
        _interpolate_acceleration(plan, stretch, b) + relative,
    )


def _interpolate_yaw_acceleration(plan: LimmsPlan, stretch: DenseStretch, b: int) -> Array:
    """Return the yaw acceleration (M,) of a box, linear between samples [rad/s^2]."""
    span = slice(stretch.first, stretch.last + 1)
    values = plan.motion.box_yaw_acceleration[span, b]
    return np.asarray(np.interp(stretch.time, plan.motion.time[span], values))


def _interpolate_acceleration(plan: LimmsPlan, stretch: DenseStretch, b: int) -> Array:
    """Return the acceleration (M, 3) of a box, linear between samples [m/s^2]."""
    span = slice(stretch.first, stretch.last + 1)
    time, values = plan.motion.time[span], plan.motion.box_acceleration[span, b]
    return np.stack([np.interp(stretch.time, time, values[:, i]) for i in range(3)], axis=-1)


def _compute_joint_accelerations(plan: LimmsPlan, stretch: DenseStretch) -> Array:
    """Return joint accelerations (M, L, 6) of the cubics between samples [rad/s^2].

    At a sample the value is the mean of both sides.
    """
    span = slice(stretch.first, stretch.last + 1)
    time = plan.motion.time[span]
    q, v = plan.motion.joint_angles[span], plan.motion.joint_velocity[span]
    h = np.diff(time)[:, None, None]
    chord = np.diff(q, axis=0) / h
    at_begin = (6 * chord - 4 * v[:-1] - 2 * v[1:]) / h
    at_end = (-6 * chord + 2 * v[:-1] + 4 * v[1:]) / h
    at_samples = np.concatenate([at_begin[:1], (at_end[:-1] + at_begin[1:]) / 2, at_end[-1:]])
    k = np.clip(np.searchsorted(time, stretch.time, side="right") - 1, 0, len(time) - 2)
    fraction = ((stretch.time - time[k]) / np.diff(time)[k])[:, None, None]
    inside = (1 - fraction) * at_begin[k] + fraction * at_end[k]
    sample = np.searchsorted(time, stretch.time)
    exact = np.abs(time[np.minimum(sample, len(time) - 1)] - stretch.time) < STEP * 1e-6
    inside[exact] = at_samples[sample[exact]]
    return np.asarray(inside)


def _compute_driving_motion(plan: LimmsPlan, stretch: DenseStretch, m: int, end: int) -> EndMotion:
    """Return the motion of an end on the ground, by second differences of its stored path."""
    span = slice(stretch.first, stretch.last + 1)
    time, path = plan.motion.time[span], plan.motion.joint_position[span, m, 7 * end]
    rest_motion = create_rest_motion(len(stretch.time))
    if len(time) < 3 or np.ptp(path, axis=0).max() < 1e-12:
        return rest_motion
    slope = np.diff(path, axis=0) / np.diff(time)[:, None]
    middle = (time[1:] + time[:-1]) / 2
    second = np.diff(slope, axis=0) / np.diff(middle)[:, None]
    second = np.vstack([second[:1], second, second[-1:]])
    columns = [np.interp(stretch.time, time, second[:, i]) for i in range(3)]
    return rest_motion._replace(acceleration=np.stack(columns, axis=-1))
