"""Every check can fail: files changed on purpose, and exactly the checks that must notice."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml
from example_climb import Climb

from climbplan.climb.check.verification import verify
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.climb.schema.model import ClimbSpec
from climbplan.terrain.model import build_terrain
from climbplan.verification.check import LIMITS, PACE_LIMITS

Change = Callable[[h5py.File], None]
TERRAIN = {"file.spec_values", "terrain.spec"}
RF, RM = 0, 1  # RF is the limb lifted at instant 0


def failed(path: Path) -> set[str]:
    return {check.name for check in verify(path).failed}


def put(name: str, index: Any, value: Any) -> Change:
    return lambda file: file[name].__setitem__(index, value)


def add(name: str, index: Any, value: Any) -> Change:
    return lambda file: file[name].__setitem__(index, file[name][index] + value)


def scale(name: str, factor: float, index: Any = ()) -> Change:
    return lambda file: file[name].__setitem__(index, file[name][index] * factor)


def attribute(group: str, name: str, value: Any) -> Change:
    return lambda file: file[group].attrs.__setitem__(name, value)


def spec_with(text: str) -> Change:
    """Another spec text, with its own hash."""

    def change(file: h5py.File) -> None:
        file.attrs["spec"] = text
        file.attrs["spec_sha256"] = hashlib.sha256(text.encode()).hexdigest()

    return change


def asking(more: str, *changes: Change) -> Change:
    """The spec asks for more, and the file agrees."""

    def change(file: h5py.File) -> None:
        spec_with(file.attrs["spec"] + more)(file)
        for other in changes:
            other(file)

    return change


def spec_instead(old: str, new: str, *changes: Change) -> Change:
    def change(file: h5py.File) -> None:
        text = file.attrs["spec"]
        assert old in text
        spec_with(text.replace(old, new))(file)
        for other in changes:
            other(file)

    return change


def limit(name: str, value: float) -> Change:
    return attribute("limits", name, value)


def cut_off_the_end(file: h5py.File) -> None:
    """The motion stops before the last push is done."""
    keep_samples(file, slice(0, -9))


def leave_out_an_instant(file: h5py.File) -> None:
    """The sample at which a push is done: the one before the next limb unloads."""
    at = int(np.argmin(np.abs(file["trajectory/com"][:, 2] - file["instants/com"][1, 2])))
    keep_samples(file, np.delete(np.arange(len(file["trajectory/time"])), at))


def keep_samples(file: h5py.File, rows: Any) -> None:
    group = file["trajectory"]
    for name in list(group):
        values, attributes = group[name][()], dict(group[name].attrs)
        kept = np.arange(len(values))[rows]
        del group[name]
        # Time goes on at the fixed rate.
        group[name] = values[: len(kept)] if name == "time" else values[kept]
        group[name].attrs.update(attributes)


def two_at_once(file: h5py.File) -> None:
    contact = file["trajectory/contact"][()]
    sample = int(np.flatnonzero(~contact[:, RF])[2])
    file["trajectory/contact"][sample, RM] = False


def swapped_flags(file: h5py.File) -> None:
    file["trajectory/contact"][...] = file["trajectory/contact"][()][:, [1, 0, 2, 3, 4, 5]]


def tight_bound(file: h5py.File) -> None:
    """A joint bound between what the instants and what the motion between them needs."""
    at_instants = file["instants/joint_command"][()].max(axis=0)
    at_instants = np.maximum(at_instants, file["instants/joint_angles"][()].max(axis=0))
    moving = file["trajectory/joint_command"][()].max(axis=0)
    limb, joint = np.unravel_index(int(np.argmax(moving - at_instants)), moving.shape)
    bound = (moving[limb, joint] + at_instants[limb, joint]) / 2
    file["robot/joint_upper"][limb, joint] = bound


def soften(file: h5py.File) -> None:
    """Joints a tenth as stiff, commanded so much further that they push as planned."""
    factor = 10.0
    scale("robot/joint_stiffness", 1 / factor)(file)
    angles, commands = file["instants/joint_angles"], file["instants/joint_command"]
    commands[...] = angles[()] + factor * (commands[()] - angles[()])


FIRST_STAND = (1, RF)  # instant, limb

TAMPERED: dict[str, tuple[Change, set[str]]] = {
    "spec text": (
        lambda file: file.attrs.__setitem__("spec", "kind: climb"),
        {"file.spec_hash", "file.spec_values"},
    ),
    "spec comment": (
        lambda file: file.attrs.__setitem__("spec", file.attrs["spec"] + "# more\n"),
        {"file.spec_hash"},
    ),
    "spec asks less payload": (spec_instead("mass: 0.5", "mass: 0.4"), {"file.spec_values"}),
    "spec asks more rounds": (spec_instead("rounds: 2", "rounds: 3"), {"file.spec_values"}),
    "spec has another wall": (spec_instead("gap: 1.23", "gap: 1.24"), TERRAIN),
    "spec has another block": (spec_instead("0.40, 0.1]", "0.41, 0.1]"), TERRAIN),
    "spec has another friction": (
        spec_instead("friction: 1.1", "friction: 1"),
        TERRAIN,
    ),
    "spec asks for a pace": (
        asking("trajectory: {pace: fastest}\n"),
        {"file.spec_values", "trajectory.dynamics"},
    ),
    "spec has another robot": (spec_instead("hexapod", "silvia"), {"robot.spec"}),
    "spec is none": (spec_with("kind: climb\n"), {"file.spec_values"}),
    "objective": (lambda file: scale_attribute(file, "objective", 1.01), {"file.objective"}),
    "bound": (lambda file: scale_attribute(file, "bound", 1.2), {"file.objective"}),
    "not a number": (put("instants/mu", FIRST_STAND, np.nan), {"file.finite"}),
    "link length": (put("robot/link_lengths", (2, 1), -0.2), {"robot.data"}),
    "no mass": (attribute("robot", "mass", 0.0), {"robot.data"}),
    "body as large as the world": (put("robot/body_hull", (7, 2), 1e9), {"robot.data"}),
    "flat body": (put("robot/body_hull", (slice(None), 2), 0.0), {"robot.data"}),
    "bent wall": (add("terrain/surfaces/0000/vertices", (0, 0), 0.01), {"terrain.data"}),
    "moved plane": (add("terrain/surfaces/0001/b", 0, 0.01), {"terrain.data"}),
    "moved block face": (add("terrain/obstacles/0000/b", 0, 0.01), {"terrain.data"}),
    "no safety": (limit("safety_torque", 0.0), {"limits.data"}),
    "another round": (put("instants/round", 5, 2), {"gait.sequence"}),
    "no contact": (
        put("instants/contact", FIRST_STAND, False),
        {"gait.sequence", "force.without_contact"},
    ),
    "body step": (
        asking("posture: {steps: {com_max: 0.05}}\n", limit("com_max", 0.05)),
        {"steps.com"},
    ),
    "body step too small": (
        asking("posture: {steps: {com_min: 0.12}}\n", limit("com_min", 0.12)),
        {"steps.com"},
    ),
    "body step, spec disagrees": (limit("com_max", 0.05), {"steps.com", "file.spec_values"}),
    "toe step": (
        asking("posture: {steps: {toe_max: 0.05}}\n", limit("toe_max", 0.05)),
        {"steps.toe"},
    ),
    "turn": (
        asking(
            "posture: {steps: {rotation_max_deg: 1}}\n",
            limit("rotation_max", float(np.deg2rad(1.0))),
        ),
        {"steps.rotation"},
    ),
    "goal": (
        spec_instead("-0.02, 0.2]", "-0.02, 0.25]", put("limits/goal_com", 2, 0.25)),
        {"goal.position", "file.objective"},
    ),
    "goal rotation": (
        spec_instead("0.0, 4.0]", "0.0, 9.0]", put("limits/goal_rpy", 2, np.deg2rad(9.0))),
        {"goal.rotation", "file.objective"},
    ),
    "toe off the wall": (
        add("rounds/toes", (0, RM, 0), 1e-4),
        {"contact.region", "gait.sequence", "trajectory.command", "file.spec_values"},
    ),
    "forbidden wall": (
        put("terrain/allowed", (RM, 1), False),
        # Where a limb may not stand its tibia has to keep all of its radius
        {"contact.allowed", "limbs.collision", "trajectory.collision", *TERRAIN},
    ),
    "swapped regions": (
        put("instants/region", (1, slice(RF, RM + 1)), 0),
        {"gait.sequence", "contact.region", "contact.allowed", "contact.normal"},
    ),
    "normal": (scale("instants/normal", 1 + 5e-6, (0, RF)), {"contact.normal"}),
    "friction of a lifted limb": (
        put("instants/mu", (0, RF), 0.5),
        {"contact.friction", "trajectory.friction"},
    ),
    "friction of all": (scale("instants/mu", 2.0), {"contact.friction", "safety.stored"}),
    "joint angle of a lifted limb": (
        add("instants/joint_angles", (0, RF, 1), 1e-3),
        {"kinematics.forward", "stiffness.joint_command"},
    ),
    "joint angle": (
        add("instants/joint_angles", (1, RF, 1), 1e-3),
        {
            "kinematics.forward",
            "torque.from_forces",
            "stiffness.force_deflection",
            "stiffness.joint_command",
        },
    ),
    "joint bound": (
        put("robot/joint_upper", (RM, 1), 0.1),
        {"kinematics.joint_bounds", "trajectory.joint_bounds"},
    ),
    "heavier robot": (
        attribute("robot", "mass", 10.001),
        {"force.equilibrium", "trajectory.command"},
    ),
    "another load": (
        add("instants/external_wrench", (3, 4), 0.01),
        {"force.equilibrium", "file.spec_values"},
    ),
    "scaled force": (
        scale("instants/force", 1.001, (1, RM)),
        {"force.equilibrium", "torque.from_forces", "stiffness.force_deflection", "safety.stored"},
    ),
    "pulling limb": (
        scale("instants/force", -1.0, (1, RM)),
        {
            "force.equilibrium",
            "force.unilateral",
            "force.friction",
            "torque.from_forces",
            "stiffness.force_deflection",
            "safety.stored",
        },
    ),
    "more friction margin": (
        asking("force: {safety_friction: 2.0}\n", limit("safety_friction", 2.0)),
        {"force.friction", "static.friction"},
    ),
    "commands asked deeper": (asking("force: {min_penetration: 0.05}\n"), {"force.penetration"}),
    "lifted limb pushes": (put("instants/force", (0, RF, 0), 1e-6), {"force.without_contact"}),
    "torque": (add("instants/joint_torques", (3, RM, 2), 0.01), {"torque.from_forces"}),
    "more torque margin": (
        asking("force: {safety_torque: 4}\n", limit("safety_torque", 4.0)),
        {"torque.limit", "static.torque"},
    ),
    "softer joints": (
        scale("robot/joint_stiffness", 0.9),
        {"stiffness.force_deflection", "static.pose", "static.friction", "trajectory.command"},
    ),
    "soft joints": (
        scale("robot/joint_stiffness", 0.1),
        {"stiffness.force_deflection", "static.pose"},
    ),
    "buckling joints": (soften, {"stiffness.force_deflection", "static.stability"}),
    "stiffer structure": (
        attribute("robot", "structural_compliance_share", 0.2),
        {
            "stiffness.force_deflection",
            "static.pose",
            "static.friction",
            "trajectory.command",
            "trajectory.friction",
        },
    ),
    "links too thick for their neighbours": (
        attribute("robot", "limb_radius", 0.1),
        {"limbs.self_collision", "trajectory.self_collision"},
    ),
    "sag": (
        add("instants/com_deflection", (2, 5), 1e-4),
        {"stiffness.force_deflection", "file.spec_values"},
    ),
    "toe command": (add("instants/toe_command", (3, RM, 2), 1e-7), {"stiffness.toe_command"}),
    "joint command of an instant": (
        add("instants/joint_command", (3, RM, 2), 2e-3),
        {
            "stiffness.joint_command",
            "stiffness.toe_command",
            "static.pose",
            "trajectory.instants",
        },
    ),
    "deflection": (
        add("instants/wall_deflection", (3, RM, 2), -1e-4),
        {"stiffness.force_deflection", "stiffness.joint_command"},
    ),
    "torque safety": (scale("instants/safety_torque", 1.01, 4), {"safety.stored"}),
    "friction safety": (scale("instants/safety_friction", 1.01, 4), {"safety.stored"}),
    "critical friction": (scale("instants/mu_critical", 0.99, (4, RM)), {"safety.stored"}),
    "wider body clearance": (
        asking("posture: {body_clearance: 0.19}\n", limit("body_clearance", 0.19)),
        {"body.clearance"},
    ),
    "uneven time": (add("trajectory/time", 7, 1e-3), {"trajectory.rate"}),
    "motion stops early": (cut_off_the_end, {"trajectory.endpoints", "trajectory.instants"}),
    "motion skips an instant": (leave_out_an_instant, {"trajectory.instants"}),
    "two limbs in the air": (two_at_once, {"trajectory.sequence"}),
    "limbs lift out of turn": (swapped_flags, {"trajectory.sequence"}),
    "body off its path": (add("trajectory/com", (100, 0), 1e-5), {"trajectory.body"}),
    "joint command": (add("trajectory/joint_command", (3, RM, 1), 1e-3), {"trajectory.command"}),
    "strained joint": (
        add("trajectory/joint_command", (3, RM, slice(None)), 3.0),
        {"trajectory.command", "trajectory.friction", "trajectory.torque"},
    ),
    "tight joint bound": (tight_bound, {"trajectory.joint_bounds"}),
    "slow joints": (scale("robot/max_joint_speed", 0.2), {"speed.limit"}),
    "short shins": (
        scale("robot/link_lengths", 0.3, (RM, 2)),
        {"kinematics.forward", "trajectory.reach"},
    ),
}


def scale_attribute(file: h5py.File, name: str, factor: float) -> None:
    file.attrs[name] = file.attrs[name] * factor


# Where one change has many consequences, those named must be among them.
AT_LEAST = {
    "soft joints",
    "buckling joints",
    "strained joint",
    "short shins",
    "limbs lift out of turn",
    "two limbs in the air",
    "no contact",
}


@pytest.mark.parametrize("name", TAMPERED)
def test_a_changed_file_fails_exactly_where_it_was_changed(name: str, plan_file: Path) -> None:
    change, expected = TAMPERED[name]
    with h5py.File(plan_file, "r+") as file:
        change(file)
    found = failed(plan_file)
    assert expected <= found
    if name not in AT_LEAST:
        assert found == expected


def with_terrain(plan: ClimbPlan, **terrain: Any) -> ClimbPlan:
    """The plan in another terrain that its spec asks for as well."""
    document = yaml.safe_load(plan.spec_text)
    document["terrain"].update(terrain)
    text = yaml.safe_dump(document)
    spec = ClimbSpec.model_validate(document)
    return replace(
        plan,
        terrain=build_terrain(spec.terrain, plan.robot),
        spec_text=text,
        spec_sha256=hashlib.sha256(text.encode()).hexdigest(),
    )


def post(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> dict[str, Any]:
    lower, upper = zip(x, y, z, strict=True)
    return {"obstacles": [{"name": "post", "lower": list(lower), "upper": list(upper)}]}


TERRAINS: dict[str, tuple[dict[str, Any], set[str]]] = {
    "shorter walls": (
        {"walls": {"gap": 1.23, "along": [-0.9, 0.3], "up": [-1.0, 2.0]}},
        {"contact.region"},
    ),
    "body in a post": (post((-0.01, 0.01), (-0.01, 0.01), (-0.5, 0.3)), {"body.clearance"}),
    "post beside body and coxa": (
        post((0.14, 0.16), (0.21, 0.25), (-0.1, 0.1)),
        {"body.clearance", "limbs.collision", "trajectory.collision"},
    ),
    "links through a post": (
        post((0.40, 0.45), (-0.05, 0.05), (-0.5, 1.0)),
        {
            "limbs.axis_collision",
            "trajectory.axis_collision",
            "limbs.collision",
            "trajectory.collision",
        },
    ),
    "swing through a bolt": (
        post((0.56, 0.572), (0.32, 0.34), (-0.08, -0.065)),
        {"trajectory.axis_collision", "trajectory.collision", "limbs.collision"},
    ),
    "body leaves the free space": (
        {
            "free_regions": [
                {"name": "low", "lower": [-0.5, -0.5, -0.5], "upper": [0.5, 0.5, 0.1]},
            ]
        },
        {"body.free_region"},
    ),
}


@pytest.mark.parametrize("name", TERRAINS)
def test_another_terrain_is_noticed(name: str, climb: Climb, tmp_path: Path) -> None:
    terrain, expected = TERRAINS[name]
    write_climb(with_terrain(climb.plan, **terrain), tmp_path / "plan.h5")
    assert failed(tmp_path / "plan.h5") == expected


def test_every_check_was_seen_to_fail() -> None:
    seen = set().union(*(names for _, names in (*TAMPERED.values(), *TERRAINS.values())))
    # A margin that is not kept fails nothing: it is told (`tests/climb/test_margins.py`)
    told = {name for name in LIMITS if name.startswith("robust.")}
    assert seen == (set(LIMITS) | set(PACE_LIMITS)) - told


def float_datasets() -> list[str]:
    """Every place in a file that holds numbers."""
    from climbplan.climb.plan import layout

    tables = {
        "robot": layout.ROBOT,
        "rounds": layout.ROUNDS,
        "instants": {**layout.INSTANTS, **layout.FORCES},
        "trajectory": layout.TRAJECTORY,
        "limits": layout.LIMITS,
        "terrain/surfaces/0000": layout.FLAT,
        "terrain/obstacles/0000": {"vertices": layout.VERTICES, **layout.HALF_SPACES},
        "terrain/free_choices/0000/0000": layout.HALF_SPACES,
    }
    return [
        f"{group}/{name}"
        for group, table in tables.items()
        for name, shape in table.items()
        if shape.kind == "float"
    ]


@pytest.mark.parametrize("name", float_datasets())
def test_nan_fails_wherever_it_stands(name: str, plan_file: Path) -> None:
    with h5py.File(plan_file, "r+") as file:
        dataset = file[name]
        dataset[(-1,) * dataset.ndim] = np.nan
    verification = verify(plan_file)
    assert not verification.passed
    assert verification.failed[0].worst_at == name


@pytest.mark.parametrize("name", float_datasets())
@pytest.mark.parametrize("value", [1e50, -1e50])
def test_absurd_numbers_fail_quietly(name: str, value: float, plan_file: Path) -> None:
    with h5py.File(plan_file, "r+") as file:
        dataset = file[name]
        dataset[(-1,) * dataset.ndim] = value
    # This robot is its plan's own: with wider joints it is another one, as good.
    passes = name == "robot/joint_upper" and value > 0
    passes |= name == "robot/joint_lower" and value < 0
    assert verify(plan_file).passed == passes


def test_what_overflows_is_no_number(plan_file: Path) -> None:
    with h5py.File(plan_file, "r+") as file:
        file["robot/joint_upper"][0, 0] = 1e300
        file["robot"].attrs["reach"] = -1e200
    verification = verify(plan_file)
    assert [c.name for c in verification.failed] == ["file.finite"]
    assert verification.failed[0].residual == 2
