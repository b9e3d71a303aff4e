"""Methods that work on the statement: the whole of it, envelopes, complementarity, ADMM.

Each gives a point of the statement; its integers are kept, the program that is left is solved
again so that nothing leaks into the answer, and the exact check of the meaning judges.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from climbplan.bookshelf.answer import Placement, SceneAnswer, Status
from climbplan.bookshelf.check.meanings import check_placements
from climbplan.bookshelf.methods.envelope_grids import published_partitions
from climbplan.bookshelf.points import as_stored, placement_of, point_of, settled, theta_of
from climbplan.bookshelf.scene import Array, Scene, Scenes, Shelf, movement_cost
from climbplan.bookshelf.statement import bookshelf
from climbplan.methods.envelope_rounds import MICP_SOLVERS
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.reformulations.complementarity import Complementarity
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.envelopes import Squares
from climbplan.reformulations.mccormick import EnvelopeForm, McCormick
from climbplan.solvers.admm import AdmmOptions, solve_admm
from climbplan.solvers.bonmin import solve_bonmin
from climbplan.solvers.ipopt.instances import solve_pinned
from climbplan.solvers.ipopt.mpcc import STRAIGHT, solve_mpcc
from climbplan.solvers.registry import require
from climbplan.solvers.result import SolverResult
from climbplan.spec.bookshelf.model import Meaning

POLISH_SECONDS = 2.0  # for the program that is left when the integers are kept
# Of solvers' points [mm, sines]: the check of the placement is what counts.
_LOOSE = 1e-5
_LEVER = 50.0  # [mm] half a book: what a change of a sine moves
_ADMM_WEIGHT = 10.0  # [mm^2 / mm] of a distance; 0.1 to 10 solved the eight scenes tried alike
_ADMM_RESIDUAL = 0.01  # of the variables' spans: 1.6 mm, the accuracy of the published solutions
_ADMM_GAP = 1e-2  # the published gap of the mixed-integer block


@dataclass(frozen=True)
class Judged:
    """A placement that holds, or why there is none."""

    placement: Placement | None
    objective: float  # [mm^2], infinite without a placement
    word: str = ""


class Judge:
    """The statement of one meaning and shelf, and the exact check that judges its points."""

    def __init__(self, count: int, shelf: Shelf, meaning: Meaning) -> None:
        self.program: Program = bookshelf(count, shelf, meaning)
        self.shelf = shelf
        self.meaning: Meaning = meaning

    def instance(self, scene: Scene) -> Instance:
        """The numbers of a scene."""
        return self.program.at(theta_of(scene))

    def judge(self, scene: Scene, x: Array) -> Judged:
        """The placement of a point (N,) if the exact check lets it pass."""
        return self.judge_placement(scene, placement_of(self.program, scene, x))

    def judge_placement(self, scene: Scene, placement: Placement) -> Judged:
        """A placement if the exact check lets it pass.

        In the meaning `contact` angles and heights are those that the states demand: what a solver
        leaves of rounding does not count.
        """
        scenes = Scenes.of([scene])
        if self.meaning == "contact":
            placement = settled(scene, placement)
        pose, state = placement.pose[None], placement.state[None]
        check = check_placements(scenes, pose, state, self.shelf, self.meaning)
        if not check.passed[0]:
            return Judged(None, math.inf, check.explain(0).replace("\n", "; "))
        return Judged(placement, float(movement_cost(scenes, pose)[0]))

    def answer(self, scene: Scene, result: SolverResult, begin: float) -> SceneAnswer:
        """What a solver says of a scene's instance, judged; begin: `time.perf_counter` seconds."""
        judged = Judged(None, math.inf, _why(result))
        if result.x is not None:
            judged = self.judge(scene, result.x)
        return SceneAnswer(
            status=_status(result, judged),
            placement=judged.placement,
            objective=judged.objective,
            bound=min(result.bound, judged.objective),
            seconds=time.perf_counter() - begin,
            nodes=result.nodes,
            candidates=1,
            word=judged.word,
        )


def _status(result: SolverResult, judged: Judged) -> Status:
    if judged.placement is not None:
        return "optimal" if result.status == "optimal" else "feasible"
    return "infeasible" if result.status == "infeasible" else "limit"


def _why(result: SolverResult) -> str:
    said = f" ({'; '.join(result.log)})" if result.log else ""
    return f"{result.solver} found none in {result.time:.1f} s{said}"


@dataclass(frozen=True)
class Budget:
    """When a method ends."""

    gap: float  # relative
    seconds: float


class MinlpScip:
    """SCIP on the whole statement: bounds are valid for it up to SCIP's row tolerance."""

    def __init__(self, judge: Judge, budget: Budget) -> None:
        self.judge, self.budget = judge, budget
        self._solver = require("minlp-scip").load()

    def solve(self, scene: Scene) -> SceneAnswer:
        """Without a start: an oracle that owes nothing to the other methods."""
        begin = time.perf_counter()
        instance = self.judge.instance(scene)
        result = self._solver(instance, self.budget.gap, self.budget.seconds)
        return self.judge.answer(scene, result, begin)


class MinlpBonmin:
    """Bonmin on the whole statement: local optima, no bound; a baseline."""

    def __init__(self, judge: Judge, budget: Budget) -> None:
        self.judge, self.budget = judge, budget

    def solve(self, scene: Scene) -> SceneAnswer:
        """From the manual start."""
        begin = time.perf_counter()
        instance = self.judge.instance(scene)
        start = manual_point(self.judge, scene)
        result = solve_bonmin(instance, self.budget.gap, self.budget.seconds, start=start)
        return self.judge.answer(scene, result, begin)


