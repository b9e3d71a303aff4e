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
from dataclasses import dataclass
from typing import Literal

import numpy as np

from climbplan.bookshelf.exact_pairs import box_row, pair_floor
from climbplan.bookshelf.exact_problem import (
    ALLOWED,
    FLAT,
    HEIGHT,
    LEAN_LEFT,
    LEAN_RIGHT,
    LEANS_LEFT,
    WIDTH,
    X0,
    Problem,
    build_problem,
    side_of,
)
from climbplan.bookshelf.exact_rows import Sheet, new_sheet
from climbplan.bookshelf.exact_tree import (
    BEST_SLOT,
    COST,
    FINISHED,
    FULL,
    NODES,
    PLACE,
    PLACEMENTS,
    Tree,
    advance,
    grown,
    least_bound,
    new_tree,
    plant,
)
from climbplan.bookshelf.scene import Array, Scene, Scenes, Shelf, State, States, movement_cost

Status = Literal["optimal", "feasible", "infeasible", "limit"]

_CAPACITY = 1024  # nodes of a new tree
_CHUNK = 256  # nodes between looks at the clock
_WIDENING_GAP = 1e-3  # absolute [mm^2] and relative, of the squared missing width


@dataclass(frozen=True)
class ExactLimits:
    """When a search ends."""

    gap_absolute: float = 0.01  # [mm^2]
    gap_relative: float = 1e-4
    time: float = 10.0  # [s] of one scene
    nodes: int = 5_000_000


@dataclass(frozen=True)
class Placement:
    """Where all books are after the insertion, the inserted one last."""

    pose: Array  # (n + 1, 3) x [m], y [m], angle [rad]
    state: States  # (n + 1,) of `State`
    slot: int  # stored books left of the inserted one


@dataclass(frozen=True)
class Shortage:
    """By how much a scene without a placement misses one."""

    width: float  # [m] a shelf this much wider has a placement
    width_bound: float  # [m] and none that is widened by less
    height: float  # [m] missing clear height; the widths are zero then


@dataclass(frozen=True)
class ExactAnswer:
    """What the search found for one scene."""

    status: Status  # `limit`: no placement found in time, `feasible`: found but the gap is open
    placement: Placement | None
    objective: float  # [mm^2] movement cost, infinite without a placement
    bound: float  # [mm^2] no placement costs less
    shortage: Shortage | None  # if infeasible
    nodes: int
    placements: int  # exact placements tried
    seconds: float

    @property
    def gap(self) -> float:
        """objective - bound [mm^2]."""
        return self.objective - self.bound if math.isfinite(self.objective) else math.inf


class ExactSolver:
    """Solves scenes one after the other, keeping its space; not for several threads at once."""

    def __init__(self, shelf: Shelf, limits: ExactLimits | None = None) -> None:
        self.shelf = shelf
        self.limits = limits or ExactLimits()
        self._sheets: dict[int, Sheet] = {}
        self._trees: dict[int, Tree] = {}

    def solve(self, scene: Scene) -> ExactAnswer:
        """The placement of least movement.

        Raises:
            UsageError: sizes or poses that cannot be those of books.
        """
        start = time.perf_counter()
        Scenes.of([scene]).require()
        limits = self.limits
        problem = build_problem(scene, self.shelf)
        end = start + limits.time
        tree, finished = self._search(problem, limits.gap_absolute, limits.gap_relative, end)
        bound, shortage = least_bound(tree), None
        placement, objective = None, math.inf
        if math.isfinite(tree.best[COST]):
            placement = _placement(problem, tree)
            objective = float(movement_cost(Scenes.of([scene]), placement.pose[None])[0])
            bound = min(bound, objective)
            status: Status = "optimal" if finished else "feasible"
        elif finished:
            status, bound = "infeasible", math.inf
            shortage = self._shortage(scene, start + 2 * limits.time)
        else:
            status = "limit"
        # A widening overwrites the counts.
        nodes, placements = int(tree.tally[NODES]), int(tree.tally[PLACEMENTS])
        seconds = time.perf_counter() - start
        return ExactAnswer(
            status, placement, objective, bound, shortage, nodes, placements, seconds
        )

    def solve_all(
        self, scenes: Scenes, progress: Callable[[int], None] | None = None
    ) -> list[ExactAnswer]:
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
        n = problem.books
        if n not in self._trees:
            self._sheets[n], self._trees[n] = new_sheet(n), new_tree(n, _CAPACITY)
        sheet, tree = self._sheets[n], self._trees[n]
        plant(problem, tree)
        while True:
            state = advance(problem, sheet, tree, absolute, relative, _CHUNK)
            if state == FINISHED:
                return tree, True
            if time.perf_counter() > end or tree.tally[NODES] > self.limits.nodes:
                return tree, False
            if state == FULL:
                self._trees[n] = tree = grown(tree)

    def _shortage(self, scene: Scene, end: float) -> Shortage:
        """How much wider or higher the shelf would have to be."""
        clear = 1e3 * self.shelf.height
        problem = build_problem(scene, self.shelf, elastic=True)
        least = problem.book[:, [HEIGHT, WIDTH]].min(axis=1)
        if (problem.book[:, ALLOWED] == 0).any():
            return Shortage(0.0, 0.0, 1e-3 * float(least.max() - clear))
        tree, _ = self._search(problem, _WIDENING_GAP, _WIDENING_GAP, end)
        wider = float(tree.best[PLACE + problem.books] - problem.right)
        # The bound is on the squared width plus next to nothing times squared moves.
        span = problem.right + wider - problem.left
        far = np.abs(problem.book[:-1, X0] - (problem.left + problem.right) / 2) + span
        square = least_bound(tree) - problem.weight_x * float((far**2).sum())
        return Shortage(1e-3 * wider, 1e-3 * math.sqrt(max(0.0, square)), 0.0)


def _placement(problem: Problem, tree: Tree) -> Placement:
    """The incumbent, with the inserted book in the middle of its free interval."""
    n, book = problem.books, problem.book
    x, tilt = tree.best[PLACE : PLACE + n + 1].copy(), np.zeros(n + 1)
    state, side = np.zeros(n + 1, np.int64), np.ones(n + 1)
    for k in range(n + 1):
        inner = int(tree.best_mask[k]).bit_length() - 1
        side[k] = side_of(inner)
        if inner == LEAN_LEFT or inner == LEAN_RIGHT:
            tilt[k] = tree.best[PLACE + n + 1 + k]
            state[k] = State.LEAN_LEFT if inner == LEAN_LEFT else State.LEAN_RIGHT
        elif inner == FLAT:
            tilt[k] = math.pi / 2
            side[k] = 1.0 if k == n or book[k, LEANS_LEFT] > 0 else -1.0
            state[k] = State.FLAT_LEFT if side[k] > 0 else State.FLAT_RIGHT
        else:
            state[k] = State.UPRIGHT
    slot = int(tree.tally[BEST_SLOT])
    x[n] = _free_middle(problem, slot, x, side, tilt)
    y = (book[:, WIDTH] * np.sin(tilt) + book[:, HEIGHT] * np.cos(tilt)) / 2
    pose = np.stack([1e-3 * x, 1e-3 * y, side * tilt], axis=1)
    return Placement(pose, state, slot)


def _free_middle(problem: Problem, slot: int, x: Array, side: Array, tilt: Array) -> float:
    """Middle of where the inserted book's centre may be."""
    n, book = problem.books, problem.book
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
        )[0]  # fmt: skip
        if k < slot:
            low = max(low, x[k] + apart)
        else:
            high = min(high, x[k] - apart)
    return 0.5 * (low + high)
