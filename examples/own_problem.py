"""A ball is to be brought past a post, left or right of it: a problem of one's own by four methods.

python examples/own_problem.py
"""

from __future__ import annotations

import numpy as np

import climbplan
from climbplan import Polytope, Problem, Program

STEPS, LONGEST = 6, 0.5  # [-], [m]
POST = 0.4  # half its width [m]


def past_a_post() -> Problem:
    """Parameter: `start` (2,) [m]. The post stands about the origin, the goal is behind it."""
    p = Program("past a post")
    start = p.parameter("start", (2,))
    x = p.continuous("place", (STEPS + 1, 2), -2.0, 2.0, unit="m")
    p.equal("way.start", x[0] - start, unit="m")
    p.equal("way.goal", x[-1] - np.array([0.1, 1.0]), unit="m")
    p.ball("way.step", x[1:] - x[:-1], LONGEST, unit="m")
    sides = [
        Polytope.halfspaces(name, np.array([normal]), np.array([-POST]))
        for name, normal in (
            ("left of it", [1.0, 0.0]),
            ("right of it", [-1.0, 0.0]),
            ("before it", [0.0, 1.0]),
            ("behind it", [0.0, -1.0]),
        )
    ]
    p.one_of("way.beside", x, [sides] * (STEPS + 1), unit="m")
    p.minimise("length", np.sum((x[1:] - x[:-1]) ** 2))
    return Problem("past_a_post", p)


def main() -> None:
    problem, theta = past_a_post(), {"start": [-0.1, -1.0]}
    for method in ("mccormick", "minlp-scip", "mpcc", "admm"):
        found = climbplan.solve(problem, theta, method=method, time_limit=20.0)
        cost = "no answer" if found.objective is None else f"{found.objective:.4f}"
        print(f"{method:11s} {found.status:9s} {cost}")


if __name__ == "__main__":
    main()
