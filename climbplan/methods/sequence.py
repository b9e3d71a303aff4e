"""The same problem again and again, with parameters that change: each tree begins with the last.

Method `branch-and-bound`; what is remembered and why it stays valid is told in
`climbplan/solvers/mixed_integer/memory.py`.
"""

from __future__ import annotations

import time
from dataclasses import replace

from climbplan.errors import UsageError
from climbplan.methods.table import MethodResult
from climbplan.methods.task import Kept, Method, MethodSettings, Task
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.memory import Move, shifted
from climbplan.solvers.mixed_integer.method import TreeMemory
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.registry import require

_METHOD: Method = "branch-and-bound"


class ProblemSequence:
    """Solves a problem at one theta after another, and remembers the last tree."""

    def __init__(self, problem: Problem, settings: MethodSettings | None = None) -> None:
        self.problem = problem
        self.settings = settings or MethodSettings()
        work = self.settings.work
        if work is not None and work < 1:
            raise UsageError(f"work: expected 1 dual step or more, got {work}")
        self._memory = TreeMemory(
            self.settings.gap,
            self.settings.tolerance,
            proves=self.settings.certificate,
            work=MOST if work is None else work,
        )
        self._moves: dict[int, Move] = {}  # by shift: the same for all instances of a statement

    def solve(self, theta: Theta, shift: int = 0) -> MethodResult:
        """As `solve_instance`; every answer has its own proof of optimality within the gap.

        At the limit of time or work it is the best that was found, with the gap that was proved.

        shift: steps by which a receding horizon has moved since the last call: what is remembered
        moves along the first axis of each block of variables, rows and choices.
        Raises UsageError as `solve_instance` does, for statements that are not convex but for
        their integers, and for a negative shift.
        """
        if shift < 0:
            raise UsageError(f"shift: expected 0 steps or more, got {shift}")
        begin = time.perf_counter()
        instance = self.problem.instance(theta)
        self._refuse(instance)
        task = Task(self.problem, theta, instance, self.settings, begin, Kept())
        blocks = self.problem.program.blocks

        def move(form: Conditional) -> Move:
            if shift not in self._moves:
                self._moves[shift] = shifted(blocks, form, shift)
            return self._moves[shift]

        left = max(self.settings.time_limit - (time.perf_counter() - begin), 0.0)
        known = self._memory.leaves is not None
        found = self._memory.solve(instance, left, move if shift else None)
        result = task.passing(found)
        spent = time.perf_counter() - begin
        word = "own tree, remembered" if known else "own tree"
        certificate = self._memory.certificate
        return MethodResult(replace(result, time=spent), _METHOD, word, 1, (), spent, certificate)

    def forget(self) -> None:
        """Begin the next tree with its root."""
        self._memory.leaves = None

    @staticmethod
    def _refuse(instance: Instance) -> None:
        beyond = instance.features - (require(_METHOD).accepts - {"products"})
        if beyond:
            raise UsageError(
                f"a sequence is solved by {_METHOD}, whose memory holds no "
                f"{' and no '.join(sorted(beyond))}"
            )
