"""Minimum movement with proof: spatial branch and bound in the meaning `contact`.

Every book stands on the ground, and its state and tilt give its height. At given tilts, non-overlap
and contact are bounds on differences of centres. A least-distance program in the centres remains.
Slots, states and tilts are searched with bounds that hold for the exact problem (`pairs`,
`contact`, `relaxation`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.exact.pairs import bound_pair_separation, fill_angle_box
from climbplan.bookshelf.exact.problem import (
    ALLOWED,
    FLAT,
    HEIGHT,
    LEAN_LEFT,
    LEAN_RIGHT,
    LEANS_LEFT,
    UPRIGHT,
    WIDTH,
    SceneArrays,
    build_problem,
    select_side,
)
from climbplan.bookshelf.exact.search import FINISHED, FULL, expand_nodes
from climbplan.bookshelf.exact.tree import (
    BEST_SLOT,
    COST,
    NODES,
    PLACE,
    PLACEMENTS,
    UNUSED,
    PlacementTree,
    compute_lower_bound,
    create_tree,
    grow_tree,
    insert_roots,
    insert_side_by_side_roots,
)
from climbplan.bookshelf.exact.workspace import NodeWorkspace, create_workspace
from climbplan.bookshelf.plan.answer import Placement, SceneAnswer, Shortage, Status
from climbplan.bookshelf.scene.shelf_scene import (
    BookState,
    Scenes,
    Shelf,
    ShelfScene,
    compute_movement_cost,
)
from climbplan.progress import hide_searches, is_observed, report_search

_CAPACITY = 1024  # nodes of a new tree
_LARGE = 65536  # a tree that has grown beyond is not used again: it takes long to empty
_CHUNK = 256  # nodes between looks at the clock, at most
_LOOK = 0.01  # [s] between looks at the clock where nodes take long
_NARROW_FRACTION = 0.3  # of the time, after which placements side by side are tried in any case
_WIDTH_STEP = 2e-5  # [m] to which a missing width is found


@dataclass(frozen=True)
class ExactLimits:
    """Termination criteria of a search."""

    gap_absolute: float = 0.01  # [mm^2]
    gap_relative: float = 1e-4
    time: float = 10.0  # [s] of one scene
    nodes: int = 5_000_000


@cache
def compile_once() -> None:
    """Compile the search, or read it from the disk, before any clock of a scene runs."""
    pose = np.array([[-0.02, 0.03, 0.0]])
    scene = ShelfScene(pose, np.array([[0.06, 0.02]]), np.array([0.06, 0.02]))
    ExactSolver(Shelf())._solve(scene)


class ExactSolver:
    """Solves scenes one after the other with reused memory; not thread-safe."""

    def __init__(self, shelf: Shelf, limits: ExactLimits | None = None, depth: float = 0.0) -> None:
        """Create a solver of scenes on one shelf.

        Args:
            shelf: walls, clear height and contact gaps.
            limits: termination criteria; the defaults if left out.
            depth: permitted penetration of books [m], for comparisons with placements that overlap.
                The check of the meaning then needs the same tolerance.
        """
        self.shelf = shelf
        self.depth = depth
        self.limits = limits or ExactLimits()
        self._workspaces: dict[int, NodeWorkspace] = {}
        self._trees: dict[int, PlacementTree] = {}

    def solve(self, scene: ShelfScene, time_limit: float | None = None) -> SceneAnswer:
        """Return the placement of minimum movement; time_limit: [s] that of the limits if left out.

        Raises:
            UsageError: sizes or poses that cannot be those of books.
        """
        compile_once()
        return self._solve(scene, self.limits.time if time_limit is None else time_limit)

    def _solve(self, scene: ShelfScene, time_limit: float = math.inf) -> SceneAnswer:
        start = time.perf_counter()
        scenes, limits = Scenes.of([scene]), self.limits
        scenes.require()
        problem = build_problem(scene, self.shelf, self.depth)
        status: Status = "infeasible"
        objective = bound = math.inf
        placement = shortage = None
        nodes = placements = 0
        if (problem.book[:, ALLOWED] == 0).any():
            shortage = self._compute_missing_height(problem)
        else:
            tree, finished = self._search(
                problem, limits.gap_absolute, limits.gap_relative, start + time_limit
            )
            nodes, placements = int(tree.counters[NODES]), int(tree.counters[PLACEMENTS])
            bound = compute_lower_bound(tree)
            if math.isfinite(tree.best[COST]):
                placement = _extract_placement(problem, tree)
                objective = float(compute_movement_cost(scenes, placement.pose[None])[0])
                bound = min(bound, objective)
                allowed = max(limits.gap_absolute, limits.gap_relative * objective)
                status = "optimal" if objective - bound <= allowed * (1 + 1e-6) else "feasible"
            elif finished:
                bound = math.inf
                with hide_searches():
                    shortage = self._find_missing_width(scene, start + time_limit)
            else:
                status = "limit"
        seconds = time.perf_counter() - start
        return SceneAnswer(
            status, placement, objective, bound, seconds, nodes, placements, shortage
        )

    def solve_all(
        self, scenes: Scenes, progress: Callable[[int], None] | None = None
    ) -> list[SceneAnswer]:
        """Solve all scenes; `progress` is called with the number of solved ones."""
        answers = []
        for scene in scenes:
            answers.append(self.solve(scene))
            if progress is not None:
                progress(len(answers))
        return answers

    def _search(
        self, problem: SceneArrays, absolute: float, relative: float, end: float
    ) -> tuple[PlacementTree, bool]:
        """Search a problem; returns the tree, and whether the search was completed."""
        n = problem.stored
        if n not in self._workspaces:
            self._workspaces[n] = create_workspace(n)
        if n not in self._trees or len(self._trees[n].pool) > _LARGE:
            self._trees[n] = create_tree(n, max(_CAPACITY, 8 * (n + 1)))
        work, tree = self._workspaces[n], self._trees[n]
        insert_roots(problem, tree)
        begin = time.perf_counter()
        narrow_time = begin + _NARROW_FRACTION * (end - begin)
        num_split, num_before_narrow, chunk = 0, 4 * (n + 1), 1
        is_narrow_offered = False
        while True:
            if not is_narrow_offered:
                chunk = min(chunk, num_before_narrow - num_split)
            before = time.perf_counter()
            state = expand_nodes(problem, work, tree, absolute, relative, chunk)
            if state == FINISHED:
                return tree, True
            now = time.perf_counter()
            if now > end or tree.counters[NODES] > self.limits.nodes:
                return tree, False
            if is_observed():
                report_search(float(tree.best[COST]), compute_lower_bound(tree))
            num_split += chunk
            if state == FULL:
                self._trees[n] = tree = grow_tree(tree)
            if not is_narrow_offered and (num_split >= num_before_narrow or now > narrow_time):
                is_narrow_offered = True
                if not math.isfinite(tree.best[COST]):
                    while tree.counters[UNUSED] < n + 1:
                        self._trees[n] = tree = grow_tree(tree)
                    insert_side_by_side_roots(problem, tree)
            chunk = min(2 * chunk, _CHUNK) if now - before < _LOOK else max(chunk // 2, 1)

    def _compute_missing_height(self, problem: SceneArrays) -> Shortage:
        """Compute the missing clear height for the book that fits neither upright nor flat."""
        smaller_side = problem.book[:, [HEIGHT, WIDTH]].min(axis=1)
        return Shortage(0.0, 0.0, 1e-3 * float(smaller_side.max()) - self.shelf.height)

    def _find_missing_width(self, scene: ShelfScene, end: float) -> Shortage:
        """Find the missing width of the shelf by bisection.

        A wider shelf keeps every placement, as some gap between books needs no contact. Bisection
        therefore separates widths that are proved insufficient from sufficient ones. The width of
        all books side by side is sufficient, and nearly always the smallest.
        """
        shelf, book = self.shelf, build_problem(scene, self.shelf).book
        fits = book[:, ALLOWED].astype(np.int64)
        flat = np.where(fits & 1 << FLAT, book[:, HEIGHT], math.inf)
        upright = np.where(fits & 1 << UPRIGHT, book[:, WIDTH], math.inf)
        sufficient_width = 1e-3 * float(np.minimum(flat, upright).sum()) - shelf.width
        insufficient_width, trial = 0.0, sufficient_width - _WIDTH_STEP
        while sufficient_width - insufficient_width > 1.001 * _WIDTH_STEP:
            wider = build_problem(scene, replace(shelf, right=shelf.right + trial), self.depth)
            tree, finished = self._search(wider, math.inf, 0.0, end)  # any placement will do
            if math.isfinite(tree.best[COST]):
                sufficient_width = trial
            elif finished:
                insufficient_width = trial
            else:
                break
            trial = 0.5 * (insufficient_width + sufficient_width)
        return Shortage(sufficient_width, insufficient_width, 0.0)


def _extract_placement(problem: SceneArrays, tree: PlacementTree) -> Placement:
    """Extract the incumbent, with the inserted book in the middle of its free interval."""
    n, book = problem.stored, problem.book
    x, tilt = np.append(tree.best[PLACE : PLACE + n], 0.0), np.zeros(n + 1)
    state, side = np.zeros(n + 1, np.int64), np.ones(n + 1)
    for k in range(n + 1):
        inner = int(tree.best_mask[k]).bit_length() - 1
        side[k], state[k] = select_side(inner), BookState.UPRIGHT
        if inner in (LEAN_LEFT, LEAN_RIGHT):
            tilt[k] = tree.best[PLACE + n + k]
            state[k] = BookState.LEAN_LEFT if inner == LEAN_LEFT else BookState.LEAN_RIGHT
        if inner == FLAT or tilt[k] == math.pi / 2:  # it lies, on the side that it was tilted to
            tilt[k] = math.pi / 2
            side[k] = 1.0 if k == n or book[k, LEANS_LEFT] > 0 else -1.0
            state[k] = BookState.FLAT_LEFT if side[k] > 0 else BookState.FLAT_RIGHT
    slot = int(tree.counters[BEST_SLOT])
    x[n] = _find_free_middle(problem, slot, x, side, tilt)
    y = (book[:, WIDTH] * np.sin(tilt) + book[:, HEIGHT] * np.cos(tilt)) / 2
    pose = np.stack([1e-3 * x, 1e-3 * y, side * tilt], axis=1)
    return Placement(pose, state, slot)


def _find_free_middle(problem: SceneArrays, slot: int, x: Array, side: Array, tilt: Array) -> float:
    """Find the middle of the interval in which the inserted book's centre is feasible."""
    n, book = problem.stored, problem.book
    boxes = np.zeros((n + 1, 7))
    for k in range(n + 1):
        fill_angle_box(tilt[k], tilt[k], boxes[k])
    half_width = (book[n, HEIGHT] * math.sin(tilt[n]) + book[n, WIDTH] * math.cos(tilt[n])) / 2
    low, high = problem.left + half_width, problem.right - half_width
    for k in range(n):
        i, j = (k, n) if k < slot else (n, k)
        min_distance = bound_pair_separation(
            side[i], book[i, WIDTH], book[i, HEIGHT], boxes[i],
            side[j], book[j, WIDTH], book[j, HEIGHT], boxes[j], 0.0,
            problem.depth,
        )[0]  # fmt: skip
        if k < slot:
            low = max(low, x[k] + min_distance)
        else:
            high = min(high, x[k] - min_distance)
    return 0.5 * (low + high)