class Micp:
    """Envelopes on the published pieces, log2 N binaries each; then the program that is left.

    In the meaning `contact` squares have true envelopes, so that the bound is valid; `published`
    has the published secants, and no bound.
    """

    def __init__(self, judge: Judge, budget: Budget, solver: str) -> None:
        self.judge, self.budget = judge, budget
        self._solver = require(MICP_SOLVERS[solver]).load()
        squares: Squares = "envelope" if judge.meaning == "contact" else "secant"
        self.method = McCormick(published_partitions(judge.program), "log2", squares)
        self._form: EnvelopeForm | None = None

    def solve(self, scene: Scene) -> SceneAnswer:
        """The optimum over the envelopes, made exact with its integers."""
        begin = time.perf_counter()
        instance = self.judge.instance(scene)
        if self._form is None:
            self._form = self.method.form(instance)
        enveloped = self._form.at(instance)
        flat = BigM().apply(enveloped.instance)
        found = self._solver(flat.instance, self.budget.gap, self.budget.seconds)
        bound = found.bound if enveloped.relaxation else -math.inf
        if found.x is None:
            word = f"no point of the envelopes in {found.time:.1f} s"
            status: Status = "limit"
            if found.status == "infeasible" and enveloped.relaxation:
                status, word = "infeasible", "even the envelopes have no point"
            seconds = time.perf_counter() - begin
            return SceneAnswer(status, None, math.inf, bound, seconds, found.nodes, 1, word=word)
        x = enveloped.invert(flat.invert(found.x))
        exact = solve_pinned(instance, x, deadline=time.monotonic() + POLISH_SECONDS)
        result = replace(found, x=exact.v, bound=bound, status="feasible")
        answer = self.judge.answer(scene, result, begin)
        tight = answer.objective - bound <= self.budget.gap * max(answer.objective, 1.0)
        return replace(answer, status="optimal") if tight else answer


Starts = Callable[[Judge, Scene], Iterable[Array]]  # points of the statement, best first


class Mpcc:
    """Complementarity with big-M coupling from one or several starts; the first that holds wins."""

    def __init__(self, judge: Judge, budget: Budget, starts: Starts) -> None:
        self.judge, self.budget, self.starts = judge, budget, starts
        self.method = Complementarity(coupling="big-m")

    def solve(self, scene: Scene) -> SceneAnswer:
        """Straight to the published eps from each start, then the program that is left."""
        begin = time.perf_counter()
        instance = self.judge.instance(scene)
        nodes, tried, word = 0, 0, ""
        for tried, start in enumerate(self.starts(self.judge, scene), 1):
            left = self.budget.seconds - (time.perf_counter() - begin)
            if left <= 0:
                break
            result = solve_mpcc(
                instance,
                self.budget.gap,
                left,
                start=start,
                method=self.method,
                homotopy=STRAIGHT,
                tolerance=_LOOSE,
            )
            nodes += result.nodes
            answer = self.judge.answer(scene, result, begin)
            word = answer.word
            if answer.placement is not None:
                return replace(answer, nodes=nodes, candidates=tried)
        seconds = time.perf_counter() - begin
        return SceneAnswer(
            "limit", None, math.inf, -math.inf, seconds, nodes, max(tried, 1), word=word
        )


class Admm:
    """Algorithm 3 of chapter 6.4 from the manual start: integers and envelopes against products.

    The published weights are not known. Ours: millimetres as they are, cosines, sines and normals
    by the length of a book, so that the cost at the start, next to nothing, does not set them. The
    best iterate is kept.
    """

    def __init__(self, judge: Judge, budget: Budget, solver: str) -> None:
        self.judge, self.budget = judge, budget
        self._solver = require(MICP_SOLVERS[solver]).load()
        weight = np.zeros(max(v.stop for v in judge.program.variables.values()))
        for variable in judge.program.variables.values():
            unit = 1.0 if variable.unit == "mm" else _LEVER**2
            if not variable.integer:
                weight[variable.start : variable.stop] = _ADMM_WEIGHT * unit
        self.options = AdmmOptions(weight=weight, norm="l1", residual=_ADMM_RESIDUAL)

    def solve(self, scene: Scene) -> SceneAnswer:
        """Alternate until both blocks agree to the published accuracy."""
        begin = time.perf_counter()
        instance = self.judge.instance(scene)
        found = solve_admm(
            instance,
            self._mixed_integer,
            start=manual_point(self.judge, scene),
            options=self.options,
            gap=self.budget.gap,
            time_limit=self.budget.seconds,
            tolerance=_LOOSE,
        )
        return self.judge.answer(scene, found.result, begin)

    def _mixed_integer(self, block: Instance) -> Array | None:
        flat = BigM().apply(block)
        found = self._solver(flat.instance, _ADMM_GAP, self.budget.seconds)
        return None if found.x is None else flat.invert(found.x)


def zero_start(judge: Judge, scene: Scene) -> list[Array]:
    """What a solver takes without a start."""
    return [np.zeros(judge.instance(scene).size)]


def manual_start(judge: Judge, scene: Scene) -> list[Array]:
    """The manual point alone."""
    return [manual_point(judge, scene)]


def manual_point(judge: Judge, scene: Scene) -> Array:
    """The scene as it is, the inserted book in the widest gap, lines solved before
    (chapter 8.1.3.2)."""
    return point_of(judge.program, scene, as_stored(scene))
