"""Plan a walk from a spec: a trajectory that passes the exact check, or the reason for none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata

import numpy as np

from climbplan.errors import Conflict, Infeasible, LimitReached
from climbplan.progress import Progress, report_search
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.check.speed import compute_leg_speeds
from climbplan.walking.dynamics.cost import compute_cost_terms
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.plan.axes import orient_plan
from climbplan.walking.plan.foot_centres import raise_plan
from climbplan.walking.plan.summary import format_summary
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.gaps import Gap, find_widest_gap
from climbplan.walking.problem.problem import build_task
from climbplan.walking.problem.scanning import fit_walk_scan, load_walk_surface
from climbplan.walking.schema.loading import LoadedMpc
from climbplan.walking.schema.solver import WalkSolverSpec
from climbplan.walking.task.task import WalkTask


def explain_slow_joints(task: WalkTask, solve: Callable[[WalkTask], WalkAnswer]) -> str:
    """Return a message if no walk was found because joints are too slow, else an empty text.

    The task is solved again for motors of any speed, and the message says which joint is too slow.

    Args:
        task: The task.
        solve: Solves a task by the method that found nothing.
    """
    if task.legs is None:
        return ""
    legs = task.legs
    unlimited = replace(legs, max_speed=np.full_like(legs.max_speed, np.inf))
    trajectory = solve(replace(task, legs=unlimited)).trajectory
    if trajectory is None:
        return ""
    ratio = compute_leg_speeds(legs, task, trajectory).speed / legs.max_speed
    n, leg, joint = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    if not ratio[n, leg, joint] > 1.0:
        return ""
    return (
        f"joints are too slow: a walk is found for motors of any speed, it asks "
        f"{legs.chain.names[leg][joint]} of {task.body.leg_names[leg]} for "
        f"{ratio[n, leg, joint]:.2g} times its {legs.max_speed[leg, joint]:.3g} rad/s at "
        f"{task.dt * n:.2f} s; a slower task.reference.velocity (and task.start.velocity) or "
        "less task.swing_clearance ask for less"
    )


_MIN_TIME = 1e-3  # [s] that a solver gets after its deadline
_WARM_FRACTION = 0.5  # of the time of `spatial-branch-and-bound`, for the searches before it


def plan_walk(loaded: LoadedMpc, report: Progress | None = None) -> WalkPlan:
    """Solve the task of a spec by its method, within its time limit.

    Args:
        loaded: The spec with its robot.
        report: Called with the stage and its fraction; None: no reports.

    Raises:
        SpecError: values that do not go together.
        Infeasible: a gap on the way to the goal is wider than any attitude of the body reaches.
        LimitReached: no feasible gait was found; the message says how the best one fails.
    """
    report = report or _ignore_progress
    begin = time.perf_counter()
    deadline = time.monotonic() + loaded.spec.solver.time_limit
    loaded = fit_walk_scan(loaded)
    spec = loaded.spec
    scan = load_walk_surface(loaded)
    task = build_task(spec, loaded.robot, loaded.source, scan=scan)
    report("solve", 0.0)
    report_search(deadline=deadline)
    ready = time.perf_counter()
    gap = find_widest_gap(task)
    if gap is not None and gap.proved:
        raise Infeasible(f"no plan exists: {gap}", [_build_conflict(gap)], stage="footholds")
    answer = solve_task(task, _limit_time(spec.solver, deadline), spec.seed)
    solved = time.perf_counter()
    if answer.trajectory is None:
        speed_reason = ""
        if time.monotonic() < deadline:
            remaining = _limit_time(spec.solver, deadline)
            speed_reason = explain_slow_joints(
                task, lambda other: solve_task(other, remaining, spec.seed)
            )
        raise LimitReached(
            _describe_failure(spec.solver.method, answer, speed_reason, gap),
            stage=spec.solver.method,
        )
    timings = {"prepare": ready - begin, "solve": solved - ready, "method": answer.seconds}
    return _build_plan(loaded, task, answer, timings)


def _describe_failure(method: str, answer: WalkAnswer, speed_reason: str, gap: Gap | None) -> str:
    """Return the message for a task without a walk."""
    return (
        f"no plan found: {method} tried {answer.tried} gaits in "
        f"{answer.seconds:.2g} s; {answer.word}"
        + (f"; {speed_reason}" if speed_reason else "")
        + (f"; {answer.cut_short}" if answer.cut_short else "")
        + (f"; the widest gap on the way to the goal: {gap}" if gap is not None else "")
    )


def _build_plan(
    loaded: LoadedMpc, task: WalkTask, answer: WalkAnswer, timings: dict[str, float]
) -> WalkPlan:
    """Return the plan of an answer that has a trajectory, with its summary."""
    assert answer.trajectory is not None
    spec = loaded.spec
    failed_checks = format_failures(check_trajectory(task, answer.trajectory))
    relative_gap = None
    if answer.bound is not None and answer.objective:
        relative_gap = (answer.objective - answer.bound) / abs(answer.objective)
    plan = WalkPlan(
        name=loaded.name,
        title=spec.title,
        method=spec.solver.method,
        status="limit" if answer.cut_short else "feasible",
        task=task,
        trajectory=answer.trajectory,
        objective=answer.objective,
        terms=compute_cost_terms(task, answer.trajectory.state, answer.trajectory.force),
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        robot_text=loaded.robot_text,
        robot_urdf=loaded.robot_urdf,
        seed=spec.seed,
        timings=timings,
        solvers=_list_solver_versions(spec.solver) | {"word": answer.word},
        sizes={
            "knots": task.knots,
            "contact binaries": int(answer.trajectory.gait.contact.size),
            "regions": len(task.ground.height),
            "gaits tried": answer.tried,
        }
        | ({"QPs": answer.qps} if answer.qps else {}),
        history=answer.history,
        initial_states=answer.initial_plan.state if answer.initial_plan is not None else None,
        bound=answer.bound,
        gap=relative_gap,
        warnings=tuple(
            warning
            for warning in (
                f"the answer breaks {failed_checks}" if failed_checks else "",
                answer.cut_short,
            )
            if warning
        ),
    )
    raised = raise_plan(replace(plan, summary=format_summary(plan)))
    return orient_plan(raised, spec.forward)


def _build_conflict(gap: Gap) -> Conflict:
    """Return the constraints that a gap makes infeasible."""
    what = f"{gap.width:.2f} m without footholds, {gap.max_width:.2f} m of reach in any attitude"
    names = ("contact.region", "workspace.toe", "goal.position")
    return Conflict(f"from {gap.near_name} to {gap.far_name}", (what,), in_words=True, names=names)


def _limit_time(solver: WalkSolverSpec, deadline: float) -> WalkSolverSpec:
    """Return the solver with the time that is left until a deadline of `time.monotonic` [s]."""
    seconds_left = max(deadline - time.monotonic(), _MIN_TIME)
    return solver.model_copy(update={"time_limit": min(seconds_left, solver.time_limit)})


def solve_task(task: WalkTask, solver: WalkSolverSpec, seed: int = 0) -> WalkAnswer:
    """Solve a task by the method of a spec, within its time limit.

    The searches that `spatial-branch-and-bound` starts from take at most half of the time together.

    Args:
        task: The task.
        solver: The solver section of a spec.
        seed: Seed of the first search; further ones follow by one.
    """
    # Each method imports its own solver only, which shortens the start.
    if solver.method == "mpcc":
        from climbplan.walking.offline.nlp import solve_nlp

        return solve_nlp(task, solver.initial_gait, solver.time_limit)
    if solver.method == "spatial-branch-and-bound":
        from climbplan.walking.micp.limits import read_limits
        from climbplan.walking.micp.solver import solve_micp

        deadline = time.monotonic() + solver.time_limit
        seconds_each = _WARM_FRACTION * solver.time_limit / solver.attitude_box.seeds
        brief_solver = solver.model_copy(
            update={"method": solver.initial_solution, "time_limit": seconds_each}
        )
        warm = solve_task(task, brief_solver, seed)
        search_solver = brief_solver.model_copy(update={"method": "gait-search"})
        other_answers = [
            solve_task(task, search_solver, seed + k) for k in range(1, solver.attitude_box.seeds)
        ]
        return solve_micp(task, read_limits(_limit_time(solver, deadline)), warm, other_answers)
    from climbplan.walking.offline.search import SearchLimits, search

    gaits = solver.gaits if solver.gaits is not None else SearchLimits.gaits
    return search(task, SearchLimits(solver.time_limit, gaits, seed, qps=solver.max_qp_solves))


def _list_solver_versions(solver: WalkSolverSpec) -> dict[str, str]:
    """Return the method and the versions of its libraries, by name."""
    versions = {"method": solver.method, "daqp": metadata.version("daqp")}
    versions["casadi"] = metadata.version("casadi")
    if solver.method == "spatial-branch-and-bound":
        versions["highs"] = metadata.version("highspy")
    return versions


def _ignore_progress(stage: str, fraction: float) -> None:
    """Ignore a progress report."""
    pass
