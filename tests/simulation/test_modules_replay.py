"""Plans of modules in MuJoCo: the checker's loads again, latches that break, files that tell it."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from climbplan.cli.app import app
from climbplan.errors import UsageError
from climbplan.limms.plan.file import write_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.schema.loading import load_limms
from climbplan.limms.simulation.comparison import compare_modules
from climbplan.limms.simulation.model import build_simulated_module, compute_mass_fraction
from climbplan.limms.simulation.replay import ModuleRun, simulate_modules
from climbplan.limms.simulation.study import (
    SimulatedModules,
    describe_end,
    format_headline,
    simulate_module_plan,
)
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.request import SimulationRequest

pytest.importorskip("mujoco")
SPECS = Path(__file__).parents[2] / "specs"


@pytest.fixture(scope="module")
def light() -> LimmsPlan:
    return plan_limms(load_limms(SPECS / "limms_throw.yaml"))


@pytest.fixture(scope="module")
def heavy() -> LimmsPlan:
    return plan_limms(load_limms(SPECS / "limms_lift_with_mass.yaml"))


@pytest.fixture(scope="module")
def lifted(heavy: LimmsPlan) -> ModuleRun:
    return simulate_modules(heavy, Conditions())


def test_a_throw_of_light_modules_ends_where_planned(light: LimmsPlan) -> None:
    run = simulate_modules(light, Conditions())
    compared = compare_modules(run)
    assert not run.lost
    assert run.broken == ()
    assert run.module.mass < 0.05 * light.box_mass[0]
    assert compared.box_error.max() < 0.005
    assert run.misses.max() < 0.001
    # In the air, as thrown
    flying = run.time > light.motion.time[light.motion.box_mode[:, 0] == 2][0]
    assert np.ptp(run.box[flying, 0, 2]) > 0.05


def test_legs_of_massless_plans_are_lighter_than_arms(light: LimmsPlan) -> None:
    assert compute_mass_fraction(light) == 0.03
    walking = replace(light, motion=replace(light.motion, mode=np.full_like(light.motion.mode, 4)))
    assert compute_mass_fraction(walking) == 5e-4
    share = build_simulated_module(walking).mass / light.box_mass[0]
    assert share == pytest.approx(5e-4)


def test_loads_are_those_that_the_checker_finds(lifted: ModuleRun) -> None:
    compared = compare_modules(lifted)
    assert not lifted.lost
    assert lifted.broken == ()
    assert compared.box_error.max() < 0.002
    on_wall = next(borne for borne in compared.contacts if borne.name.endswith("on left"))
    assert on_wall.force > 60  # a module of 40.6 N swings and carries
    assert on_wall.force == pytest.approx(on_wall.force_planned, rel=0.03)
    assert on_wall.moment == pytest.approx(on_wall.moment_planned, rel=0.03)
    assert np.median(np.abs(lifted.torque - lifted.planned_torque)) < 0.05
    most = np.abs(lifted.torque).max()
    assert most == pytest.approx(np.abs(lifted.planned_torque).max(), rel=0.03)


def test_a_latch_breaks_at_its_limit_and_the_box_is_lost(
    heavy: LimmsPlan, lifted: ModuleRun
) -> None:
    borne = {each.name: each for each in compare_modules(lifted).contacts}
    (on_box,) = (each for name, each in borne.items() if " on box" in name)
    weak = replace(heavy, module=heavy.module | {"latch_moment": 0.9 * on_box.moment})
    run = simulate_modules(weak, Conditions())
    assert run.broken
    broken = run.broken[0]
    assert f"holds {0.9 * on_box.moment:g} N m and bears" in broken.words
    found = SimulatedModules(weak, run, compare_modules(run), "")
    assert not describe_end(found).good
    assert describe_end(found).failure(None)
    assert broken.words in format_headline(found)
    # Massless the same motion breaks nothing: its plan does not ask what hardware holds
    free = replace(weak, massless=True)
    assert simulate_modules(free, Conditions()).broken == ()


@pytest.mark.slow
def test_a_heavier_box_than_planned_is_not_where_it_should_be(heavy: LimmsPlan) -> None:
    run = simulate_modules(heavy, Conditions(payload=0.5))
    assert run.lost or run.broken or compare_modules(run).box_error.max() > 0.005


def test_what_modules_are_not_simulated_with_is_refused(light: LimmsPlan) -> None:
    for asked, flag in (
        (SimulationRequest(Conditions(), runs=3), "--runs"),
        (SimulationRequest(Conditions(speed=2.0)), "--speed"),
    ):
        with pytest.raises(UsageError, match=flag):
            simulate_module_plan(light, asked)


def test_the_command_writes_what_others_do(light: LimmsPlan, tmp_path: Path) -> None:
    write_limms_plan(light, tmp_path / "plan.h5")
    arguments = ["simulate", str(tmp_path / "plan.h5"), "-o", str(tmp_path / "out"), "--json"]
    answer = CliRunner().invoke(app, [*arguments, "--no-pictures", "-q"])
    assert answer.exit_code == 0, answer.output
    told = json.loads(answer.stdout)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["massless"]
    assert report["masses"].startswith("A massless plan: each module is simulated with 3%")
    assert told["path"] == report["path"]
    assert report["goal_error"] < 0.005
    assert report["broken"] == []
    assert (tmp_path / "out" / "report.html").exists()
    assert {p.name for p in (tmp_path / "out" / "figures").iterdir()} == {"way.png", "loads.png"}
    head, *rows = (tmp_path / "out" / "simulation.csv").read_text().splitlines()
    assert head == "time_s,contact,force_planned_N,force_N,moment_planned_Nm,moment_Nm"
    assert len(rows) > 100
    assert "mujoco" in sys.modules
