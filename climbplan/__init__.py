"""Verified plans for robots that move by making and breaking contact.

    import climbplan

    spec = climbplan.load_spec("specs/climb_steps.yaml", overrides={"force.safety_friction": 2.0})
    plan = climbplan.plan(spec)
    plan.rounds.com, plan.instants.force        # arrays under the names of the plan file
    plan.verify().passed, plan.write_report("outputs/steps"), plan.save("outputs/steps")

Names are loaded when they are first used: `import climbplan` itself imports nothing heavy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from climbplan.api.cvxpy_solver import CVXPY
    from climbplan.api.limits import find_limit
    from climbplan.api.loading import load_spec
    from climbplan.api.plan import Plan, load_plan
    from climbplan.api.planning import plan, verify
    from climbplan.api.problem_from_spec import problem_from_spec
    from climbplan.api.session import Session
    from climbplan.api.solving import Solution, solve
    from climbplan.bookshelf.schema.model import BookshelfSpec
    from climbplan.climb.schema.model import ClimbSpec
    from climbplan.climb.schema.transition import TransitionSpec
    from climbplan.limms.schema.model import LimmsSpec
    from climbplan.program.polytope import Polytope
    from climbplan.program.problem import Problem
    from climbplan.program.statement import Program
    from climbplan.schema.robots.robot import RobotSpec
    from climbplan.walking.schema.model import MpcSpec

__version__ = "0.1.0"
__all__ = [
    "CVXPY",
    "BookshelfSpec",
    "ClimbSpec",
    "LimmsSpec",
    "MpcSpec",
    "Plan",
    "Polytope",
    "Problem",
    "Program",
    "RobotSpec",
    "Session",
    "Solution",
    "TransitionSpec",
    "find_limit",
    "load_plan",
    "load_spec",
    "plan",
    "problem_from_spec",
    "solve",
    "verify",
]
_MODULES = {
    "CVXPY": "api.cvxpy_solver",
    "BookshelfSpec": "bookshelf.schema.model",
    "ClimbSpec": "climb.schema.model",
    "LimmsSpec": "limms.schema.model",
    "MpcSpec": "walking.schema.model",
    "Plan": "api.plan",
    "Polytope": "program.polytope",
    "Problem": "program.problem",
    "Program": "program.statement",
    "RobotSpec": "schema.robots.robot",
    "Session": "api.session",
    "Solution": "api.solving",
    "TransitionSpec": "climb.schema.transition",
    "find_limit": "api.limits",
    "load_plan": "api.plan",
    "load_spec": "api.loading",
    "plan": "api.planning",
    "problem_from_spec": "api.problem_from_spec",
    "solve": "api.solving",
    "verify": "api.planning",
}
_RENAMED = {"load": "load_spec", "read": "load_plan", "stated": "problem_from_spec"}


def __getattr__(name: str) -> Any:
    """Return a public name, imported from its module; an old name warns and gives its new one."""
    if name in _RENAMED:
        from climbplan.deprecation import warn_renamed

        warn_renamed(f"`climbplan.{name}`", f"`climbplan.{_RENAMED[name]}`")
        return __getattr__(_RENAMED[name])
    if name not in _MODULES:
        raise AttributeError(f"climbplan has no {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(f"climbplan.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
