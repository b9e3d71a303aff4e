"""`climbplan fit-strategy` and the methods that take its model files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from command_line import RunCommand

from climbplan.bookshelf.methods.training import collect_shelf_data
from climbplan.bookshelf.scene.scene_file import read_scenes, write_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes
from climbplan.learning.fit_run import build_fit_options, build_model_file, train, write_verified
from climbplan.learning.model import MODEL_KINDS
from climbplan.schema.learning.strategy_loading import load_strategy

SPECS = Path(__file__).parents[2] / "specs"
STRATEGY = SPECS / "strategy_bookshelf.yaml"
CART_POLE, STATEMENT = SPECS / "cart_pole.yaml", f"{SPECS / 'cart_pole.py'}:problem"
SMALL = ("--set", "model.forest.trees=10", "--set", "model.network.epochs=5")
SMALL += ("--set", "model.boosting.rounds=3", "--set", "model.reduce.trees=10")
SMALL += ("--set", "model.reduce.clusters=kmeans", "--set", "model.reduce.count=20")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Models of every kind, trained once from the shipped scenes without figures."""
    folder, made = tmp_path_factory.mktemp("models"), {}
    loaded = load_strategy(STRATEGY, [*SMALL[1::2], "data.held_out=0"])
    data = collect_shelf_data(loaded)
    for kind in MODEL_KINDS:
        options = replace(build_fit_options(loaded.spec), kind=kind)
        made[kind] = folder / f"{kind}.h5"
        write_verified(build_model_file(train(data, options, 0.0), loaded, data), made[kind])
    return made


@pytest.fixture
def few_scenes(workplace: Path) -> str:
    """A spec of the first scenes of the shipped file."""
    scenes = read_scenes(SPECS / "bookshelf_scenes.h5", "scenes")
    write_scenes(Scenes(scenes.pose[:5], scenes.size[:5], scenes.inserted[:5]), Path("few.h5"), {})
    Path("few.yaml").write_text("kind: bookshelf\nscenes: {file: few.h5}\n")
    return "few.yaml"


