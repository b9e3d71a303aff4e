"""Initial guesses of the programs of arms: straight paths, detours, parabolas."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.branch_choices import HeldTask, compute_release_fraction, list_way_points
from climbplan.limms.arms.grid_path import find_grid_path
from climbplan.limms.modules.limbs import compute_limb_angles
from climbplan.limms.scene.corridor import path_length
from climbplan.limms.scene.limms_scene import GRAVITY, ModuleScene
from climbplan.limms.scene.phases import BoxPhase, PhaseTrajectory, SupportModule
from climbplan.limms.scene.placement import centre_of

KNOTS = 8  # intervals of a phase
DETOUR = 0.2  # [m]
SPEED = 0.45  # [m/s] of the box in a guess
RELEASE_FRACTIONS = (0.92, 0.75, 0.55)  # fractions of the reach at which guesses release the box


def list_detours(start: Array, end: Array) -> list[Array]:
    """Return lateral detours (D,) of a straight path: none, and both signs of two directions."""
    displacement = centre_of(end - start)
    length = float(np.linalg.norm(displacement))
    direction = displacement / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    detours = [np.zeros(3), *(DETOUR * sign * side for side in (first, second) for sign in (1, -1))]
    return [np.pad(detour, (0, len(start) - 3)) for detour in detours]


def build_guess(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    task: HeldTask,
    detour: Array | None = None,
    release_fraction: float = 0.92,
) -> list[PhaseTrajectory]:
    """Build a slow straight motion through the corridor, with a parabola if the box is thrown.

    Args:
        scene: The scene.
        limbs: The arms.
        task: The task.
        detour: Lateral detour of every piece of the path (D,).
        release_fraction: Fraction of the reach at which the box is released.
    """
    corners = list_way_points(task)
    if task.throw:
        fraction = release_fraction * compute_release_fraction(
            scene, limbs, corners[-2], corners[-1]
        )
        corners[-1] = corners[-2] + fraction * (corners[-1] - corners[-2])
    blocks = list(task.corridor.blocks)
    if task.throw:
        # Wind-up and throw are separate phases with their own durations
        corners = np.insert(corners, -1, 0.4 * corners[-2] + 0.6 * corners[-1], axis=0)
        blocks.append(blocks[-1])
    pieces = []
    for (first, last), block in zip(pairwise(corners), blocks, strict=True):
        length = float(path_length(first, last))
        fractions = np.linspace(0, 1, KNOTS + 1)[:, None]
        position = first + fractions * (last - first)
        if detour is not None:
            position = np.clip(position + np.sin(np.pi * fractions) * detour, block[0], block[1])
        velocity = (last - first) / max(length / SPEED, 0.4)
        pieces.append(PathPiece(position, max(length / SPEED, 0.4), velocity, block))
    return build_trajectories(scene, limbs, task, pieces)


@dataclass(frozen=True)
class PathPiece:
    """A piece of the path of the box in one phase."""

    position: Array  # (KNOTS + 1, D) placements [m, rad]
    duration: float  # [s]
    velocity: Array  # (KNOTS + 1, D) or (D,) [m/s, rad/s]
    block: Array  # (2, D) of free placements of the box


def build_trajectories(
    scene: ModuleScene, limbs: Sequence[SupportModule], task: HeldTask, pieces: Sequence[PathPiece]
) -> list[PhaseTrajectory]:
    """Build the guess along pieces of a path, with a parabola at the end if the box is thrown."""
    trajectories: list[PhaseTrajectory] = []
    for piece in pieces:
        position, block = piece.position, piece.block
        velocity = np.broadcast_to(piece.velocity, position.shape)
        feet = np.array([[limb.fixed_position for limb in limbs]] * (KNOTS + 1))
        angles = np.stack(
            [
                compute_limb_angles(scene, limb, position, feet[:, i], limb.branch)[0]
                for i, limb in enumerate(limbs)
            ],
            axis=1,
        )
        if trajectories:  # same full turns as in the last phase
            full_turns = (
                np.round((trajectories[-1].angles[-1] - angles[0]) / (2 * np.pi)) * 2 * np.pi
            )
            angles = angles + full_turns
        phase = BoxPhase("held", block[0], block[1], KNOTS, 0.15, 12.0)
        trajectories.append(
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
        release = pieces[-1].position[-1]
        trajectories.append(_build_flight(release, task.goal, task.corridor.blocks[-1], len(limbs)))
    return trajectories


def _build_flight(release: Array, goal: Array, block: Array, limbs: int) -> PhaseTrajectory:
    """Return a parabola with its apex at the goal, or of a minimum duration."""
    rise = max(goal[2] - release[2], 0.0)
    duration = max(float(np.sqrt(2 * rise / GRAVITY)), 0.15)
    gravity = np.array([0, 0, -GRAVITY, 0])[: len(goal)]
    velocity = (goal - release) / duration - gravity * duration / 2
    times = np.linspace(0, duration, 2)[:, None]
    phase = BoxPhase("flight", block[0], block[1], 1, 0.05, 2.0)
    return PhaseTrajectory(
        phase,
        duration,
        release + velocity * times + gravity * times**2 / 2,
        velocity + gravity * times,
        np.broadcast_to(gravity, (2, len(gravity))),
        np.zeros((2, limbs, 6)),
        np.zeros((2, limbs, 3)),
        np.zeros((2, limbs, 3)),
    )


def generate_guesses(
    scene: ModuleScene, limbs: Sequence[SupportModule], task: HeldTask
) -> Iterator[list[PhaseTrajectory]]:
    """Yield guesses lazily.

    The smoothest straight guess comes first, with or without a detour. Throws add guesses with
    earlier release. Carried boxes add the path of a grid search.
    """
    corners = list_way_points(task)
    for fraction in RELEASE_FRACTIONS if task.throw else RELEASE_FRACTIONS[:1]:
        guesses = [
            build_guess(scene, limbs, task, detour, fraction)
            for detour in list_detours(corners[0], corners[-1])
        ]
        yield min(guesses, key=compute_max_joint_step)
    if not task.throw:
        searched_guess = search_guess(scene, limbs, task)
        if searched_guess is not None:
            yield searched_guess


def search_guess(
    scene: ModuleScene, limbs: Sequence[SupportModule], task: HeldTask
) -> list[PhaseTrajectory] | None:
    """Return a slow motion along the path of a grid search, or None."""
    pieces = []
    for path, block in find_grid_path(scene, limbs, task):
        steps = path_length(path[:-1], path[1:])
        arc_length = np.concatenate([[0.0], np.cumsum(steps)])
        stations = np.linspace(0.0, arc_length[-1], KNOTS + 1)
        position = np.stack(
            [np.interp(stations, arc_length, path[:, i]) for i in range(path.shape[1])], axis=-1
        )
        duration = max(float(arc_length[-1]) / SPEED, 0.4)
        velocity = np.gradient(position, duration / KNOTS, axis=0)
        pieces.append(PathPiece(position, duration, velocity, block))
    return build_trajectories(scene, limbs, task, pieces) if pieces else None


def compute_max_joint_step(trajectories: Sequence[PhaseTrajectory]) -> float:
    """Return the largest joint step between two knots of a guess [rad]."""
    return max(
        float(np.abs(np.diff(trajectory.angles, axis=0)).max())
        for trajectory in trajectories
        if trajectory.phase.kind == "held"
    )
