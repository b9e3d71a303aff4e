"""Named gaits that a search or an NLP starts from, and their regions."""

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
    """Return which legs stand (P, L) in each phase of a named, cyclic gait.

    In a trot halves alternate: diagonals of a quadruped, tripods of a hexapod. In a pace left and
    right alternate. In a bound one pair steps after the other; in a walk one leg does, those of one
    half first.

    Args:
        name: One of `GAITS`.
        legs: Number of legs.
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
    """Return the gait with these contacts on the regions that suit its workspace boxes best.

    Args:
        task: The task.
        contact: Contacts (N + 1, L).
        state: Motion (N + 1, 12) that decides where boxes are; None: an even one to the reference.
    """
    region = find_regions_under(task, state)
    if task.ground.count > 1:
        motion = guess_states(task) if state is None else state
        region = _select_reachable_regions(task, contact, motion, region)
    return build_gait(contact, region)


def find_regions_under(task: WalkTask, state: Array | None = None) -> IntArray:
    """Return the regions (N + 1, L) nearest to the middles of the boxes; at knot 0 to the toes.

    Args:
        task: The task.
        state: Motion (N + 1, 12); None: an even one to the reference.
    """
    if task.ground.count == 1:
        return np.zeros((task.knots + 1, task.body.leg_count), np.int64)
    motion = guess_states(task) if state is None else state
    ground, centers = task.ground, _compute_workspace_centers(task, motion)[..., :2]
    points = np.ascontiguousarray(centers.reshape(-1, 2))
    nearest = find_nearest_regions(points, ground.lower, ground.upper, ground.sides)
    region: IntArray = nearest.reshape(centers.shape[:-1])
    for leg in range(task.body.leg_count if ground.allowed.size else 0):
        regions_of_leg = ground.list_regions(leg)
        places = np.ascontiguousarray(centers[:, leg])
        shapes = (values[regions_of_leg] for values in (ground.lower, ground.upper, ground.sides))
        region[:, leg] = regions_of_leg[find_nearest_regions(places, *shapes)]
    region[0] = ground.find_start_regions(task.start.toes[:, :2])
    return region


def _compute_workspace_centers(task: WalkTask, motion: Array) -> Array:
    """Return the middles of the workspace boxes (N + 1, L, 3), world frame [m]."""
    R = rotation_world_body(motion[:, 6:9])
    middle: Array = motion[:, None, :3] + task.body.toe_center @ np.swapaxes(R, -1, -2)
    return middle


def _select_reachable_regions(
    task: WalkTask, contact: BoolArray, motion: Array, region: IntArray
) -> IntArray:
    """Return regions (N + 1, L), each stance phase on the one that its toe can reach for longest.

    Of several regions that stay within the boxes it is the one nearest to the boxes' middles.
    """
    ground, body = task.ground, task.body
    chosen = region.copy()
    middle, R = _compute_workspace_centers(task, motion), rotation_world_body(motion[:, 6:9])
    for leg, first, last in find_stance_phases(contact)[1]:
        if first == 0:
            continue
        interval = np.arange(first, min(last + task.workspace_over_stance, task.knots) + 1)
        mean_center = middle[interval, leg, :2].mean(axis=0)
        footholds = ground.foothold_arrays
        if ground.allowed.size:
            footholds = ground.leg_foothold_arrays[leg]
        nearest = select_region(
            mean_center,
            np.ascontiguousarray(motion[interval, POSITION]),
            R[interval],
            body.toe_center[leg],
            body.toe_half,
            footholds,
        )
        chosen[first, leg] = ground.list_regions(leg)[nearest] if ground.allowed.size else nearest
    return chosen


def repeat_gait(name: str, legs: int, knots: int, phase: int = 0) -> BoolArray:
    """Return contacts (N + 1, L) of a named gait, started at one of its phases."""
    phases = build_gait_phases(name, legs)
    return phases[(np.arange(knots + 1) + phase) % len(phases)]


def prepend_full_stance(contact: BoolArray, knots: int) -> BoolArray:
    """Return the contacts with all legs on the ground at the first `knots` knots."""
    result = contact.copy()
    result[:knots] = True
    return result


def generate_initial_gaits(
    task: WalkTask, names: Sequence[str] = GAITS, brakes: Iterable[int] = range(4)
) -> Iterator[Gait]:
    """Yield named gaits in all their phases that keep the least number of contacts.

    Args:
        task: The task.
        names: Names of the gaits.
        brakes: Numbers of knots at which all legs stand first, to brake.
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
    """Return whether at least `min_contacts` legs stand in every interval."""
    return bool((contact[:-1].sum(axis=1) >= task.min_contacts).all())


def mirror_gait(gait: Gait) -> Gait:
    """Return the gait with left and right legs exchanged."""
    mirrored = mirror_legs(gait.contact.shape[1])
    return Gait(gait.contact[:, mirrored], gait.region[:, mirrored])


def is_left_right_symmetric(task: WalkTask) -> bool:
    """Return whether the task is symmetric, so that mirrored gaits do equally well."""
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
