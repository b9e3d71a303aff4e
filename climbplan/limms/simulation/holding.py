"""What closed contacts bear in each step, from their constraints, and which bear too much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.check.contacts import Contact
from climbplan.limms.schema.module import ModuleSpec
from climbplan.limms.simulation.model import Hold

_ROWS = 6  # of a weld
_FORCE, _MOMENT = slice(0, 3), slice(3, 6)
_STILL = 0.5  # [N, N m] below which an end that hardly presses is let be


@dataclass
class Closed:
    """A contact that is closed now."""

    contact: Contact
    number: int  # of its weld
    off: Array  # (3,) from where its end was to be to where it closed, on the terrain [m]
    felt: Array  # (6,) smoothed


@dataclass
class Order:
    """What is closed now, as arrays (n, ...): it is looked at in every step."""

    holds: tuple[Hold, ...]
    dof: IntArray  # (n, 6) of the modules' free bodies
    root: IntArray  # (n,) bodies
    link: IntArray  # (n,)
    own: Array  # (n, 1) from the link's frame to the end [m]
    weld: IntArray  # (n,) place among the welds that are active
    is_latch: BoolArray
    felt: Array  # (n, 6) smoothed; rows are those of `Closed`


def order_of(
    closed: Mapping[Hold, Closed], root: IntArray, ends: IntArray, module: ModuleSpec
) -> Order:
    """Arrays of what is closed; root: (L,) first degree of freedom of each module, ends: (L, 2)
    bodies of their end links."""
    each, holds = closed.values(), tuple(closed)
    numbers = np.array([one.number for one in each], int)
    modules, end = np.array([(h.module, h.end) for h in holds], int).reshape(-1, 2).T
    felt = np.array([one.felt for one in each]).reshape(-1, 6)
    for row, one in zip(felt, each, strict=True):
        one.felt = row
    return Order(
        holds=holds,
        dof=root[modules][:, None] + np.arange(6),
        root=ends[modules, 0],
        link=ends[modules, end],
        own=np.where(end == 1, module.link_lengths[-1], 0.0)[:, None],
        weld=np.searchsorted(np.sort(numbers), numbers),
        is_latch=np.array([one.contact.kind == "latch" for one in each], bool),
        felt=felt,
    )


def borne(model: Any, data: Any, order: Order) -> Array:
    """Force and moment (n, 6) on each closed end at its place, from its constraint's rows."""
    welds = int(data.ne) // _ROWS  # rows of equality come first
    jacobian = data.efc_J[: welds * _ROWS * model.nv].reshape(welds, _ROWS, model.nv)
    own = jacobian[order.weld[:, None, None], np.arange(_ROWS)[:, None], order.dof[:, None]]
    force = data.efc_force[: welds * _ROWS].reshape(welds, _ROWS)[order.weld]
    both: Array = (force[:, None] @ own)[:, 0]
    # A free body's speeds: of its origin in the world, of its turning in its own frame
    turning = (data.xmat[order.root].reshape(-1, 3, 3) @ both[:, 3:, None])[..., 0]
    arm = data.xpos[order.link] + order.own * data.xmat[order.link][:, 2::3]
    both[:, 3:] = turning - _cross(arm - data.xpos[order.root], both[:, :3])
    return both


def too_much(order: Order, module: ModuleSpec, friction: float) -> list[tuple[int, str]]:
    """Which contacts do not hold what is felt, by their number, and why not, in words."""
    felt, is_on_ground = order.felt, ~order.is_latch
    force, moment = (np.sqrt((felt[:, part] ** 2).sum(axis=1)) for part in (_FORCE, _MOMENT))
    aside, push = np.hypot(felt[:, 0], felt[:, 1]), np.maximum(felt[:, 2], 0.0)
    held, tilt = module.radius * push + module.ground_moment, np.hypot(felt[:, 3], felt[:, 4])
    pulled = force > module.max_force
    twisted = order.is_latch & (moment > module.latch_moment)
    slid = is_on_ground & (aside > friction * push + _STILL)
    tipped = is_on_ground & (tilt > held + _STILL)
    told = []
    for k in np.flatnonzero(pulled | twisted | slid | tipped):
        if pulled[k]:
            words = f"holds {module.max_force:g} N and bears {force[k]:.3g} N"
        elif twisted[k]:
            words = f"holds {module.latch_moment:g} N m and bears {moment[k]:.3g} N m"
        elif slid[k]:
            words = f"presses with {push[k]:.3g} N and is pushed aside with {aside[k]:.3g} N"
        else:
            words = f"holds {held[k]:.3g} N m and bears {tilt[k]:.3g} N m"
        told.append((int(k), words))
    return told


def _cross(a: Array, b: Array) -> Array:
    """Products (n, 3) of vectors; `np.cross` takes several times as long for so few."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
