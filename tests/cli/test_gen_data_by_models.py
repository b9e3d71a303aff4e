"""`climbplan gen-data` with methods that learn: rows depend on the contents of the model."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import RunCommand

from climbplan.cli import gen_data
from climbplan.datasets.schema.loading import load_dataset
from climbplan.datasets.workspace import Identity
from climbplan.store.dataset_file import read_dataset_file

STATEMENT = f"{Path(__file__).parents[2] / 'specs' / 'cart_pole.py'}:problem"
SPEC = "kind: dataset\ncount: {}\nproblem: {{kind: program, solver: {{method: mpcc}}}}\n"


@pytest.fixture
def model(workplace: Path, run_command: RunCommand) -> Path:
    """A forest of a few solved cart-poles, in a folder of its own."""
    Path("solved.yaml").write_text(SPEC.format(8))
    made = run_command("gen-data", "solved.yaml", "--problem", STATEMENT, "-o", "solved")
    assert made.code == 0, made.err
    Path("model.yaml").write_text(
        "kind: strategy\nproblem: cart_pole\n"
        "data: {files: [solved/dataset.h5], held_out: 0}\n"
        "model: {kind: forest, forest: {trees: 5}}\n"
    )
    fitted = run_command("fit-strategy", "model.yaml", "--problem", STATEMENT, "-o", "model")
    assert fitted.code == 0, fitted.err
    return Path("model", "model.h5")


def test_rows_by_a_trained_model(model: Path, run_command: RunCommand) -> None:
    """Those that it was trained on; a path that --set gives starts from the current directory."""
    folder = Path("specs")
    folder.mkdir()
    (folder / "rows.yaml").write_text(SPEC.format(3))
    given = ("--method", "forest", "--problem", STATEMENT, "-o", "rows")
    done = run_command(
        "gen-data", "specs/rows.yaml", *given, "--set", f"problem.solver.model.file={model}"
    )
    assert done.code == 0, done.err
    rows = read_dataset_file(Path("rows", "dataset.h5"))
    assert rows.feasible.all()
    assert any("forest" in message for message in rows.message), rows.message


@pytest.mark.slow
def test_another_model_of_the_same_name_is_another_run(
    model: Path, workplace: Path, run_command: RunCommand
) -> None:
    setting = f"problem.solver.model.file={model}"
    loaded = load_dataset(workplace / "solved.yaml", [setting, "problem.solver.method=forest"])

    def identity() -> Identity:
        frame = gen_data._build_recipe(loaded, STATEMENT).source().frame
        return Identity.of(loaded.spec, frame, gen_data._list_files(loaded, STATEMENT))

    before = identity()
    again = ("model.yaml", "--problem", STATEMENT, "-o", "model", "--seed", "1", "--force")
    assert run_command("fit-strategy", *again).code == 0
    assert identity().token != before.token
    assert identity().spec == before.spec


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("forest", "problem.solver.model: method `forest` needs a trained model"),
        ("knn", "problem.solver.library: method `knn` takes integers from a library"),
    ],
)
def test_what_is_missing_is_told_with_its_key(
    workplace: Path, run_command: RunCommand, method: str, words: str
) -> None:
    Path("rows.yaml").write_text(SPEC.format(3))
    done = run_command("gen-data", "rows.yaml", "--problem", STATEMENT, "--method", method)
    assert done.code == 2
    assert words in done.err
    assert not Path("outputs").exists()
