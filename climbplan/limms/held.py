"""Arms that carry or throw the box: guesses, the program, and cuts against collisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from climbplan.limms.answers import Cut, Ends, Outcome
from climbplan.limms.arm_program import solve_arms
from climbplan.limms.chain import BRANCHES, in_range
from climbplan.limms.contact import gap_between, gap_to_blocks, gap_within, link_segments
from climbplan.limms.corridor import Way
from climbplan.limms.cuts import solve_clear
from climbplan.limms.limbs import limb_angles, limb_points
from climbplan.limms.scene import GRAVITY, Array, Scene
from climbplan.limms.statement import Limb, Phase, Trace

KNOTS = 8  # intervals of a phase
BUMP = 0.2  # [m]
SPEED = 0.45  # [m/s] of the guess
RELEASES = (0.92, 0.75, 0.55)  # how far of what arms reach a guess throws
TRIES = 3  # guesses of a throw


@dataclass(frozen=True)
class HeldTask:
    """What arms are to do: from, to, through which blocks, and whether they throw."""

    start: Array
    goal: Array
    way: Way
    throw: bool
    arrival_speed: float


def clearance(scene: Scene, limbs: Sequence[Limb], box: Array, feet: Array, angles: Array) -> Array:
    """Least gap (T) of limbs from solids, boxes, themselves and each other along a path [m].

    box: (T, 3); feet: (T, limbs, 3); angles: (T, limbs, 6).
    """
    radius = scene.module.radius
    gaps = []
    segments = []
    fixed = scene.solids
    if scene.boxes > 1:
        half = scene.box_size[1:] / 2
        centres = scene.box_start[1:]
        fixed = np.concatenate([fixed, np.stack([centres - half, centres + half], axis=1)])
    for i, limb in enumerate(limbs):
        points = limb_points(scene, limb, box, feet[:, i], angles[:, i])
        segments.append(link_segments(points, radius))
        gaps.append(gap_to_blocks(segments[i], fixed[:, 0], fixed[:, 1], radius).min(axis=(1, 2)))
        half = scene.box_size[0] / 2
        low, high = (box - half)[:, None], (box + half)[:, None]
        gaps.append(gap_to_blocks(segments[i], low, high, radius).min(axis=(1, 2)))
        gaps.append(gap_within(segments[i], radius).min(axis=1))
        gaps += [gap_between(segments[i], s, radius).min(axis=(1, 2)) for s in segments[:i]]
    worst: Array = np.min(gaps, axis=0)
    return worst


def branch_choices(
    scene: Scene, limb: Limb, path: Array, feet: Array, most: int = 3
) -> list[tuple[float, Limb]]:
    """The limb with its likeliest branches, best first: feasible at the start, least trouble after.

    path: (T, 3) box centres; feet: (T, 3) other ends.
    """
    found = []
    for branch in BRANCHES:
        angles, missing = limb_angles(scene, limb, path, feet, branch)
        excess = in_range(scene.module, angles)
        gap = clearance(scene, [limb], path, feet[:, None], angles[:, None])
        if missing[0] > 1e-9 or excess[0] > 0 or gap[0] < -1e-4:
            continue
        turning = np.abs(np.diff(angles, axis=0)).max(axis=1).sum() if len(path) > 1 else 0.0
        trouble = (
            10 * missing.max()
            + 3 * max(excess.max(), 0.0)
            + 20 * np.maximum(-gap, 0.0).mean()
            + 0.1 * turning
        )
        found.append((float(trouble), replace(limb, branch=branch)))
    found.sort(key=lambda entry: entry[0])
    return found[:most]


def way_points(task: HeldTask) -> Array:
    """Start, crossings and goal (n, 3)."""
    return np.vstack([task.start, task.way.crossings, task.goal])


def release_share(scene: Scene, limbs: Sequence[Limb], first: Array, last: Array) -> float:
    """How far along a straight line all arms reach, in any branch."""
    shares = np.linspace(0, 1, 41)
    path = first + shares[:, None] * (last - first)
    ok = np.ones(len(shares), bool)
    for limb in limbs:
        feet = np.broadcast_to(limb.fixed_position, path.shape)
        each = []
        for branch in BRANCHES:
            angles, missing = limb_angles(scene, limb, path, feet, branch)
            each.append((missing <= 0) & (in_range(scene.module, angles) < 0))
        ok &= np.any(each, axis=0)
    bad = np.flatnonzero(~ok)
    return float(shares[bad[0] - 1]) if len(bad) and bad[0] > 0 else float(not len(bad))


def path_choices(
    scene: Scene, limbs: Sequence[Limb], task: HeldTask
) -> list[list[tuple[float, Limb]]]:
    """Likeliest branches of each limb along the straight way, as far as it is not thrown."""
    corners = way_points(task)
    if task.throw:
        share = release_share(scene, limbs, corners[-2], corners[-1])
        corners[-1] = corners[-2] + share * (corners[-1] - corners[-2])
    path = np.vstack(
        [
            first + np.linspace(0, 1, 9)[:, None] * (last - first)
            for first, last in pairwise(corners)
        ]
    )
    return [
        branch_choices(scene, limb, path, np.tile(limb.fixed_position, (len(path), 1)))
        for limb in limbs
    ]


def bumps(first: Array, last: Array) -> list[Array]:
    """Sideways detours (3,) of a straight way: none, and both ways along two directions."""
    along = (last - first) / max(float(np.linalg.norm(last - first)), 1e-9)
    one = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    one /= np.linalg.norm(one)
    other = np.cross(along, one)
    return [np.zeros(3), *(BUMP * sign * side for side in (one, other) for sign in (1, -1))]


def guess_for(
    scene: Scene,
    limbs: Sequence[Limb],
    task: HeldTask,
    bump: Array | None = None,
    release: float = 0.92,
) -> list[Trace]:
    """A slow straight motion through the way, and a parabola if the box is thrown.

    bump: a sideways detour of every leg of the way; release: how far of what arms reach they throw.
    """
    corners = way_points(task)
    if task.throw:
        reached = release * release_share(scene, limbs, corners[-2], corners[-1])
        corners[-1] = corners[-2] + reached * (corners[-1] - corners[-2])
    blocks = list(task.way.blocks)
    if task.throw:
        # Time runs differently in wind-up and throw: a phase of its own for each
        corners = np.insert(corners, -1, 0.4 * corners[-2] + 0.6 * corners[-1], axis=0)
        blocks.append(blocks[-1])
    pieces = []
    for (first, last), block in zip(pairwise(corners), blocks, strict=True):
        length = float(np.linalg.norm(last - first))
        share = np.linspace(0, 1, KNOTS + 1)[:, None]
        position = first + share * (last - first)
        if bump is not None:
            position = np.clip(position + np.sin(np.pi * share) * bump, block[0], block[1])
        velocity = (last - first) / max(length / SPEED, 0.4)
        pieces.append(Piece(position, max(length / SPEED, 0.4), velocity, block))
    return traces_along(scene, limbs, task, pieces)


@dataclass(frozen=True)
class Piece:
    """A way of the box in one phase, as a guess."""

    position: Array  # (KNOTS + 1, 3) [m]
    duration: float  # [s]
    velocity: Array  # (KNOTS + 1, 3) or (3,) [m/s]
    block: Array  # (2, 3) of free centres of the box


def traces_along(
    scene: Scene, limbs: Sequence[Limb], task: HeldTask, pieces: Sequence[Piece]
) -> list[Trace]:
    """The guess that follows pieces of a way, and a parabola after them if the box is thrown."""
    traces: list[Trace] = []
    for piece in pieces:
        position, block = piece.position, piece.block
        velocity = np.broadcast_to(piece.velocity, position.shape)
        feet = np.array([[limb.fixed_position for limb in limbs]] * (KNOTS + 1))
        angles = np.stack(
            [
                limb_angles(scene, limb, position, feet[:, i], limb.branch)[0]
                for i, limb in enumerate(limbs)
            ],
            axis=1,
        )
        if traces:  # whole turns as before
            turn = np.round((traces[-1].angles[-1] - angles[0]) / (2 * np.pi)) * 2 * np.pi
            angles = angles + turn
        phase = Phase("held", block[0], block[1], KNOTS, 0.15, 12.0)
        traces.append(
            Trace(
                phase,
                piece.duration,
                position,
                velocity,
                np.zeros_like(position),
                angles,
                feet,
                np.zeros((KNOTS + 1, len(limbs), 3)),
            )
        )
    if task.throw:
        end = pieces[-1].position[-1]
        traces.append(_flight(end, task.goal, task.way.blocks[-1], len(limbs)))
    return traces


def _flight(release: Array, goal: Array, block: Array, limbs: int) -> Trace:
    """A parabola with its top at the goal, or a third of a second long."""
    rise = max(goal[2] - release[2], 0.0)
    duration = max(float(np.sqrt(2 * rise / GRAVITY)), 0.15)
    down = np.array([0, 0, -GRAVITY])
    velocity = (goal - release) / duration - down * duration / 2
    times = np.linspace(0, duration, 2)[:, None]
    phase = Phase("flight", block[0], block[1], 1, 0.05, 2.0)
    return Trace(
        phase,
        duration,
        release + velocity * times + down * times**2 / 2,
        velocity + down * times,
        np.broadcast_to(down, (2, 3)),
        np.zeros((2, limbs, 6)),
        np.zeros((2, limbs, 3)),
        np.zeros((2, limbs, 3)),
    )


def plan_held(
    scene: Scene,
    limbs: Sequence[Limb],
    task: HeldTask,
    time_limit: float,
    given: Sequence[Trace] | None = None,
) -> Outcome:
    """Solve the program of one held stage, from guess after guess until one leads to an optimum.

    given: the only guess to begin from. The outcome is the first optimum, else the best answer,
    else the last try; its times are those of all.
    """
    ends = Ends(task.start, task.goal, task.arrival_speed if task.throw else 0.0)
    spent, built = 0.0, 0.0
    best: Outcome | None = None
    some = TRIES if task.throw else 1
    for first in [list(given)] if given else guesses_for(scene, limbs, task)[:some]:

        def once(
            guess: Sequence[Trace] | None, cuts: Sequence[Cut], first: list[Trace] = first
        ) -> Outcome:
            return solve_arms(scene, limbs, guess or first, ends, cuts, time_limit)

        outcome = solve_clear(scene, limbs, once)
        spent, built = spent + outcome.seconds, built + outcome.build_seconds
        if best is None or _rank(outcome) < _rank(best):
            best = outcome
        if outcome.optimal:
            break
    assert best is not None
    return replace(best, seconds=spent, build_seconds=built)


def _rank(outcome: Outcome) -> tuple[bool, bool, float]:
    """Optima first, then answers, the cheapest first."""
    return (not outcome.optimal, not outcome.solved, outcome.objective)


def guesses_for(scene: Scene, limbs: Sequence[Limb], task: HeldTask) -> list[list[Trace]]:
    """Guesses with and without detours, smoothest first; throws also from nearer the start."""
    corners = way_points(task)
    ranked: list[list[Trace]] = []
    for share in RELEASES if task.throw else RELEASES[:1]:
        guesses = [
            guess_for(scene, limbs, task, bump, share) for bump in bumps(corners[0], corners[-1])
        ]
        ranked.append(min(guesses, key=jerkiness))
    return ranked


def jerkiness(traces: Sequence[Trace]) -> float:
    """Largest turn of a joint between two knots of a guess [rad]."""
    return max(
        float(np.abs(np.diff(t.angles, axis=0)).max()) for t in traces if t.phase.kind == "held"
    )


def combinations(
    choices: Sequence[Sequence[tuple[float, Limb]]], most: int = 6
) -> list[tuple[Limb, ...]]:
    """Choices of a branch for each limb, least trouble together first."""
    every = sorted(product(*choices), key=lambda combo: sum(entry[0] for entry in combo))
    return [tuple(entry[1] for entry in combo) for combo in every[:most]]
