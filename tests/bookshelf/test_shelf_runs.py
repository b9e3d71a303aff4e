"""Runs over scenes: order, workers, checks of the meaning, oddities of stored scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.bookshelf.check.verification import verify
from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.plan.file import write_shelf_plan
from climbplan.bookshelf.planner import runs
from climbplan.bookshelf.planner.runs import check_answers, run_shelf, solve_scenes
from climbplan.bookshelf.scene.oddities import find_oddities
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene
from climbplan.bookshelf.schema.loading import LoadedShelf, load_shelf
from climbplan.bookshelf.schema.model import ShelfSolverSpec
from climbplan.errors import Infeasible

SPECS = Path(__file__).parents[2] / "specs"
SETTING = MethodSetting(Shelf(), "contact", ShelfSolverSpec(), Path())


def rows(*changes: dict[int, float]) -> Scenes:
    """Scenes of two upright books and a third to insert [mm], each with some columns changed."""
    base = [-60, 40, 0, 80, 20, 30, 35, 0, 70, 25, 60, 20]
    table = np.array([base] * len(changes), float)
    for row, change in enumerate(changes):
        for column, value in change.items():
            table[row, column] = value
    return Scenes.from_theta(table, "mm")


@pytest.fixture
def shifted(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Makes every method shift the inserted book by some metres."""

    def shift(by: float) -> None:
        class Shifted:
            def __init__(self, exact: SceneMethod) -> None:
                self.exact = exact

            def solve(self, scene: ShelfScene) -> SceneAnswer:
                answer = self.exact.solve(scene)
                assert answer.placement is not None
                pose = answer.placement.pose + np.array([[0, 0, 0]] * scene.count + [[by, 0, 0]])
                return replace(answer, placement=replace(answer.placement, pose=pose))

        def prepare(setting: MethodSetting, count: int) -> SceneMethod:
            return Shifted(ExactSolver(setting.shelf))

        monkeypatch.setattr(runs, "prepare_method", prepare)

    return shift


def test_progress_and_order() -> None:
    scenes = rows({11: 20}, {11: 22}, {11: 130, 10: 90}, {11: 24})
    told: list[tuple[str, float]] = []
    answers = solve_scenes(scenes, SETTING, 1, lambda stage, part: told.append((stage, part)))
    assert told == [("solve", part) for part in (0.25, 0.5, 0.75, 1.0)]
    assert [answer.status for answer in answers] == ["optimal", "optimal", "infeasible", "optimal"]
    for scene, answer in zip(scenes, answers, strict=True):
        if answer.placement is not None:
            assert 2 * answer.placement.pose[-1, 1] == pytest.approx(scene.inserted[1])  # flat


def test_answers_that_break_a_constraint_count_as_none() -> None:
    scenes = rows({}, {})
    answers = solve_scenes(scenes, SETTING)
    first = answers[0].placement
    assert first is not None
    broken = first.pose + np.array([[0, 0, 0], [0, 0, 0], [0, 2e-5, 0]])  # 0.02 mm above ground
    answers[0] = replace(answers[0], placement=replace(first, pose=broken))
    lost, kept = check_answers(scenes, answers, SETTING)
    assert (lost.status, lost.placement, lost.objective) == ("limit", None, math.inf)
    assert "book.ground: 0.02 mm at the inserted book (at most 0.01)" in lost.message
    assert kept == answers[1]


def test_a_solvers_word_is_not_believed() -> None:
    scenes = rows({}, {}, {}, {})
    true = solve_scenes(scenes, SETTING)[0]
    words = [
        replace(true, objective=0.0, status="optimal", bound=-math.inf),
        replace(true, bound=true.objective + 1.0),
        replace(true, bound=true.objective + 1e-4),
        replace(true, status="infeasible", placement=None, objective=math.inf, bound=math.inf),
    ]
    unproved, above, near, denied = check_answers(scenes, words, SETTING)
    assert (unproved.status, unproved.objective) == ("feasible", true.objective)
    assert (above.status, above.bound) == ("feasible", -math.inf)
    assert "above the cost, and so not valid" in above.message
    assert (near.status, near.bound) == ("optimal", true.objective)
    assert (denied.status, denied.bound) == ("limit", -math.inf)
    assert "fit side by side" in denied.message


def test_meaning_decides_what_passes(shifted: Callable[[float], None], tmp_path: Path) -> None:
    """The published meaning lets a book overlap another one by less than 3 mm."""
    text = (
        "kind: bookshelf\nsolver: {method: minlp-scip}\nscene:\n"
        "  books: [{x_mm: -60, height_mm: 80, width_mm: 20}, "
        "{x_mm: 30, height_mm: 70, width_mm: 25}]\n"
        "  insert: {height_mm: 90, width_mm: 117}\n"  # 0.2 mm of room
    )
    (tmp_path / "contact.yaml").write_text(text)
    (tmp_path / "published.yaml").write_text(f"{text}\nformulation: published\n")
    shifted(1e-3)
    with pytest.raises(runs.LimitReached, match=r"breaks book\.overlap"):
        run_shelf(load_shelf(tmp_path / "contact.yaml"))
    plan = run_shelf(load_shelf(tmp_path / "published.yaml"))
    assert plan.meaning == "published"
    assert plan.solutions.overlap[0] > 5e-4
    write_shelf_plan(plan, tmp_path / "plan.h5")
    verification = verify(tmp_path / "plan.h5")
    assert verification.passed, verification.table()
    assert "book.separation" in {check.name for check in verification.checks}


def loaded(*settings: str) -> LoadedShelf:
    return load_shelf(SPECS / "bookshelf_scene.yaml", settings)


def test_every_book_that_is_too_tall_is_named() -> None:
    size = "{height_mm: 130, width_mm: 120}"
    settings = [f"scene.insert={size}", "scene.books.1.height_mm=140", "scene.books.1.width_mm=115"]
    with pytest.raises(Infeasible) as caught:
        run_shelf(loaded(*settings))
    said = str(caught.value)
    assert "misses 10.00 mm of clear height (book 1 and the inserted book)" in said
    assert "height_mm >= 120.00" in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({0: -69, 5: 30}, ()),
        ({0: 20}, ("books 0 and 1 overlap by 12.5 mm before the insertion",)),
        ({1: 43.9}, ()),  # within the contact gap
        ({1: 45}, ("book 0 floats 5.0 mm above the ground",)),
        ({1: 39}, ("book 0 reaches 1.0 mm below the ground",)),
        ({0: -72}, ("book 0 reaches 0.9 mm into or beyond a wall",)),
        ({0: 60}, ("book 1 stands 30.0 mm left of the book listed before it",)),
    ],
)
def test_oddities(change: dict[int, float], said: tuple[str, ...]) -> None:
    assert find_oddities(rows(change), Shelf()) == said


def test_oddities_of_many_scenes_name_the_worst() -> None:
    lines = find_oddities(rows({}, {1: 45}, {1: 60}), Shelf())
    assert lines == (
        "scene 2: book 0 floats 20.0 mm above the ground (the worst of 2 such scenes)",
    )
