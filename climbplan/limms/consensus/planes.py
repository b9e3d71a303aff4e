"""Separating planes, eq. (6.4): one for each pair of close links, with a fixed normal.

A plane for a whole module would forbid elbows around a box; a variable normal makes the block much
harder. Normals come from the closest points of the last pose, and are renewed.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.knot_contacts import ON_BOX, ModuleContacts
from climbplan.limms.consensus.knot_program import SeparatingPlane
from climbplan.limms.consensus.problem import POINTS, ConsensusProblem
from climbplan.limms.modules.contact import gap_to_blocks, link_segments
from climbplan.limms.modules.distances import segment_to_segment
from climbplan.limms.scene.limms_scene import Points

PLANE_DISTANCE = 0.06  # [m]; closer pairs get a plane
PLANE_MARGIN = 0.004  # [m] beyond contact
_NORMALS = np.vstack([np.eye(3), -np.eye(3)])
_OWN_PAIRS = ((0, 2), (0, 3), (1, 3))


def build_planes(
    problem: ConsensusProblem,
    contacts: Sequence[ModuleContacts],
    poses: Sequence[Points],
    box: Array,
    max_gap: float = PLANE_DISTANCE,
) -> tuple[list[SeparatingPlane], float]:
    """Return planes for all close pairs, the closest first, and the deepest penetration [m].

    Args:
        problem: The problem.
        contacts: Contacts of all modules.
        poses: Points of all modules (8, 3) each.
        box: Position of the box (3,) [m].
        max_gap: Largest gap of a pair with a plane [m].
    """
    radius = problem.scene.module.radius
    segments = [link_segments(points, radius) for points in poses]
    planes: list[tuple[float, SeparatingPlane]] = []
    for m, module_segments in enumerate(segments):
        planes += _separate_from_boxes(problem, contacts[m], module_segments, box, m, max_gap)
        pairs = [(m, i, m, j) for i, j in _OWN_PAIRS]
        for a, i, b, j in pairs:
            planes += _separate_links(
                problem, segments[a][i], segments[b][j], (a, i), (b, j), max_gap
            )
    touching = {
        (m, POINTS - 2, contact.parent, 0 if problem.box_end[contact.parent] == 0 else POINTS - 2)
        for m, contact in enumerate(contacts)
        if contact.parent >= 0
    }
    for a, b in combinations(range(len(poses)), 2):
        for i in range(POINTS - 1):
            for j in range(POINTS - 1):
                if (a, i, b, j) in touching or (b, j, a, i) in touching:
                    continue
                planes += _separate_links(
                    problem, segments[a][i], segments[b][j], (a, i), (b, j), max_gap
                )
    planes.sort(key=lambda entry: entry[0])
    penetration = -min((gap for gap, _ in planes), default=0.0)
    return [plane for _, plane in planes], max(penetration, 0.0)


def _make_empty_row(problem: ConsensusProblem) -> Array:
    """Return zero coefficients of a plane."""
    return np.zeros(15 * problem.scene.num_modules + 3)


def _separate_from_boxes(
    problem: ConsensusProblem,
    contacts: ModuleContacts,
    segments: Array,
    box: Array,
    m: int,
    max_gap: float,
) -> list[tuple[float, SeparatingPlane]]:
    """Return planes that keep links beyond the nearest face of the box and of static boxes."""
    scene, radius = problem.scene, problem.scene.module.radius
    planes = []
    # A latched end touches the box, and its link leads straight away
    latched = {(0, POINTS - 1)[i] for i in (0, 1) if contacts.ends[i].kind == ON_BOX}
    centres = np.vstack([box[None], scene.box_start[1:]])
    for b, (centre, size) in enumerate(zip(centres, scene.box_size, strict=True)):
        gaps = gap_to_blocks(
            segments, (centre - size / 2)[None], (centre + size / 2)[None], radius
        )[:, 0]
        for i in range(POINTS - 1):
            if gaps[i] > max_gap:
                continue
            face_distances = (_NORMALS @ (segments[i] - centre).T).min(axis=1) - np.tile(
                size / 2, 2
            )
            face = int(np.argmax(face_distances))
            normal = _NORMALS[face]
            offset = float(size[face % 3] / 2 + radius + PLANE_MARGIN)
            for point in (i, i + 1):
                if b == 0 and point in latched:
                    continue
                row = _make_empty_row(problem)
                row[15 * m + 3 * point : 15 * m + 3 * point + 3] = normal
                value = offset
                if b == 0:
                    row[-3:] = -normal
                else:
                    value += float(normal @ centre)
                planes.append((float(gaps[i]), SeparatingPlane(row, value)))
    return planes


def _separate_links(
    problem: ConsensusProblem,
    first_segment: Array,
    second_segment: Array,
    first: tuple[int, int],
    second: tuple[int, int],
    max_gap: float,
) -> list[tuple[float, SeparatingPlane]]:
    """Return planes between all four pairs of ends of two links, normal to their closest points."""
    radius = problem.scene.module.radius
    gap = (
        float(
            segment_to_segment(
                first_segment[0], first_segment[1], second_segment[0], second_segment[1]
            )
        )
        - 2 * radius
    )
    if gap > max_gap:
        return []
    normal = _find_separating_direction(first_segment, second_segment)
    planes = []
    for i in (0, 1):
        for j in (0, 1):
            row = _make_empty_row(problem)
            _add_end(problem, row, first, i, normal)
            _add_end(problem, row, second, j, -normal)
            planes.append((gap, SeparatingPlane(row, 2 * radius + PLANE_MARGIN)))
    return planes


def _add_end(
    problem: ConsensusProblem, row: Array, link: tuple[int, int], which: int, normal: Array
) -> None:
    """Add normal . (end of a link) to a row; ends with latches stop one radius short of them."""
    m, i = link
    point = i + which
    fraction = 0.0
    if point in (0, POINTS - 1):
        fraction = problem.scene.module.radius / float(problem.link_lengths[i])
    inner = i + 1 - which
    row[15 * m + 3 * point : 15 * m + 3 * point + 3] += (1 - fraction) * normal
    row[15 * m + 3 * inner : 15 * m + 3 * inner + 3] += fraction * normal


def _find_separating_direction(first: Array, second: Array) -> Array:
    """Return the unit vector between the closest points of two segments, from second to first."""
    fractions = np.linspace(0, 1, 41)[:, None]
    a, b = (
        first[0] + fractions * (first[1] - first[0]),
        second[0] + fractions * (second[1] - second[0]),
    )
    differences = a[:, None] - b[None]
    length = np.linalg.norm(differences, axis=-1)
    i, j = np.unravel_index(int(np.argmin(length)), length.shape)
    if length[i, j] > 1e-6:
        return np.asarray(differences[i, j] / length[i, j])
    normal = np.cross(first[1] - first[0], second[1] - second[0])
    size = float(np.linalg.norm(normal))
    return normal / size if size > 1e-9 else np.array([0.0, 0.0, 1.0])
