"""Every method by name: what it answers holds, what it cannot do it says."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.table import prepare_method
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.plan.file import write_shelf_plan
from climbplan.bookshelf.planner.runs import check_answers, run_shelf
from climbplan.bookshelf.scene.scene_file import read_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf
from climbplan.bookshelf.schema.loading import load_shelf
from climbplan.bookshelf.schema.model import Meaning, ShelfSolverSpec
from climbplan.errors import UsageError

SPECS = Path(__file__).parents[2] / "specs"


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    return read_scenes(SPECS / "bookshelf_scenes.h5")


@pytest.fixture(scope="module")
def optima(scenes: Scenes) -> list[SceneAnswer]:
    return solved(scenes, range(len(scenes)), {})


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All forty scenes solved by `exact`."""
    path = tmp_path_factory.mktemp("library") / "plan.h5"
    write_shelf_plan(run_shelf(load_shelf(str(SPECS / "bookshelf_file.yaml"))), path)
    return path


def solved(
    scenes: Scenes, which: Any, solver: dict[str, Any], meaning: Meaning = "contact"
) -> list[SceneAnswer]:
    """Answers by a method, each through the exact check."""
    setting = MethodSetting(Shelf(), meaning, ShelfSolverSpec(**solver), SPECS)
    method = prepare_method(setting, scenes.count)
    chosen = Scenes.of([scenes[int(k)] for k in which])
    return check_answers(chosen, [method.solve(scene) for scene in chosen], setting)


def test_mpcc_from_the_scene_as_it_is(scenes: Scenes, optima: list[SceneAnswer]) -> None:
    """Most scenes are solved, none at less than the optimum."""
    which = range(16)
    answers = solved(scenes, which, {"method": "mpcc", "start": "manual"})
    placed = [a.placement is not None for a in answers]
    assert sum(placed) >= 10
    for k, answer in zip(which, answers, strict=True):
        assert answer.objective >= optima[k].bound - 1e-3
        assert answer.bound == -math.inf
        if answer.placement is None:
            assert answer.message


def test_mpcc_from_zero_says_that_it_found_nothing(scenes: Scenes) -> None:
    (answer,) = solved(scenes, [9], {"method": "mpcc", "start": "zero"})
    assert answer.status == "limit"
    assert "found none" in answer.message


@pytest.mark.parametrize("method", ["mpcc", "pinned", "knn"])
def test_neighbours_solve_what_the_library_holds(
    scenes: Scenes, optima: list[SceneAnswer], library: Path, method: str
) -> None:
    """Its own scenes are in the library: the first candidate is the optimum."""
    source = {"file": str(library)}
    which = [9, 30, 33, 0]
    solver = {"method": method, "start": "knn", "library": source}
    for k, answer in zip(which, solved(scenes, which, solver), strict=True):
        assert answer.placement is not None
        assert answer.objective == pytest.approx(optima[k].objective, rel=1e-3, abs=2e-2)


@pytest.mark.parametrize("backend", ["daqp", "clarabel", "osqp"])
def test_neighbours_of_other_scenes(
    scenes: Scenes, optima: list[SceneAnswer], library: Path, backend: str
) -> None:
    """A library without the scene itself: placements hold and cost no less than the optimum."""
    source = {"file": str(library), "size": 30}
    which = range(31, 35)
    options = {"method": "pinned", "library": source, "solver": backend, "max_candidates": 8}
    answers = solved(scenes, which, options)
    assert sum(a.placement is not None for a in answers) >= 3
    for k, answer in zip(which, answers, strict=True):
        assert answer.objective >= optima[k].bound - 1e-3


def test_the_published_convex_program_answers_or_says_so(scenes: Scenes, library: Path) -> None:
    options = {"method": "pinned", "library": {"file": str(library)}, "max_refinements": 0}
    (answer,) = solved(scenes, [0], {**options, "max_candidates": 2})
    assert answer.placement is not None or "candidates" in answer.message


def test_knn_falls_back_to_exact(scenes: Scenes, library: Path) -> None:
    """One quadratic program about another scene leads nowhere in most."""
    options = {
        "library": {"file": str(library), "size": 1},
        "max_candidates": 1,
        "max_refinements": 1,
    }
    which = range(9, 17)
    alone = solved(scenes, which, {**options, "method": "pinned"})
    both = solved(scenes, which, {**options, "method": "knn"})
    assert any(a.placement is None for a in alone)
    for first, second in zip(alone, both, strict=True):
        assert second.placement is not None
        assert ("exact" in second.message) == (first.placement is None)


