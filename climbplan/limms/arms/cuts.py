"""Collisions of an answer turned into cuts: planes that links have to stay beyond, knot by knot.

What is touched between knots gives more knots, at which it can be cut off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.budget.program_results import Cut, ProgramOutcome
from climbplan.limms.modules.contact import LINKS, gap_to_blocks, gap_to_boxes, link_segments
from climbplan.limms.modules.limbs import limb_angles, limb_points
from climbplan.limms.motion.cubics import box_path
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb, PhaseTrajectory
from climbplan.limms.scene.placement import centre_of, rotate_to_world, yaw_of

GROUND_MARGIN = 0.008  # [m] beyond the radius
ROUNDS = 4
FINER = 2  # times that knots may be doubled
_NORMALS = np.vstack([np.eye(3), -np.eye(3)])

Solve = Callable[[Sequence[PhaseTrajectory] | None, Sequence[Cut]], ProgramOutcome]


def solve_clear(scene: Scene, limbs: Sequence[Limb], solve: Solve) -> ProgramOutcome:
    """Solve, cut off what collides with solids and boxes at the knots, solve again.

    Where knots are clear and what is between them is not, or joints turn too fast there, phases get
    twice the knots.
    """
    cuts: list[Cut] = []
    outcome = solve(None, cuts)
    rounds, finer = 0, 0
    while outcome.solved:
        traces = list(outcome.traces)
        fresh = _all_collisions(scene, limbs, traces)
        if not fresh:
            rough = [k for k, trace in enumerate(traces) if _is_rough(scene, limbs, trace)]
            if not rough or finer == FINER:
                break
            finer += 1
            for number in rough:
                traces[number] = refined(scene, limbs, traces[number])
            cuts = [replace(c, knot=2 * c.knot) if c.phase in rough else c for c in cuts]
            fresh = _all_collisions(scene, limbs, traces)
        elif rounds == ROUNDS:
            break
        else:
            rounds += 1
        cuts = cuts + fresh
        again = solve(traces, cuts)
        outcome = replace(again, work=outcome.work + again.work)
    return outcome


def _all_collisions(
    scene: Scene, limbs: Sequence[Limb], traces: Sequence[PhaseTrajectory]
) -> list[Cut]:
    return [
        cut
        for number, trace in enumerate(traces)
        if trace.phase.kind != "flight"
        for cut in collisions(scene, limbs, number, trace)
    ]


def refined(scene: Scene, limbs: Sequence[Limb], trace: PhaseTrajectory) -> PhaseTrajectory:
    """The same motion with twice the knots; cubics are halved exactly."""
    count = 2 * trace.phase.intervals
    time = np.linspace(0.0, trace.duration, count + 1)
    path = box_path(trace.duration, trace.position, trace.velocity, trace.acceleration, time)
    feet = np.repeat(trace.feet[:1], count + 1, axis=0)
    old = np.linspace(0.0, trace.duration, len(trace.angles))
    angles = np.empty((count + 1, len(limbs), 6))
    for i, limb in enumerate(limbs):
        near = np.stack([np.interp(time, old, trace.angles[:, i, j]) for j in range(6)], axis=1)
        own, _ = limb_angles(scene, limb, path.position, feet[:, i], limb.branch)
        angles[:, i] = own + np.round((near - own) / (2 * np.pi)) * 2 * np.pi
    return replace(
        trace,
        phase=replace(trace.phase, intervals=count),
        position=path.position,
        velocity=path.velocity,
        acceleration=path.acceleration,
        angles=angles,
        feet=feet,
        force=np.zeros((count + 1, len(limbs), 3)),
    )


def _is_rough(scene: Scene, limbs: Sequence[Limb], trace: PhaseTrajectory) -> bool:
    """Whether something is touched between the knots of a phase, or joints turn too fast."""
    if trace.phase.kind == "flight":
        return False
    dense = refined(scene, limbs, refined(scene, limbs, trace))
    step = trace.duration / dense.phase.intervals
    fastest = float(np.abs(np.diff(dense.angles, axis=0)).max()) / step
    return fastest > scene.module.max_joint_speed or bool(collisions(scene, limbs, 0, dense))


def collisions(
    scene: Scene, limbs: Sequence[Limb], number: int, trace: PhaseTrajectory
) -> list[Cut]:
    """Cuts for all links that are in something at knots of a phase."""
    radius = scene.module.radius
    half = scene.box_size / 2
    fixed, unturned = scene.solids, np.zeros(3)
    centres, yaws = scene.box_start[1:], scene.start_yaws[1:]
    own_centres, own_yaws = centre_of(trace.position), yaw_of(trace.position)
    found = []
    for i, limb in enumerate(limbs):
        points = limb_points(scene, limb, trace.position, trace.feet[:, i], trace.angles[:, i])
        segments = link_segments(points, radius)
        gap = gap_to_blocks(segments, fixed[:, 0], fixed[:, 1], radius)
        for knot, link, solid in np.argwhere(gap < -1e-4):
            at = _At(number, int(knot), i, int(link))
            found += _cut(at, points.position[knot], fixed[solid], radius, unturned, 0.0, False)
        if scene.num_boxes > 1:
            gap = gap_to_boxes(segments, centres, yaws, half[1:], radius)
            for knot, link, box in np.argwhere(gap < -1e-4):
                block = np.array([-half[box + 1], half[box + 1]])
                at = _At(number, int(knot), i, int(link))
                place = centres[box], float(yaws[box])
                found += _cut(at, points.position[knot], block, radius, *place, False)
        box_gap = gap_to_boxes(segments, own_centres[:, None], own_yaws[:, None], half[:1], radius)
        for knot, link in np.argwhere(box_gap[..., 0] < -1e-4):
            block = np.array([-half[0], half[0]])
            at = _At(number, int(knot), i, int(link))
            place = own_centres[knot], float(own_yaws[knot])
            found += _cut(at, points.position[knot], block, radius, *place, True)
    return found


class _At(NamedTuple):
    """Where a cut is needed."""

    phase: int
    knot: int
    limb: int
    link: int


def _cut(
    at: _At,
    points: Array,
    block: Array,
    radius: float,
    centre: Array,
    yaw: float,
    is_carried: bool,
) -> list[Cut]:
    """Keep both ends of a link beyond the face of a block that it is nearest to leave by.

    block: its corners (2, 3) in its own frame, which is at `centre` with `yaw`; is_carried: it is
    the box that is carried, and the cut moves with it.
    """
    ends = LINKS[at.link]
    own = rotate_to_world(-yaw, points[list(ends)] - centre)
    faces = np.concatenate([block[1], -block[0]])
    ahead = (_NORMALS @ own.T).min(axis=1) - faces  # of the worse end, beyond each face
    face = int(np.argmax(ahead))
    normal, offset = _NORMALS[face], float(faces[face] + radius + GROUND_MARGIN)
    if not is_carried:
        normal = rotate_to_world(yaw, normal)
        offset += float(normal @ centre)
    return [
        Cut(at.phase, at.knot, at.limb, end, normal, offset, is_carried)
        for end in ends
        if end not in (0, 7)  # what is latched or stands is where it is
    ]
