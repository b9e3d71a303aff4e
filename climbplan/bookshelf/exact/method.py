"""Least movement, proved: geometric branch and bound in the meaning `contact`.

Every book stands on the ground, so that a state and a tilt give its height; non-overlap and contact
at given tilts are bounds on differences of centres, and a least-distance program in the centres
remains. Slots, states and tilts are searched with bounds that hold for the exact problem
(`exact_pairs`, `exact_contact`, `exact_relax`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.exact.pairs import box_row, pair_floor
from climbplan.bookshelf.exact.problem import (
    ALLOWED,
    FLAT,
    HEIGHT,
    LEAN_LEFT,
    LEAN_RIGHT,
    LEANS_LEFT,
    UPRIGHT,
    WIDTH,
    Problem,
    build_problem,
    side_of,
)
from climbplan.bookshelf.exact.search import FINISHED, FULL, advance
from climbplan.bookshelf.exact.sheet import Sheet, new_sheet
from climbplan.bookshelf.exact.tree import (
    BEST_SLOT,
    COST,
    NODES,
    PLACE,
    PLACEMENTS,
    UNUSED,
    Tree,
    grown,
    least_bound,
    new_tree,
    offer_narrow,
    plant,
)
from climbplan.bookshelf.plan.answer import Placement, SceneAnswer, Shortage, Status
from climbplan.bookshelf.scene.shelf_scene import Scene, Scenes, Shelf, State, movement_cost

_CAPACITY = 1024  # nodes of a new tree
_LARGE = 65536  # a tree that has grown beyond is not used again: it takes long to empty
_CHUNK = 256  # nodes between looks at the clock, at most
_LOOK = 0.01  # [s] between looks at the clock where nodes take long
_NARROW_FRACTION = 0.3  # of the time, after which placements side by side are tried in any case
_WIDTH_STEP = 2e-5  # [m] to which a missing width is found


@dataclass(frozen=True)
class ExactLimits:
    """When a search ends."""

    gap_absolute: float = 0.01  # [mm^2]
    gap_relative: float = 1e-4
    time: float = 10.0  # [s] of one scene
    nodes: int = 5_000_000


@cache
def compile_once() -> None:
    """Compile the search, or read it from the disk, before any clock of a scene runs."""
    pose = np.array([[-0.02, 0.03, 0.0]])
    scene = Scene(pose, np.array([[0.06, 0.02]]), np.array([0.06, 0.02]))
    ExactSolver(Shelf())._solve(scene)


class ExactSolver:
    """Solves scenes one after the other, keeping its space; not for several threads at once."""

    def __init__(self, shelf: Shelf, limits: ExactLimits | None = None, depth: float = 0.0) -> None:
        """depth: by which books may penetrate each other [m], for comparisons with placements that
        do; then the check of the meaning has to be given as much."""
        self.shelf = shelf
        self.depth = depth
        self.limits = limits or ExactLimits()
        self._sheets: dict[int, Sheet] = {}
        self._trees: dict[int, Tree] = {}

    def solve(self, scene: Scene, time_limit: float | None = None) -> SceneAnswer:
        """The placement of least movement; time_limit: [s] that of the limits if left out.

        Raises:
            UsageError: sizes or poses that cannot be those of books.
        """
        compile_once()
        return self._solve(scene, self.limits.time if time_limit is None else time_limit)

    def _solve(self, scene: Scene, time_limit: float = math.inf) -> SceneAnswer:
        start = time.perf_counter()
        scenes, limits = Scenes.of([scene]), self.limits
        scenes.require()
        problem = build_problem(scene, self.shelf, self.depth)
        status: Status = "infeasible"
        objective = bound = math.inf
        placement = shortage = None
        nodes = placements = 0
        if (problem.book[:, ALLOWED] == 0).any():
            shortage = self._missing_height(problem)
        else:
            tree, finished = self._search(
                problem, limits.gap_absolute, limits.gap_relative, start + time_limit
            )
            nodes, placements = int(tree.tally[NODES]), int(tree.tally[PLACEMENTS])
            bound = least_bound(tree)
            if math.isfinite(tree.best[COST]):
                placement = _placement(problem, tree)
                objective = float(movement_cost(scenes, placement.pose[None])[0])
                bound = min(bound, objective)
                allowed = max(limits.gap_absolute, limits.gap_relative * objective)
                status = "optimal" if objective - bound <= allowed * (1 + 1e-6) else "feasible"
            elif finished:
                bound = math.inf
                shortage = self._missing_width(scene, start + time_limit)
            else:
                status = "limit"
        seconds = time.perf_counter() - start
        return SceneAnswer(
            status, placement, objective, bound, seconds, nodes, placements, shortage
        )

    def solve_all(
        self, scenes: Scenes, progress: Callable[[int], None] | None = None
    ) -> list[SceneAnswer]:
        """Answers to all scenes; `progress` is called with the number done."""
        answers = []
        for scene in scenes:
            answers.append(self.solve(scene))
            if progress is not None:
                progress(len(answers))
        return answers

    def _search(
        self, problem: Problem, absolute: float, relative: float, end: float
    ) -> tuple[Tree, bool]:
        """The tree after the search, and whether it was finished."""
        n = problem.stored
        if n not in self._sheets:
            self._sheets[n] = new_sheet(n)
        if n not in self._trees or len(self._trees[n].pool) > _LARGE:
            self._trees[n] = new_tree(n, max(_CAPACITY, 8 * (n + 1)))
        sheet, tree = self._sheets[n], self._trees[n]
        plant(problem, tree)
        begin = time.perf_counter()
        narrow_time = begin + _NARROW_FRACTION * (end - begin)
        num_split, num_before_narrow, chunk = 0, 4 * (n + 1), 1
        is_narrow_offered = False
        while True:
            if not is_narrow_offered:
                chunk = min(chunk, num_before_narrow - num_split)
            before = time.perf_counter()
            state = advance(problem, sheet, tree, absolute, relative, chunk)
            if state == FINISHED:
                return tree, True
            now = time.perf_counter()
            if now > end or tree.tally[NODES] > self.limits.nodes:
                return tree, False
            num_split += chunk
            if state == FULL:
                self._trees[n] = tree = grown(tree)
            if not is_narrow_offered and (num_split >= num_before_narrow or now > narrow_time):
                is_narrow_offered = True
                if not math.isfinite(tree.best[COST]):
                    while tree.tally[UNUSED] < n + 1:
                        self._trees[n] = tree = grown(tree)
                    offer_narrow(problem, tree)
            chunk = min(2 * chunk, _CHUNK) if now - before < _LOOK else max(chunk // 2, 1)

    def _missing_height(self, problem: Problem) -> Shortage:
        """What the clear height misses for the book that fits neither upright nor flat."""
        least = problem.book[:, [HEIGHT, WIDTH]].min(axis=1)
        return Shortage(0.0, 0.0, 1e-3 * float(least.max()) - self.shelf.height)

    def _missing_width(self, scene: Scene, end: float) -> Shortage:
        """How much wider the shelf would have to be.

        A wider shelf keeps every placement, as some gap between books needs no contact: bisection
        between widths that are proved too little and enough. Books side by side are enough, and
        nearly always the least.
        """
        shelf, book = self.shelf, build_problem(scene, self.shelf).book
        fits = book[:, ALLOWED].astype(np.int64)
        flat = np.where(fits & 1 << FLAT, book[:, HEIGHT], math.inf)
        upright = np.where(fits & 1 << UPRIGHT, book[:, WIDTH], math.inf)
        enough = 1e-3 * float(np.minimum(flat, upright).sum()) - shelf.width
        short, trial = 0.0, enough - _WIDTH_STEP
        while enough - short > 1.001 * _WIDTH_STEP:
            wider = build_problem(scene, replace(shelf, right=shelf.right + trial), self.depth)
            tree, finished = self._search(wider, math.inf, 0.0, end)  # any placement will do
            if math.isfinite(tree.best[COST]):
                enough = trial
            elif finished:
                short = trial
            else:
                break
            trial = 0.5 * (short + enough)
        return Shortage(enough, short, 0.0)


def _placement(problem: Problem, tree: Tree) -> Placement:
    """The incumbent, with the inserted book in the middle of its free interval."""
    n, book = problem.stored, problem.book
    x, tilt = np.append(tree.best[PLACE : PLACE + n], 0.0), np.zeros(n + 1)
    state, side = np.zeros(n + 1, np.int64), np.ones(n + 1)
    for k in range(n + 1):
        inner = int(tree.best_mask[k]).bit_length() - 1
        side[k], state[k] = side_of(inner), State.UPRIGHT
        if inner in (LEAN_LEFT, LEAN_RIGHT):
            tilt[k] = tree.best[PLACE + n + k]
            state[k] = State.LEAN_LEFT if inner == LEAN_LEFT else State.LEAN_RIGHT
        if inner == FLAT or tilt[k] == math.pi / 2:  # it lies, on the side that it was tilted to
            tilt[k] = math.pi / 2
            side[k] = 1.0 if k == n or book[k, LEANS_LEFT] > 0 else -1.0
            state[k] = State.FLAT_LEFT if side[k] > 0 else State.FLAT_RIGHT
    slot = int(tree.tally[BEST_SLOT])
    x[n] = _free_middle(problem, slot, x, side, tilt)
    y = (book[:, WIDTH] * np.sin(tilt) + book[:, HEIGHT] * np.cos(tilt)) / 2
    pose = np.stack([1e-3 * x, 1e-3 * y, side * tilt], axis=1)
    return Placement(pose, state, slot)


def _free_middle(problem: Problem, slot: int, x: Array, side: Array, tilt: Array) -> float:
    """Middle of where the inserted book's centre may be."""
    n, book = problem.stored, problem.book
    boxes = np.zeros((n + 1, 7))
    for k in range(n + 1):
        box_row(tilt[k], tilt[k], boxes[k])
    own = (book[n, HEIGHT] * math.sin(tilt[n]) + book[n, WIDTH] * math.cos(tilt[n])) / 2
    low, high = problem.left + own, problem.right - own
    for k in range(n):
        i, j = (k, n) if k < slot else (n, k)
        apart = pair_floor(
            side[i], book[i, WIDTH], book[i, HEIGHT], boxes[i],
            side[j], book[j, WIDTH], book[j, HEIGHT], boxes[j], 0.0,
            problem.depth,
        )[0]  # fmt: skip
        if k < slot:
            low = max(low, x[k] + apart)
        else:
            high = min(high, x[k] - apart)
    return 0.5 * (low + high)