@pytest.mark.parametrize("meaning", ["contact", "published"])
def test_admm(scenes: Scenes, optima: list[SceneAnswer], meaning: Meaning) -> None:
    which = [1, 3, 4]
    answers = solved(scenes, which, {"method": "admm"}, meaning)
    assert sum(a.placement is not None for a in answers) >= 2
    if meaning == "contact":
        for k, answer in zip(which, answers, strict=True):
            assert answer.objective >= optima[k].bound - 1e-3


@pytest.mark.slow
def test_bounds_of_the_statement_hold(scenes: Scenes, optima: list[SceneAnswer]) -> None:
    """SCIP's and the envelopes' bounds are below the optimum that branch and bound proved."""
    for method in ("minlp-scip", "mccormick"):
        (answer,) = solved(scenes, [9], {"method": method, "time_limit": 4.0})
        assert answer.bound <= optima[9].objective + 1e-6, method
        assert answer.objective >= optima[9].bound - 1e-3, method


@pytest.mark.slow
def test_bonmin_finds_a_placement(scenes: Scenes, optima: list[SceneAnswer]) -> None:
    which = [3, 9, 11]  # a heuristic on a nonconvex program: now and then it ends without one
    answers = solved(scenes, which, {"method": "minlp-bonmin", "time_limit": 20.0})
    assert all(answer.bound == -math.inf for answer in answers)
    found = [(k, a) for k, a in zip(which, answers, strict=True) if a.placement is not None]
    assert len(found) >= 2
    for k, answer in found:
        assert optima[k].bound - 1e-3 <= answer.objective < math.inf


def test_envelopes_go_to_scip_as_well(scenes: Scenes, optima: list[SceneAnswer]) -> None:
    """SCIP's model of mixed-integer bilinear programs takes those without products too."""
    options = {"method": "mccormick", "solver": "scip", "time_limit": 2.0}
    (answer,) = solved(scenes, [9], options)
    assert answer.bound <= optima[9].objective + 1e-3
    assert answer.status in ("optimal", "feasible", "limit")


def test_published_meaning_is_cheaper_than_contact(
    scenes: Scenes, optima: list[SceneAnswer], library: Path
) -> None:
    """Its tolerances let books overlap, so that its optima cost less in nearly all scenes."""
    source = {"file": str(library), "allow_other_shelves": True}
    options = {"method": "pinned", "library": source, "max_candidates": 12}
    which = [9, 30, 35, 11]
    answers = solved(scenes, which, options, "published")
    cheaper = [a.objective < optima[k].objective for k, a in zip(which, answers, strict=True)]
    assert np.mean(cheaper) >= 0.75


def test_what_does_not_go_together(scenes: Scenes, library: Path) -> None:
    with pytest.raises(UsageError, match=r"solver\.library"):
        solved(scenes, [0], {"method": "pinned"})
    with pytest.raises(UsageError, match="unknown convex solver"):
        solved(
            scenes,
            [0],
            {"method": "pinned", "library": {"file": str(library)}, "solver": "highs"},
        )
    setting = MethodSetting(
        Shelf(),
        "contact",
        ShelfSolverSpec(method="pinned", library={"file": str(library)}),  # type: ignore[arg-type]
        SPECS,
    )
    with pytest.raises(UsageError, match="3 stored books, expected 4"):
        prepare_method(setting, 4)


@pytest.mark.parametrize(
    ("shelf", "meaning", "words"),
    [
        (
            Shelf(right=0.09),
            "contact",
            "made for a shelf whose right is 0.08111 m, here it is 0.09 m",
        ),
        (Shelf(lean_margin=0.1), "contact", "made for a shelf whose lean_margin is 0 rad"),
        (Shelf(), "published", "made for formulation 'contact', here it is 'published'"),
    ],
)
@pytest.mark.parametrize("method", ["pinned", "knn", "mpcc"])
def test_a_library_of_another_shelf_or_meaning_is_refused_unless_the_spec_takes_it(
    library: Path, shelf: Shelf, meaning: Meaning, words: str, method: str
) -> None:
    def setting(source: dict[str, object]) -> MethodSetting:
        given = {"method": method, "start": "knn", "library": source}
        return MethodSetting(shelf, meaning, ShelfSolverSpec.model_validate(given), SPECS)

    with pytest.raises(UsageError, match=rf"library {library}: {words}") as refused:
        prepare_method(setting({"file": str(library)}), 3)
    assert "solver.library.allow_other_shelves: true" in str(refused.value)
    prepare_method(setting({"file": str(library), "allow_other_shelves": True}), 3)
