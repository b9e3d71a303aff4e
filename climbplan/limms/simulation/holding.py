"""Loads of closed contacts in each step, from their constraints, and overloads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.check.contacts import Contact
from climbplan.limms.schema.module import ModuleSpec
from climbplan.limms.simulation.model import Weld

_ROWS = 6  # of a weld
_FORCE, _MOMENT = slice(0, 3), slice(3, 6)
_FORCE_TOLERANCE = 0.5  # [N, N m] tolerance for ends that hardly press


@dataclass
class ClosedContact:
    """A contact that is closed now."""

    contact: Contact
    number: int  # of its weld
    offset: Array  # (3,) of its end from the planned position, on the terrain [m]
    filtered: Array  # (6,) low-pass filtered load [N, N m]


@dataclass
class ContactArrays:
    """All closed contacts as arrays (n, ...), for use in every step."""

    holds: tuple[Weld, ...]
    dof: IntArray  # (n, 6) of the modules' free bodies
    root: IntArray  # (n,) bodies
    link: IntArray  # (n,)
    end_offset: Array  # (n, 1) from the link's frame to the end [m]
    weld: IntArray  # (n,) index among the active welds
    is_latch: BoolArray
    filtered: Array  # (n, 6) filtered loads, shared with `ClosedContact`


def build_contact_arrays(
    closed: Mapping[Weld, ClosedContact], root: IntArray, ends: IntArray, module: ModuleSpec
) -> ContactArrays:
    """Build arrays of closed contacts.

    Args:
        closed: The closed contacts.
        root: First degree of freedom of each module (L,).
        ends: Bodies of the end links (L, 2).
        module: The module.
    """
    contacts, holds = closed.values(), tuple(closed)
    numbers = np.array([contact.number for contact in contacts], int)
    modules, end_indices = np.array([(h.module, h.end) for h in holds], int).reshape(-1, 2).T
    filtered = np.array([contact.filtered for contact in contacts]).reshape(-1, 6)
    for row, contact in zip(filtered, contacts, strict=True):
        contact.filtered = row
    return ContactArrays(
        holds=holds,
        dof=root[modules][:, None] + np.arange(6),
        root=ends[modules, 0],
        link=ends[modules, end_indices],
        end_offset=np.where(end_indices == 1, module.link_lengths[-1], 0.0)[:, None],
        weld=np.searchsorted(np.sort(numbers), numbers),
        is_latch=np.array([contact.contact.kind == "latch" for contact in contacts], bool),
        filtered=filtered,
    )


def compute_contact_wrenches(model: Any, data: Any, order: ContactArrays) -> Array:
    """Return force and moment (n, 6) on each closed end, from the rows of its constraint."""
    welds = int(data.ne) // _ROWS  # rows of equality come first
    jacobian = data.efc_J[: welds * _ROWS * model.nv].reshape(welds, _ROWS, model.nv)
    module_jacobian = jacobian[
        order.weld[:, None, None], np.arange(_ROWS)[:, None], order.dof[:, None]
    ]
    force = data.efc_force[: welds * _ROWS].reshape(welds, _ROWS)[order.weld]
    wrench: Array = (force[:, None] @ module_jacobian)[:, 0]
    # Free joints have linear velocities in the world frame, angular ones in the body frame
    world_moment = (data.xmat[order.root].reshape(-1, 3, 3) @ wrench[:, 3:, None])[..., 0]
    lever_arm = data.xpos[order.link] + order.end_offset * data.xmat[order.link][:, 2::3]
    wrench[:, 3:] = world_moment - _cross(lever_arm - data.xpos[order.root], wrench[:, :3])
    return wrench


def find_overloads(
    order: ContactArrays, module: ModuleSpec, friction: float
) -> list[tuple[int, str]]:
    """Return the indices of overloaded contacts, each with a message."""
    filtered, is_on_ground = order.filtered, ~order.is_latch
    force, moment = (
        np.sqrt((filtered[:, components] ** 2).sum(axis=1)) for components in (_FORCE, _MOMENT)
    )
    tangential, normal_force = (
        np.hypot(filtered[:, 0], filtered[:, 1]),
        np.maximum(filtered[:, 2], 0.0),
    )
    tilt_capacity, tilt = (
        module.radius * normal_force + module.ground_moment,
        np.hypot(filtered[:, 3], filtered[:, 4]),
    )
    is_pulled = force > module.max_force
    is_twisted = order.is_latch & (moment > module.latch_moment)
    has_slid = is_on_ground & (tangential > friction * normal_force + _FORCE_TOLERANCE)
    has_tipped = is_on_ground & (tilt > tilt_capacity + _FORCE_TOLERANCE)
    overloads = []
    for k in np.flatnonzero(is_pulled | is_twisted | has_slid | has_tipped):
        if is_pulled[k]:
            message = f"holds {module.max_force:g} N and bears {force[k]:.3g} N"
        elif is_twisted[k]:
            message = f"holds {module.latch_moment:g} N m and bears {moment[k]:.3g} N m"
        elif has_slid[k]:
            message = (
                f"presses with {normal_force[k]:.3g} N and is pushed aside with "
                f"{tangential[k]:.3g} N"
            )
        else:
            message = f"holds {tilt_capacity[k]:.3g} N m and bears {tilt[k]:.3g} N m"
        overloads.append((int(k), message))
    return overloads


def _cross(a: Array, b: Array) -> Array:
    """Return cross products (n, 3) of vectors; faster than `np.cross` for few rows."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
