"""Solve the same problem repeatedly with changing parameters, each warm-started by the last.

Method `branch-and-bound` stores leaves, with products also boxes; why these remain valid is
explained in `climbplan/solvers/mixed_integer/leaf_cover.py`. Method `benders` stores cuts
(`climbplan/solvers/benders/benders_cuts.py`).
"""

from __future__ import annotations

import time
from dataclasses import replace

from climbplan.errors import UsageError
from climbplan.methods.table import MethodResult
from climbplan.methods.task import Method, MethodSettings, SharedCache, Task
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.benders.method import WarmStartedBenders
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.leaf_cover import HorizonShift, build_horizon_shift
from climbplan.solvers.mixed_integer.method import WarmStartedTree
from climbplan.solvers.mixed_integer.nodes import UNLIMITED
from climbplan.solvers.mixed_integer.spatial_method import WarmStartedSpatialTree
from climbplan.solvers.registry import require

SEQUENCE_METHODS: tuple[Method, ...] = ("branch-and-bound", "benders")
_WORDS = {"branch-and-bound": "own tree", "benders": "Benders cuts"}


class ProblemSequence:
    """Solves a problem at one theta after another, and stores the last tree or its cuts."""

    def __init__(
        self,
        problem: Problem,
        settings: MethodSettings | None = None,
        method: Method = "branch-and-bound",
    ) -> None:
        """Begin without a warm start; `auto` is the first of `SEQUENCE_METHODS`."""
        self.problem = problem
        self.settings = settings or MethodSettings()
        self.method: Method = SEQUENCE_METHODS[0] if method == "auto" else method
        if self.method not in SEQUENCE_METHODS:
            names = " or ".join(SEQUENCE_METHODS)
            raise UsageError(f"a sequence is solved by method {names}, got {method!r}")
        work = self.settings.work
        if work is not None and work < 1:
            raise UsageError(f"work: expected 1 dual step or more, got {work}")
        self._memory: WarmStartedTree | WarmStartedSpatialTree | WarmStartedBenders | None = None
        self._moves: dict[
            int, HorizonShift
        ] = {}  # by shift: the same for all instances of a statement

    def solve(self, theta: Theta, horizon_shift: int = 0) -> MethodResult:
        """Solve at one theta; every answer has its own proof of optimality within the gap.

        At the limit of time or work the answer is the best point found, with the gap that was
        proved.

        Args:
            theta: Parameters by block.
            horizon_shift: Steps by which a receding horizon has moved since the last call; the warm
                start shifts along the first axis of each block of variables, rows and choices.

        Raises:
            UsageError: The statement has smooth rows, the shift is negative, or a case of
                `solve_instance`.
        """
        if horizon_shift < 0:
            raise UsageError(f"shift: expected 0 steps or more, got {horizon_shift}")
        begin = time.perf_counter()
        instance = self.problem.instance(theta)
        memory = self._memory
        if memory is None:
            memory = self._memory = self._create_solver(instance)
        task = Task(self.problem, theta, instance, self.settings, begin, SharedCache())
        blocks = self.problem.program.blocks

        def move(form: IndicatorForm) -> HorizonShift:
            if horizon_shift not in self._moves:
                self._moves[horizon_shift] = build_horizon_shift(
                    blocks, form, horizon_shift, instance.products
                )
            return self._moves[horizon_shift]

        time_left = max(self.settings.time_limit - (time.perf_counter() - begin), 0.0)
        warm_started = memory.has_warm_start
        answer = memory.solve(instance, time_left, move if horizon_shift else None)
        result = task.apply_own_check(answer)
        duration = time.perf_counter() - begin
        message = _WORDS[self.method] + (", remembered" if warm_started else "")
        certificate = None if isinstance(memory, WarmStartedBenders) else memory.certificate
        result = replace(result, time=duration)
        return MethodResult(result, self.method, message, 1, (), duration, certificate)

    def reset(self) -> None:
        """Begin the next tree with its root."""
        self._memory = None

    def _create_solver(
        self, instance: Instance
    ) -> WarmStartedTree | WarmStartedSpatialTree | WarmStartedBenders:
        """Create the warm-started solver for a statement."""
        settings = self.settings
        work = UNLIMITED if settings.work is None else settings.work
        unsupported = instance.features - require(self.method).accepts
        if unsupported:
            raise UsageError(
                f"a sequence is solved by {self.method}, whose memory holds no "
                f"{' and no '.join(sorted(unsupported))}"
            )
        if self.method == "benders":
            if settings.certificate:
                raise UsageError("a certificate is made by method branch-and-bound, not benders")
            return WarmStartedBenders(settings.gap, settings.tolerance, work)
        solver_type = WarmStartedSpatialTree if instance.products.count else WarmStartedTree
        return solver_type(settings.gap, settings.tolerance, proves=settings.certificate, work=work)
