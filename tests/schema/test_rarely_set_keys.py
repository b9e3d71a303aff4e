"""Keys that no shipped spec sets reach what they are for, in its units."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.table import prepare_method
from climbplan.bookshelf.planner.dataset_rows import build_drop_rules
from climbplan.bookshelf.scene.scene_source import build_shelf
from climbplan.bookshelf.schema.dataset import BookshelfProblemSpec
from climbplan.bookshelf.schema.loading import load_shelf
from climbplan.climb.envelopes import run
from climbplan.climb.postures.statement import build_posture_program
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.envelopes_loading import load_envelopes
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.worlds.uncertainty import Distribution
from climbplan.climb.simulation.worlds.uncertainty_spec import read_uncertainty
from climbplan.datasets.schema.loading import load_dataset
from climbplan.limms.legs.gaits import generate_gaits
from climbplan.limms.schema.loading import load_limms
from climbplan.schema.robots.stored import RobotTexts
from climbplan.walking.micp.limits import read_limits
from climbplan.walking.online.admittance import AdmittanceController, AdmittanceGains
from climbplan.walking.online.estimation import SensorQuality
from climbplan.walking.online.state_feedback import SimulatedSensors
from climbplan.walking.schema.loading import load_mpc

SPECS = Path(__file__).parents[2] / "specs"


def test_shelf_of_other_tolerances() -> None:
    keys = {
        "max_wall_gap_mm": 2.0,
        "lean_margin_deg": 3.0,
        "published.distance_tolerance_mm": 4.0,
        "published.left_wall_tolerance_mm": 5.0,
    }
    overrides = [f"shelf.{key}={value}" for key, value in keys.items()]
    shelf = build_shelf(load_shelf(SPECS / "bookshelf_scene.yaml", overrides).spec.shelf)
    assert shelf.wall_gap == 2e-3
    assert shelf.lean_margin == math.radians(3.0)
    assert shelf.published.distance == 4e-3
    assert shelf.published.left_wall == 5e-3


def test_a_search_of_books_ends_at_its_nodes() -> None:
    """Within a wide gap the first placement is enough; one node proves nothing in three books."""
    spec = load_shelf(
        SPECS / "bookshelf_scene.yaml",
        ["solver.method=exact", "solver.gap_mm2=7.5", "solver.node_limit=1"],
    ).spec
    setting = MethodSetting.of(spec, build_shelf(spec.shelf), SPECS)
    method = prepare_method(setting, 1)
    assert isinstance(method, ExactSolver)
    limits = method.limits
    assert (limits.gap_absolute, limits.nodes) == (7.5, 1)


def test_datasets_draw_upright_books_and_wait_for_rows() -> None:
    drop = BookshelfProblemSpec.model_validate(
        {"kind": "bookshelf", "drop": {"upright_acceptance": 0.2}}
    )
    assert build_drop_rules(drop).upright_kept == 0.2
    spec = load_dataset(SPECS / "dataset_bookshelf.yaml", ["row_timeout=77"]).spec
    assert spec.row_seconds == 77.0


def test_walks_begin_with_more_pieces_and_softer_legs() -> None:
    overrides = [
        "solver.moment_arm_partitions=3",
        "solver.height_pieces=5",
        "solver.method=spatial-branch-and-bound",
    ]
    limits = read_limits(load_mpc(SPECS / "mpc_forward.yaml", overrides).spec.solver)
    assert (limits.arm_pieces, limits.height_pieces) == (3, 5)
    gains = ["leg_stiffness=1000", "leg_damping=7"]
    stated = load_mpc(
        SPECS / "mpc_forward.yaml",
        ["solver.method=online", *(f"loop.admittance.{gain}" for gain in gains)],
    ).spec.loop.admittance
    legs = AdmittanceController(AdmittanceGains(**stated.model_dump()), 1)
    ahead, rate = np.array([[0.0, 0.0, 0.01]]), np.array([[0.0, 0.0, 0.1]])
    assert np.allclose(legs.compute_forces(np.zeros((1, 3)), ahead, rate), [[0.0, 0.0, 10.0 + 0.7]])


def test_a_gyroscope_is_as_noisy_as_stated() -> None:
    overrides = ["solver.method=online", "loop.sensors.gyro=0.5"]
    stated = load_mpc(SPECS / "mpc_forward.yaml", overrides).spec.loop.sensors
    quality = SensorQuality(**stated.model_dump())
    sensors = SimulatedSensors(quality, 9.81, np.random.default_rng(0), gyro_bias=0.0)
    still, toes = np.zeros(12), np.zeros((4, 3))
    felt = [sensors.sample(still, still, toes, np.ones(4, bool), 1e-3).gyro for _ in range(500)]
    assert 0.45 < np.std(felt) < 0.55


def test_quadrupeds_of_modules_take_no_more_steps_than_allowed() -> None:
    most = load_limms(SPECS / "limms_lift_heavy.yaml", ["solver.max_steps=4"]).spec.solver
    shift = np.array([0.3, 0.0, 0.0])
    few = list(generate_gaits(4, 1, shift, 0.1, most.max_steps))
    assert few
    assert len(few) < len(list(generate_gaits(4, 1, shift, 0.1, 16)))


def test_postures_are_held_within_reach_on_the_way_or_not() -> None:
    rows = []
    for value in ("true", "false"):
        loaded = load_climb(
            SPECS / "climb_obstacle.yaml", [f"posture.check_reach_during_round={value}"]
        )
        scene = build_scene(loaded.spec, loaded.robot)
        rows.append({block.name for block in build_posture_program(scene).blocks.balls})
    assert rows[0] - rows[1] == {
        "workspace.stance_lift",
        "workspace.stance_place",
        "workspace.reach_lift",
        "workspace.reach_place",
    }


def test_motors_of_worlds_are_as_weak_as_stated() -> None:
    loaded = load_climb(SPECS / "climb_obstacle.yaml", ["uncertainty.motor_gain=0.2"])
    plan: Any = SimpleNamespace(spec_text=loaded.text, name="plan", robot_texts=RobotTexts())
    assert read_uncertainty(plan).gain == Distribution("normal", 0.0, 0.2)


def test_envelopes_are_grown_until_enough_is_feasible(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of envelopes that are their own growth, and of which as much is feasible as they grew."""
    overrides = ["fit.least_feasible=0.5", "fit.likelihood=0.25"]
    spec = load_envelopes(SPECS / "envelopes_ground3.yaml", overrides).spec
    likelihoods = []

    def fitted(_: object, __: object, count: int, likelihood: float, seed: int) -> list[Any]:
        likelihoods.append(likelihood)
        return [SimpleNamespace(envelope=SimpleNamespace(widen=lambda growth: growth))]

    monkeypatch.setattr(run, "GROWTHS", (0.1, 0.4, 0.6, 0.9))
    monkeypatch.setattr(run, "select_training_points", lambda moved: (None, None))
    monkeypatch.setattr(run, "fit_clusters", fitted)
    rows: Any = SimpleNamespace(feasible=np.ones(3, bool))
    labels: Any = lambda envelopes, rows: [np.full(3, envelopes[0][0])]  # noqa: E731
    assert run.fit_by_clustering(rows, labels, spec) == (0.6,)
    assert likelihoods == [0.25]
