"""Whether obstacles close the body's way, and by how much.

Free space is the union of convex pieces, one alternative of every choice each. The level body goes
from piece to piece where both hold it at once. The widest way from start to goal is the one whose
narrowest place is widest (a bottleneck path); where even that is too narrow, the way is closed for
a body that does not turn.
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

_MOST = 216  # pieces that are looked at: three boxes
_ROOMY = 1.0  # [m] more room than this is not told apart
_SMALL = 1e-4  # [m]
_MARGIN = 0.01  # [m] beyond the least that a moved posture is moved

Piece = tuple[int, ...]  # alternative of every choice


@dataclass(frozen=True)
class Passage:
    """The narrowest place on the widest way."""

    room: float  # [m] beyond the clearance asked for on every side, negative if it is too narrow
    between: tuple[str, ...]  # alternatives that bound it: "beam face 5"


def closed_way(scene: ClimbScene) -> Iterator[Conflict]:
    """The conflict that says that the way is closed, where it is."""
    ends = list(_buried(scene))
    if ends:
        yield from ends
        return
    found = widest_way(scene)
    if found is None or found.room >= -_SMALL:
        return
    keep = scene.spec.posture.body_clearance
    short = -found.room
    names = " and ".join(dict.fromkeys(repr(n.rpartition(" face ")[0] or n) for n in found.between))
    text = (
        f"the way is closed: at {names} the body, level, lacks {1e3 * 2 * short:.0f} mm between "
        f"what is on both sides of it, or {1e3 * short:.0f} mm on one"
    )
    if keep > short:
        left = np.floor(1e3 * (keep - short) + 1e-3) / 1e3  # but for the digits of a solver
        text += f" ({1e3 * keep:.0f} mm are body_clearance)"
        remedies = (
            Remedy(f"body clearance of {1e3 * left:.0f} mm", "posture.body_clearance", float(left)),
        )
        yield Conflict("body", (text,), remedies, in_words=True)
        return
    yield Conflict("body", (text,), in_words=True)


def _buried(scene: ClimbScene) -> Iterator[Conflict]:
    """Start and goal whose body, level, is in no piece of free space."""
    rooms = _Rooms(scene)
    for name, stance in (("start", scene.start), ("goal", scene.goal)):
        for index, choice in enumerate(scene.terrain.free_choices):
            short = rooms.short(index, stance.com)
            depth, k = float(short.min()), int(short.argmin())
            if depth <= _SMALL:
                continue
            # Out across the nearest face, to the next millimetre
            way = rooms.out_of(index, k, stance.com)
            moved = stance.com + (np.ceil(1e3 * depth) / 1e3 + _MARGIN) * way
            x, y, z = (round(float(v), 4) for v in moved)
            what = choice[k].name.rpartition(" face ")[0] or choice[k].name
            keep = scene.spec.posture.body_clearance
            text = (
                f"the body, level, lacks {1e3 * depth:.0f} mm of the room beside {what!r} "
                f"(body_clearance {1e3 * keep:.0f} mm)"
            )
            words = f"a {name} {1e3 * depth:.0f} mm away"
            remedy = Remedy(words, f"task.{name}.com", (x, y, z))
            yield Conflict(f"{name} posture", (text,), (remedy,), in_words=True)


def widest_way(scene: ClimbScene) -> Passage | None:
    """The bottleneck of the body's widest way; None without obstacles, or with too many."""
    choices = scene.terrain.free_choices
    count = int(np.prod([len(choice) for choice in choices])) if choices else 0
    if not 0 < count <= _MOST:
        return None
    rooms = _Rooms(scene)
    pieces = list(itertools.product(*(range(len(choice)) for choice in choices)))
    # Dijkstra for the bottleneck: the least of -room along the way, largest first
    heap: list[tuple[float, Piece, tuple[Piece, ...]]] = [
        (-rooms.at(piece, scene.start.com), piece, (piece,)) for piece in pieces
    ]
    heapq.heapify(heap)
    goal = {piece: rooms.at(piece, scene.goal.com) for piece in pieces}
    done: set[Piece] = set()
    best: tuple[float, tuple[Piece, ...]] | None = None
    while heap:
        narrow, piece, here = heapq.heappop(heap)
        if best is not None and narrow >= best[0]:
            break
        if piece in done:
            continue
        done.add(piece)
        last = max(narrow, -goal[piece])
        if best is None or last < best[0]:
            best = (last, here if last == narrow else (piece,))
        for other in _neighbours(piece, choices):
            if other not in done:
                width = -rooms.both(piece, other)
                worst = max(narrow, width)
                at = (piece, other) if width >= narrow else here
                heapq.heappush(heap, (worst, other, at))
    if best is None:
        return None
    return Passage(-best[0], _bounding(choices, best[1]))


