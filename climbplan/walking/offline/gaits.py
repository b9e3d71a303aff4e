"""Gaits to start from: what legs do in turn, knot by knot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.leg_order import MIRROR_POINT, alternating, mirror_legs
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.kernels.footing import stance_phases
from climbplan.walking.kernels.regions import best_region, nearest_regions
from climbplan.walking.offline.footing import gait_of
from climbplan.walking.offline.sqp import guessed_states
from climbplan.walking.task.task import POSITION, Gait, WalkTask

GAITS = ("trot", "slow trot", "jump", "walking trot", "pace", "bound", "walk", "stand")


@cache
def steps_of(name: str, legs: int) -> BoolArray:
    """Which legs stand (P, L) in the phases of a named gait, which come round.

    In a trot halves alternate: diagonals of a quadruped, tripods of a hexapod. In a pace sides do,
    in a bound one pair after the other steps, in a walk one leg, those of one half first.
    """
    half = alternating(legs) == 0
    left = np.arange(legs) % 2 == 0
    every = np.ones(legs, bool)
    if name in ("trot", "slow trot", "walking trot"):
        between = {"trot": (), "slow trot": (half,), "walking trot": (every,)}[name]
        again = (~half,) if name == "slow trot" else between
        steps = [half, *between, ~half, *again]
    elif name == "pace":
        steps = [left, ~left]
    elif name == "jump":
        steps = [every, ~every]
    elif name == "bound":
        steps = [np.arange(legs) // 2 != pair for pair in reversed(range(legs // 2))]
    elif name == "walk":
        order = np.argsort(alternating(legs), kind="stable")
        steps = [np.arange(legs) != leg for leg in order]
    else:
        assert name == "stand"
        steps = [every]
    return np.array(steps)


def with_regions(task: WalkTask, contact: BoolArray, state: Array | None = None) -> Gait:
    """A gait with these contacts (N + 1, L), on the regions that feet would best stand on.

    state: (N + 1, 12) the motion to judge that by; an even one to the reference if None.
    """
    region = regions_under(task, state)
    if task.ground.count > 1:
        motion = guessed_states(task) if state is None else state
        region = _within_reach(task, contact, motion, region)
    return gait_of(contact, region)


def regions_under(task: WalkTask, state: Array | None = None) -> IntArray:
    """Regions (N + 1, L) nearest to the middle of the workspace boxes; at knot 0 to the toes."""
    if task.ground.count == 1:
        return np.zeros((task.knots + 1, task.body.leg_count), np.int64)
    motion = guessed_states(task) if state is None else state
    ground, under = task.ground, _under(task, motion)[..., :2]
    points = np.ascontiguousarray(under.reshape(-1, 2))
    nearest = nearest_regions(points, ground.lower, ground.upper, ground.sides)
    region: IntArray = nearest.reshape(under.shape[:-1])
    region[0] = task.ground.nearest(task.start.toes[:, :2])
    return region


def _under(task: WalkTask, motion: Array) -> Array:
    """Middles of the workspace boxes (N + 1, L, 3), world frame."""
    R = rotation_world_body(motion[:, 6:9])
    middle: Array = motion[:, None, :3] + task.body.toe_center @ np.swapaxes(R, -1, -2)
    return middle


def _within_reach(task: WalkTask, contact: BoolArray, motion: Array, region: IntArray) -> IntArray:
    """The same with each stance phase on the region that leaves its boxes least while it lasts.

    Of several that do not leave them the one nearest to the boxes' middles.
    """
    ground, body = task.ground, task.body
    chosen = region.copy()
    lower, upper, sides = ground.footholds
    middle, R = _under(task, motion), rotation_world_body(motion[:, 6:9])
    for leg, first, last in stance_phases(contact)[1]:
        if first == 0:
            continue
        during = np.arange(first, min(last + task.whole_stance, task.knots) + 1)
        wanted = middle[during, leg, :2].mean(axis=0)
        chosen[first, leg] = best_region(
            wanted,
            np.ascontiguousarray(motion[during, POSITION]),
            R[during],
            body.toe_center[leg],
            body.toe_half,
            lower,
            upper,
            sides,
            ground.height,
            ground.slope,
            ground.inner,
        )
    return chosen


def cycle(name: str, legs: int, knots: int, phase: int = 0) -> BoolArray:
    """Contacts (N + 1, L) of a named gait, started at one of its phases."""
    steps = steps_of(name, legs)
    return steps[(np.arange(knots + 1) + phase) % len(steps)]


def braked(contact: BoolArray, knots: int) -> BoolArray:
    """The same with all legs on the ground for the first `knots` knots."""
    result = contact.copy()
    result[:knots] = True
    return result


def starting_gaits(
    task: WalkTask, names: Sequence[str] = GAITS, brakes: Iterable[int] = range(4)
) -> Iterator[Gait]:
    """Named gaits in all their phases that keep the least contacts.

    brakes: knots in which they first brake with all legs.
    """
    seen, legs = set(), task.body.leg_count
    for brake in brakes:
        for name in names:
            for phase in range(len(steps_of(name, legs))):
                contact = braked(cycle(name, legs, task.knots, phase), brake)
                if not enough_contacts(task, contact):
                    continue
                gait = with_regions(task, contact)
                if gait.key not in seen:
                    seen.add(gait.key)
                    yield gait


def enough_contacts(task: WalkTask, contact: BoolArray) -> bool:
    """Every interval has its least number of standing legs."""
    return bool((contact[:-1].sum(axis=1) >= task.least_contacts).all())


def mirrored(gait: Gait) -> Gait:
    """What left legs do is done by right ones."""
    other = mirror_legs(gait.contact.shape[1])
    return Gait(gait.contact[:, other], gait.region[:, other])


def mirror_even(task: WalkTask) -> bool:
    """Left and right are the same in the task: mirrored gaits do equally well."""
    if task.ground.rough:
        return False
    body, reference = task.body, task.reference
    other = mirror_legs(body.leg_count)
    toes = task.start.toes - task.start.state[POSITION]
    aside = np.concatenate(
        [
            task.start.state[[4, 6, 8, 9, 11]],
            reference.velocity[:, 1],
            reference.euler[:, [0, 2]].ravel(),
            (toes - toes[other] * MIRROR_POINT).ravel(),
            (body.toe_center - body.toe_center[other] * MIRROR_POINT).ravel(),
            body.inertia[1, [0, 2]],
        ]
    )
    return bool(np.abs(aside).max() < 1e-9)
