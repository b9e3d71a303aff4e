"""Collisions of an answer turned into cuts: planes that links have to stay beyond, knot by knot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from climbplan.limms.arms.answers import Cut, Outcome
from climbplan.limms.modules.contact import LINKS, gap_to_blocks, gap_to_boxes, link_segments
from climbplan.limms.modules.limbs import limb_points
from climbplan.limms.placement import centre_of, in_world, yaw_of
from climbplan.limms.scene import Array, Scene
from climbplan.limms.statement import Limb, Trace

MARGIN = 0.008  # [m] beyond the radius
ROUNDS = 4
_NORMALS = np.vstack([np.eye(3), -np.eye(3)])

Solve = Callable[[Sequence[Trace] | None, Sequence[Cut]], Outcome]


def solve_clear(scene: Scene, limbs: Sequence[Limb], solve: Solve) -> Outcome:
    """Solve, look for collisions with solids and boxes at the knots, cut them off, solve again."""
    cuts: list[Cut] = []
    outcome = solve(None, cuts)
    for _ in range(ROUNDS):
        if not outcome.solved:
            break
        fresh = [
            cut
            for number, trace in enumerate(outcome.traces)
            if trace.phase.kind != "flight"
            for cut in collisions(scene, limbs, number, trace)
        ]
        if not fresh:
            break
        cuts += fresh
        again = solve(outcome.traces, cuts)
        outcome = replace(again, work=outcome.work + again.work)
    return outcome


def collisions(scene: Scene, limbs: Sequence[Limb], number: int, trace: Trace) -> list[Cut]:
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
        if scene.boxes > 1:
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
    own = in_world(-yaw, points[list(ends)] - centre)
    faces = np.concatenate([block[1], -block[0]])
    ahead = (_NORMALS @ own.T).min(axis=1) - faces  # of the worse end, beyond each face
    face = int(np.argmax(ahead))
    normal, offset = _NORMALS[face], float(faces[face] + radius + MARGIN)
    if not is_carried:
        normal = in_world(yaw, normal)
        offset += float(normal @ centre)
    return [
        Cut(at.phase, at.knot, at.limb, end, normal, offset, is_carried)
        for end in ends
        if end not in (0, 7)  # what is latched or stands is where it is
    ]
