"""SCALER on one wall: feasible by gripping alone, verified from the file, explained without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.climb.check.verification import verify
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import Unresolved, UsageError
from climbplan.verification.check import GRIP_LIMITS, LIMITS

SPECS = Path(__file__).parents[2] / "specs"
WALL, CEILING = SPECS / "climb_single_wall.yaml", SPECS / "climb_ceiling.yaml"
SHORT = ["task.rounds=1", "task.goal.com=[0,-0.3595,0.075]"]


@pytest.fixture(scope="module")
def climb() -> ClimbPlan:
    return plan_climb(load_climb(WALL))


@pytest.fixture
def file(climb: ClimbPlan, tmp_path: Path) -> Path:
    path = tmp_path / "plan.h5"
    write_climb(climb, path)
    return path


def test_the_plan_holds_from_its_file_alone(file: Path, climb: ClimbPlan) -> None:
    verification = verify(file)
    assert verification.passed, verification.table()
    assert set(GRIP_LIMITS) <= {check.name for check in verification.checks}
    again = read_climb(file)
    assert climb.grips is not None
    assert again.grips is not None
    np.testing.assert_array_equal(again.grips.pull_margin, climb.grips.pull_margin)
    np.testing.assert_array_equal(
        again.grips.trajectory.packed_array, climb.grips.trajectory.packed_array
    )


def test_upper_grips_pull_and_hold_more(climb: ClimbPlan) -> None:
    assert climb.grips is not None
    names = climb.robot.limb_names
    front = [names.index("LF"), names.index("RF")]
    onto = np.einsum("kni,kni->kn", climb.forces.force, climb.instants.normal)
    pushes = np.flatnonzero(~climb.instants.lifted.any(axis=1))
    assert (onto[pushes][:, front] < 0).any(axis=1).all()  # someone above pulls at every push
    held = climb.instants.contact
    assert (climb.grips.pull_margin[held] > 0).all()
    assert climb.grips.instants.grip[held].min() > 0


@pytest.mark.parametrize(
    ("spec", "changes"),
    [(CEILING, []), (WALL, ["task.payload.mass=3"])],
    ids=["ceiling", "payload"],
)
def test_upside_down_and_with_payload(spec: Path, changes: list[str], tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_climb(plan_climb(load_climb(spec, changes)), path)
    assert verify(path).passed


@pytest.mark.slow
def test_open_grippers_lack_pull() -> None:
    with pytest.raises(Unresolved) as caught:
        plan_climb(load_climb(WALL, ["gripper.max_force=0", *SHORT]))
    text = str(caught.value)
    assert "8 of 8 instants have no admissible grips" in text
    first = str(caught.value.conflicts[0])
    assert first.startswith("round 1, LF lifted: with open grippers pull towards the surface")
    assert "N at RF" in first
    assert "[grip.unilateral, grip.shear]" in first
    assert {"grip.unilateral", "grip.shear", "torque.limit", "wrist.torque"} <= set(
        GRIP_LIMITS
    ) | set(LIMITS)
    # The least gripping force that is said to do, does.
    needed = float(text.split("gripping force >= ")[1].split(" N")[0])
    plan_climb(load_climb(WALL, [f"gripper.max_force={needed}", *SHORT]))
    with pytest.raises(Unresolved):
        plan_climb(load_climb(WALL, [f"gripper.max_force={0.97 * needed}", *SHORT]))


def test_flat_wall_cannot_be_gripped() -> None:
    """On the plane itself fingers only shear: no gripping force makes up for pull."""
    loaded = load_climb(WALL, SHORT)
    panel = loaded.spec.terrain.panel
    assert panel is not None
    holds = {n: h.model_copy(update={"undercut_deg": -90.0}) for n, h in panel.holds.items()}
    flat = loaded.spec.terrain.model_copy(
        update={"panel": panel.model_copy(update={"holds": holds})}
    )
    spec = loaded.spec.model_copy(update={"terrain": flat})
    with pytest.raises(Unresolved, match="pull towards the surface is missing"):
        plan_climb(replace(loaded, spec=spec))


def test_risk_and_model_decide_what_spines_hold(tmp_path: Path) -> None:
    safe = plan_climb(load_climb(WALL, SHORT))
    bold = plan_climb(load_climb(WALL, [*SHORT, "gripper.risk=0.5"]))
    assert safe.grips is not None
    assert bold.grips is not None
    assert (bold.grips.spines > safe.grips.spines).all()
    (tmp_path / "gripper.json").write_text("{}")
    with pytest.raises(UsageError, match="not a gripper model"):
        plan_climb(load_climb(WALL, [*SHORT, f"gripper.model={tmp_path / 'gripper.json'}"]))


@pytest.mark.parametrize(
    ("dataset", "entry", "check"),
    [
        ("grips/instants/grip", (3, 0), "grip.force"),
        ("grips/instants/palm", (3, 0, 1), "grip.unilateral"),
        ("grips/instants/moment", (3, 0, 2), "force.equilibrium"),
        ("grips/spines", (5,), "grip.spines"),
        ("grips/pull_margin", (3, 1), "grip.pull_out"),
        ("grips/wrist_angles", (3, 1, 2), "wrist.alignment"),
        ("grips/wrist_torque", (3, 1, 0), "wrist.from_forces"),
        ("grips/trajectory/grip", (40, 1), "trajectory.grip_force"),
        ("grips/trajectory/force", (40, 1, 1), "trajectory.contact_force"),
        ("robot/gripper/wrist_max_torque", (0,), "wrist.torque"),
        ("robot/gripper/wrist_upper", (2,), "wrist.bounds"),
    ],
)
def test_tampering_is_found(file: Path, dataset: str, entry: tuple[int, ...], check: str) -> None:
    with h5py.File(file, "r+") as store:
        change = {"robot/gripper/wrist_max_torque": -3.0, "robot/gripper/wrist_upper": -1.0}
        store[dataset][entry] += change.get(dataset, 100.0)
    failed = {found.name for found in verify(file).failed}
    assert check in failed
