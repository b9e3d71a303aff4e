"""The same problem again and again, with parameters that change: each is helped by the last.

Method `branch-and-bound` remembers leaves, with products boxes, too; what stays valid and why is
told in `climbplan/solvers/mixed_integer/memory.py`. Method `benders` remembers cuts
(`climbplan/solvers/benders/cuts.py`).
"""

from __future__ import annotations

import time
from dataclasses import replace

from climbplan.errors import UsageError
from climbplan.methods.table import MethodResult
from climbplan.methods.task import Kept, Method, MethodSettings, Task
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.benders.method import BendersMemory
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.memory import Move, shifted
from climbplan.solvers.mixed_integer.method import TreeMemory
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.mixed_integer.spatial_method import SpatialMemory
from climbplan.solvers.registry import require

SEQUENCE_METHODS: tuple[Method, ...] = ("branch-and-bound", "benders")
_WORDS = {"branch-and-bound": "own tree", "benders": "Benders cuts"}


class ProblemSequence:
    """Solves a problem at one theta after another, and remembers the last tree or its cuts."""

    def __init__(
        self,
        problem: Problem,
        settings: MethodSettings | None = None,
        method: Method = "branch-and-bound",
    ) -> None:
        """method: one of `SEQUENCE_METHODS`, or `auto`, which is the first of them."""
        self.problem = problem
        self.settings = settings or MethodSettings()
        self.method: Method = SEQUENCE_METHODS[0] if method == "auto" else method
        if self.method not in SEQUENCE_METHODS:
            known = " or ".join(SEQUENCE_METHODS)
            raise UsageError(f"a sequence is solved by method {known}, got {method!r}")
        work = self.settings.work
        if work is not None and work < 1:
            raise UsageError(f"work: expected 1 dual step or more, got {work}")
        self._memory: TreeMemory | SpatialMemory | BendersMemory | None = None
        self._moves: dict[int, Move] = {}  # by shift: the same for all instances of a statement

    def solve(self, theta: Theta, shift: int = 0) -> MethodResult:
        """As `solve_instance`; every answer has its own proof of optimality within the gap.

        At the limit of time or work it is the best that was found, with the gap that was proved.

        shift: steps by which a receding horizon has moved since the last call: what is remembered
        moves along the first axis of each block of variables, rows and choices.
        Raises UsageError as `solve_instance` does, for statements with smooth rows, and for a
        negative shift.
        """
        if shift < 0:
            raise UsageError(f"shift: expected 0 steps or more, got {shift}")
        begin = time.perf_counter()
        instance = self.problem.instance(theta)
        memory = self._memory
        if memory is None:
            memory = self._memory = self._made_for(instance)
        task = Task(self.problem, theta, instance, self.settings, begin, Kept())
        blocks = self.problem.program.blocks

        def move(form: Conditional) -> Move:
            if shift not in self._moves:
                self._moves[shift] = shifted(blocks, form, shift, instance.products)
            return self._moves[shift]

        left = max(self.settings.time_limit - (time.perf_counter() - begin), 0.0)
        known = memory.remembers
        found = memory.solve(instance, left, move if shift else None)
        result = task.passing(found)
        spent = time.perf_counter() - begin
        word = _WORDS[self.method] + (", remembered" if known else "")
        certificate = None if isinstance(memory, BendersMemory) else memory.certificate
        result = replace(result, time=spent)
        return MethodResult(result, self.method, word, 1, (), spent, certificate)

    def forget(self) -> None:
        """Begin the next tree with its root."""
        self._memory = None

    def _made_for(self, instance: Instance) -> TreeMemory | SpatialMemory | BendersMemory:
        settings = self.settings
        work = MOST if settings.work is None else settings.work
        beyond = instance.features - require(self.method).accepts
        if beyond:
            raise UsageError(
                f"a sequence is solved by {self.method}, whose memory holds no "
                f"{' and no '.join(sorted(beyond))}"
            )
        if self.method == "benders":
            if settings.certificate:
                raise UsageError("a certificate is made by method branch-and-bound, not benders")
            return BendersMemory(settings.gap, settings.tolerance, work)
        made = SpatialMemory if instance.products.count else TreeMemory
        return made(settings.gap, settings.tolerance, proves=settings.certificate, work=work)
