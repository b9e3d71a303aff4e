"""LIMMS specs: every mistake at once, with line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.errors import SpecError
from climbplan.limms.schema.loading import load_limms
from climbplan.limms.schema.space import compute_solid_blocks

TOLERANCES = """\
kind: limms
terrain:
  regions:
    - {name: room, lower: [0, -1, 0], upper: [2, 1, 2]}
  anchors:
    - {name: wall, position: [0, 0, 1], normal: [1, 0, 0]}
box: {size: [0.2, 0.2, 0.2], mass: 0.3, start: [1, 0, 0.1], goal: [1, 0, 1]}
static_boxes:
  - {size: [0.2, 0.2, 0.2], position: [1, 0.5, 0.1]}
modules:
  - {name: A, position: [0.5, 0.5, 0]}
"""


def messages(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        load_limms(path)
    return str(caught.value).splitlines()


def test_good_one(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(TOLERANCES, encoding="utf-8")
    assert load_limms(path).module.name == "LIMMS"


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("position: [1, 0.5, 0.1]", "position: [1, 0.1, 0.1]", 9, "overlaps the box at box.start"),
        ("position: [0, 0, 1]", "position: [-0.5, 0, 1]", 6, "outside the free space"),
        ("position: [0, 0, 1]", "position: [1, 0, 1]", 6, "not on a face"),
        ("goal: [1, 0, 1]", "goal: [0.05, 0, 1]", 7, "50 mm out of the free space"),
        ("goal: [1, 0, 1]", "goal: [4, 0, 1]", 7, "the box at its goal is outside the space"),
        ("goal: [1, 0, 1]", "goal: [1, 0.5, 0.1]", 7, "inside static box 0"),
        ("start: [1, 0, 0.1]", "start: [1, 0, 0.4]", 7, "does not stand on the ground"),
        (
            "position: [0.5, 0.5, 0]",
            "position: [0.5, 0.5, 0.2]",
            11,
            "does not stand on the ground",
        ),
        ("position: [0.5, 0.5, 0]", "anchor: roof", 11, "expected an anchor of the terrain (wall)"),
        (
            "position: [0.5, 0.5, 0]",
            "position: [0.5, 0.5, 0], anchor: wall",
            11,
            "either `position`",
        ),
        ("normal: [1, 0, 0]", "normal: [1, 1, 0]", 6, "unit vector along an axis"),
        ("upper: [2, 1, 2]", "upper: [2, 1, 0]", 4, "expected more than lower"),
        ("kind: limms", "kind: limms\nrobot: lims", 2, "did you mean 'limms'"),
        ("kind: limms", "kind: limms\ntask: {allow: [quadruped]}", 11, "needs 4 modules, got 1"),
    ],
)
def test_mistakes_have_line_and_key(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    assert old in TOLERANCES
    found = messages(tmp_path, TOLERANCES.replace(old, new))
    assert any(words in text and f":{line}:" in text for text in found), found


def test_all_mistakes_at_once(tmp_path: Path) -> None:
    text = TOLERANCES.replace("goal: [1, 0, 1]", "goal: [0.05, 0, 1]")
    text = text.replace("position: [0.5, 0.5, 0]", "position: [5, 0.5, 0]")
    assert len(messages(tmp_path, text)) == 2


def test_solids_fill_what_regions_leave() -> None:
    free = [((0, 0, 0), (1, 1, 1)), ((1, 0, 0.5), (2, 1, 1))]
    solids = compute_solid_blocks(free)
    whole = 4.0 * 3.0 * 3.0
    solid = sum((b[0] - a[0]) * (b[1] - a[1]) * (b[2] - a[2]) for a, b in solids)
    assert solid == pytest.approx(whole - 1.0 - 0.5)
