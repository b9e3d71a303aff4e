"""Modules that have no room where a spec puts them, and other places that cannot be."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.errors import SpecError
from climbplan.limms.schema.loading import load_limms

TOLERANCES = """\
kind: limms
terrain:
  regions:
    - {name: room, lower: [0, -1, 0], upper: [2, 1, 2]}
  anchors:
    - {name: wall, position: [0, 0, 1], normal: [1, 0, 0]}
    - {name: side, position: [0.9, 1, 1], normal: [0, -1, 0]}
box: {size: [0.2, 0.2, 0.2], mass: 0.3, start: [1.5, 0, 0.1], goal: [1, 0, 1]}
static_boxes:
  - {size: [0.2, 0.2, 0.2], position: [1, 0.5, 0.1]}
modules:
  - {name: A, position: [0.5, 0.5, 0]}
  - {name: B, anchor: wall}
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("position: [0.5, 0.5, 0]", "position: [1.5, 0.05, 0]", "is in the box at its start"),
        ("position: [0.5, 0.5, 0]", "position: [1.1, 0.5, 0]", "is in parked box 0"),
        ("position: [0.5, 0.5, 0]", "position: [0.01, 0.5, 0]", "is in what is solid"),
        ("upper: [2, 1, 2]", "upper: [2, 1, 0.98]", "outside the free space"),
        (
            "{name: A, position: [0.5, 0.5, 0]}",
            "{name: A, anchor: side}",
            "'B', straight and 0.99 m",
        ),
        ("B, anchor: wall", "B, position: [0.5, 0.55, 0]", "is in module 'A'"),
        ("position: [0.9, 1, 1]", "position: [0, 0, 1]", "anchor 'wall' is at the same place"),
        ("goal: [1, 0, 1]", "goal: [1.5, 0, 0.1]", "another place than the start"),
        ("start: [1.5, 0, 0.1]", "start: [1.5, 0, 0.1001]", "does not stand on the ground"),
        ("size: [0.2, 0.2, 0.2], mass", "size: [0.2, 5, 0.2], mass", "out of the free space"),
        ("mass: 0.3", "mass: .nan", "mass"),
        ("goal: [1, 0, 1]", "goal: [1, 0, .inf]", "goal"),
        ("kind: limms", "kind: limms\ntask: {allow: [quadruped, flight]}", "needs 4 modules"),
    ],
)
def test_places_that_cannot_be_are_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in TOLERANCES
    path = tmp_path / "scene.yaml"
    path.write_text(TOLERANCES.replace(old, new), encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        load_limms(path)
    assert words in str(caught.value)


def test_the_good_one_loads(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(TOLERANCES, encoding="utf-8")
    assert len(load_limms(path).spec.modules) == 2
