"""Motions from which the programs of arms begin: straight ways, detours, parabolas."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.arm_ways import arm_way
from climbplan.limms.arms.held_branches import HeldTask, release_share, way_points
from climbplan.limms.modules.limbs import limb_angles
from climbplan.limms.scene.corridor import path_length
from climbplan.limms.scene.limms_scene import GRAVITY, Scene
from climbplan.limms.scene.phases import Limb, Phase, PhaseTrajectory
from climbplan.limms.scene.placement import centre_of

KNOTS = 8  # intervals of a phase
BUMP = 0.2  # [m]
SPEED = 0.45  # [m/s] of the guess
RELEASES = (0.92, 0.75, 0.55)  # how far of what arms reach a guess throws


def bumps(first: Array, last: Array) -> list[Array]:
    """Sideways detours (D,) of a straight way: none, and both ways along two directions."""
    way = centre_of(last - first)
    length = float(np.linalg.norm(way))
    along = way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    one = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    one /= np.linalg.norm(one)
    other = np.cross(along, one)
    found = [np.zeros(3), *(BUMP * sign * side for side in (one, other) for sign in (1, -1))]
    return [np.pad(each, (0, len(first) - 3)) for each in found]


def guess_for(
    scene: Scene,
    limbs: Sequence[Limb],
    task: HeldTask,
    bump: Array | None = None,
    release: float = 0.92,
) -> list[PhaseTrajectory]:
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
        length = float(path_length(first, last))
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

    position: Array  # (KNOTS + 1, D) placements [m, rad]
    duration: float  # [s]
    velocity: Array  # (KNOTS + 1, D) or (D,) [m/s, rad/s]
    block: Array  # (2, D) of free placements of the box


def traces_along(
    scene: Scene, limbs: Sequence[Limb], task: HeldTask, pieces: Sequence[Piece]
) -> list[PhaseTrajectory]:
    """The guess that follows pieces of a way, and a parabola after them if the box is thrown."""
    traces: list[PhaseTrajectory] = []
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
            PhaseTrajectory(
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


def _flight(release: Array, goal: Array, block: Array, limbs: int) -> PhaseTrajectory:
    """A parabola with its top at the goal, or a third of a second long."""
    rise = max(goal[2] - release[2], 0.0)
    duration = max(float(np.sqrt(2 * rise / GRAVITY)), 0.15)
    down = np.array([0, 0, -GRAVITY, 0])[: len(goal)]
    velocity = (goal - release) / duration - down * duration / 2
    times = np.linspace(0, duration, 2)[:, None]
    phase = Phase("flight", block[0], block[1], 1, 0.05, 2.0)
    return PhaseTrajectory(
        phase,
        duration,
        release + velocity * times + down * times**2 / 2,
        velocity + down * times,
        np.broadcast_to(down, (2, len(down))),
        np.zeros((2, limbs, 6)),
        np.zeros((2, limbs, 3)),
        np.zeros((2, limbs, 3)),
    )


def guesses_for(
    scene: Scene, limbs: Sequence[Limb], task: HeldTask
) -> Iterator[list[PhaseTrajectory]]:
    """Guesses one after the other, as far as they are asked for.

    Straight ones with and without detours, the smoothest of them; of throws also from nearer the
    start; of what is carried the way that a search finds for the arms.
    """
    corners = way_points(task)
    for share in RELEASES if task.throw else RELEASES[:1]:
        guesses = [
            guess_for(scene, limbs, task, bump, share) for bump in bumps(corners[0], corners[-1])
        ]
        yield min(guesses, key=jerkiness)
    if not task.throw:
        found = searched(scene, limbs, task)
        if found is not None:
            yield found


def searched(scene: Scene, limbs: Sequence[Limb], task: HeldTask) -> list[PhaseTrajectory] | None:
    """A slow motion along the way that a search finds for the arms, or None."""
    pieces = []
    for way, block in arm_way(scene, limbs, task):
        steps = path_length(way[:-1], way[1:])
        along = np.concatenate([[0.0], np.cumsum(steps)])
        share = np.linspace(0.0, along[-1], KNOTS + 1)
        position = np.stack(
            [np.interp(share, along, way[:, i]) for i in range(way.shape[1])], axis=-1
        )
        duration = max(float(along[-1]) / SPEED, 0.4)
        velocity = np.gradient(position, duration / KNOTS, axis=0)
        pieces.append(Piece(position, duration, velocity, block))
    return traces_along(scene, limbs, task, pieces) if pieces else None


def jerkiness(traces: Sequence[PhaseTrajectory]) -> float:
    """Largest turn of a joint between two knots of a guess [rad]."""
    return max(
        float(np.abs(np.diff(t.angles, axis=0)).max()) for t in traces if t.phase.kind == "held"
    )
