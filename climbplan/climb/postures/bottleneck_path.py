"""Test whether obstacles block the body's path, and by how much.

Free space is the union of convex pieces, one alternative of every choice each. The level body goes
from piece to piece where both contain it at once. The widest path from start to goal is the one
whose narrowest place is widest (bottleneck shortest path). Where even that one is too narrow, the
path is blocked for a body that does not rotate.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from climbplan.arrays import Array
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Conflict, Remedy
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.model import FreeRegion

_MAX_PIECES = 216  # pieces that are looked at: three boxes
_MAX_CLEARANCE = 1.0  # [m] more room than this is not told apart
_TOLERANCE = 1e-4  # [m]
_SHIFT_MARGIN = 0.01  # [m] beyond the least that a moved posture is moved

Piece = tuple[int, ...]  # alternative of every choice


@dataclass(frozen=True)
class Bottleneck:
    """The narrowest place of the widest path."""

    clearance: (
        float  # [m] beyond the clearance asked for on every side, negative if it is too narrow
    )
    bounding_alternatives: tuple[str, ...]  # alternatives that bound it: "beam face 5"


def find_closed_passage(scene: ClimbScene) -> Iterator[Conflict]:
    """Yield the conflict that says that the path is blocked, where it is."""
    ends = list(_find_buried_ends(scene))
    if ends:
        yield from ends
        return
    bottleneck = find_widest_path(scene)
    if bottleneck is None or bottleneck.clearance >= -_TOLERANCE:
        return
    body_clearance = scene.spec.posture.body_clearance
    shortage = -bottleneck.clearance
    names = " and ".join(
        dict.fromkeys(
            repr(n.rpartition(" face ")[0] or n) for n in bottleneck.bounding_alternatives
        )
    )
    text = (
        f"the way is closed: at {names} the body, level, lacks {1e3 * 2 * shortage:.0f} mm between "
        f"what is on both sides of it, or {1e3 * shortage:.0f} mm on one"
    )
    if body_clearance > shortage:
        allowed_clearance = (
            np.floor(1e3 * (body_clearance - shortage) + 1e-3) / 1e3
        )  # but for the digits of a solver
        text += f" ({1e3 * body_clearance:.0f} mm are body_clearance)"
        remedies = (
            Remedy(
                f"body clearance of {1e3 * allowed_clearance:.0f} mm",
                "posture.body_clearance",
                float(allowed_clearance),
            ),
        )
        yield Conflict("body", (text,), remedies, in_words=True)
        return
    yield Conflict("body", (text,), in_words=True)


def _find_buried_ends(scene: ClimbScene) -> Iterator[Conflict]:
    """Yield a conflict for start and goal whose level body is in no piece of free space."""
    free_space = _OriginClearance(scene)
    for name, stance in (("start", scene.start), ("goal", scene.goal)):
        for index, choice in enumerate(scene.terrain.free_choices):
            violations = free_space.compute_violations(index, stance.com)
            depth, k = float(violations.min()), int(violations.argmin())
            if depth <= _TOLERANCE:
                continue
            # Out across the nearest face, to the next millimetre
            direction = free_space.find_exit_direction(index, k, stance.com)
            moved_origin = stance.com + (np.ceil(1e3 * depth) / 1e3 + _SHIFT_MARGIN) * direction
            x, y, z = (round(float(v), 4) for v in moved_origin)
            obstacle = choice[k].name.rpartition(" face ")[0] or choice[k].name
            body_clearance = scene.spec.posture.body_clearance
            text = (
                f"the body, level, lacks {1e3 * depth:.0f} mm of the room beside {obstacle!r} "
                f"(body_clearance {1e3 * body_clearance:.0f} mm)"
            )
            description = f"a {name} {1e3 * depth:.0f} mm away"
            remedy = Remedy(description, f"task.{name}.com", (x, y, z))
            yield Conflict(f"{name} posture", (text,), (remedy,), in_words=True)


def find_widest_path(scene: ClimbScene) -> Bottleneck | None:
    """Return the bottleneck of the body's widest path; None without obstacles, or with too many
    pieces.
    """
    choices = scene.terrain.free_choices
    count = int(np.prod([len(choice) for choice in choices])) if choices else 0
    if not 0 < count <= _MAX_PIECES:
        return None
    free_space = _OriginClearance(scene)
    pieces = list(itertools.product(*(range(len(choice)) for choice in choices)))
    # Dijkstra for the bottleneck: the least of -room along the way, largest first
    heap: list[tuple[float, Piece, tuple[Piece, ...]]] = [
        (-free_space.compute_clearance(piece, scene.start.com), piece, (piece,)) for piece in pieces
    ]
    heapq.heapify(heap)
    goal = {piece: free_space.compute_clearance(piece, scene.goal.com) for piece in pieces}
    visited: set[Piece] = set()
    best: tuple[float, tuple[Piece, ...]] | None = None
    while heap:
        negated_width, piece, bottleneck_pieces = heapq.heappop(heap)
        if best is not None and negated_width >= best[0]:
            break
        if piece in visited:
            continue
        visited.add(piece)
        negated_path_width = max(negated_width, -goal[piece])
        if best is None or negated_path_width < best[0]:
            best = (
                negated_path_width,
                bottleneck_pieces if negated_path_width == negated_width else (piece,),
            )
        for neighbour in _neighbours(piece, choices):
            if neighbour not in visited:
                negated_transition = -free_space.compute_shared_clearance(piece, neighbour)
                next_negated_width = max(negated_width, negated_transition)
                next_bottleneck = (
                    (piece, neighbour) if negated_transition >= negated_width else bottleneck_pieces
                )
                heapq.heappush(heap, (next_negated_width, neighbour, next_bottleneck))
    if best is None:
        return None
    return Bottleneck(-best[0], _name_alternatives(choices, best[1]))


def _neighbours(piece: Piece, choices: tuple[tuple[FreeRegion, ...], ...]) -> Iterator[Piece]:
    """Yield the pieces that differ in one choice."""
    for choice_index, choice in enumerate(choices):
        for alternative in range(len(choice)):
            if alternative != piece[choice_index]:
                yield (*piece[:choice_index], alternative, *piece[choice_index + 1 :])


def _name_alternatives(
    choices: tuple[tuple[FreeRegion, ...], ...], pieces: tuple[Piece, ...]
) -> tuple[str, ...]:
    """Return the names of the alternatives of some pieces, without repetition."""
    names = [choice[k].name for piece in pieces for choice, k in zip(choices, piece, strict=True)]
    return tuple(dict.fromkeys(names))


class _OriginClearance:
    """The clearance that pieces of free space leave to the level body's origin."""

    def __init__(self, scene: ClimbScene) -> None:
        yaw = np.array([0.0, 0.0, scene.start.rpy[2]])
        hull = scene.robot.body_hull @ rotation_world_body(yaw).T
        keep = scene.spec.posture.body_clearance
        self._rows = [
            [(r.A, r.b - keep - (r.A @ hull.T).max(axis=1)) for r in choice]
            for choice in scene.terrain.free_choices
        ]
        self._low, self._high = _bound_body_origin(scene)
        self._shared_clearance: dict[tuple[Piece, Piece], float] = {}

    def compute_clearance(self, piece: Piece, com: Array) -> float:
        """Return the smallest distance [m] of an origin from the faces of a piece, negative
        outside.
        """
        clearances = [(b - A @ com).min() for A, b in self._halfspaces_of(piece)]
        return float(min(min(clearances), _MAX_CLEARANCE))

    def compute_violations(self, index: int, com: Array) -> Array:
        """Return how far (K,) [m] an origin is outside each alternative of a choice, negative
        inside.
        """
        return np.array([(A @ com - b).max() for A, b in self._rows[index]])

    def find_exit_direction(self, index: int, k: int, com: Array) -> Array:
        """Return the unit direction (3,) into an alternative, across its most violated face."""
        A, b = self._rows[index][k]
        return np.asarray(-A[int((A @ com - b).argmax())])

    def compute_shared_clearance(self, first: Piece, second: Piece) -> float:
        """Return the largest clearance that an origin can have in two pieces at once."""
        key = (min(first, second), max(first, second))
        if key not in self._shared_clearance:
            rows = [*self._halfspaces_of(first), *self._halfspaces_of(second)]
            A, b = np.vstack([a for a, _ in rows]), np.concatenate([b for _, b in rows])
            widened = np.hstack([A, np.ones((len(A), 1))])
            bounds = [*zip(self._low, self._high, strict=True), (None, _MAX_CLEARANCE)]
            solution = linprog([0.0, 0.0, 0.0, -1.0], A_ub=widened, b_ub=b, bounds=bounds)
            self._shared_clearance[key] = float(solution.x[3]) if solution.status == 0 else -np.inf
        return self._shared_clearance[key]

    def _halfspaces_of(self, piece: Piece) -> list[tuple[Array, Array]]:
        """Return the halfspaces (A, b) of a piece, one pair per choice."""
        return [alternatives[k] for alternatives, k in zip(self._rows, piece, strict=True)]


def _bound_body_origin(scene: ClimbScene) -> tuple[Array, Array]:
    """Return a box (3,), (3,) [m] with every body origin from which all limbs reach a region."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if scene.terrain.is_curved:
        return low, high
    max_distance = np.linalg.norm(scene.robot.shoulder_body, axis=1) + scene.robot.reach
    for limb in range(scene.robot.limb_count):
        corners = np.concatenate(
            [scene.terrain.regions[r].vertices for r in np.flatnonzero(scene.terrain.allowed[limb])]
        )
        low = np.maximum(low, corners.min(axis=0) - max_distance[limb])
        high = np.minimum(high, corners.max(axis=0) + max_distance[limb])
    return np.minimum(low, high), high
