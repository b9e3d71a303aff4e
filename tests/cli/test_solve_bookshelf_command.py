"""`solve-bookshelf` from spec to files, streams and exit codes, on real scenes."""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import RunCommand

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.plan.file import read_shelf_plan
from climbplan.bookshelf.planner import runs
from climbplan.bookshelf.scene.scene_file import write_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes, ShelfScene

SPECS = Path(__file__).parents[2] / "specs"
SCENE = str(SPECS / "bookshelf_scene.yaml")
FILE = str(SPECS / "bookshelf_file.yaml")

# Two books on a shelf 162.22 mm wide [mm]; widths of the book to insert.
FITS, TOO_WIDE = 20.0, 140.0


def scene_rows(*inserted: float) -> Scenes:
    rows = [[-40, 40, 0, 80, 20, 30, 35, 0, 70, 25, 90, width] for width in inserted]
    return Scenes.from_theta(np.array(rows, float), "mm")


@pytest.fixture
def scene_file(workplace: Path) -> Callable[..., list[str]]:
    """Options that set a file with scenes of these inserted widths."""

    def write(*inserted: float) -> list[str]:
        write_scenes(scene_rows(*inserted), workplace / "own.h5", {}, "mine")
        return ["-s", "scenes.file=own.h5", "-s", "scenes.group=mine"]

    return write


def use_method(
    monkeypatch: pytest.MonkeyPatch, answer: Callable[[int, SceneAnswer], SceneAnswer]
) -> None:
    """Change the exact answers; `answer` gets the number of the scene and what is true."""

    class Changed:
        def __init__(self, setting: MethodSetting) -> None:
            self.exact, self.count = ExactSolver(setting.shelf), 0

        def solve(self, scene: ShelfScene) -> SceneAnswer:
            self.count += 1
            return answer(self.count - 1, self.exact.solve(scene))

    monkeypatch.setattr(runs, "prepare_method", lambda setting, count: Changed(setting))


@pytest.mark.parametrize("name", ["bookshelf_scene", "bookshelf_five", "bookshelf_file"])
def test_shipped_specs(run_command: RunCommand, workplace: Path, name: str) -> None:
    outcome = run_command("solve-bookshelf", str(SPECS / f"{name}.yaml"))
    assert outcome.code == 0, outcome.err
    assert outcome.out == f"outputs/{name}/plan.h5\n"
    lines = outcome.err.splitlines()
    assert lines[0].startswith(name)
    assert lines[1].startswith("solve     ")
    assert any(line.startswith("verify    passed    ") for line in lines[2:])
    made = {p.name for p in (workplace / "outputs" / name).iterdir()}
    assert made == {"plan.h5", "report.json", "report.html", "figures"}
    assert run_command("verify", f"outputs/{name}").code == 0
    assert read_shelf_plan(workplace / "outputs" / name / "plan.h5").verified


def test_summary_of_a_file(run_command: RunCommand) -> None:
    lines = run_command("solve-bookshelf", FILE).err.splitlines()
    assert "40 scenes, 3 stored books" in lines[0]
    assert lines[1].startswith("solve     40 of 40")
    assert "median" in lines[1]
    assert lines[2].startswith("cost      optimal")
    assert "14 scenes above 1 mm^2" in lines[2]


def test_json_is_one_object_and_the_report(run_command: RunCommand, workplace: Path) -> None:
    outcome = run_command("solve-bookshelf", SCENE, "--json", "-q")
    assert outcome.err == ""
    report = json.loads(outcome.out)
    written = json.loads((workplace / "outputs/bookshelf_scene/report.json").read_text())
    plan = "outputs/bookshelf_scene/plan.h5"
    assert report == {**written, "plan": plan, "exit_code": 0}
    assert (report["status"], report["verified"]) == ("optimal", True)
    assert report["objective"] == pytest.approx(43.9, abs=0.02)
    assert [book["state"] for book in report["books"]] == [
        "upright", "flat right", "leaning right", "upright",
    ]  # fmt: skip


