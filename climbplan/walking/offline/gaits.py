"""Gaits to start from: what legs do in turn, knot by knot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.leg_order import MIRROR_POINT, alternating, mirror_legs
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.kernels.contact_phases import find_stance_phases
from climbplan.walking.kernels.foothold_regions import find_nearest_regions, select_region
from climbplan.walking.offline.footing import build_gait
from climbplan.walking.offline.sqp import guess_states
from climbplan.walking.task.task import POSITION, Gait, WalkTask

GAITS = ("trot", "slow trot", "jump", "walking trot", "pace", "bound", "walk", "stand")


@cache
def build_gait_phases(name: str, legs: int) -> BoolArray:
    """Which legs stand (P, L) in the phases of a named gait, which come round.

    In a trot halves alternate: diagonals of a quadruped, tripods of a hexapod. In a pace sides do,
    in a bound one pair after the other steps, in a walk one leg, those of one half first.
    """
    half = alternating(legs) == 0
    left = np.arange(legs) % 2 == 0
    all_legs = np.ones(legs, bool)
    if name in ("trot", "slow trot", "walking trot"):
        between = {"trot": (), "slow trot": (half,), "walking trot": (all_legs,)}[name]
        second_between = (~half,) if name == "slow trot" else between
        phases = [half, *between, ~half, *second_between]
    elif name == "pace":
        phases = [left, ~left]
    elif name == "jump":
        phases = [all_legs, ~all_legs]
    elif name == "bound":
        phases = [np.arange(legs) // 2 != pair for pair in reversed(range(legs // 2))]
    elif name == "walk":
        order = np.argsort(alternating(legs), kind="stable")
        phases = [np.arange(legs) != leg for leg in order]
    else:
        assert name == "stand"
        phases = [all_legs]
    return np.array(phases)


def assign_regions(task: WalkTask, contact: BoolArray, state: Array | None = None) -> Gait:
    """A gait with these contacts (N + 1, L), on the regions that feet would best stand on.

    state: (N + 1, 12) the motion to judge that by; an even one to the reference if None.
    """
    region = find_regions_under(task, state)
    if task.ground.count > 1:
        motion = guess_states(task) if state is None else state
        region = _select_reachable_regions(task, contact, motion, region)
    return build_gait(contact, region)


def find_regions_under(task: WalkTask, state: Array | None = None) -> IntArray:
    """Regions (N + 1, L) nearest to the middle of the workspace boxes; at knot 0 to the toes."""
    if task.ground.count == 1:
        return np.zeros((task.knots + 1, task.body.leg_count), np.int64)
    motion = guess_states(task) if state is None else state
    ground, centers = task.ground, _compute_workspace_centers(task, motion)[..., :2]
    points = np.ascontiguousarray(centers.reshape(-1, 2))
    nearest = find_nearest_regions(points, ground.lower, ground.upper, ground.sides)
    region: IntArray = nearest.reshape(centers.shape[:-1])
    region[0] = task.ground.nearest(task.start.toes[:, :2])
    return region


def _compute_workspace_centers(task: WalkTask, motion: Array) -> Array:
    """Middles of the workspace boxes (N + 1, L, 3), world frame."""
    R = rotation_world_body(motion[:, 6:9])
    middle: Array = motion[:, None, :3] + task.body.toe_center @ np.swapaxes(R, -1, -2)
    return middle


def _select_reachable_regions(task: WalkTask, contact: BoolArray, motion: Array, region: IntArray) -> IntArray:
    """The same with each stance phase on the region that leaves its boxes least while it lasts.

    Of several that do not leave them the one nearest to the boxes' middles.
    """
    ground, body = task.ground, task.body
    chosen = region.copy()
    middle, R = _compute_workspace_centers(task, motion), rotation_world_body(motion[:, 6:9])
    for leg, first, last in find_stance_phases(contact)[1]:
        if first == 0:
            continue
        interval = np.arange(first, min(last + task.workspace_over_stance, task.knots) + 1)
        mean_center = middle[interval, leg, :2].mean(axis=0)
        chosen[first, leg] = select_region(
            mean_center,
            np.ascontiguousarray(motion[interval, POSITION]),
            R[interval],
            body.toe_center[leg],
            body.toe_half,
            ground.foothold_arrays,
        )
    return chosen


def repeat_gait(name: str, legs: int, knots: int, phase: int = 0) -> BoolArray:
    """Contacts (N + 1, L) of a named gait, started at one of its phases."""
    phases = build_gait_phases(name, legs)
    return phases[(np.arange(knots + 1) + phase) % len(phases)]


def prepend_full_stance(contact: BoolArray, knots: int) -> BoolArray:
    """The same with all legs on the ground for the first `knots` knots."""
    result = contact.copy()
    result[:knots] = True
    return result


def generate_initial_gaits(
    task: WalkTask, names: Sequence[str] = GAITS, brakes: Iterable[int] = range(4)
) -> Iterator[Gait]:
    """Named gaits in all their phases that keep the least contacts.

    brakes: knots in which they first brake with all legs.
    """
    yielded_keys, legs = set(), task.body.leg_count
    for brake in brakes:
        for name in names:
            for phase in range(len(build_gait_phases(name, legs))):
                contact = prepend_full_stance(repeat_gait(name, legs, task.knots, phase), brake)
                if not has_enough_contacts(task, contact):
                    continue
                gait = assign_regions(task, contact)
                if gait.key not in yielded_keys:
                    yielded_keys.add(gait.key)
                    yield gait


def has_enough_contacts(task: WalkTask, contact: BoolArray) -> bool:
    """Every interval has its least number of standing legs."""
    return bool((contact[:-1].sum(axis=1) >= task.min_contacts).all())


def mirror_gait(gait: Gait) -> Gait:
    """What left legs do is done by right ones."""
    mirrored = mirror_legs(gait.contact.shape[1])
    return Gait(gait.contact[:, mirrored], gait.region[:, mirrored])


def is_left_right_symmetric(task: WalkTask) -> bool:
    """Left and right are the same in the task: mirrored gaits do equally well."""
    if task.ground.is_rough:
        return False
    body, reference = task.body, task.reference
    mirrored = mirror_legs(body.leg_count)
    toes = task.start.toes - task.start.state[POSITION]
    asymmetry = np.concatenate(
        [
            task.start.state[[4, 6, 8, 9, 11]],
            reference.velocity[:, 1],
            reference.euler[:, [0, 2]].ravel(),
            (toes - toes[mirrored] * MIRROR_POINT).ravel(),
            (body.toe_center - body.toe_center[mirrored] * MIRROR_POINT).ravel(),
            body.inertia[1, [0, 2]],
        ]
    )
    return bool(np.abs(asymmetry).max() < 1e-9)
