"""Climbs after transitions: in one plan, and from plan to plan."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scenes import PlannedScenes

from climbplan.climb.check.verification import verify, verify_and_mark, verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.planner.start_from_plan import resolve_start_plan
from climbplan.climb.schema.loading import load_climb, load_text
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.simulation.executive.replanning import MeasuredStance, replan_climb
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import SpecError, UsageError
from climbplan.robots.rotations import rotation_world_body

SPECS = Path(__file__).parents[3] / "specs"
MISSION = SPECS / "mission_ground_to_top.yaml"

ONWARDS = """\
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [0.0, 1.6]}
task:
  rounds: 2
  start: {plan: ground/plan.h5}
  goal: {com: [0, 0, 0.5]}
force: {safety_friction: 1.1}
"""


@pytest.fixture(scope="module")
def ground(planned_scenes: PlannedScenes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    (folder / "ground").mkdir()
    shutil.copy(planned_scenes["transition"], folder / "ground" / "plan.h5")
    assert verify_and_mark(folder / "ground" / "plan.h5").passed
    (folder / "onwards.yaml").write_text(ONWARDS)
    return folder


def test_a_climb_starts_where_a_transition_ends(ground: Path, tmp_path: Path) -> None:
    before = read_climb(ground / "ground" / "plan.h5")
    after = plan_climb(load_climb(ground / "onwards.yaml"))
    np.testing.assert_allclose(after.rounds.com[0], before.rounds.com[-1], atol=1e-12)
    np.testing.assert_allclose(after.rounds.toes[0], before.rounds.toes[-1], atol=1e-9)
    # The file stands for itself: the other plan is no longer needed to verify it.
    assert "plan.h5" not in after.spec_text
    write_climb(after, tmp_path / "plan.h5")
    verification = verify(tmp_path / "plan.h5")
    assert verification.passed, verification.table()


def _refusal(ground: Path, old: str = "", new: str = "") -> str:
    assert old in ONWARDS
    text = ONWARDS.replace(old, new) if old else ONWARDS
    (ground / "changed.yaml").write_text(text)
    with pytest.raises(SpecError) as caught:
        plan_climb(load_climb(ground / "changed.yaml"))
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("ground/plan.h5", "ground/none.h5", "changed.yaml:8: task.start.plan: "),
        ("ground/plan.h5", "onwards.yaml", "task.start.plan: "),
        ("{plan: ground/plan.h5}", "{plan: ''}", "task.start.plan: "),
        ("{plan: ground/plan.h5}", "{plan: ground/plan.h5, com: [0, 0, 0]}", "unknown beside"),
        ("{plan: ground/plan.h5}", "{rpy_deg: [0, 0, 0]}", "task.start.com: missing"),
        ("gap: 1.23", "gap: 1.3", "35.00 mm off 'right'"),
    ],
)
def test_starts_that_do_not_fit(ground: Path, old: str, new: str, words: str) -> None:
    assert words in _refusal(ground, old, new)


def test_another_robot_or_a_failed_plan_is_no_start(ground: Path) -> None:
    robot = (Path(__file__).parents[3] / "climbplan/robots/silvia.yaml").read_text()
    (ground / "longer.yaml").write_text(robot.replace("name: RM", "name: MR"))
    assert "whose limbs are RF, RM" in _refusal(ground, "robot: silvia", "robot: longer.yaml")
    bad = ground / "ground" / "bad.h5"
    bad.write_bytes((ground / "ground" / "plan.h5").read_bytes())
    with h5py.File(bad, "r+") as file:
        file.attrs["verified"] = np.bool_(False)
    assert "fails its verification" in _refusal(ground, "plan.h5", "bad.h5")
    with h5py.File(bad, "r+") as file:
        file.attrs["verified"] = np.bool_(True)  # says so, but its robot is not the one it names
        file["robot/joint_upper"][...] *= 2
    assert "fails its verification: 1 of" in _refusal(ground, "plan.h5", "bad.h5")


def test_a_climb_with_a_start_of_its_own_stays_as_it_is() -> None:
    loaded = load_text(ONWARDS.replace("{plan: ground/plan.h5}", "{com: [0, 0, 0.3]}"), "own")
    assert resolve_start_plan(loaded) is loaded


@pytest.fixture(scope="module")
def mission() -> ClimbPlan:
    return plan_transition(load_transition(MISSION, ["climb.rounds=2", "climb.goal.com=[0,0,0.6]"]))


def test_the_mission_is_one_verified_plan(mission: ClimbPlan, tmp_path: Path) -> None:
    write_climb(mission, tmp_path / "plan.h5")
    verification = verify(tmp_path / "plan.h5")
    assert verification.passed, verification.table()
    assert mission.rounds.count == 4
    moved = mission.instants.lifted[::2].sum(axis=1)
    assert moved.tolist() == [3, 3] + [1] * 12
    # Toes leave the ground, and end on the walls above where the transition put them.
    assert mission.rounds.toes[0, :, 2] == pytest.approx(0.0)
    assert (mission.rounds.toes[-1, :, 2] > mission.rounds.toes[2, :, 2] + 0.1).all()


def _swap_two_limbs_of_the_climb(file: h5py.File) -> None:
    for name in ("lifted", "contact"):
        rows = file[f"instants/{name}"]
        rows[4, :], rows[6, :] = rows[6, :], rows[4, :]


def _another_goal(file: h5py.File) -> None:
    file["limits/goal_com"][2] += 0.01


@pytest.mark.parametrize(
    ("change", "check"),
    [(_swap_two_limbs_of_the_climb, "gait.sequence"), (_another_goal, "file.spec_values")],
)
def test_tampering_with_a_mission_is_found(
    mission: ClimbPlan, tmp_path: Path, change: object, check: str
) -> None:
    assert callable(change)
    write_climb(mission, tmp_path / "plan.h5")
    with h5py.File(tmp_path / "plan.h5", "r+") as file:
        change(file)
    assert check in {c.name for c in verify(tmp_path / "plan.h5").failed}


def _stand(plan: ClimbPlan, instant: int, limb: int, slide: float) -> MeasuredStance:
    """Return the stance before a lift of a plan, with a toe that has slid down [m]."""
    instants = plan.instants
    toes = instants.toes[instant].copy()
    toes[limb, 2] -= slide
    return MeasuredStance(
        com=instants.com[instant],
        rotation=rotation_world_body(instants.rpy[instant]),
        toes=toes,
        friction=np.ones(len(plan.terrain.surfaces)),
        load=np.zeros(6),
        instant=instant,
        next_instant=instant + 1,
    )


def test_the_climb_of_a_mission_is_planned_anew(mission: ClimbPlan) -> None:
    first = int(np.flatnonzero(mission.instants.round > 2)[0])
    stance = _stand(mission, first + 3, 1, 0.03)  # in the first round of two
    rest = replan_climb(mission, stance)
    assert rest.kind == "climb"
    assert verify_plan(rest).passed
    np.testing.assert_allclose(rest.rounds.com[0], stance.com, atol=1e-12)
    np.testing.assert_allclose(rest.rounds.toes[0], stance.toes, atol=1e-3)
    np.testing.assert_array_equal(rest.limits.goal_com, mission.limits.goal_com)
    assert rest.rounds.count in (2, 3)
    assert rest.limits.safety_torque == mission.limits.safety_torque


def test_a_mission_is_planned_anew_within_its_transition(mission: ClimbPlan) -> None:
    limb = int(np.flatnonzero(mission.instants.lifted[0])[0])  # on its wall, off its foothold
    stance = _stand(mission, 1, limb, 0.02)
    rest = replan_climb(mission, stance)
    assert rest.kind == "transition"
    assert verify_plan(rest).passed
    np.testing.assert_allclose(rest.rounds.com[0], stance.com, atol=1e-12)
    np.testing.assert_allclose(rest.rounds.toes[0], stance.toes, atol=1e-3)
    np.testing.assert_array_equal(rest.limits.goal_com, mission.limits.goal_com)
    # A round more than were left, as the toe has to move again; the climb follows
    assert rest.rounds.count == mission.rounds.count


def test_transitions_are_planned_anew_only_by_robots_that_they_carry(mission: ClimbPlan) -> None:
    text = mission.spec_text.replace("robot: silvia", "robot: other.yaml")
    with pytest.raises(UsageError, match="the plan does not carry other"):
        replan_climb(replace(mission, spec_text=text), _stand(mission, 1, 1, 0.0))