def test_trains_from_shipped_scenes_and_reports(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("fit-strategy", str(STRATEGY), "-o", "m", *SMALL)
    assert done.code == 0, done.err
    assert done.out == "m/model.h5\n"
    path = Path("m/model.h5")
    made = {p.name for p in path.parent.iterdir()}
    assert made == {"model.h5", "report.json", "report.html", "figures"}
    assert {p.name for p in (path.parent / "figures").iterdir()} == {"spaces.png", "ranks.png"}
    report = json.loads((path.parent / "report.json").read_text())
    assert report["format"] == "climbplan/strategy"
    assert report["verified"] is True
    assert report["fit"]["groups"] == 40
    assert report["fit"]["rows"] == 80
    assert report["fit"]["evaluation"]["problems"] == report["fit"]["held_out_rows"] == 8
    with h5py.File(path) as file:
        assert file.attrs["kind"] == "forest"
        assert "data:" in file.attrs["spec"]


@pytest.mark.parametrize("kind", ["knn", "forest", "boosting", "network"])
def test_every_kind_solves_scenes_and_says_which_step_won(
    run_command: RunCommand, models: dict[str, Path], few_scenes: str, kind: str
) -> None:
    model = ("--set", f"solver.model.file={models[kind]}", "--method", kind)
    done = run_command("solve-bookshelf", few_scenes, *model, "-o", "out")
    assert done.code == 0, done.err
    with h5py.File("out/plan.h5") as file:
        words = [word.decode() for word in file["solution/message"][()]]
        assert bool(file.attrs["verified"])
    assert all(f"({kind}) of " in word or "answered by `exact`" in word for word in words)


def test_reduced_programs_answer_a_scene(
    run_command: RunCommand, models: dict[str, Path], workplace: Path
) -> None:
    scene = str(SPECS / "bookshelf_scene.yaml")
    model = ("--set", f"solver.model.file={models['reduce']}", "--method", "reduce")
    done = run_command("solve-bookshelf", scene, *model, "--time-limit", "20", "-o", "out")
    assert done.code == 0, done.err
    with h5py.File("out/plan.h5") as file:
        assert bool(file.attrs["verified"])


def test_without_fallback_nothing_else_answers(
    run_command: RunCommand, few_scenes: str, workplace: Path
) -> None:
    loaded = load_strategy(STRATEGY, ["data.size=1", "data.mirror=false", "model.kind=knn"])
    data = collect_shelf_data(loaded)
    stored = build_model_file(train(data, build_fit_options(loaded.spec), 0.0), loaded, data)
    write_verified(stored, Path("one.h5"))
    given = ("--set", "solver.model.file=one.h5", "--method", "knn")
    given += ("--set", "solver.max_refinements=0")  # envelopes alone seldom hold
    refusing = ("--set", "solver.fallback=false", "-o", "a")
    alone = run_command("solve-bookshelf", few_scenes, *given, *refusing)
    assert alone.code == 4
    whole = run_command("solve-bookshelf", few_scenes, *given, "-o", "b")
    assert whole.code == 0
    with h5py.File("b/plan.h5") as file:
        words = [word.decode() for word in file["solution/message"][()]]
    assert any("answered by `exact`" in word for word in words)


def test_models_that_do_not_fit_are_refused(
    run_command: RunCommand, models: dict[str, Path], few_scenes: str
) -> None:
    given = ("--set", f"solver.model.file={models['knn']}", "-o", "out")
    for more, word in (
        (("--method", "forest"), "expected a model for method 'forest', got one of kind 'knn'"),
        (("--method", "knn", "--set", "shelf.right_mm=90"), "made for a shelf whose right"),
        (("--method", "knn", "--set", "formulation=published"), "made for formulation 'contact'"),
    ):
        done = run_command("solve-bookshelf", few_scenes, *given, *more)
        assert done.code == 2
        assert word in done.err
    five = str(SPECS / "bookshelf_five.yaml")
    done = run_command("solve-bookshelf", five, "--method", "knn", *given)
    assert done.code == 2
    assert "made for books 3, here it is 5" in done.err
    none = run_command("solve-bookshelf", few_scenes, "--method", "forest", "-o", "out")
    assert none.code == 2
    assert "solver.model.file" in none.err


def test_wrong_data_is_refused(run_command: RunCommand, workplace: Path) -> None:
    Path("empty.h5").write_bytes(b"")
    for files, word in (("[empty.h5]", "empty"), ("[none.h5]", "no such file"), ("[]", "files")):
        done = run_command(
            "fit-strategy", str(STRATEGY), "--set", f"data.files={files}", "-o", "out"
        )
        assert done.code == 2
        assert word in done.err
        assert not Path("out").exists()


def test_forest_on_the_cart_pole(run_command: RunCommand, workplace: Path) -> None:
    drawn = ("--set", "theta=null", "--problem", STATEMENT)
    solved = run_command(
        "solve", str(CART_POLE), *drawn, "--set", "sample.count=15", "--method", "mpcc", "-o", "lib"
    )
    assert solved.code == 0, solved.err
    Path("cart.yaml").write_text(
        "kind: strategy\nproblem: cart_pole\ndata: {files: [lib/plan.h5]}\n"
        "model: {kind: forest, forest: {trees: 20}}\n"
    )
    refused = run_command("fit-strategy", "cart.yaml", "-o", "model")
    assert refused.code == 2
    assert "--problem" in refused.err
    refused = run_command("fit-strategy", str(SPECS / "strategy_bookshelf.yaml"), "--compare", "2")
    assert refused.code == 2
    assert "--problem" in refused.err
    done = run_command(
        "fit-strategy", "cart.yaml", "--problem", STATEMENT, "--compare", "2", "-o", "model"
    )
    assert done.code == 0, done.err
    assert "verdict   use " in done.err
    comparison = json.loads(Path("model/report.json").read_text())["fit"]["comparison"]
    assert comparison["problems"] == 2
    assert comparison["verdict"] in Path("model/report.html").read_text()
    online = run_command(
        "solve", str(CART_POLE), *drawn, "--seed", "5", "--set", "sample.count=3",
        "--method", "forest", "--set", "solver.model.file=model/model.h5", "-o", "online",
    )  # fmt: skip
    assert online.code == 0, online.err
    report = json.loads(Path("online/report.json").read_text())
    assert report["rows"]["answered"] == 3
    assert report["verified"] is True
    winners = [row["winner"] for row in report["results"]]
    assert sum("(forest)" in winner for winner in winners) >= 1
    springs = STATEMENT.replace(":problem", ":springs")
    other = run_command(
        "solve", str(CART_POLE), "--problem", springs, "--method", "forest",
        "--set", "solver.model.file=model/model.h5", "-o", "other",
    )  # fmt: skip
    assert other.code == 2
    assert "made for problem 'cart_pole'" in other.err


def test_a_hostile_model_ends_with_exit_code_2(
    run_command: RunCommand, models: dict[str, Path], few_scenes: str
) -> None:
    path = Path("hostile.h5")
    path.write_bytes(models["forest"].read_bytes())
    with h5py.File(path, "r+") as file:
        file["forest/left"][0] = 0
    model = ("--set", f"solver.model.file={path}", "--method", "forest")
    done = run_command("solve-bookshelf", few_scenes, *model, "-o", "out")
    assert done.code == 2
    assert "does not stand behind it" in done.err


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('"right": 0.08111', '"right": 1' + "0" * 400, "a number of 401 digits"),
        ('"right": 0.08111', '"right": NaN', "holds NaN, a number that is not finite"),
        ('"right": 0.08111', '"right": true', "a shelf whose right is True"),
        ('"books": 3', '"books": 1' + "0" * 400, "a number of 401 digits"),
        ('"features": "gaps"', '"features": "raw"', "14 features, expected 17"),
    ],
)
def test_a_hostile_context_is_refused_with_the_file_and_briefly(
    run_command: RunCommand,
    models: dict[str, Path],
    few_scenes: str,
    before: str,
    after: str,
    words: str,
) -> None:
    path = Path("hostile.h5")
    path.write_bytes(models["knn"].read_bytes())
    with h5py.File(path, "r+") as file:
        context = str(file.attrs["context"])
        assert before in context
        file.attrs["context"] = context.replace(before, after)
    model = ("--set", f"solver.model.file={path}", "--method", "knn")
    done = run_command("solve-bookshelf", few_scenes, *model, "-o", "out")
    assert done.code == 2
    assert "hostile.h5: " in done.err
    assert words in done.err
    assert len(done.err) < 400
