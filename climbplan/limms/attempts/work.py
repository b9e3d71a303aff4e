"""Work of programs: what budgets count, and what it took."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.solvers.ipopt.trajectory import TrajectoryAnswer


@dataclass(frozen=True)
class Work:
    """Programs solved, with their iterations, and the seconds that they and their building took."""

    programs: int = 0
    iterations: int = 0
    seconds: float = 0.0
    build_seconds: float = 0.0

    def __add__(self, other: Work) -> Work:
        return Work(
            self.programs + other.programs,
            self.iterations + other.iterations,
            self.seconds + other.seconds,
            self.build_seconds + other.build_seconds,
        )


def work_of(answer: TrajectoryAnswer) -> Work:
    """Of one program."""
    return Work(1, answer.iterations, answer.seconds, answer.build_seconds)
