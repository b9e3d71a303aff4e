"""Checks of a walking plan file: its numbers, its spec, its objective and its trajectory."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import combinations

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import MissingSolver, SpecError
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.holding import HeldSpec
from climbplan.schema.kinds import validate
from climbplan.schema.terrain.scan import ScanSpec
from climbplan.schema.yaml_source import parse_yaml
from climbplan.terrain.raw_surface import RawSurface
from climbplan.verification.check import Check, Limit, mark_not_compared
from climbplan.verification.held import check_spec_differences
from climbplan.walking.check.checker import check_loop, check_trajectory
from climbplan.walking.plan.axes import orient_task
from climbplan.walking.plan.foot_centres import raise_task
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.problem.problem import build_sampled_task, build_task
from climbplan.walking.schema.loading import load_stored_body
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import WalkTask


def compute_objective_terms(task: WalkTask, state: Array, force: Array) -> dict[str, float]:
    """Return each term of the objective by name.

    Args:
        task: The task.
        state: States (N + 1, 12).
        force: Forces (N + 1, L, 3); the last is not used.
    """
    weights, reference = task.weights, task.reference
    terms = dict.fromkeys(("velocity", "angles", "height", "motion", "force_difference"), 0.0)
    for n in range(task.knots):
        position, velocity, angles = np.split(state[n + 1, :9], 3)
        terms["velocity"] += weights.velocity @ np.square(velocity - reference.velocity[n])
        terms["angles"] += weights.angles @ np.square(angles - reference.euler[n])
        terms["height"] += weights.height * (position[2] - reference.height[n]) ** 2
        terms["motion"] += weights.motion * np.sum((position - state[n, :3]) ** 2)
        pairs = (np.sum((a - b) ** 2) for a, b in combinations(force[n], 2))
        terms["force_difference"] += weights.force_difference * 2 * sum(pairs)  # in either order
    return {name: float(term) for name, term in terms.items()}


LIMITS = {
    "file.spec_hash": Limit(0, "", "sha256 of the spec's text is the stored one"),
    "file.finite": Limit(0, "", "entries that are NaN or infinite"),
    "file.data": Limit(0, "", "values that no robot and no ground can have"),
    "file.spec_values": Limit(
        1e-9, "", "task, start, references and weights are those of the spec"
    ),
    "file.objective": Limit(1e-6, "", "the objective is that of the trajectory (relative)"),
}


def check_plan(plan: WalkPlan, spec_to_hold: HeldSpec | None = None) -> Iterator[Check]:
    """Yield all checks of a plan.

    Unsound text or numbers end the checks, as later ones would mean little.

    Args:
        plan: The plan.
        spec_to_hold: A spec that the plan has to satisfy instead of its own.
    """
    digest = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    yield _build_check("file.spec_hash", float(digest != plan.spec_sha256), "the text was changed")
    yield _build_fault_check("file.finite", list(plan.not_finite))
    faults = list(_find_faults(plan.task))
    faults += [f"{name} is not that of the steps" for name in plan.at_odds]
    yield _build_fault_check("file.data", faults)
    if plan.not_finite or faults:
        return
    if spec_to_hold is not None:
        yield check_spec_differences(spec_to_hold)
        plan = replace(
            plan,
            spec_text=spec_to_hold.text,
            robot_text=spec_to_hold.robot_text,
            robot_urdf=spec_to_hold.robot_urdf,
        )
    yield _check_spec_values(plan)
    yield _check_objective(plan)
    if plan.loop is not None:
        yield from check_loop(plan.task, plan.trajectory, plan.loop.push)
    else:
        yield from check_trajectory(plan.task, plan.trajectory)


def _find_faults(task: WalkTask) -> Iterator[str]:
    """Yield the values of a task that no robot and no ground can have."""
    body, ground = task.body, task.ground
    for name, value in (
        ("mass", body.mass),
        ("gravity", body.gravity),
        ("force_limit", body.force_limit),
        ("friction", ground.friction),
        ("step", task.dt),
        ("lift", task.swing_clearance),
    ):
        if not value > 0:
            yield f"{name} {value:g} is not above zero"
    inertia = body.inertia
    if not np.allclose(inertia, inertia.T) or not np.linalg.eigvalsh(inertia).min() > 0:
        yield "the inertia is not symmetric and positive definite"
    if not (body.toe_half > 0).all():
        yield "a workspace box is empty"
    if not (ground.lower < ground.upper).all():
        yield "a region of the ground is empty"


def _check_spec_values(plan: WalkPlan) -> Check:
    """Return the check that the stored task is that of the stored spec and robot."""
    try:
        spec, findings = validate(parse_yaml(plan.spec_text, "spec"), MpcSpec)
    except SpecError as error:
        return _build_check("file.spec_values", math.inf, str(error).splitlines()[0])
    if spec is None:
        return _build_check("file.spec_values", math.inf, findings[0].message)
    try:
        robot = load_stored_body(spec, plan.robot_text, plan.robot_urdf)
        # Plan files without a standoff have the centres of feet on the ground
        standoff = plan.task.ground.standoff
        task = raise_task(build_task(spec, robot, centres=standoff > 0), standoff)
        task = orient_task(task, spec.forward)
    except MissingSolver as reason:
        reason_text = f"{reason}: robot and task are taken from the plan file"
        return mark_not_compared(
            _build_check("file.spec_values", 0.0), reason_text, "robot as stored", reason_text
        )
    except SpecError as error:
        return _build_check("file.spec_values", math.inf, str(error).splitlines()[0])
    differences = {
        "seed": 0.0 if plan.seed == spec.seed else math.inf,
        "solver.method": 0.0 if plan.method == spec.solver.method else math.inf,
        "forward": 0.0 if plan.forward == spec.forward else math.inf,
        "terrain.scan": _compare_scans(plan.task.ground.scan, spec.terrain.scan),
    }
    if plan.loop is not None:
        task = build_sampled_task(task, plan.task.knots)
    differences |= _compare_tasks(plan.task, task)
    worst = max(differences, key=lambda key: differences[key])
    return _build_check("file.spec_values", differences[worst], worst)


def _compare_tasks(stored: WalkTask, expected: WalkTask) -> dict[str, float]:
    """Return the largest difference of each part of two tasks, by name."""
    differences = {}
    for holder in ("body", "ground", "start", "reference", "weights", "goal"):
        stored_part, expected_part = vars(stored)[holder], vars(expected)[holder]
        for name in (field.name for field in fields(stored_part) if field.name != "scan"):
            differences[f"{holder}.{name}"] = _compute_difference(
                getattr(stored_part, name), getattr(expected_part, name)
            )
    differences |= _compare_legs(stored.legs, expected.legs)
    for name in (
        "knots",
        "dt",
        "integrator",
        "swing_clearance",
        "min_contacts",
        "workspace_over_stance",
    ):
        differences[name] = _compute_difference(vars(stored)[name], vars(expected)[name])
    return differences


def _compare_scans(stored: RawSurface | None, spec: ScanSpec | None) -> float:
    """Return the largest difference of the numbers of a scan; infinite if only one has a scan."""
    if stored is None or spec is None:
        return 0.0 if stored is None and spec is None else math.inf
    return abs(stored.flatness - spec.flatness)


def _compare_legs(stored: WalkingLegs | None, expected: WalkingLegs | None) -> dict[str, float]:
    """Return the largest difference of each part of the legs of two tasks, by name."""
    if stored is None or expected is None:
        return {"legs": 0.0 if stored is expected else math.inf}
    holders = ((stored.chain, expected.chain), (stored, expected))
    return {
        f"legs.{field.name}": _compute_difference(
            getattr(stored_part, field.name), getattr(expected_part, field.name)
        )
        for stored_part, expected_part in holders
        for field in fields(stored_part)
        if field.name != "chain"
    }


def _compute_difference(first: object, second: object) -> float:
    """Return the largest difference of two values; infinite if they are not comparable."""
    if first is None or isinstance(first, str | tuple):
        return 0.0 if first == second else math.inf
    a, b = np.asarray(first, float), np.asarray(second, float)
    if a.shape == b.shape and np.array_equal(a, b):  # infinite ones too
        return 0.0
    return float(np.abs(a - b).max(initial=0.0)) if a.shape == b.shape else math.inf


def _check_objective(plan: WalkPlan) -> Check:
    """Return the check that the stored objective and its terms are those of the trajectory."""
    terms = compute_objective_terms(plan.task, plan.trajectory.state, plan.trajectory.force)
    total = sum(terms.values())
    errors = {"objective": abs(plan.objective - total)}
    for name, value in terms.items():
        stored = plan.terms.get(name)
        errors[name] = abs(stored - value) if isinstance(stored, float) else math.inf
    worst = max(errors, key=lambda key: math.inf if math.isnan(errors[key]) else errors[key])
    return _build_check("file.objective", errors[worst] / max(1.0, abs(total)), worst)


def _build_fault_check(name: str, faults: list[str]) -> Check:
    """Return a check whose residual is the number of faults."""
    return _build_check(name, float(len(faults)), faults[0] if faults else "")


def _build_check(name: str, residual: float, worst_at: str = "") -> Check:
    """Return a check by its name in `LIMITS`; NaN never passes."""
    limit = LIMITS[name]
    passed = bool(residual <= limit.value)  # False for NaN
    place = worst_at if residual > 0 or not passed else ""
    return Check(name, residual, limit.value, limit.unit, passed, "", place)
