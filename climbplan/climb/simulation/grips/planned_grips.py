"""What a plan says its grippers do: which holds they are on, how wrists turn, how fingers grip."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants, true_angles
from climbplan.robots.gripper import wrists_at
from climbplan.robots.last_link import last_link_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.holds import flat_hold
from climbplan.terrain.surfaces import Region

_AHEAD = 0.5  # [s] that fingers grip before load comes and after it has gone


def planned_regions(plan: ClimbPlan) -> IntArray:
    """(T, N) surface that each limb is on, of one in the air the one that it goes to."""
    instant = sample_instants(plan)
    every = np.concatenate([plan.rounds.region[:1], plan.instants.region])[instant + 1]
    stands = np.concatenate([np.ones_like(plan.instants.contact[:1]), plan.instants.contact])
    stands = stands[instant + 1]
    out = every.copy()
    contact = plan.trajectory.contact
    for limb in range(contact.shape[1]):
        following = int(every[-1, limb])
        pieces = np.flatnonzero(np.diff(contact[:, limb].astype(int))) + 1
        edges = [0, *pieces.tolist(), len(contact)]
        for first, last in reversed(list(itertools.pairwise(edges))):
            if contact[first, limb]:
                known = np.flatnonzero(stands[first:last, limb])
                if len(known):
                    following = int(every[first + int(known[0]), limb])
            out[first:last, limb] = following
    return out


def planned_toe(plan: ClimbPlan, sample: int, limb: int) -> Array:
    """(3,) where the plan has a limb stand in the span of contact that a sample begins."""
    instant = sample_instants(plan)
    contact = plan.trajectory.contact[:, limb]
    for s in range(sample, len(contact)):
        if not contact[s]:
            break
        if instant[s] < 0:
            return np.asarray(plan.rounds.toes[0, limb])
        if plan.instants.contact[instant[s], limb]:
            return np.asarray(plan.instants.toes[instant[s], limb])
    return np.asarray(plan.instants.toes[instant[sample], limb])


def planned_wrists(plan: ClimbPlan, region: IntArray) -> tuple[Array, Array]:
    """(T, N, 3) angles of wrists [rad], between two holds on the way from one to the other.

    And the torques that their motors bring [N m].
    """
    assert plan.robot.gripper is not None
    assert plan.grips is not None
    moving, grips = plan.trajectory, plan.grips
    surfaces = plan.terrain.surfaces
    normals = np.array([s.normal if isinstance(s, Region) else np.zeros(3) for s in surfaces])
    axes = np.array([_axis(s) for s in surfaces])
    angles = true_angles(plan, sample_instants(plan))
    rotation = rotation_world_body(moving.rpy)
    link = np.einsum("tab,tnib->tnia", rotation, last_link_body(plan.robot, angles))
    found = wrists_at(link, -normals[region], axes[region])
    aim = found.angles.copy()
    time = moving.time
    for limb in range(region.shape[1]):
        for first, last in spans_of(~moving.contact[:, limb]):
            if first == 0:
                continue
            old = region[first - 1, limb]
            rows = slice(first, last)
            there = link[rows, limb]
            away, across = (np.broadcast_to(x[old], there[:, 0].shape) for x in (-normals, axes))
            from_there = wrists_at(there, away, across).angles
            end = min(last, len(time) - 1)
            share = (time[rows] - time[first]) / max(time[end] - time[first], 1e-9)
            aim[rows, limb] += (1 - share[:, None]) * (from_there - aim[rows, limb])
    arm = -plan.robot.gripper.length * normals[region]
    moment = grips.trajectory.moment + np.cross(arm, grips.trajectory_force)
    # Against what the surface brings
    torque = -np.einsum("tnji,tni->tnj", found.axes, moment)
    return aim, torque


def _axis(surface: Any) -> Array:
    if not isinstance(surface, Region):
        return np.zeros(3)
    return (surface.hold or flat_hold(surface.normal)).axis


def planned_gripping(plan: ClimbPlan, speed: float) -> Array:
    """(T, N) gripping force: the most that is planned within a moment of each sample [N]."""
    assert plan.grips is not None
    moving, grip = plan.trajectory, plan.grips.trajectory.grip
    first = np.searchsorted(moving.time, moving.time - _AHEAD * speed)
    last = np.searchsorted(moving.time, moving.time + _AHEAD * speed, side="right")
    return np.array([grip[a:b].max(axis=0) for a, b in zip(first, last, strict=True)])
