"""`climbplan fit-terrain` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from known_surfaces import stairs

from climbplan.cli.app import run
from climbplan.errors import ExitCode


def mesh_file(folder: Path) -> Path:
    raw = stairs().raw
    path = folder / "stairs.stl"
    trimesh.Trimesh(raw.vertices, raw.triangles, process=False).export(path)
    return path


def test_a_mesh_becomes_a_terrain_to_edit(tmp_path: Path, capsys) -> None:
    path = mesh_file(tmp_path)
    out = tmp_path / "out"
    assert run(["fit-terrain", str(path), "-o", str(out), "-s", "steepest_deg=40"]) == 0
    assert capsys.readouterr().out.strip() == str(out / "terrain.yaml")
    terrain = yaml.safe_load((out / "terrain.yaml").read_text())["terrain"]
    assert len(terrain["regions"]) == 5
    assert terrain["scan"] == {"file": str(path), "steepest_deg": 40, "fit": False}
    page = (out / "report.html").read_text()
    assert "5 contact regions" in page
    assert "data:image/png" in page
    assert (out / "figures" / "terrain.png").stat().st_size > 10_000


def test_the_terrain_is_a_specs_part(tmp_path: Path) -> None:
    path = mesh_file(tmp_path)
    out = tmp_path / "out"
    assert run(["fit-terrain", str(path), "-o", str(out), "--no-report", "-q"]) == 0
    assert not (out / "report.html").exists()
    spec = yaml.safe_load((out / "terrain.yaml").read_text())
    spec |= {
        "kind": "climb",
        "robot": "silvia",
        "task": {
            "rounds": 1,
            "start": {"com": [0.5, 0.1, 0.25]},
            "goal": {"com": [0.5, 0.15, 0.25]},
        },
    }
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(spec))
    assert run(["validate", str(tmp_path / "spec.yaml"), "-q"]) == 0


def test_a_spec_of_the_same_name_plans_into_another_folder(
    tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    """stairs.stl goes where the plan of stairs.yaml does not."""
    path = mesh_file(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert run(["fit-terrain", path.name, "--no-report", "-q"]) == 0
    assert capsys.readouterr().out.strip() == "outputs/stairs_terrain/terrain.yaml"
    assert not Path("outputs", "stairs").exists()


def test_json_tells_figures_and_mistakes(tmp_path: Path, capsys) -> None:
    path = mesh_file(tmp_path)
    assert run(["fit-terrain", str(path), "-o", str(tmp_path / "a"), "--no-report", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["regions"] == 10
    assert told["triangles"] == 20
    bad = tmp_path / "bad.stl"
    bad.write_text("no mesh")
    code = run(["fit-terrain", str(bad), "-o", str(tmp_path / "b"), "--json"])
    assert code == ExitCode.USAGE
    assert "bad.stl" in json.loads(capsys.readouterr().out)["message"]
    assert not (tmp_path / "b").exists()


def test_wrong_settings_are_listed(tmp_path: Path, capsys) -> None:
    path = mesh_file(tmp_path)
    keys = ["-s", "flatnes=0.01", "-s", "least_size=-1"]
    assert run(["fit-terrain", str(path), "-o", str(tmp_path / "a"), *keys]) == ExitCode.USAGE
    told = capsys.readouterr().err
    assert "did you mean 'flatness'" in told
    assert "least_size" in told


def test_spots_for_a_gripper_become_a_panel(tmp_path: Path, capsys) -> None:
    line = np.arange(-0.12, 0.12, 4e-3)
    x, z = (v.ravel() for v in np.meshgrid(line, line, indexing="ij"))
    ridge = np.clip(0.035 + 2.0 * (0.015 - np.abs(z)), 0.0, 0.035)  # level, sides at 63 degrees
    out = np.where(np.abs(x) < 0.05, ridge, 0.0)
    path = tmp_path / "wall.xyz"
    np.savetxt(path, np.stack([x, 1.0 - out, z], axis=1))  # faces -y, towards the origin
    target = tmp_path / "out"
    assert run(["fit-terrain", str(path), "-o", str(target), "--holds", "0.06"]) == 0
    assert capsys.readouterr().out.strip() == str(target / "terrain.yaml")
    panel = yaml.safe_load((target / "terrain.yaml").read_text())["terrain"]["panel"]
    assert panel["angle_deg"] == pytest.approx(90.0, abs=0.5)
    first = next(iter(panel["holds"].values()))
    assert abs((first["axis_deg"] + 90) % 180 - 90) <= 15  # fingers above and below
    assert first["undercut_deg"] == pytest.approx(-26.6, abs=8.0)
    code = run(["fit-terrain", str(path), "-o", str(tmp_path / "b"), "--holds", "7"])
    assert code == ExitCode.USAGE
    assert "--holds: expected an opening" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()