def test_standard_input(
    run_command: RunCommand, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = Path(SCENE).read_bytes()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text)))
    assert run_command("solve-bookshelf", "-").out == "outputs/stdin/plan.h5\n"


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["scene.insert.width_mm=150"], "51.78 mm of width are missing"),
        (["scene.insert={height_mm: 300, width_mm: 120}"], "misses 10.00 mm of clear height"),
    ],
)
def test_infeasible_scene(
    run_command: RunCommand, workplace: Path, settings: list[str], said: str
) -> None:
    options = [part for one in settings for part in ("-s", one)]
    outcome = run_command("solve-bookshelf", SCENE, *options)
    assert (outcome.code, outcome.out) == (3, "")
    assert said in outcome.err
    assert "feasible with" in outcome.err
    assert [entry.name for entry in workplace.iterdir()] == ["small.yaml"]


def test_the_missing_width_is_enough(run_command: RunCommand) -> None:
    wide = ["-s", "scene.insert.width_mm=150"]
    assert run_command("solve-bookshelf", SCENE, *wide, "-s", "shelf.right_mm=132.8").code == 3
    assert run_command("solve-bookshelf", SCENE, *wide, "-s", "shelf.right_mm=132.9").code == 0


def test_odd_scenes_are_solved_with_warnings(run_command: RunCommand) -> None:
    settings = ("books.1.x_mm=-60", "books.0.y_mm=50", "books.2.x_mm=-90")
    options = [part for one in settings for part in ("-s", f"scene.{one}")]
    outcome = run_command("solve-bookshelf", SCENE, "-q", *options)
    assert outcome.code == 0
    assert outcome.err.splitlines() == [
        "warning: books 0 and 2 overlap by 26.8 mm before the insertion (and 1 more)",
        "warning: book 2 stands 30.0 mm left of the book listed before it",
        "warning: book 0 floats 16.0 mm above the ground",
        "warning: book 2 reaches 44.6 mm into or beyond a wall (and 1 more)",
    ]


def test_infeasible_scenes_of_a_file_are_answers(
    run_command: RunCommand, workplace: Path, scene_file: Callable[..., list[str]]
) -> None:
    outcome = run_command("solve-bookshelf", FILE, *scene_file(FITS, TOO_WIDE))
    assert outcome.code == 0, outcome.err
    assert "1 proved infeasible" in outcome.err
    plan = read_shelf_plan(workplace / "outputs/bookshelf_file/plan.h5")
    assert plan.solutions.status == ("optimal", "infeasible")
    assert plan.totals.status == "optimal"
    assert np.isnan(plan.solutions.pose[1]).all()
    assert (plan.solutions.state[1] == -1).all()
    assert plan.solutions.message[1] == "22.78 mm of width are missing"


def test_only_infeasible_scenes(
    run_command: RunCommand, scene_file: Callable[..., list[str]]
) -> None:
    outcome = run_command("solve-bookshelf", FILE, *scene_file(TOO_WIDE, TOO_WIDE))
    assert outcome.code == 3
    assert outcome.out == "outputs/bookshelf_file/plan.h5\n"
    assert run_command("verify", "outputs/bookshelf_file").code == 0


