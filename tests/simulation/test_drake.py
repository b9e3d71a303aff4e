"""The second engine on a table of three legs, whose forces and torques are known."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from standing_table import HEIGHT, RADIUS, table_urdf, write_table_motion, write_table_plan

from climbplan.errors import MissingSolver, UsageError
from climbplan.simulation.drake import plant as plants
from climbplan.simulation.drake.exported import read_motion
from climbplan.simulation.drake.report import (
    build_report,
    explain_failure,
    format_lines,
    format_table,
    summarise_run,
)
from climbplan.simulation.drake.robot_document import write_robot_document
from climbplan.simulation.drake.settings import Settings
from climbplan.simulation.drake.simulating import read_stored_urdf, simulate_exported
from climbplan.simulation.drake.terrain import TerrainSolid, read_terrain

BLIND = Settings(regulate=False)


def simulate(
    tmp_path: Path,
    settings: Settings = BLIND,
    *,
    urdf: str | None = None,
    urdf_path: Path | None = None,
    obstacle: tuple[float, float] | None = None,
    **motion: Any,
) -> dict[str, Any]:
    pytest.importorskip("pydrake")
    write_table_plan(tmp_path / "plan.h5", urdf or table_urdf(), obstacle=obstacle)
    write_table_motion(tmp_path, **motion)
    run = simulate_exported(tmp_path, tmp_path / "plan.h5", settings, urdf_path, lambda done: None)
    assert len(format_table(run).splitlines()) == 1 + len(run.recording.time)
    return build_report(run)


def test_a_standing_table_bears_what_is_planned(tmp_path: Path) -> None:
    report = simulate(tmp_path)
    assert not report["fell"]
    assert report["body"]["max_mm"] < 0.5
    assert report["torque"]["max_error"] < 0.01
    assert report["force"]["max_error"] < 0.01
    assert report["slips"] == report["lost_contacts"] == report["link_contacts"] == []
    assert report["planned_penetrations"] == report["toes_replaced_by_spheres"] == []
    assert report["gravity_torque_difference"] < 1e-9
    assert report["mass"]["planned_kg"] == pytest.approx(report["mass"]["urdf_kg"])
    assert explain_failure(report, 0) == ""
    assert summarise_run(report) == "Drake: stands, 0 slips, 0 lost contacts"


def test_softer_motors_sink_by_what_springs_say(tmp_path: Path) -> None:
    report = simulate(tmp_path, Settings(regulate=False, gain_scale=0.8), seconds=0.8)
    # The load on each spring is the weight of the base and of that foot
    sag = (4.0 / 3 + 0.5) * 9.81 / 4000 * (1 / 0.8 - 1)
    assert report["body"]["end_mm"] == pytest.approx(1e3 * sag, rel=0.05)


def test_a_box_that_the_base_rests_on_is_named(tmp_path: Path) -> None:
    report = simulate(tmp_path, obstacle=(0.0, HEIGHT - 0.025 + 0.004))
    assert report["planned_penetrations"][0] == {
        "link": "base",
        "other": "box",
        "time": 0.0,
        "depth": pytest.approx(0.004, abs=1e-4),
        "is_toe": False,
    }
    touch = report["link_contacts"][0]
    assert (touch["link"], touch["other"]) == ("base", "box")
    assert touch["max_force"] > 30.0
    assert any("base touches box" in line for line in format_lines(report))


def test_commands_that_bear_nothing_let_it_fall(tmp_path: Path) -> None:
    report = simulate(tmp_path, too_short=0.25, seconds=1.5)
    assert report["fell"]
    assert 0.1 < report["fall_time"] < 1.5
    assert "falls in Drake" in explain_failure(report, 5)


def test_toes_without_geometry_are_spheres(tmp_path: Path) -> None:
    report = simulate(tmp_path, urdf=table_urdf(with_feet=False))
    assert report["toes_replaced_by_spheres"] == ["A", "B", "C"]
    assert report["force"]["max_error"] < 0.01


def test_inertias_that_no_body_has_are_told(tmp_path: Path) -> None:
    report = simulate(tmp_path, urdf=table_urdf().replace('izz="1e-3"', 'izz="5e-3"'), seconds=0.1)
    assert len(report["urdf_warnings"]) == 3
    assert sum("inertia" in line for line in format_lines(report)) == 1


def test_without_drake_the_message_says_how_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(MissingSolver, match=r"pip install 'climbplan\[drake\]'"):
        plants.import_pydrake("common")


def test_robots_without_urdf_are_refused(tmp_path: Path) -> None:
    write_table_plan(tmp_path / "plan.h5", "")
    with pytest.raises(UsageError, match="table is not from a URDF"):
        read_stored_urdf(tmp_path / "plan.h5")
    write_table_motion(tmp_path, base_link=None)
    with pytest.raises(UsageError, match="not from a URDF"):
        read_motion(tmp_path)


def test_terrain_is_where_material_ends(tmp_path: Path) -> None:
    write_table_plan(tmp_path / "plan.h5", table_urdf(), obstacle=(0.1, 0.2))
    (floor, box), left_out = read_terrain(tmp_path / "plan.h5")
    assert left_out == ()
    assert floor.corners[:, 2].max() == pytest.approx(0.0, abs=1e-12)
    assert RADIUS > 0
    axes, middle, size = box.as_box() or pytest.fail("no box")
    assert sorted(size) == pytest.approx([0.1, 0.1, 0.1])
    assert middle == pytest.approx([0.0, 0.0, 0.15])
    assert np.linalg.det(axes) == pytest.approx(1.0)
    wedge = TerrainSolid("wedge", box.corners + box.corners[:, 2:] * [1.0, 0.0, 0.0], 1.0)
    assert wedge.as_box() is None


def test_the_contract_names_every_module_of_the_mujoco_model() -> None:
    root = Path(__file__).parents[2]
    contracts = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]
    (contract,) = [c for c in contracts["contracts"] if "second engine" in c["name"]]
    folder = root / "climbplan" / "simulation"
    modules = {
        p.stem for p in folder.iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()
    }
    forbidden = {
        name.removeprefix("climbplan.simulation.") for name in contract["forbidden_modules"]
    }
    assert modules - {"__init__", "drake"} <= forbidden


def test_meshes_collide_as_their_convex_hulls(tmp_path: Path) -> None:
    trimesh.creation.box((0.5, 0.5, 0.05)).export(tmp_path / "base.stl")
    text = table_urdf().replace('<box size="0.5 0.5 0.05"/>', '<mesh filename="base.stl"/>')
    report = simulate(
        tmp_path,
        urdf=text,
        urdf_path=tmp_path / "table.urdf",
        obstacle=(0.0, HEIGHT - 0.025 + 0.004),
        seconds=0.1,
    )
    (found,) = report["planned_penetrations"]
    assert found["link"] == "base"
    assert found["depth"] == pytest.approx(0.004, abs=1e-4)


def test_meshes_that_are_missing_are_named(tmp_path: Path) -> None:
    text = table_urdf().replace(
        '<box size="0.5 0.5 0.05"/>', '<mesh filename="package://nowhere/base.stl"/>'
    )
    with pytest.raises(UsageError, match="--urdf FILE"):
        write_robot_document(text, tmp_path / "table.urdf", {}, tmp_path)
