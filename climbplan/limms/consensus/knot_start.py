"""Where the nonlinear block begins at a knot: inverse kinematics in closed form, all branches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.knot_modes import (
    FIXED,
    NOTHING,
    ON_BOX,
    ON_MODULE,
    ON_PATCH,
    Hands,
    patch_bounds,
)
from climbplan.limms.consensus.knot_program import Pose
from climbplan.limms.consensus.setting import CHAIN_POINTS, Setting
from climbplan.limms.modules.chain import BRANCHES, forward, from_last, in_range, inverse
from climbplan.limms.modules.contact import gap_between, gap_to_blocks, gap_within, link_segments
from climbplan.limms.modules.limbs import standing_rotation
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, Points, anchor_frame
from climbplan.limms.scene.limms_scene import Pose as Frame

_DEEP = 50.0  # [1/m] what a collision counts against squared distances
_STANCES = (0.3, 0.38, 0.46, 0.54, 0.62)  # [m] of feet from their faces
_OUT = 10.0  # [1/m], [1/rad] what a reach or range that is missing counts


def start_at(
    setting: Setting,
    hands: Sequence[Hands],
    box: Array,
    points: Array,
    before: Sequence[Array | None],
) -> tuple[Pose, list[Points]]:
    """The best candidate of each module for itself; and where their points are.

    box: (3,), points: (L, 5, 3) targets; before: angles of other iterates or knots (n, 6) or None.
    """
    L = setting.scene.count
    roots, angles = np.zeros((L, 3)), np.zeros((L, 6))
    placed: dict[int, Points] = {}
    for m in sorted(range(L), key=lambda m: hands[m].parent >= 0):
        first, last = _frames(setting, hands, m, box, points[m], placed)
        root = hands[m].root
        place = forward if root == 0 else from_last
        base = first if root == 0 else last
        candidates = [np.zeros(6)]
        earlier = before[m]
        if earlier is not None:
            candidates += list(np.atleast_2d(earlier))
        places, missing = [base.position] * len(candidates), [0.0] * len(candidates)
        for place_of_root in _roots(setting, hands[m], box, base.position):
            moved = Frame(place_of_root, base.rotation)
            for branch in BRANCHES:
                ends = (moved, last) if root == 0 else (first, moved)
                solution = inverse(setting.scene.module, *ends, branch)
                candidates.append(solution.angles)
                places.append(place_of_root)
                missing.append(float(solution.missing))
        stack = np.array(candidates)
        shape = (len(stack), 3, 3)
        many = Frame(np.array(places), np.broadcast_to(base.rotation, shape))
        found = place(setting.scene.module, many, stack)
        trouble = _trouble(setting, hands[m], box, points[m], found, stack)
        trouble += _DEEP * _into(setting, hands, m, found, placed)
        trouble += _OUT * np.array(missing)
        best = int(np.argmin(trouble))
        angles[m], roots[m] = stack[best], places[best]
        placed[m] = Points(found.position[best], found.rotation[best])
    return Pose(box, roots, angles), [placed[m] for m in range(L)]


def _roots(setting: Setting, hands: Hands, box: Array, place: Array) -> Iterator[Array]:
    """Where the root may be: as it is, and for a leg that stands at some distances of its face."""
    yield place
    end = hands.ends[0]
    if hands.root != 0 or end.side < 0 or end.kind != ON_PATCH:
        return
    normal = SIDE_NORMALS[end.side]
    half = float(abs(normal) @ setting.scene.box_size[0]) / 2
    aside = (place - box) - ((place - box) @ normal) * normal
    for share in (1.0, 0.0):
        for away in _STANCES:
            wanted = box + share * aside + (half + away) * normal
            yield np.clip(wanted, *patch_bounds(setting, end.patch))


def _frames(
    setting: Setting,
    hands: Sequence[Hands],
    m: int,
    box: Array,
    points: Array,
    placed: dict[int, Points],
) -> tuple[Frame, Frame]:
    """Where both ends should be: as they are held, else as the targets say."""
    frames = []
    for number, end in enumerate(hands[m].ends):
        position, near = (points[0], points[1]) if number == 0 else (points[4], points[3])
        axis = near - position if number == 0 else position - near
        rotation = end.rotation
        if rotation is None:
            length = float(np.linalg.norm(axis))
            rotation = anchor_frame(axis / length) if length > 1e-6 else standing_rotation(0)
        if end.kind == FIXED and end.place is not None:
            position = end.place
        elif end.kind == ON_BOX and end.place is not None:
            position = box + end.place
        elif end.kind == ON_PATCH:
            position = np.clip(position, *patch_bounds(setting, end.patch))
        elif end.kind == ON_MODULE:
            theirs = placed[end.parent]
            there = 0 if setting.box_end[end.parent] == 0 else 7
            flip = np.eye(3) if there == 0 else np.diag([1.0, -1.0, -1.0])
            position, rotation = theirs.position[there], theirs.rotation[there] @ flip
        frames.append(Frame(np.asarray(position, float), np.asarray(rotation, float)))
    return frames[0], frames[1]


def _into(
    setting: Setting, hands: Sequence[Hands], m: int, found: Points, placed: dict[int, Points]
) -> Array:
    """How deep candidates (n) of a module are in those that are placed; chains touch."""
    radius = setting.scene.module.radius
    segments = link_segments(found, radius)
    deep = np.zeros(len(segments))
    for other, theirs in placed.items():
        if hands[m].parent == other:
            continue
        apart = gap_between(segments, link_segments(theirs, radius), radius)
        deep += np.maximum(-apart, 0).sum(axis=(1, 2))
    return deep


def _trouble(
    setting: Setting, hands: Hands, box: Array, target: Array, found: Points, angles: Array
) -> Array:
    """How bad candidates (n) are: distance, missed ends, collisions, range."""
    scene, radius = setting.scene, setting.scene.module.radius
    off = found.position[:, CHAIN_POINTS] - target
    cost = (off**2).sum(axis=(1, 2))
    for number, end in enumerate(hands.ends):
        if number != hands.root and end.kind in (FIXED, ON_BOX):
            at = np.zeros(3) if end.place is None else end.place
            wanted = at + (box if end.kind == ON_BOX else 0.0)
            gone = found.position[:, 7 * number] - wanted
            cost += _OUT * np.linalg.norm(gone, axis=1)
            if end.rotation is not None:
                turned = found.rotation[:, 7 * number] - end.rotation
                cost += np.linalg.norm(turned, axis=(1, 2))
        if number != hands.root and end.kind == NOTHING:
            continue
    segments = link_segments(found, radius)
    half = scene.box_size[0] / 2
    low = np.vstack([(box - half)[None], scene.box_start[1:] - scene.box_size[1:] / 2])
    high = np.vstack([(box + half)[None], scene.box_start[1:] + scene.box_size[1:] / 2])
    deep = np.maximum(-gap_to_blocks(segments, low, high, radius), 0).sum(axis=(1, 2))
    deep += np.maximum(-gap_within(segments, radius), 0).sum(axis=1)
    deep += np.maximum(
        -gap_to_blocks(segments, scene.solids[:, 0], scene.solids[:, 1], radius), 0
    ).sum(axis=(1, 2))
    return cost + _DEEP * deep + _OUT * np.maximum(in_range(scene.module, angles), 0)
