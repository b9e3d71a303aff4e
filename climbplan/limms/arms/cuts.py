"""Collisions of an answer turned into cuts: planes that links have to stay beyond, knot by knot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from climbplan.limms.arms.answers import Cut, Outcome
from climbplan.limms.modules.contact import LINKS, gap_to_blocks, link_segments
from climbplan.limms.modules.limbs import limb_points
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
    blocks = list(scene.solids)
    blocks += [
        np.array([centre - h, centre + h])
        for centre, h in zip(scene.box_start[1:], half[1:], strict=True)
    ]
    fixed = np.array(blocks)
    found = []
    for i, limb in enumerate(limbs):
        points = limb_points(scene, limb, trace.position, trace.feet[:, i], trace.angles[:, i])
        segments = link_segments(points, radius)
        gap = gap_to_blocks(segments, fixed[:, 0], fixed[:, 1], radius)
        for knot, link, solid in np.argwhere(gap < -1e-4):
            found += _cut(
                number, int(knot), i, int(link), points.position[knot], fixed[solid], radius, None
            )
        box_gap = gap_to_blocks(
            segments,
            (trace.position - half[0])[:, None],
            (trace.position + half[0])[:, None],
            radius,
        )[..., 0]
        for knot, link in np.argwhere(box_gap < -1e-4):
            block = np.array([-half[0], half[0]])
            found += _cut(
                number,
                int(knot),
                i,
                int(link),
                points.position[knot],
                block,
                radius,
                trace.position[knot],
            )
    return found


def _cut(
    phase: int,
    knot: int,
    limb: int,
    link: int,
    points: Array,
    block: Array,
    radius: float,
    box: Array | None,
) -> list[Cut]:
    """Keep both ends of a link beyond the face of a block that it is nearest to leave by."""
    ends = LINKS[link]
    own = points[list(ends)] - (0 if box is None else box)
    faces = np.concatenate([block[1], -block[0]])
    ahead = (_NORMALS @ own.T).min(axis=1) - faces  # of the worse end, beyond each face
    face = int(np.argmax(ahead))
    offset = float(faces[face] + radius + MARGIN)
    return [
        Cut(phase, knot, limb, end, _NORMALS[face], offset, box is not None)
        for end in ends
        if end not in (0, 7)  # what is latched or stands is where it is
    ]