def _neighbours(piece: Piece, choices: tuple[tuple[FreeRegion, ...], ...]) -> Iterator[Piece]:
    """Pieces that differ in one choice."""
    for place, choice in enumerate(choices):
        for other in range(len(choice)):
            if other != piece[place]:
                yield (*piece[:place], other, *piece[place + 1 :])


def _bounding(
    choices: tuple[tuple[FreeRegion, ...], ...], pieces: tuple[Piece, ...]
) -> tuple[str, ...]:
    names = [choice[k].name for piece in pieces for choice, k in zip(choices, piece, strict=True)]
    return tuple(dict.fromkeys(names))


class _Rooms:
    """How much room pieces of free space leave to the level body's origin."""

    def __init__(self, scene: ClimbScene) -> None:
        yaw = np.array([0.0, 0.0, scene.start.rpy[2]])
        hull = scene.robot.body_hull @ rotation_world_body(yaw).T
        keep = scene.spec.posture.body_clearance
        self._rows = [
            [(r.A, r.b - keep - (r.A @ hull.T).max(axis=1)) for r in choice]
            for choice in scene.terrain.free_choices
        ]
        self._low, self._high = _reachable_box(scene)
        self._both: dict[tuple[Piece, Piece], float] = {}

    def at(self, piece: Piece, com: Array) -> float:
        """Least distance [m] of an origin from the faces of a piece, negative outside."""
        rooms = [(b - A @ com).min() for A, b in self._of(piece)]
        return float(min(min(rooms), _ROOMY))

    def short(self, index: int, com: Array) -> Array:
        """By how much (K,) [m] an origin misses each alternative of a choice, negative inside."""
        return np.array([(A @ com - b).max() for A, b in self._rows[index]])

    def out_of(self, index: int, k: int, com: Array) -> Array:
        """(3,) unit direction into an alternative, across the face that is missed by most."""
        A, b = self._rows[index][k]
        return np.asarray(-A[int((A @ com - b).argmax())])

    def both(self, first: Piece, second: Piece) -> float:
        """The most room that an origin has in two pieces at once."""
        key = (min(first, second), max(first, second))
        if key not in self._both:
            rows = [*self._of(first), *self._of(second)]
            A, b = np.vstack([a for a, _ in rows]), np.concatenate([b for _, b in rows])
            widened = np.hstack([A, np.ones((len(A), 1))])
            bounds = [*zip(self._low, self._high, strict=True), (None, _ROOMY)]
            found = linprog([0.0, 0.0, 0.0, -1.0], A_ub=widened, b_ub=b, bounds=bounds)
            self._both[key] = float(found.x[3]) if found.status == 0 else -np.inf
        return self._both[key]

    def _of(self, piece: Piece) -> list[tuple[Array, Array]]:
        return [own[k] for own, k in zip(self._rows, piece, strict=True)]


def _reachable_box(scene: ClimbScene) -> tuple[Array, Array]:
    """A box (3,), (3,) [m] that holds every body origin from which all limbs reach a region."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if scene.terrain.curved:
        return low, high
    arm = np.linalg.norm(scene.robot.shoulder_body, axis=1) + scene.robot.reach
    for limb in range(scene.robot.limb_count):
        corners = np.concatenate(
            [scene.terrain.regions[r].vertices for r in np.flatnonzero(scene.terrain.allowed[limb])]
        )
        low = np.maximum(low, corners.min(axis=0) - arm[limb])
        high = np.minimum(high, corners.max(axis=0) + arm[limb])
    return np.minimum(low, high), high
