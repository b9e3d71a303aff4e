"""The exact check: plans pass, and whatever is changed in them is found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from walk_tasks import named, walk_task

from climbplan.verification.verification import Verification
from climbplan.walking.check.checker import LIMITS, check_trajectory, format_failures
from climbplan.walking.offline.sqp import solve_gait
from climbplan.walking.task.task import Gait, WalkTask, WalkTrajectory


@cache
def trotting() -> tuple[WalkTask, WalkTrajectory]:
    task = walk_task((1.0, 0, 0), integrator="mean", min_contacts=2)
    found = solve_gait(task, named("trot", task), None, 60)
    assert found.trajectory is not None
    assert found.is_feasible
    return task, found.trajectory


def failed(task: WalkTask, found: WalkTrajectory) -> set[str]:
    return {check.name for check in check_trajectory(task, found) if not check.passed}


def changed(name: str, index: tuple[int, ...], by: float) -> WalkTrajectory:
    _, found = trotting()
    values = getattr(found, name).copy()
    values[index] += by
    return replace(found, **{name: values})


def test_a_solved_gait_passes_all() -> None:
    task, found = trotting()
    checks = check_trajectory(task, found)
    assert format_failures(checks) == ""
    # No goal was stated
    assert [check.name for check in checks] == [n for n in LIMITS if n != "goal.position"]
    assert all(check.used > 0.1 for check in checks if check.name == "workspace.toe")


@pytest.mark.parametrize(
    ("name", "index", "by", "expected"),
    [
        ("state", (0, 3), 0.01, "start.state"),
        ("state", (4, 0), 1e-3, "dynamics.position"),
        ("state", (4, 4), 1e-3, "dynamics.velocity"),
        ("state", (4, 7), 1e-3, "dynamics.attitude"),
        ("state", (4, 10), 1e-3, "dynamics.angular_velocity"),
        ("state", (5, 3), 0.2, "rollout.velocity"),
        ("state", (5, 8), 0.2, "rollout.attitude"),
        ("force", (2, 0, 0), 60.0, "force.friction"),
        ("force", (2, 0, 2), 60.0, "force.limit"),
        ("force", (2, 0, 2), -60.0, "force.friction"),
        ("toes", (3, 1, 2), 0.01, "contact.region"),
        ("toes", (3, 0, 2), -0.01, "swing.clearance"),
        ("toes", (3, 0, 0), 0.3, "workspace.toe"),
        ("state", (3, 6), 1.6, "state.tilt"),
    ],
)
def test_changes_are_found(name: str, index: tuple[int, ...], by: float, expected: str) -> None:
    task, _ = trotting()
    assert expected in failed(task, changed(name, index, by))


def test_force_on_a_swinging_leg_and_missing_contacts() -> None:
    task, found = trotting()
    contact = found.gait.contact.copy()
    contact[2, 0] = False
    lifted = replace(found, gait=Gait(contact, found.gait.region))
    assert {"force.without_contact", "gait.contacts"} <= failed(task, lifted)


def test_a_slipping_toe() -> None:
    task = walk_task((0.2, 0, 0), integrator="mean")
    answer = solve_gait(task, named("slow trot", task), None, 60)
    assert answer.trajectory is not None
    toes = answer.trajectory.toes.copy()
    toes[3, 1, 0] += 1e-3
    assert "contact.no_slip" in failed(task, replace(answer.trajectory, toes=toes))


def test_nan_never_passes() -> None:
    task, _ = trotting()
    assert "dynamics.velocity" in failed(task, changed("force", (1, 1, 0), np.nan))


def test_euler_in_continuous_time_is_told_not_judged() -> None:
    task = walk_task((1.0, 0, 0))
    answer = solve_gait(task, named("trot", task), None, 60)
    assert answer.trajectory is not None
    checks = {check.name: check for check in check_trajectory(task, answer.trajectory)}
    assert checks["continuous.attitude"].passed
    assert checks["continuous.attitude"].mark == "not judged"
    assert "not judged" in checks["continuous.attitude"].margin
    assert checks["continuous.attitude"].residual > checks["continuous.attitude"].limit
    found = Verification(tuple(checks.values()))
    assert found.badge == "verified in its model (forward Euler, workspace at knots)"
    assert any("attitude is off by up to" in words for words in found.leaves_out)
    as_mean = replace(task, integrator="mean")
    assert "continuous.attitude" in failed(as_mean, answer.trajectory)


def test_a_walk_that_holds_in_continuous_time_is_verified_without_more() -> None:
    task = walk_task((1.0, 0, 0), integrator="mean", workspace_over_stance=True)
    answer = solve_gait(task, named("slow trot", task), None, 60)
    assert answer.trajectory is not None
    checks = check_trajectory(task, answer.trajectory)
    assert all(check.judged for check in checks)
    assert Verification(checks).badge == "verified"
