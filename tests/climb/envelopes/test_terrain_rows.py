"""Labelled terrains as rows of a dataset: drawn, checked again, and read for a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from climbplan.climb.envelopes.dataset_rows import (
    TerrainRows,
    compute_linear_violation,
    read_labelled_rows,
    read_point,
)
from climbplan.climb.envelopes.distribution import build_distribution
from climbplan.climb.envelopes.legs import build_ball_directions
from climbplan.climb.envelopes.statement import build_posture_statement
from climbplan.climb.envelopes.terrains import LimbPatches
from climbplan.climb.schema.envelopes_loading import build_envelopes
from climbplan.climb.schema.terrains_dataset import TerrainsProblemSpec
from climbplan.datasets.check.verification import verify_dataset
from climbplan.errors import LimitReached, PlanFileError, SpecError, UsageError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_any_robot, load_robot
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_row import Row, build_dataset, derive_seed

PLACE = Path("dataset.h5")


def _spec(**changes: object) -> TerrainsProblemSpec:
    given = {
        "kind": "terrains",
        "robot": "silvia",
        "terrain": {"distribution": "wall3"},
        "solver": {"node_limit": 40},
    }
    return TerrainsProblemSpec.model_validate({**given, **changes})


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.from_spec(load_robot("silvia"))


def _made(source: TerrainRows, count: int) -> Dataset:
    rows = []
    for k in range(count):
        drawn = source.draw(np.random.default_rng(derive_seed(4, k)))
        rows.append(Row(k, derive_seed(4, k), source.parameters(drawn), source.solve(drawn)))
    return replace(build_dataset(source.frame, rows), spec_sha256="e3b0c442" + _EMPTY)


def _rows(data: Dataset, status: str) -> np.ndarray:
    return np.array([k for k, word in enumerate(data.status) if word == status])


_EMPTY = "98fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"  # rest of sha256 of nothing


@pytest.fixture(scope="module")
def data(robot: Robot) -> Dataset:
    return _made(TerrainRows(_spec(), robot), 14)


def test_rows_are_decided_and_verified(data: Dataset) -> None:
    assert {"feasible", "infeasible"} <= set(data.status) <= {"feasible", "infeasible", "limit"}
    verification = verify_dataset(data, PLACE)
    assert verification.passed, verification
    names = {check.name for check in verification.checks}
    assert {"block.residual", "rows.linear", "rows.proof"} <= names


def test_infeasible_rows_balance_forces_but_not_moments(data: Dataset, robot: Robot) -> None:
    terrains = build_distribution(_spec().terrain, robot)
    statement = build_posture_statement(terrains.legs)
    for row in _rows(data, "infeasible"):
        force, toe = data.solution["force"][row], data.solution["toe"][row]
        np.testing.assert_allclose(force.sum(axis=0), [0, 0, 1], atol=1e-6)
        moment = np.cross(toe - data.solution["com"][row], force).sum(axis=0)
        assert np.abs(moment).max() > 1e-4
        patches = LimbPatches.from_vector(data.parameters[row])
        instance = statement.program.instantiate(statement.theta(patches))
        assert compute_linear_violation(instance, read_point(statement, data, row)) <= 1e-7
        assert (
            compute_linear_violation(instance, np.zeros(instance.size)) > 0.1
        )  # no weights: not on it


def test_a_moved_toe_fails_the_check(data: Dataset) -> None:
    toe = data.solution["toe"].copy()
    toe[np.flatnonzero(data.feasible)[0], 0, 0] += 1e-4
    verification = verify_dataset(replace(data, solution={**data.solution, "toe": toe}), PLACE)
    failed = {check.name for check in verification.checks if not check.passed}
    assert failed == {"block.residual"}


def test_a_feasible_terrain_called_infeasible_fails_the_check(data: Dataset) -> None:
    row = int(np.flatnonzero(data.feasible)[0])
    feasible = data.feasible.copy()
    feasible[row] = False
    status = tuple("infeasible" if k == row else word for k, word in enumerate(data.status))
    verification = verify_dataset(replace(data, feasible=feasible, status=status), PLACE)
    failed = {check.name for check in verification.checks if not check.passed}
    assert failed == {"rows.proof"}


def test_share_of_feasible_rows(robot: Robot) -> None:
    for share, word in ((1.0, "feasible"), (0.0, "infeasible")):
        source = TerrainRows(_spec(feasible_fraction=share), robot)
        statuses = {source.draw(np.random.default_rng(k)).status for k in range(4)}
        assert statuses == {word}
    source = TerrainRows(_spec(feasible_fraction=0.0, max_attempts=1), robot)
    with pytest.raises(LimitReached, match="in 1 draws"):
        [source.draw(np.random.default_rng(k)) for k in range(20)]


def test_rows_for_a_fit(data: Dataset, robot: Robot) -> None:
    terrains = build_distribution(_spec().terrain, robot)
    with pytest.raises(UsageError, match="data split"):
        read_labelled_rows(data, PLACE, terrains)
    half = np.arange(data.count) % 2 == 0
    good = np.flatnonzero(data.feasible)
    half[good[0]], half[good[1]] = True, False
    bad = _rows(data, "infeasible")
    half[bad[0]], half[bad[1]] = True, False
    split = replace(data, train=half, test=~half)
    rows = read_labelled_rows(split, PLACE, terrains)
    decided = np.array([word != "limit" for word in data.status])
    assert len(rows.training.terrain) == (half & decided).sum()
    assert len(rows.held_out.terrain) == (~half & decided).sum()
    toe = data.solution["toe"][half & decided]
    np.testing.assert_array_equal(rows.training.point[:, :, :3], toe)
    with pytest.raises(UsageError, match="not the spec's distribution"):
        read_labelled_rows(split, PLACE, replace(terrains, jitter=0.05))
    with pytest.raises(UsageError, match="both feasible and infeasible"):
        read_labelled_rows(
            replace(split, test=data.feasible, train=~data.feasible), PLACE, terrains
        )


def test_foreign_facts_are_refused(data: Dataset) -> None:
    frame = replace(data.frame, facts={**data.frame.facts, "shoulder": [[0, 0]]})
    with pytest.raises(PlanFileError, match="no numbers for 3 limbs"):
        verify_dataset(replace(data, frame=frame), PLACE)


def test_any_robot_stands_on_terrains_of_its_own() -> None:
    """A robot from a URDF, between walls with all its limbs and on the ground with three."""
    walker = build_robot(load_any_robot("specs/robot_walker.yaml"))
    spec = _spec(terrain={"distribution": "wall", "tilt_deg": 20}, feasible_fraction=1.0)
    terrains = build_distribution(spec.terrain, walker)
    assert terrains.legs.names == walker.limb_names
    np.testing.assert_array_equal(terrains.legs.stance, walker.stance_body)
    assert (terrains.normal[:, 0] * walker.stance_body[:, 0] < 0).all()
    toes = walker.stance_body[:, None] + walker.stance_radius * build_ball_directions()
    near = np.linalg.norm(toes - walker.shoulder_body[:, None], axis=-1) <= walker.reach
    assert 0.7 < np.linalg.norm(toes[near], axis=-1).max() <= terrains.legs.length
    data = _made(TerrainRows(spec, walker), 2)
    assert verify_dataset(data, PLACE).passed
    assert set(data.status) == {"feasible"}
    stance = {"L1": (-0.4, 0.3, -0.2)}
    own = {"distribution": "ground", "limbs": ["L1", "R1", "L2"], "stance": stance}
    standing = build_distribution(_spec(terrain=own).terrain, walker)
    assert standing.legs.names == ("L1", "R1", "L2")
    np.testing.assert_array_equal(standing.legs.stance[0], stance["L1"])
    np.testing.assert_array_equal(standing.normal, np.tile([0.0, 0.0, 1.0], (3, 1)))


def test_limbs_of_terrains_are_those_of_the_robot() -> None:
    text = {"kind": "envelopes", "robot": "silvia", "terrain": {"distribution": "ground"}}

    def mistakes(**terrain: object) -> str:
        data = {**text, "terrain": {**text["terrain"], **terrain}}  # type: ignore[dict-item]
        source = SourceText("e.yaml", "e", Path(), yaml.safe_dump(data))
        with pytest.raises(SpecError) as refused:
            build_envelopes(parse_yaml(source.text, source.shown), source)
        return str(refused.value)

    assert "terrain.limbs.2: SiLVIA has no limb 'LX'" in mistakes(limbs=["RF", "LF", "LX"])
    assert "terrain.stance.LX: SiLVIA has no limb" in mistakes(stance={"LX": [0, 0, 0]})
    assert "expected at least 3 limbs, got 2" in mistakes(limbs=["RF", "LF"])
    assert "expected each limb once" in mistakes(limbs=["RF", "LF", "RF"])
    named = mistakes(distribution="ground3", limbs=["RF", "LF", "LR"])
    assert "`ground3` names its limbs" in named