def test_scenes_without_an_answer(
    run_command: RunCommand,
    workplace: Path,
    scene_file: Callable[..., list[str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def answer(k: int, true: SceneAnswer) -> SceneAnswer:
        if k == 0:
            return true
        return replace(true, status="limit", placement=None, objective=math.inf, bound=-math.inf)

    use_method(monkeypatch, answer)
    outcome = run_command("solve-bookshelf", FILE, *scene_file(FITS, FITS, FITS))
    assert outcome.code == 4
    assert "2 without an answer" in outcome.err
    plan = read_shelf_plan(workplace / "outputs/bookshelf_file/plan.h5")
    assert plan.solutions.status == ("optimal", "limit", "limit")
    alone = run_command("solve-bookshelf", SCENE)
    assert alone.code == 0
    use_method(monkeypatch, lambda k, true: answer(1, true))
    alone = run_command("solve-bookshelf", SCENE, "-o", "new")
    assert (alone.code, alone.out) == (4, "")
    assert "no placement found" in alone.err
    assert not (workplace / "new").exists()


def overlapping(k: int, true: SceneAnswer) -> SceneAnswer:
    """The inserted book stands in the first one, and costs nothing."""
    assert true.placement is not None
    pose = true.placement.pose.copy()
    pose[-1, 0] = pose[0, 0]
    return replace(true, placement=replace(true.placement, pose=pose))


def test_an_answer_that_breaks_a_constraint_is_none(
    run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_method(monkeypatch, overlapping)
    outcome = run_command("solve-bookshelf", SCENE)
    assert outcome.code == 4
    assert "the method's answer breaks book.overlap" in outcome.err


def test_a_plan_that_fails_verification_is_kept(
    run_command: RunCommand, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_method(monkeypatch, overlapping)
    monkeypatch.setattr(runs, "check_answers", lambda scenes, answers, setting: list(answers))
    outcome = run_command("solve-bookshelf", SCENE)
    assert outcome.code == 5
    assert outcome.out == "outputs/bookshelf_scene/plan.h5\n"
    assert "verify    FAILED" in outcome.err
    assert "book.overlap" in outcome.err
    assert not read_shelf_plan(workplace / "outputs/bookshelf_scene/plan.h5").verified


def test_interruption_leaves_nothing(
    run_command: RunCommand, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(k: int, true: SceneAnswer) -> SceneAnswer:
        if k == 3:
            raise KeyboardInterrupt
        return true

    use_method(monkeypatch, interrupt)
    outcome = run_command("solve-bookshelf", FILE)
    assert (outcome.code, outcome.out) == (130, "")
    assert [entry.name for entry in workplace.iterdir()] == ["small.yaml"]


def test_a_finished_directory(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("solve-bookshelf", SCENE, "-o", "x").code == 0
    before = (workplace / "x/plan.h5").read_bytes()
    again = run_command("solve-bookshelf", SCENE, "-o", "x")
    assert again.code == 2
    assert "--force" in again.err
    assert (workplace / "x/plan.h5").read_bytes() == before
    assert run_command("solve-bookshelf", SCENE, "-o", "x", "--force").code == 0


def test_jobs_give_the_same_file_but_for_times(run_command: RunCommand, workplace: Path) -> None:
    for jobs in ("1", "2"):
        outcome = run_command("solve-bookshelf", FILE, "-q", "-j", jobs, "-o", f"jobs{jobs}")
        assert (outcome.code, outcome.err) == (0, "")
    names: list[str] = []
    with h5py.File("jobs1/plan.h5") as one, h5py.File("jobs2/plan.h5") as two:
        one.visit(names.append)
        assert len(names) > 10
        for name in names:
            if isinstance(one[name], h5py.Dataset) and name not in ("solution/time", "summary"):
                np.testing.assert_array_equal(one[name][()], two[name][()], err_msg=name)
        for name in set(one.attrs) - {"created", "timings"}:
            assert one.attrs[name] == two.attrs[name], name


def test_saved_model(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("solve-bookshelf", SCENE, "--save-model", "whole.cip").code == 0
    assert "[nonlinear]" in (workplace / "whole.cip").read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([SCENE, "--save-model", "no/x.lp"], "no such directory 'no'"),
        ([SCENE, "--save-model", "x.txt"], "x.txt: expected .lp, .mps or .cip"),
        ([SCENE, "-s", "scene.insert.width_mm=0"], "--set scene.insert.width_mm=0: scene.insert"),
        ([SCENE, "-s", "scene.insert.height_mm=1e5", "-s", "scene.books.0.x_mm=-2e5"], "scene: "),
        ([SCENE, "--method", "mpcc", "--solver", "daqp"], "--solver daqp: solver.solver: method"),
        ([SCENE, "-s", "scene.books.0.x_mm=.nan"], "expected a number in mm, got .nan"),
        ([SCENE, "--method", "exakt"], "--method exakt: solver.method: expected one of"),
        ([SCENE, "--solver", "cplex"], "--solver cplex: solver.solver: expected one of"),
        ([SCENE, "--time-limit", "0"], "--time-limit 0.0: solver.time_limit: expected"),
        ([SCENE, "--seed", "-1"], "--seed -1: seed: expected"),
        ([FILE, "-s", "scenes.file=none.h5"], "scenes.file=none.h5: scenes.file: "),
        ([FILE, "-s", "scenes.group=scene"], "did you mean 'scenes'?"),
        (["small.yaml"], "expected a spec of kind `bookshelf`, got a `climb`"),
    ],
)
def test_mistakes(
    run_command: RunCommand, workplace: Path, arguments: list[str], said: str
) -> None:
    outcome = run_command("solve-bookshelf", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert said in outcome.err
    assert [entry.name for entry in workplace.iterdir()] == ["small.yaml"]


def test_wrong_rows_are_named(run_command: RunCommand, workplace: Path) -> None:
    good = scene_rows(FITS, FITS, FITS)
    good.size[1, 0, 1], good.pose[2, 1, 0] = 0.0, math.nan
    write_scenes(good, workplace / "bad.h5", {})
    outcome = run_command("validate", FILE, "-s", "scenes.file=bad.h5")
    assert outcome.code == 2
    first, second = outcome.err.splitlines()
    assert first.endswith("scenes.file: scene 1, book 0: width is 0, expected more than 0")
    assert second.endswith("scenes.file: scene 2, book 1: x is nan, expected a finite number")


def test_validate_names_line_and_key(run_command: RunCommand, workplace: Path) -> None:
    (workplace / "s.yaml").write_text("kind: bookshelf\nscenes:\n  file: gone.h5\n")
    assert run_command("validate", "s.yaml").err.startswith("s.yaml:3: scenes.file: ")
    good = run_command("validate", SCENE, FILE)
    assert (good.code, good.err) == (0, "")
    odd = run_command("validate", SCENE, "-s", "scene.books.0.y_mm=50")
    assert odd.code == 0
    assert "book 0 floats 16.0 mm above the ground" in odd.err


def test_new_gives_what_runs(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("new", "bookshelf").out == "bookshelf_scene.yaml\n"
    assert run_command("new", "bookshelf", "--example", "bookshelf_file").code == 0
    for name in ("bookshelf_scene", "bookshelf_file"):
        assert run_command("solve-bookshelf", f"{name}.yaml", "-q").code == 0
    refused = run_command("new", "bookshelf", "--example", "bookshelf_file")
    assert refused.code == 2
    (workplace / "bookshelf_file.yaml").unlink()
    refused = run_command("new", "bookshelf", "--example", "bookshelf_file")
    assert "bookshelf_scenes.h5: already exists" in refused.err


def test_schema(run_command: RunCommand) -> None:
    schema = json.loads(run_command("schema", "bookshelf").out)
    assert schema["$id"] == "urn:climbplan:spec:bookshelf"


def test_export(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("solve-bookshelf", SCENE, "-o", "x").code == 0
    assert run_command("export", "x").out == "x/placements.csv\n"
    header, *rows = (workplace / "x/placements.csv").read_text().splitlines()
    assert header.startswith("scene,status,objective_mm2,book,height_m,width_m,before_x_m")
    assert len(rows) == 4
    plan = read_shelf_plan(workplace / "x/plan.h5")
    cells = rows[1].split(",")
    assert [float(cell) for cell in cells[9:12]] == plan.solutions.pose[0, 1].tolist()
    assert cells[-1] == "flat right"
    assert rows[3].split(",")[3] == "inserted"


def test_report_again(run_command: RunCommand, workplace: Path) -> None:
    assert run_command("solve-bookshelf", SCENE, "-o", "x").code == 0
    before = json.loads((workplace / "x/report.json").read_text())
    assert run_command("report", "x", "-o", "y").out == "y/report.html\n"
    assert json.loads((workplace / "y/report.json").read_text()) == before
    told = {**before, "plan": "x/plan.h5", "exit_code": 0}
    assert json.loads(run_command("report", "x", "--json").out) == told


def test_a_file_of_another_kind(run_command: RunCommand) -> None:
    scenes = str(SPECS / "bookshelf_scenes.h5")
    for command in ("verify", "report", "export"):
        outcome = run_command(command, scenes)
        assert outcome.code == 2
        assert "holds 'climbplan/scenes', expected one of 'climbplan/climb'" in outcome.err


def test_what_fails_its_verification_is_not_passed_on_in_silence(
    run_command: RunCommand, workplace: Path
) -> None:
    run_command("solve-bookshelf", SCENE, "-o", "x")
    with h5py.File("x/plan.h5", "r+") as file:
        file["solution/pose"][0, 0, 0] += 0.02
    refused = run_command("export", "x")
    assert (refused.code, refused.out) == (5, "")
    assert "x/plan.h5 fails its verification" in refused.err
    assert "--unverified" in refused.err
    assert not (workplace / "x" / "placements.csv").exists()
    for command in (("export", "--unverified"), ("report",)):
        outcome = run_command(*command, "x")
        assert outcome.code == 0
        assert "warning: x/plan.h5 fails its verification" in outcome.err
    remark, header = (workplace / "x" / "placements.csv").read_text().splitlines()[:2]
    assert remark.startswith("# NOT VERIFIED: the plan fails its verification: ")
    assert not header.startswith("#")
    streamed = run_command("export", "--unverified", "x", "-o", "-")
    assert streamed.out.splitlines()[:2] == [remark, header]
