"""Verification of a dataset: every row's solution by the problem's own exact check.

Scenes of books, terrains and walks are checked from the file alone, motions from the files beside
it, rows of a stated program with its statement. That a terrain is infeasible is proved again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.bookshelf.check.plan_checks import check_solutions
from climbplan.bookshelf.plan import dataset_frame as shelf
from climbplan.bookshelf.schema.model import ShelfSolverSpec
from climbplan.climb.envelopes import dataset_rows as terrains
from climbplan.climb.envelopes.search import TOLERANCE, find_posture
from climbplan.climb.envelopes.terrains import LimbPatches
from climbplan.datasets.check import motion_rows
from climbplan.datasets.motions import rows as motions
from climbplan.datasets.schema.model import ProgramDatasetSpec, ShelfDatasetSpec
from climbplan.errors import PlanFileError, SpecError, UsageError
from climbplan.methods import dataset_rows as programs
from climbplan.program.problem import Problem
from climbplan.schema.kinds import Model, validate
from climbplan.schema.program.model import ProgramSolverSpec
from climbplan.schema.yaml_source import parse_yaml
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_file import read_dataset_file
from climbplan.verification.check import Check, LeftOut
from climbplan.verification.held import describe_reference
from climbplan.verification.verification import Verification, mark_verified
from climbplan.walking.check.checker import check_trajectory
from climbplan.walking.dynamics.cost import compute_objective
from climbplan.walking.online import dataset_rows as walks
from climbplan.walking.online.library import cut_sections

MEANINGS = {
    "file.spec_hash": "sha256 of the spec's text is the stored one",
    "rows.seeds": "rows of one seed hold different problems",
    "rows.integers": "integers are those of the solution",
    "rows.answers": "rows whose solution, cost and status do not go together",
    "rows.bound": "no bound exceeds its cost",
    "split.shared": "problems that are in both train and test",
    "block.residual": "the statement's worst block at every answered row",
    "rows.walks": "walks that break a limit of the exact check",
    "rows.sections": "features of sections are those of the walk",
    "rows.linear": "points of infeasible rows satisfy all rows of P but the bilinear ones",
    "rows.proof": "infeasible rows whose infeasibility is not proved again",
    "file.objective": "costs are those of the stored solutions",
    "rows.usable": "rows of motions that are usable without an answer, or have files otherwise",
    "rows.files": "motions and meshes that are missing or have another SHA-256",
    "rows.motions": "measures that usable motions break: slip, penetration, friction, limits",
}
_RELATIVE = 1e-6
_NO_BLOCKS = LeftOut("file alone", "the problem's blocks are not looked at without --problem")


def verify(path: Path, problem: Problem | None = None) -> Verification:
    """Check a dataset file; of a stated program only what needs no statement if none is given.

    Raises:
        PlanFileError: not a whole dataset.
        UsageError: another problem than the dataset's.
    """
    return verify_dataset(read_dataset_file(path), path, problem)


def verify_dataset(data: Dataset, path: Path, problem: Problem | None = None) -> Verification:
    """Verify a dataset that was read already; its path is for messages."""
    # Absurd numbers become infinite or NaN on the way and fail their check: no need to warn.
    with np.errstate(all="ignore"):
        checks = (*_check_file(data), *_check_rows(data, path, problem))
    is_file_alone = data.frame.kind == programs.KIND and problem is None
    beyond = (_NO_BLOCKS,) if is_file_alone else ()
    against = describe_reference(data, None)
    return Verification(checks, beyond=beyond, against=against, is_motion=False)


def verify_and_mark(path: Path, problem: Problem | None = None) -> Verification:
    """Verify a dataset and write the outcome into its file; raises as `verify`."""
    verification = verify(path, problem)
    mark_verified(path, verification)
    return verification


def _check_file(data: Dataset) -> Iterator[Check]:
    digest = hashlib.sha256(data.spec_text.encode()).hexdigest()
    yield _check_count("file.spec_hash", int(digest != data.spec_sha256))
    hashes = np.array(data.hashes())
    if data.train is not None and data.test is not None:
        shared = np.isin(hashes[data.train], hashes[data.test])
        yield _check_count("split.shared", int(shared.sum()))
    is_drawn = data.drawn
    pairs = {(int(s), h) for s, h in zip(data.seed[is_drawn], hashes[is_drawn], strict=True)}
    seeds = {int(s) for s in data.seed[is_drawn]}
    yield _check_count("rows.seeds", len(pairs) - len(seeds))
    over = (data.bound - data.objective) / np.maximum(1.0, np.abs(data.objective))
    yield _check_worst("rows.bound", np.where(data.feasible, over, 0.0), _RELATIVE, "relative")


def _check_rows(data: Dataset, path: Path, problem: Problem | None) -> Iterator[Check]:
    if data.frame.kind == shelf.KIND:
        yield from _check_shelves(data, path)
    elif data.frame.kind == programs.KIND:
        if problem is not None:
            yield from _check_program(data, problem)
    elif data.frame.kind == terrains.KIND:
        yield from _check_terrains(data, path)
    elif data.frame.kind == walks.KIND:
        yield from _check_walks(data, path)
    elif data.frame.kind == motions.KIND:
        yield from _check_motions(data, path)
    else:
        raise PlanFileError(f"{path}: rows of an unknown kind, {data.frame.kind!r}")


def _check_shelves(data: Dataset, path: Path) -> Iterator[Check]:
    try:
        shelf_data = shelf.read_shelf_dataset(data)
    except UsageError as error:
        raise PlanFileError(f"{path}: {error}") from error
    rows, solutions = shelf_data.rows, shelf_data.plan.solutions
    yield _check_count("rows.answers", int(data.feasible.sum()) - int(solutions.placed.sum()))
    expected = np.column_stack([solutions.state, solutions.slot])
    deviation = np.abs(data.integers[rows] - expected).max(axis=1).astype(float)
    yield _check_worst("rows.integers", np.where(data.feasible[rows], deviation, 0.0), 0.0)
    yield from check_solutions(shelf_data.plan, _read_shelf_solver(data))


def _read_shelf_solver(data: Dataset) -> ShelfSolverSpec | None:
    """Return the gaps that the spec asked for; None if its text is not that of such a spec."""
    spec = _parse_spec(data, ShelfDatasetSpec)
    return None if spec is None else spec.problem.solver


def _parse_spec(data: Dataset, model: type[Model]) -> Model | None:
    try:
        return validate(parse_yaml(data.spec_text, "spec"), model)[0]
    except SpecError:
        return None


def _check_program(data: Dataset, problem: Problem) -> Iterator[Check]:
    if data.frame != programs.build_frame(problem):
        raise UsageError(
            f"problem {problem.name!r} does not have the variables and parameters of the dataset "
            f"(made for {data.frame.problem!r})"
        )
    spec = _parse_spec(data, ProgramDatasetSpec)
    tolerance = (spec.problem.solver if spec is not None else ProgramSolverSpec()).tolerance
    rows = np.flatnonzero(data.feasible)
    integer = programs.mask_integer_variables(problem)
    worst, deviation, integer_deviation = (
        np.zeros(len(rows)),
        np.zeros(len(rows)),
        np.zeros(len(rows)),
    )
    for k, row in enumerate(rows):
        x, chosen = data.solution["x"][row], data.solution["assignment"][row]
        report = problem.program.check(x, problem.split(data.parameters[row]), chosen)
        worst[k] = max((block.residual for block in report.blocks), default=0.0)
        deviation[k] = abs(report.objective - data.objective[row]) / max(
            1.0, abs(data.objective[row])
        )
        stored = np.concatenate([np.round(x[integer]), chosen])
        integer_deviation[k] = float(np.abs(stored - data.integers[row]).max(initial=0.0))
    yield _check_worst("rows.integers", integer_deviation, 0.0, rows=rows)
    yield _check_worst("block.residual", worst, tolerance, rows=rows)
    yield _check_worst("file.objective", deviation, _RELATIVE, "relative", rows=rows)


def _check_walks(data: Dataset, path: Path) -> Iterator[Check]:
    """Yield every walk by the exact check: the margin of the worst of its checks."""
    task = walks.read_frame_task(data.frame, path)
    rows = np.flatnonzero(data.feasible)
    worst, deviation, integer_deviation, features = (np.zeros(len(rows)) for _ in range(4))
    lacks: dict[str, LeftOut] = {}
    for k, row in enumerate(rows):
        row_task, walk = walks.read_walk(task, data, int(row))
        checks = check_trajectory(row_task, walk)
        worst[k] = max(float(not check.passed) for check in checks)
        lacks |= {out.model: out for check in checks if (out := check.left_out) is not None}
        cost = compute_objective(row_task, walk.state, walk.force)
        deviation[k] = abs(cost - data.objective[row]) / max(1.0, abs(cost))
        contact = walk.gait.contact[:-1].astype(np.int64).ravel()
        integer_deviation[k] = float(np.abs(contact - data.integers[row]).max())
        recomputed_features = cut_sections(row_task, walk, 0).features
        features[k] = float(
            np.abs(recomputed_features - data.solution["section_features"][row]).max()
        )
    left = LeftOut(", ".join(lacks), "walks that hold in their model only") if lacks else None
    yield replace(_check_worst("rows.walks", worst, 0.0, rows=rows), left_out=left)
    yield _check_worst("rows.integers", integer_deviation, 0.0, rows=rows)
    yield _check_worst("rows.sections", features, _RELATIVE, rows=rows)
    yield _check_worst("file.objective", deviation, _RELATIVE, "relative", rows=rows)


def _check_motions(data: Dataset, path: Path) -> Iterator[Check]:
    """Yield whether files are there as the rows say, and measures of their motions."""
    motion_rows.require_columns(data, path)
    yield _check_count("rows.usable", motion_rows.count_unsound_rows(data))
    yield _check_worst("rows.files", motion_rows.find_changed_files(data, path.parent), 0.0)
    yield _check_worst("rows.motions", motion_rows.count_broken_measures(data, path.parent), 0.0)


def _check_terrains(data: Dataset, path: Path) -> Iterator[Check]:
    statement = terrains.build_statement(data.frame, path)
    feasible = np.flatnonzero(data.feasible)
    infeasible = np.array(
        [k for k, row_status in enumerate(data.status) if row_status == "infeasible"], int
    )
    residual, linear = np.zeros(len(feasible)), np.zeros(len(infeasible))
    proved = 0
    for k, row in enumerate(feasible):
        patches = LimbPatches.from_vector(data.parameters[row])
        instance = statement.program.instantiate(statement.theta(patches))
        residual[k] = instance.violation(terrains.read_point(statement, data, int(row)))
    for k, row in enumerate(infeasible):
        patches = LimbPatches.from_vector(data.parameters[row])
        instance = statement.program.instantiate(statement.theta(patches))
        x = terrains.read_point(statement, data, row)
        linear[k] = terrains.compute_linear_violation(instance, x)
        nodes = int(data.solution["nodes"][row])
        answer = find_posture(statement, patches, nodes=max(nodes, 1))
        proved += answer.status == "infeasible"
    yield _check_worst("block.residual", residual, TOLERANCE, rows=feasible)
    yield _check_worst("file.objective", np.abs(data.objective[feasible]), 0.0, rows=feasible)
    yield _check_worst("rows.linear", linear, TOLERANCE, rows=infeasible)
    yield _check_count("rows.proof", len(infeasible) - proved)


def _check_count(name: str, faults: int) -> Check:
    return Check(name, float(faults), 0.0, "", faults == 0, "", "", 0.0)


def _check_worst(
    name: str,
    residual: np.ndarray,
    limit: float,
    unit: str = "",
    rows: np.ndarray | None = None,
) -> Check:
    """Return the largest residual over rows; nothing to check passes."""
    if residual.size == 0:
        return Check(name, 0.0, limit, unit, True, "", "", 0.0)
    worst_row = int(np.argmax(np.where(np.isnan(residual), np.inf, residual)))
    value = (
        max(float(residual[worst_row]), 0.0)
        if residual[worst_row] == residual[worst_row]
        else float("nan")
    )
    passed = bool(value <= limit)
    place = f"row {worst_row if rows is None else rows[worst_row]}" if value != 0 else ""
    return Check(name, value, limit, unit, passed, "", place, value / limit if limit else 0.0)
