"""The work of solving programs: what budgets count, and its time."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.solvers.ipopt.staged_program import StagedProgramAnswer


@dataclass(frozen=True)
class Work:
    """Numbers of programs and iterations, and the seconds of solving and of building."""

    programs: int = 0
    iterations: int = 0
    seconds: float = 0.0
    build_seconds: float = 0.0

    def __add__(self, more: Work) -> Work:
        return Work(
            self.programs + more.programs,
            self.iterations + more.iterations,
            self.seconds + more.seconds,
            self.build_seconds + more.build_seconds,
        )


def measure_work(answer: StagedProgramAnswer) -> Work:
    """Return the work of one program."""
    return Work(1, answer.iterations, answer.seconds, answer.build_seconds)
