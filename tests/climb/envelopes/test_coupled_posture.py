"""Problem P of one posture: the exact search against first principles and against SCIP."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.climb.envelopes.legs import INSCRIBED, build_ball_directions
from climbplan.climb.envelopes.relaxation import solve_relaxed
from climbplan.climb.envelopes.search import find_posture
from climbplan.climb.envelopes.statement import PostureStatement, build_posture_statement
from climbplan.climb.envelopes.terrains import (
    DISTRIBUTIONS,
    LimbPatches,
    TerrainDistribution,
    select_distribution,
)
from climbplan.errors import UsageError
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_robot
from climbplan.solvers.registry import solve


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.from_spec(load_robot("silvia"))


@pytest.fixture(scope="module", params=DISTRIBUTIONS)
def case(
    request: pytest.FixtureRequest, robot: Robot
) -> tuple[TerrainDistribution, PostureStatement]:
    terrains = select_distribution(request.param, robot)
    return terrains, build_posture_statement(terrains.legs)


def test_directions_leave_the_polytope_inside_the_ball() -> None:
    """The constant is the least cosine to the nearest direction, found by sampling."""
    points = np.random.default_rng(0).normal(size=(200_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    least = (points @ build_ball_directions().T).max(axis=1).min()
    assert INSCRIBED <= least <= INSCRIBED + 1e-3


def test_feasible_points_satisfy_the_physics(
    case: tuple[TerrainDistribution, PostureStatement],
) -> None:
    """Exact cone, exact ball, patch, and moments about the body itself."""
    terrains, statement = case
    legs, found = terrains.legs, 0
    for k in range(12):
        patches = terrains.sample(np.random.default_rng([5, k]))
        answer = find_posture(statement, patches, nodes=100)
        if answer.x is None:
            continue
        found += 1
        value = {n: statement.program.value(n, answer.x) for n in statement.program.variables}
        toe, force, com = value["toe"], value["force"], value["com"]
        down = np.array([0.0, 0.0, -1.0])
        np.testing.assert_allclose(force.sum(axis=0) + down, 0, atol=1e-6)
        np.testing.assert_allclose(np.cross(toe - com, force).sum(axis=0), 0, atol=1e-6)
        pressure = np.einsum("ij,ij->i", force, patches.normal)
        shear = np.linalg.norm(force - pressure[:, None] * patches.normal, axis=1)
        assert (shear <= patches.friction * pressure + 1e-6).all()
        offset = np.einsum("ij,ij->i", toe * legs.length - patches.vertices[:, 0], patches.normal)
        np.testing.assert_allclose(offset, 0, atol=1e-6)
        turned = legs.stance + np.cross(value["rpy"], legs.stance)
        arm = (toe - com) * legs.length - turned
        assert (np.linalg.norm(arm, axis=1) <= legs.stance_radius + 1e-6).all()
    assert found >= 3


def test_infeasible_is_what_scip_finds_too(robot: Robot) -> None:
    """Labels of walls agree with spatial branch and bound on the statement itself."""
    terrains = select_distribution("wall3", robot)
    statement = build_posture_statement(terrains.legs)
    labels = []
    for k in range(8):
        patches = terrains.sample(np.random.default_rng([7, k]))
        ours = find_posture(statement, patches, nodes=200)
        if ours.status == "limit":
            continue
        theirs = solve(
            statement.program.instantiate(statement.theta(patches)), "minlp-scip", time_limit=5
        )
        if theirs.status == "limit":
            continue
        assert (theirs.x is not None) == (ours.status == "feasible")
        labels.append(ours.status)
    assert len(set(labels)) == 2


def test_relaxation_holds_every_posture(
    case: tuple[TerrainDistribution, PostureStatement],
) -> None:
    """A terrain with a posture has a relaxed one: what the proofs rest on."""
    terrains, statement = case
    for k in range(12):
        patches = terrains.sample(np.random.default_rng([5, k]))
        if find_posture(statement, patches, nodes=50).status != "feasible":
            continue
        theta = statement.theta(patches)
        assert solve_relaxed(terrains.legs, patches, theta["force"], theta["moment"]) is not None


def test_rows_of_patches_round_trip(robot: Robot) -> None:
    patches = select_distribution("wall5", robot).sample(np.random.default_rng(1))
    again = LimbPatches.from_vector(patches.vector())
    np.testing.assert_array_equal(again.vertices, patches.vertices)
    np.testing.assert_array_equal(again.normal, patches.normal)
    np.testing.assert_array_equal(again.friction, patches.friction)
    with pytest.raises(UsageError, match="numbers for each limb of a row"):
        LimbPatches.from_vector(np.zeros(17))


def test_samples_stay_in_their_distribution(robot: Robot) -> None:
    terrains = select_distribution("wall3", robot)
    for k in range(50):
        patches = terrains.sample(np.random.default_rng(k))
        cosine = np.einsum("ij,ij->i", patches.normal, terrains.normal)
        assert (cosine >= np.cos(terrains.tilt) - 1e-12).all()
        assert ((patches.friction >= 0.1) & (patches.friction <= 1.2)).all()
        off = np.abs(patches.vertices.mean(axis=1) - terrains.legs.stance)
        assert (off <= terrains.jitter + 1e-12).all()
    with pytest.raises(UsageError, match="unknown terrains"):
        select_distribution("ceiling", Robot.from_spec(load_robot("silvia")))


def test_a_program_that_defeats_presolve_is_still_decided(robot: Robot) -> None:
    """HiGHS 1.15 ends with neither answer on this terrain, and from the basis it leaves."""
    terrains = select_distribution("wall3", robot)
    statement = build_posture_statement(terrains.legs)
    patches = terrains.sample(np.random.default_rng([3, 351]))
    theta = statement.theta(patches)
    assert solve_relaxed(terrains.legs, patches, theta["force"], theta["moment"]) is None
