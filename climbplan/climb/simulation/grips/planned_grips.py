"""The planned actions of grippers: their holds, wrist angles and gripping forces."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.robots.gripper import wrists_at
from climbplan.robots.last_link import last_link_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.holds import flat_hold
from climbplan.terrain.surfaces import Region

_GRIP_LEAD = 0.5  # [s] that fingers grip before load comes and after it has gone


def find_planned_regions(plan: ClimbPlan) -> IntArray:
    """Find the surface (T, N) that each limb is on; in the air the one of its next contact."""
    instant = sample_instants(plan)
    region_at_sample = np.concatenate([plan.rounds.region[:1], plan.instants.region])[instant + 1]
    in_contact = np.concatenate([np.ones_like(plan.instants.contact[:1]), plan.instants.contact])
    in_contact = in_contact[instant + 1]
    regions = region_at_sample.copy()
    contact = plan.trajectory.contact
    for limb in range(contact.shape[1]):
        following = int(region_at_sample[-1, limb])
        pieces = np.flatnonzero(np.diff(contact[:, limb].astype(int))) + 1
        edges = [0, *pieces.tolist(), len(contact)]
        for first, last in reversed(list(itertools.pairwise(edges))):
            if contact[first, limb]:
                standing = np.flatnonzero(in_contact[first:last, limb])
                if len(standing):
                    following = int(region_at_sample[first + int(standing[0]), limb])
            regions[first:last, limb] = following
    return regions


def find_planned_toe(plan: ClimbPlan, sample: int, limb: int) -> Array:
    """Find the planned toe (3,) of a limb in the contact phase that begins at a sample [m]."""
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


def plan_wrists(plan: ClimbPlan, region: IntArray) -> tuple[Array, Array]:
    """Plan wrist angles (T, N, 3) [rad] and motor torques (T, N, 3) [N m].

    During a swing the angles are interpolated between those at the two holds.
    """
    assert plan.robot.gripper is not None
    assert plan.grips is not None
    trajectory, grips = plan.trajectory, plan.grips
    surfaces = plan.terrain.surfaces
    normals = np.array([s.normal if isinstance(s, Region) else np.zeros(3) for s in surfaces])
    axes = np.array([_get_closing_axis(s) for s in surfaces])
    angles = compute_true_angles(plan, sample_instants(plan))
    rotation = rotation_world_body(trajectory.rpy)
    link = np.einsum("tab,tnib->tnia", rotation, last_link_body(plan.robot, angles))
    wrists = wrists_at(link, -normals[region], axes[region])
    angles_out = wrists.angles.copy()
    time = trajectory.time
    for limb in range(region.shape[1]):
        for first, last in spans_of(~trajectory.contact[:, limb]):
            if first == 0:
                continue
            previous_region = region[first - 1, limb]
            rows = slice(first, last)
            last_link = link[rows, limb]
            approach, closing = (
                np.broadcast_to(x[previous_region], last_link[:, 0].shape) for x in (-normals, axes)
            )
            angles_at_previous = wrists_at(last_link, approach, closing).angles
            end = min(last, len(time) - 1)
            fraction = (time[rows] - time[first]) / max(time[end] - time[first], 1e-9)
            angles_out[rows, limb] += (1 - fraction[:, None]) * (
                angles_at_previous - angles_out[rows, limb]
            )
    arm = -plan.robot.gripper.length * normals[region]
    moment = grips.trajectory.moment + np.cross(arm, grips.trajectory_force)
    # Opposite to the moment that the surface exerts
    torque = -np.einsum("tnji,tni->tnj", wrists.axes, moment)
    return angles_out, torque


def _get_closing_axis(surface: Any) -> Array:
    if not isinstance(surface, Region):
        return np.zeros(3)
    return (surface.hold or flat_hold(surface.normal)).axis


def compute_gripping_force(plan: ClimbPlan, speed: float) -> Array:
    """Compute gripping forces (T, N): the largest planned within _GRIP_LEAD of a sample [N]."""
    assert plan.grips is not None
    trajectory, grip = plan.trajectory, plan.grips.trajectory.grip
    first = np.searchsorted(trajectory.time, trajectory.time - _GRIP_LEAD * speed)
    last = np.searchsorted(trajectory.time, trajectory.time + _GRIP_LEAD * speed, side="right")
    return np.array([grip[a:b].max(axis=0) for a, b in zip(first, last, strict=True)])
