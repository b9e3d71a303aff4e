"""Collisions of a solution turned into cuts: planes that links stay beyond, knot by knot.

This is a cutting-plane scheme: the program is solved, violated constraints are added, and it is
solved again. Collisions between knots double the knots, so that cuts apply there, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.budget.program_results import CollisionCut, ProgramOutcome
from climbplan.limms.modules.contact import LINKS, gap_to_blocks, gap_to_boxes, link_segments
from climbplan.limms.modules.limbs import compute_limb_angles, compute_limb_points
from climbplan.limms.motion.cubics import evaluate_box_path
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import PhaseTrajectory, SupportModule
from climbplan.limms.scene.placement import centre_of, rotate_to_world, yaw_of

CUT_MARGIN = 0.008  # [m] beyond the radius
MAX_CUT_ROUNDS = 4
MAX_REFINEMENTS = 2  # number of times that knots may be doubled
_NORMALS = np.vstack([np.eye(3), -np.eye(3)])

SolveProgram = Callable[[Sequence[PhaseTrajectory] | None, Sequence[CollisionCut]], ProgramOutcome]


def solve_with_cuts(
    scene: ModuleScene, limbs: Sequence[SupportModule], solve: SolveProgram
) -> ProgramOutcome:
    """Solve the program, add cuts for collisions at the knots, and solve again.

    Phases get twice the knots where only motion between the knots collides or is too fast.
    """
    cuts: list[CollisionCut] = []
    outcome = solve(None, cuts)
    rounds, refinements = 0, 0
    while outcome.solved:
        trajectories = list(outcome.traces)
        new_cuts = _find_all_cuts(scene, limbs, trajectories)
        if not new_cuts:
            rough_phases = [
                k
                for k, trajectory in enumerate(trajectories)
                if _is_rough(scene, limbs, trajectory)
            ]
            if not rough_phases or refinements == MAX_REFINEMENTS:
                break
            refinements += 1
            for index in rough_phases:
                trajectories[index] = refine_trajectory(scene, limbs, trajectories[index])
            cuts = [replace(c, knot=2 * c.knot) if c.phase in rough_phases else c for c in cuts]
            new_cuts = _find_all_cuts(scene, limbs, trajectories)
        elif rounds == MAX_CUT_ROUNDS:
            break
        else:
            rounds += 1
        cuts = cuts + new_cuts
        next_outcome = solve(trajectories, cuts)
        outcome = replace(next_outcome, work=outcome.work + next_outcome.work)
    return outcome


def _find_all_cuts(
    scene: ModuleScene, limbs: Sequence[SupportModule], trajectories: Sequence[PhaseTrajectory]
) -> list[CollisionCut]:
    """Return the cuts for all phases but flights."""
    return [
        cut
        for index, trajectory in enumerate(trajectories)
        if trajectory.phase.kind != "flight"
        for cut in find_cuts(scene, limbs, index, trajectory)
    ]


def refine_trajectory(
    scene: ModuleScene, limbs: Sequence[SupportModule], trajectory: PhaseTrajectory
) -> PhaseTrajectory:
    """Return the same motion with twice the knots; cubics are split exactly."""
    num_intervals = 2 * trajectory.phase.intervals
    time = np.linspace(0.0, trajectory.duration, num_intervals + 1)
    path = evaluate_box_path(
        trajectory.duration, trajectory.position, trajectory.velocity, trajectory.acceleration, time
    )
    feet = np.repeat(trajectory.feet[:1], num_intervals + 1, axis=0)
    knots = np.linspace(0.0, trajectory.duration, len(trajectory.angles))
    angles = np.empty((num_intervals + 1, len(limbs), 6))
    for i, limb in enumerate(limbs):
        interpolated = np.stack(
            [np.interp(time, knots, trajectory.angles[:, i, j]) for j in range(6)], axis=1
        )
        solved, _ = compute_limb_angles(scene, limb, path.position, feet[:, i], limb.branch)
        angles[:, i] = solved + np.round((interpolated - solved) / (2 * np.pi)) * 2 * np.pi
    return replace(
        trajectory,
        phase=replace(trajectory.phase, intervals=num_intervals),
        position=path.position,
        velocity=path.velocity,
        acceleration=path.acceleration,
        angles=angles,
        feet=feet,
        force=np.zeros((num_intervals + 1, len(limbs), 3)),
    )


def _is_rough(
    scene: ModuleScene, limbs: Sequence[SupportModule], trajectory: PhaseTrajectory
) -> bool:
    """Return whether links collide or joints are too fast between the knots of a phase."""
    if trajectory.phase.kind == "flight":
        return False
    dense = refine_trajectory(scene, limbs, refine_trajectory(scene, limbs, trajectory))
    step = trajectory.duration / dense.phase.intervals
    max_rate = float(np.abs(np.diff(dense.angles, axis=0)).max()) / step
    return max_rate > scene.module.max_joint_speed or bool(find_cuts(scene, limbs, 0, dense))


def find_cuts(
    scene: ModuleScene, limbs: Sequence[SupportModule], phase: int, trajectory: PhaseTrajectory
) -> list[CollisionCut]:
    """Return cuts for all links that collide at knots of a phase."""
    radius = scene.module.radius
    half = scene.box_size / 2
    solids, origin = scene.solids, np.zeros(3)
    centres, yaws = scene.box_start[1:], scene.start_yaws[1:]
    box_centres, box_yaws = centre_of(trajectory.position), yaw_of(trajectory.position)
    cuts = []
    for i, limb in enumerate(limbs):
        points = compute_limb_points(
            scene, limb, trajectory.position, trajectory.feet[:, i], trajectory.angles[:, i]
        )
        segments = link_segments(points, radius)
        gap = gap_to_blocks(segments, solids[:, 0], solids[:, 1], radius)
        for knot, link, solid in np.argwhere(gap < -1e-4):
            location = _CutLocation(phase, int(knot), i, int(link))
            cuts += _build_cuts(
                location,
                points.position[knot],
                solids[solid],
                radius,
                centre=origin,
                yaw=0.0,
                is_carried=False,
            )
        if scene.num_boxes > 1:
            gap = gap_to_boxes(segments, centres, yaws, half[1:], radius)
            for knot, link, box in np.argwhere(gap < -1e-4):
                block = np.array([-half[box + 1], half[box + 1]])
                location = _CutLocation(phase, int(knot), i, int(link))
                centre, box_yaw = centres[box], float(yaws[box])
                cuts += _build_cuts(
                    location,
                    points.position[knot],
                    block,
                    radius,
                    centre=centre,
                    yaw=box_yaw,
                    is_carried=False,
                )
        box_gap = gap_to_boxes(segments, box_centres[:, None], box_yaws[:, None], half[:1], radius)
        for knot, link in np.argwhere(box_gap[..., 0] < -1e-4):
            block = np.array([-half[0], half[0]])
            location = _CutLocation(phase, int(knot), i, int(link))
            centre, box_yaw = box_centres[knot], float(box_yaws[knot])
            cuts += _build_cuts(
                location,
                points.position[knot],
                block,
                radius,
                centre=centre,
                yaw=box_yaw,
                is_carried=True,
            )
    return cuts


class _CutLocation(NamedTuple):
    """Where a cut is needed."""

    phase: int
    knot: int
    limb: int
    link: int


def _build_cuts(
    location: _CutLocation,
    points: Array,
    block: Array,
    radius: float,
    *,
    centre: Array,
    yaw: float,
    is_carried: bool,
) -> list[CollisionCut]:
    """Return cuts that keep both ends of a link beyond the nearest face of a block.

    Args:
        location: Phase, knot, limb and link.
        points: Points of the module (8, 3) [m].
        block: Corners of the block (2, 3) in its frame [m].
        radius: Radius of the link [m].
        centre: Centre of the frame (3,) [m].
        yaw: Yaw of the frame [rad].
        is_carried: Whether the block is the carried box, with which the cut moves.
    """
    ends = LINKS[location.link]
    local_ends = rotate_to_world(-yaw, points[list(ends)] - centre)
    faces = np.concatenate([block[1], -block[0]])
    face_distances = (_NORMALS @ local_ends.T).min(
        axis=1
    ) - faces  # of the worse end beyond each face
    face = int(np.argmax(face_distances))
    normal, offset = _NORMALS[face], float(faces[face] + radius + CUT_MARGIN)
    if not is_carried:
        normal = rotate_to_world(yaw, normal)
        offset += float(normal @ centre)
    return [
        CollisionCut(location.phase, location.knot, location.limb, end, normal, offset, is_carried)
        for end in ends
        if end not in (0, 7)  # latched or standing ends do not move
    ]
