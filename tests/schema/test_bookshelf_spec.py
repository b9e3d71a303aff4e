"""Bookshelf specs: the shipped ones, and what is refused."""

from __future__ import annotations

import math
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.pages.pictures import is_moved
from climbplan.bookshelf.scene.scene_source import build_shelf, read_spec_scenes
from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.bookshelf.schema.model import BookshelfSpec

SPECS = Path(__file__).parents[2] / "specs"


def _shipped(name: str) -> dict[str, Any]:
    return yaml.safe_load((SPECS / f"{name}.yaml").read_text(encoding="utf-8"))


def _small(**change: Any) -> dict[str, Any]:
    book = {"x_mm": 0, "height_mm": 80, "width_mm": 20}
    data: dict[str, Any] = {
        "kind": "bookshelf",
        "scene": {"books": [book], "insert": {"height_mm": 70, "width_mm": 30}},
    }
    return {**data, **change}


@pytest.mark.parametrize(
    ("name", "count", "movers"), [("bookshelf_scene", 3, 2), ("bookshelf_five", 5, 3)]
)
def test_inline_examples(name: str, count: int, movers: int) -> None:
    spec = BookshelfSpec.model_validate(_shipped(name))
    scenes, shelf = read_spec_scenes(spec, SPECS), build_shelf(spec.shelf)
    assert scenes.count == count
    answer = ExactSolver(shelf).solve(scenes[0])
    assert answer.status == "optimal"
    assert answer.placement is not None
    assert sum(is_moved(scenes[0], answer.placement, k) for k in range(count)) == movers


def test_the_example_of_a_file() -> None:
    spec = BookshelfSpec.model_validate(_shipped("bookshelf_file"))
    assert len(read_spec_scenes(spec, SPECS)) == 40


def test_defaults_are_those_of_the_shelf() -> None:
    written, default = build_shelf(BookshelfSpec.model_validate(_small()).shelf), Shelf()
    for field in fields(Shelf):
        if field.name != "published":
            value = getattr(default, field.name)
            assert getattr(written, field.name) == pytest.approx(value, rel=1e-12)
    assert astuple(written.published) == pytest.approx(astuple(default.published), rel=1e-12)


def test_books_stand_on_the_ground_unless_told_otherwise() -> None:
    book = {"x_mm": 1, "tilt_deg": 30, "height_mm": 80, "width_mm": 20}
    data = _small()
    data["scene"]["books"] = [book, {**book, "y_mm": 55}]
    pose = read_spec_scenes(BookshelfSpec.model_validate(data), SPECS).pose[0]
    tilt = math.radians(30)
    on_ground = 1e-3 * (20 * math.sin(tilt) + 80 * math.cos(tilt)) / 2
    np.testing.assert_allclose(pose, [[1e-3, on_ground, tilt], [1e-3, 0.055, tilt]])


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"scenes": {"file": "x.h5"}}, "expected either `scene` or `scenes`, got both"),
        ({"scene": None}, "got neither"),
        ({"formulation": "published"}, "`exact` solves the formulation `contact` only"),
        ({"solver": {"solver": "highs"}}, "method `exact`: it takes no solver, got 'highs'"),
        (
            {"solver": {"method": "mccormick", "solver": "daqp"}},
            "method `mccormick`: expected one of highs, scip, gurobi, got 'daqp'",
        ),
        ({"shelf": {"left_mm": 90}}, "expected more than left_mm 90"),
        ({"shelf": {"height_mm": 0}}, "greater than 0"),
        ({"solver": {"method": "guess"}}, "method"),
        ({"solver": {"time_limit": math.nan}}, "finite"),
        ({"shelves": {}}, "shelves"),
    ],
)
def test_mistakes_are_named(change: dict[str, Any], where: str) -> None:
    with pytest.raises(ValidationError, match=where):
        BookshelfSpec.model_validate(_small(**change))


@pytest.mark.parametrize("value", [0, -5, "20 mm", math.inf])
def test_sizes_of_no_book(value: Any) -> None:
    data = _small()
    data["scene"]["insert"]["width_mm"] = value
    with pytest.raises(ValidationError, match="width_mm"):
        BookshelfSpec.model_validate(data)


def test_every_field_says_what_it_is() -> None:
    schema = BookshelfSpec.model_json_schema()
    for model in [schema, *schema["$defs"].values()]:
        for name, field in model["properties"].items():
            assert field.get("description"), f"{model['title']}.{name}"
