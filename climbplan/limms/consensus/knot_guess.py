"""Initial guess of the nonlinear block at a knot: closed-form inverse kinematics, all branches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.knot_contacts import (
    FIXED,
    NOTHING,
    ON_BOX,
    ON_MODULE,
    ON_PATCH,
    ModuleContacts,
    compute_patch_bounds,
)
from climbplan.limms.consensus.knot_program import KnotConfiguration
from climbplan.limms.consensus.problem import CHAIN_POINTS, ConsensusProblem
from climbplan.limms.modules.chain import (
    BRANCHES,
    forward,
    forward_from_last,
    range_excess,
    solve_inverse_kinematics,
)
from climbplan.limms.modules.contact import gap_between, gap_to_blocks, gap_within, link_segments
from climbplan.limms.modules.limbs import compute_standing_rotation
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, Points, anchor_frame
from climbplan.limms.scene.limms_scene import FramePoses as Frame

_PENETRATION_WEIGHT = 50.0  # [1/m] of penetrations against squared distances
_STANCE_DISTANCES = (0.3, 0.38, 0.46, 0.54, 0.62)  # [m] of feet from faces of the box
_VIOLATION_WEIGHT = 10.0  # [1/m], [1/rad] of missing reach and joint ranges


def compute_initial_guess(
    problem: ConsensusProblem,
    contacts: Sequence[ModuleContacts],
    box: Array,
    points: Array,
    earlier_angles: Sequence[Array | None],
) -> tuple[KnotConfiguration, list[Points]]:
    """Return the best candidate of each module by itself, and all of its points.

    Args:
        problem: The problem.
        contacts: Contacts of all modules.
        box: Position of the box (3,) [m].
        points: Target points (L, 5, 3) [m].
        earlier_angles: For each module, angles of other iterates or knots (n, 6) [rad] or None.
    """
    num_modules = problem.scene.num_modules
    roots, angles = np.zeros((num_modules, 3)), np.zeros((num_modules, 6))
    placed: dict[int, Points] = {}
    for module in sorted(range(num_modules), key=lambda module: contacts[module].parent >= 0):
        first, last = _compute_target_frames(problem, contacts, module, box, points[module], placed)
        root = contacts[module].root
        kinematics = forward if root == 0 else forward_from_last
        base = first if root == 0 else last
        candidates = [np.zeros(6)]
        previous = earlier_angles[module]
        if previous is not None:
            candidates += list(np.atleast_2d(previous))
        root_positions, reach_errors = [base.position] * len(candidates), [0.0] * len(candidates)
        for root_position in _iterate_roots(problem, contacts[module], box, base.position):
            moved_frame = Frame(root_position, base.rotation)
            for branch in BRANCHES:
                ends = (moved_frame, last) if root == 0 else (first, moved_frame)
                solution = solve_inverse_kinematics(problem.scene.module, *ends, branch)
                candidates.append(solution.angles)
                root_positions.append(root_position)
                reach_errors.append(float(solution.reach_error))
        candidate_angles = np.array(candidates)
        shape = (len(candidate_angles), 3, 3)
        frames = Frame(np.array(root_positions), np.broadcast_to(base.rotation, shape))
        candidate_points = kinematics(problem.scene.module, frames, candidate_angles)
        cost = _evaluate_candidates(
            problem, contacts[module], box, points[module], candidate_points, candidate_angles
        )
        cost += _PENETRATION_WEIGHT * _measure_penetration(
            problem, contacts, module, candidate_points, placed
        )
        cost += _VIOLATION_WEIGHT * np.array(reach_errors)
        best = int(np.argmin(cost))
        angles[module], roots[module] = candidate_angles[best], root_positions[best]
        placed[module] = Points(candidate_points.position[best], candidate_points.rotation[best])
    return KnotConfiguration(box, roots, angles), [placed[module] for module in range(num_modules)]


def _iterate_roots(
    problem: ConsensusProblem, contacts: ModuleContacts, box: Array, position: Array
) -> Iterator[Array]:
    """Yield candidate roots; those of a standing leg have several distances from its face."""
    yield position
    end = contacts.ends[0]
    if contacts.root != 0 or end.side < 0 or end.kind != ON_PATCH:
        return
    normal = SIDE_NORMALS[end.side]
    half = float(abs(normal) @ problem.scene.box_size[0]) / 2
    lateral = (position - box) - ((position - box) @ normal) * normal
    for fraction in (1.0, 0.0):
        for distance in _STANCE_DISTANCES:
            foot = box + fraction * lateral + (half + distance) * normal
            yield np.clip(foot, *compute_patch_bounds(problem, end.patch))


def _compute_target_frames(
    problem: ConsensusProblem,
    contacts: Sequence[ModuleContacts],
    module: int,
    box: Array,
    points: Array,
    placed: dict[int, Points],
) -> tuple[Frame, Frame]:
    """Return the frames of both ends: by contact where attached, else by the target points."""
    frames = []
    for index, end in enumerate(contacts[module].ends):
        position, neighbour = (points[0], points[1]) if index == 0 else (points[4], points[3])
        axis = neighbour - position if index == 0 else position - neighbour
        rotation = end.rotation
        if rotation is None:
            length = float(np.linalg.norm(axis))
            rotation = (
                anchor_frame(axis / length) if length > 1e-6 else compute_standing_rotation(0)
            )
        if end.kind == FIXED and end.place is not None:
            position = end.place
        elif end.kind == ON_BOX and end.place is not None:
            position = box + end.place
        elif end.kind == ON_PATCH:
            position = np.clip(position, *compute_patch_bounds(problem, end.patch))
        elif end.kind == ON_MODULE:
            parent_points = placed[end.parent]
            parent_end = 0 if problem.box_end[end.parent] == 0 else 7
            flip = np.eye(3) if parent_end == 0 else np.diag([1.0, -1.0, -1.0])
            position, rotation = (
                parent_points.position[parent_end],
                parent_points.rotation[parent_end] @ flip,
            )
        frames.append(Frame(np.asarray(position, float), np.asarray(rotation, float)))
    return frames[0], frames[1]


def _measure_penetration(
    problem: ConsensusProblem,
    contacts: Sequence[ModuleContacts],
    current: int,
    candidates: Points,
    placed: dict[int, Points],
) -> Array:
    """Return the penetration (n,) of candidates into placed modules [m]; chains may touch."""
    radius = problem.scene.module.radius
    segments = link_segments(candidates, radius)
    depth = np.zeros(len(segments))
    for module, points in placed.items():
        if contacts[current].parent == module:
            continue
        gap = gap_between(segments, link_segments(points, radius), radius)
        depth += np.maximum(-gap, 0).sum(axis=(1, 2))
    return depth


def _evaluate_candidates(
    problem: ConsensusProblem,
    contacts: ModuleContacts,
    box: Array,
    target: Array,
    candidates: Points,
    angles: Array,
) -> Array:
    """Return the cost (n,) of candidates: distance, contact errors, collisions, joint ranges."""
    scene, radius = problem.scene, problem.scene.module.radius
    errors = candidates.position[:, CHAIN_POINTS] - target
    cost = (errors**2).sum(axis=(1, 2))
    for index, end in enumerate(contacts.ends):
        if index != contacts.root and end.kind in (FIXED, ON_BOX):
            offset = np.zeros(3) if end.place is None else end.place
            desired = offset + (box if end.kind == ON_BOX else 0.0)
            position_error = candidates.position[:, 7 * index] - desired
            cost += _VIOLATION_WEIGHT * np.linalg.norm(position_error, axis=1)
            if end.rotation is not None:
                rotation_error = candidates.rotation[:, 7 * index] - end.rotation
                cost += np.linalg.norm(rotation_error, axis=(1, 2))
        if index != contacts.root and end.kind == NOTHING:
            continue
    segments = link_segments(candidates, radius)
    half = scene.box_size[0] / 2
    low = np.vstack([(box - half)[None], scene.box_start[1:] - scene.box_size[1:] / 2])
    high = np.vstack([(box + half)[None], scene.box_start[1:] + scene.box_size[1:] / 2])
    penetration = np.maximum(-gap_to_blocks(segments, low, high, radius), 0).sum(axis=(1, 2))
    penetration += np.maximum(-gap_within(segments, radius), 0).sum(axis=1)
    penetration += np.maximum(
        -gap_to_blocks(segments, scene.solids[:, 0], scene.solids[:, 1], radius), 0
    ).sum(axis=(1, 2))
    return (
        cost
        + _PENETRATION_WEIGHT * penetration
        + _VIOLATION_WEIGHT * np.maximum(range_excess(scene.module, angles), 0)
    )
