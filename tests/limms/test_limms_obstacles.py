"""Obstacles in a room of modules: kept off by box and modules, named in errors, and drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.errors import SpecError
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.motion.assembly import build_initial_plan
from climbplan.limms.motion.reaching import drive
from climbplan.limms.pages.obstacles import find_obstacles
from climbplan.limms.pages.scene import build_module_scene
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import build_scene
from climbplan.limms.schema.loading import LoadedLimms, load_limms
from climbplan.limms.schema.space import build_space

# One module hangs from the ceiling; a wall stands between the table with the box and its goal
ROOM = """\
kind: limms
terrain:
  regions:
    - {name: room, lower: [-1.5, -1, 0], upper: [1.5, 1, 1.05]}
  obstacles:
    - {name: wall, lower: [-0.05, -0.7, 0], upper: [0.05, 0.2, 0.4]}
    - {name: table, lower: [-0.4, -0.1, 0], upper: [-0.2, 0.1, 0.2]}
  anchors:
    - {name: ceiling, position: [-0.02, 0.35, 1.05], normal: [0, 0, -1]}
box: {size: [0.2, 0.2, 0.2], mass: 0.2, start: [-0.3, 0, 0.3], goal: [0.3, 0, 0.35]}
modules:
  - {name: A, anchor: ceiling}
"""


def read(folder: Path, text: str) -> LoadedLimms:
    path = folder / "room.yaml"
    path.write_text(text, encoding="utf-8")
    return load_limms(path)


@pytest.fixture(scope="module")
def over(tmp_path_factory: pytest.TempPathFactory) -> LimmsPlan:
    return plan_limms(read(tmp_path_factory.mktemp("obstacles"), ROOM))


def test_box_goes_over_a_wall_from_the_ceiling(over: LimmsPlan) -> None:
    assert verify_plan(over).passed
    box = over.motion.box_position[:, 0]
    across = np.abs(box[:, 0]) < 0.15  # over the wall at least in part
    assert box[across, 2].min() >= 0.5 - 1e-6
    drawn = find_obstacles(over)
    assert np.allclose(drawn[0], [[-0.05, -0.7, 0], [0.05, 0.2, 0.4]])
    assert len(drawn) == 2
    shown = [shape.name for shape in build_module_scene(over).shapes]
    assert sum(name.startswith("obstacle") for name in shown) == 2


def test_checker_finds_what_reaches_into_obstacles(over: LimmsPlan, tmp_path: Path) -> None:
    """The plan held against the same room with a higher wall: box and arm touch it."""
    taller = read(tmp_path, ROOM.replace("0.2, 0.4]", "0.2, 0.6]"))
    solids = build_scene(taller).solids
    failed = {check.name for check in verify_plan(replace(over, solids=solids)).failed}
    assert {"box.collision", "file.spec_values"} <= failed
    # Right where the elbow is, a block that the box does not come to
    moment = int(np.argmax(over.motion.time >= 0.5 * over.motion.time[-1]))
    elbow = over.motion.joint_position[moment, 0, 3]
    block = np.array([[elbow - 0.01, elbow + 0.01]])
    hit = verify_plan(replace(over, solids=np.concatenate([over.solids, block])))
    assert "limbs.collision" in {check.name for check in hit.failed}


def test_modules_drive_round_obstacles(tmp_path: Path) -> None:
    text = ROOM.replace("anchor: ceiling}", "position: [-0.8, -0.2, 0]}")
    scene = build_scene(read(tmp_path, text))
    world = build_initial_plan(scene)
    drive(world, 0, np.array([0.8, -0.2, 0.0]), "A", np.random.default_rng(0))
    way = np.concatenate([s.base_position[:, 0] for s in world.stretches])
    near = np.abs(way[:, 0]) < 0.05 + scene.module.radius - 1e-6
    assert near.any()
    assert ((way[near, 1] >= 0.2) | (way[near, 1] <= -0.7)).all()
    assert np.allclose(way[-1], [0.8, -0.2, 0.0])


def test_space_is_without_obstacles() -> None:
    room = ((0.0, 0.0, 0.0), (4.0, 1.0, 1.0))
    pillar = ((1.0, 0.0, -1.0), (2.0, 1.0, 0.5))
    space = build_space([room], [("pillar", pillar), ("elsewhere", ((9, 9, 9), (10, 10, 10)))])
    assert space.obstacles == (("pillar", ((1.0, 0.0, 0.0), (2.0, 1.0, 0.5))),)
    free = sum(np.prod(np.subtract(high, low)) for low, high in space.free)
    assert free == pytest.approx(4.0 - 0.5)


def test_a_closed_wall_holds_no_way(tmp_path: Path) -> None:
    closed = ROOM.replace("[-0.05, -0.7, 0]", "[-0.05, -1, 0]").replace("0.2, 0.4]", "1, 1.05]")
    closed = closed.replace("anchor: ceiling}", "position: [0.8, 0.5, 0]}")
    closed = closed.replace("[-0.02, 0.35, 1.05]", "[0.5, 0.35, 1.05]")
    scene = build_scene(read(tmp_path, closed))
    assert find_corridor(decompose_free_space(scene), scene.box_start[0], scene.goal) is None


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("goal: [0.3, 0, 0.35]", "goal: [0.1, 0, 0.35]", 10, "50 mm into obstacle 'wall'"),
        ("start: [-0.3, 0, 0.3]", "start: [-0.3, 0, 0.2]", 10, "into obstacle 'table'"),
        ("upper: [0.05, 0.2, 0.4]", "upper: [-0.05, 0.2, 0.4]", 6, "expected more than lower"),
        ("lower: [-0.05, -0.7, 0]", "lower: [-0.05, -0.7]", 6, "terrain.obstacles.0.lower"),
        ("name: table", "name: wall", 7, "names must differ"),
        ("lower: [-0.4, -0.1, 0], upper: [-0.2, 0.1, 0.2]", "lower: [2, 0, 0], upper: [3, 1, 1]",
         7, "'table' is nowhere in the free space"),
        ("anchor: ceiling}", "position: [0.0, 0.22, 0]}", 12, "is in obstacle 'wall' at the start"),
        ("position: [-0.02, 0.35, 1.05]", "position: [0, 0, 0.2]", 9, "outside the free space"),
    ],
)  # fmt: skip
def test_mistakes_have_line_and_key(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    assert old in ROOM
    with pytest.raises(SpecError) as caught:
        read(tmp_path, ROOM.replace(old, new))
    found = str(caught.value).splitlines()
    assert any(words in text and f":{line}:" in text for text in found), found
