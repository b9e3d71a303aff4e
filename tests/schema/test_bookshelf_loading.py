"""Loading bookshelf specs: where paths start from, and mistakes with their lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.bookshelf.schema.loading import LoadedShelf, load_shelf
from climbplan.errors import SpecError
from climbplan.schema.loading import load_spec

TEXT = """\
kind: bookshelf
scenes: {file: data/scenes.h5, group: a}
solver:
  method: pinned
  library: {file: ../library/plan.h5}
"""


@pytest.fixture
def spec(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A spec in another directory than the current one."""
    for name in ("specs", "here"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    path = tmp_path / "specs" / "many.yaml"
    path.write_text(TEXT)
    return path


def files(loaded: LoadedShelf) -> tuple[str, str]:
    assert loaded.spec.scenes is not None
    assert loaded.spec.solver.library is not None
    return loaded.spec.scenes.file, loaded.spec.solver.library.file


def test_paths_of_the_file_start_from_its_directory(spec: Path) -> None:
    loaded = load_shelf(spec)
    assert files(loaded) == ("data/scenes.h5", "../library/plan.h5")
    assert loaded.directory == spec.parent
    assert (loaded.text, loaded.name) == (TEXT, "many")


def test_paths_of_options_start_from_the_current_directory(spec: Path) -> None:
    loaded = load_shelf(spec, ["scenes.file=own.h5", "scenes.group=b"])
    assert files(loaded) == (str(Path.cwd() / "own.h5"), "../library/plan.h5")
    assert str(Path.cwd() / "own.h5") in loaded.text  # the text means the same anywhere
    other = load_shelf(spec, ["solver.library={file: lib.h5}", "scenes.file=/abs/x.h5"])
    assert files(other) == ("/abs/x.h5", str(Path.cwd() / "lib.h5"))


def test_overriding_the_group_alone_leaves_the_file(spec: Path) -> None:
    loaded = load_shelf(spec, ["scenes.group=b"])
    assert files(loaded)[0] == "data/scenes.h5"
    assert loaded.spec.scenes is not None
    assert loaded.spec.scenes.group == "b"


def test_any_kind(spec: Path) -> None:
    assert load_spec(spec) == load_shelf(spec)


def test_all_mistakes_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(
        "kind: bookshelf\n"
        "scene:\n"
        "  books:\n"
        "    - {x_mm: 0, height_mm: 80, width_mm: 0}\n"
        "    - {x_mm: .nan, height_mm: tall, width_mm: 20}\n"
        "  insert: {height_mm: 70}\n"
        "shelf: {left_mm: 9, right_mm: 8}\n"
        "solvr: {}\n"
    )
    with pytest.raises(SpecError) as caught:
        load_shelf(path)
    found = {(mistake.line, mistake.key) for mistake in caught.value.mistakes}
    assert found == {
        (4, "scene.books.0.width_mm"),
        (5, "scene.books.1.x_mm"),
        (5, "scene.books.1.height_mm"),
        (6, "scene.insert.width_mm"),
        (7, "shelf.right_mm"),
        (8, "solvr"),
    }


def test_another_kind(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text("kind: robot\n")
    with pytest.raises(SpecError, match="expected a spec of kind `bookshelf`, got a `robot`"):
        load_shelf(path)
