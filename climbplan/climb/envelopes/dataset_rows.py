"""Labelled terrains as rows of a dataset (Algorithm 1): drawn, decided, and read back for a fit.

parameters: patches of all limbs (`LimbPatches.vector`). solution, of a feasible row a point of
problem P, of an infeasible one a solution of P without its bilinear rows: weights of patch corners,
toe [P], force [weights], com [P], rpy [rad], and the nodes that the decision took.

Algorithm numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.envelopes.distribution import build_distribution
from climbplan.climb.envelopes.legs import Legs
from climbplan.climb.envelopes.relaxation import solve_relaxed
from climbplan.climb.envelopes.rows import TerrainDataset, find_linear_point
from climbplan.climb.envelopes.search import find_posture
from climbplan.climb.envelopes.statement import PostureStatement, build_posture_statement
from climbplan.climb.envelopes.terrains import CORNERS, LimbPatches, TerrainDistribution
from climbplan.climb.schema.terrains_dataset import TerrainsProblemSpec
from climbplan.errors import LimitReached, PlanFileError, UsageError
from climbplan.program.instance import Instance
from climbplan.robots.model import Robot
from climbplan.store.dataset import Dataset, DatasetFrame, build_solution_layout
from climbplan.store.dataset_row import RowAnswer

KIND = "terrains"
BLOCKS = ("weight", "toe", "force", "com", "rpy")  # all variables of the statement


@dataclass(frozen=True)
class DecidedTerrain:
    """A terrain and what is known about it."""

    patches: LimbPatches
    status: Literal["feasible", "infeasible", "limit"]
    x: Array | None  # a point of P; of an infeasible one of P without its bilinear rows
    nodes: int
    tried: int  # terrains drawn for it
    seconds: float


class TerrainRows:
    """Draws terrains until one has the label that the row is for."""

    def __init__(self, spec: TerrainsProblemSpec, robot: Robot) -> None:
        """The robot stands on the limbs that the spec's distribution names."""
        self._spec = spec
        self._terrains = build_distribution(spec.terrain, robot)
        self._statement = build_posture_statement(self._terrains.legs)
        self._frame = build_frame(self._terrains)

    @property
    def frame(self) -> DatasetFrame:
        """Limbs and distribution."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> DecidedTerrain:
        """Return a decided terrain; raises LimitReached if none of the row's label was found in
        time.

        Terrains that do not even allow a balance of forces are passed over. One that stays
        undecided, or is infeasible though its relaxation is not, is taken as it is.
        """
        spec, statement = self._spec, self._statement
        begin = time.perf_counter()
        wants_feasible = bool(rng.random() < spec.feasible_fraction)
        description = "a feasible terrain" if wants_feasible else "an infeasible terrain"
        for num_tried in range(1, spec.max_attempts + 1):
            if time.perf_counter() - begin > spec.solver.time_limit:
                raise LimitReached(
                    f"{description} was not drawn within {spec.solver.time_limit:g} s "
                    "(problem.solver.time_limit)"
                )
            patches = self._terrains.sample(rng)
            theta = statement.theta(patches)
            root = solve_relaxed(statement.legs, patches, theta["force"], theta["moment"])
            if (root is not None) != wants_feasible:
                continue
            linear = find_linear_point(statement.program.instantiate(theta))
            if linear is None:
                continue
            if root is None:
                duration = time.perf_counter() - begin
                return DecidedTerrain(patches, "infeasible", linear, 1, num_tried, duration)
            answer = find_posture(statement, patches, nodes=spec.solver.node_limit)
            x = linear if answer.status == "infeasible" else answer.x
            duration = time.perf_counter() - begin
            return DecidedTerrain(patches, answer.status, x, answer.nodes, num_tried, duration)
        raise LimitReached(
            f"{description} was not drawn in {spec.max_attempts} draws (problem.max_attempts)"
        )

    def parameters(self, terrain: DecidedTerrain) -> Array:
        """Return vertices, normals and friction coefficients."""
        return terrain.patches.vector()

    def solve(self, terrain: DecidedTerrain) -> RowAnswer:
        """Return the label with its point."""
        point_values: dict[str, Any] | None = None
        if terrain.x is not None:
            point_values = {name: self._statement.program.value(name, terrain.x) for name in BLOCKS}
            point_values["nodes"] = np.asarray(terrain.nodes)
        messages = {
            "feasible": "",
            "infeasible": "proved: no forces balance at any toes in the patches",
            "limit": f"undecided after {terrain.nodes} nodes",
        }
        feasible = terrain.status == "feasible"
        return RowAnswer(
            status=terrain.status,
            message=messages[terrain.status],
            solution=point_values if feasible else None,
            evidence=None if feasible else point_values,
            integers=np.zeros(0, np.int64),
            objective=0.0 if feasible else np.nan,
            time=terrain.seconds,
        )


def build_frame(terrains: TerrainDistribution) -> DatasetFrame:
    """Return what rows of one distribution share."""
    legs = terrains.legs
    n = legs.count
    facts = {
        "distribution": terrains.name,
        "tilt": terrains.tilt,
        "jitter": terrains.jitter,
        "half_size": terrains.half_size,
        "limb_names": list(legs.names),
        "shoulder": legs.shoulder.tolist(),
        "stance": legs.stance.tolist(),
        "reach": legs.reach,
        "stance_radius": legs.stance_radius,
        "position_scale": legs.length,
    }
    corners = [f"{limb}_{u}_{a}" for limb in legs.names for u in range(CORNERS) for a in "xyz"]
    normals = [f"{limb}_normal_{a}" for limb in legs.names for a in "xyz"]
    return DatasetFrame(
        kind=KIND,
        problem=terrains.name,
        facts=facts,
        parameter_names=(*corners, *normals, *(f"{limb}_friction" for limb in legs.names)),
        integer_names=(),
        layouts={
            "weight": build_solution_layout((n, CORNERS)),
            "toe": build_solution_layout((n, 3), "P", "world"),
            "force": build_solution_layout((n, 3), "weight", "world"),
            "com": build_solution_layout((3,), "P", "world"),
            "rpy": build_solution_layout((3,), "rad"),
            "nodes": build_solution_layout((), kind="int"),
        },
    )


def build_statement(frame: DatasetFrame, path: Path) -> PostureStatement:
    """Return problem P of a dataset's limbs; raises PlanFileError for facts of anything else."""
    facts = frame.facts
    try:
        legs = Legs(
            tuple(str(name) for name in facts["limb_names"]),
            np.array(facts["shoulder"], float),
            np.array(facts["stance"], float),
            float(facts["reach"]),
            float(facts["stance_radius"]),
            float(facts["position_scale"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise PlanFileError(f"{path}: facts are not those of limbs: {error}") from error
    n = legs.count
    if legs.shoulder.shape != (n, 3) or legs.stance.shape != (n, 3):
        raise PlanFileError(f"{path}: facts hold no numbers for {n} limbs")
    if len(frame.parameter_names) != (3 * CORNERS + 4) * n or set(frame.layouts) != {
        *BLOCKS,
        "nodes",
    }:
        raise PlanFileError(f"{path}: its columns are not those of terrains of {n} limbs")
    return build_posture_statement(legs)


def read_point(statement: PostureStatement, data: Dataset, row: int) -> Array:
    """Return the point (n,) that a row holds, NaN where it has none."""
    x = np.empty(max(block.stop for block in statement.program.variables.values()))
    for name in BLOCKS:
        block = statement.program.variables[name]
        x[block.start : block.stop] = data.solution[name][row].ravel()
    return x


def compute_linear_violation(instance: Instance, x: Array) -> float:
    """Return how far a point misses the bounds and those rows of P that have no products."""
    free = np.diff(instance.Q.indptr) == 0
    row = (instance.A @ x)[free]
    residuals = (
        instance.row_lower[free] - row,
        row - instance.row_upper[free],
        instance.lower - x,
        x - instance.upper,
    )
    return max(float(residual.max(initial=0.0)) for residual in residuals)


@dataclass(frozen=True)
class LabelledRows:
    """Rows to fit to, and rows that are held out."""

    training: TerrainDataset
    held_out: TerrainDataset


def read_labelled_rows(data: Dataset, path: Path, terrains: TerrainDistribution) -> LabelledRows:
    """Return the decided rows of a dataset, by its masks.

    Raises UsageError for a dataset of something else, without masks, or with a mask that lacks
    feasible or infeasible rows.
    """
    if data.frame != build_frame(terrains):
        raise UsageError(
            f"{path}: a dataset of {data.frame.problem!r}, which is not the spec's distribution "
            f"({terrains.name}) with its limbs and ranges"
        )
    if data.train is None or data.test is None:
        raise UsageError(f"{path}: no split into train and test: climbplan data split {path}")
    return LabelledRows(
        _select_rows(data, np.flatnonzero(data.train), f"{path}: train"),
        _select_rows(data, np.flatnonzero(data.test), f"{path}: test"),
    )


def _select_rows(data: Dataset, chosen: IntArray, place: str) -> TerrainDataset:
    decided = np.array([data.status[k] in ("feasible", "infeasible") for k in chosen], bool)
    rows = chosen[decided]
    feasible = data.feasible[rows]
    if not feasible.any() or feasible.all():
        raise UsageError(f"{place}: both feasible and infeasible rows are needed")
    point = np.concatenate([data.solution["toe"][rows], data.solution["force"][rows]], axis=2)
    return TerrainDataset(
        terrain=data.parameters[rows],
        feasible=feasible,
        point=point,
        drawn=len(chosen),
        trivial=0,
        undecided=int((~decided).sum()),
    )
