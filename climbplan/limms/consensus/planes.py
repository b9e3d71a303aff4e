"""Separating planes, eq. (6.4): one for each pair of links that are close, its normal kept.

A plane for a whole module would forbid elbows round a box; a variable normal makes the block much
harder. The normals come from the closest points of the pose before, and are renewed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.knot_modes import ON_BOX, Hands
from climbplan.limms.consensus.knot_program import Plane
from climbplan.limms.consensus.setting import POINTS, Setting
from climbplan.limms.modules.contact import gap_to_blocks, link_segments
from climbplan.limms.modules.distances import segment_to_segment
from climbplan.limms.scene.limms_scene import Points

NEAR = 0.06  # [m] gap below which a pair gets a plane
SLACK = 0.004  # [m] beyond touching
_NORMALS = np.vstack([np.eye(3), -np.eye(3)])
_OWN_PAIRS = ((0, 2), (0, 3), (1, 3))


def planes_at(
    setting: Setting,
    hands: Sequence[Hands],
    poses: Sequence[Points],
    box: Array,
    near: float = NEAR,
) -> tuple[list[Plane], float]:
    """Planes for all close pairs, the closest first, and the deepest penetration [m].

    poses: of all modules, (8, 3) points each.
    """
    radius = setting.scene.module.radius
    segments = [link_segments(points, radius) for points in poses]
    found: list[tuple[float, Plane]] = []
    for m, own in enumerate(segments):
        found += _from_blocks(setting, hands[m], own, box, m, near)
        pairs = [(m, i, m, j) for i, j in _OWN_PAIRS]
        for a, i, b, j in pairs:
            found += _between(setting, segments[a][i], segments[b][j], (a, i), (b, j), near)
    touching = {
        (m, POINTS - 2, both.parent, 0 if setting.box_end[both.parent] == 0 else POINTS - 2)
        for m, both in enumerate(hands)
        if both.parent >= 0
    }
    for a, b in combinations(range(len(poses)), 2):
        for i in range(POINTS - 1):
            for j in range(POINTS - 1):
                if (a, i, b, j) in touching or (b, j, a, i) in touching:
                    continue
                found += _between(setting, segments[a][i], segments[b][j], (a, i), (b, j), near)
    found.sort(key=lambda entry: entry[0])
    worst = -min((gap for gap, _ in found), default=0.0)
    return [plane for _, plane in found], max(worst, 0.0)


def _row(setting: Setting) -> Array:
    return np.zeros(15 * setting.scene.count + 3)


def _from_blocks(
    setting: Setting, hands: Hands, segments: Array, box: Array, m: int, near: float
) -> list[tuple[float, Plane]]:
    """Links beyond the face of the box, or of a parked one, that they are nearest to leave by."""
    scene, radius = setting.scene, setting.scene.module.radius
    found = []
    # A latched end touches; its link goes straight away from there
    latched = {(0, POINTS - 1)[i] for i in (0, 1) if hands.ends[i].kind == ON_BOX}
    centres = np.vstack([box[None], scene.box_start[1:]])
    for b, (centre, size) in enumerate(zip(centres, scene.box_size, strict=True)):
        gaps = gap_to_blocks(
            segments, (centre - size / 2)[None], (centre + size / 2)[None], radius
        )[:, 0]
        for i in range(POINTS - 1):
            if gaps[i] > near:
                continue
            ahead = (_NORMALS @ (segments[i] - centre).T).min(axis=1) - np.tile(size / 2, 2)
            face = int(np.argmax(ahead))
            normal = _NORMALS[face]
            offset = float(size[face % 3] / 2 + radius + SLACK)
            for point in (i, i + 1):
                if b == 0 and point in latched:
                    continue
                row = _row(setting)
                row[15 * m + 3 * point : 15 * m + 3 * point + 3] = normal
                value = offset
                if b == 0:
                    row[-3:] = -normal
                else:
                    value += float(normal @ centre)
                found.append((float(gaps[i]), Plane(row, value)))
    return found


def _between(
    setting: Setting,
    one: Array,
    other: Array,
    first: tuple[int, int],
    second: tuple[int, int],
    near: float,
) -> list[tuple[float, Plane]]:
    """All four pairs of ends of two links apart along the direction of their closest points."""
    radius = setting.scene.module.radius
    gap = float(segment_to_segment(one[0], one[1], other[0], other[1])) - 2 * radius
    if gap > near:
        return []
    normal = _direction(one, other)
    found = []
    for i in (0, 1):
        for j in (0, 1):
            row = _row(setting)
            _add_end(setting, row, first, i, normal)
            _add_end(setting, row, second, j, -normal)
            found.append((gap, Plane(row, 2 * radius + SLACK)))
    return found


def _add_end(
    setting: Setting, row: Array, link: tuple[int, int], which: int, normal: Array
) -> None:
    """normal . an end of a link; those with latches stop one radius short of them."""
    m, i = link
    point = i + which
    short = 0.0
    if point in (0, POINTS - 1):
        short = setting.scene.module.radius / float(setting.links[i])
    inner = i + 1 - which
    row[15 * m + 3 * point : 15 * m + 3 * point + 3] += (1 - short) * normal
    row[15 * m + 3 * inner : 15 * m + 3 * inner + 3] += short * normal


def _direction(one: Array, other: Array) -> Array:
    """Unit vector from the second segment to the first between their closest points."""
    share = np.linspace(0, 1, 41)[:, None]
    a, b = one[0] + share * (one[1] - one[0]), other[0] + share * (other[1] - other[0])
    apart = a[:, None] - b[None]
    length = np.linalg.norm(apart, axis=-1)
    i, j = np.unravel_index(int(np.argmin(length)), length.shape)
    if length[i, j] > 1e-6:
        return np.asarray(apart[i, j] / length[i, j])
    normal = np.cross(one[1] - one[0], other[1] - other[0])
    size = float(np.linalg.norm(normal))
    return normal / size if size > 1e-9 else np.array([0.0, 0.0, 1.0])
