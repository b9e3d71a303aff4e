"""Measures find what was broken on purpose, and nothing else; files of others are completed."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import climbplan
from climbplan.arrays import Array
from climbplan.cli.app import run
from climbplan.climb.exports.tracked_motion import read_tracked_motion
from climbplan.errors import UsageError
from climbplan.motions.completion import Completion, complete_motion, read_robot
from climbplan.motions.contact_rule import FootShape, Rule, add_contacts, read_foot_shapes
from climbplan.motions.inverse_dynamics import compute_dynamics
from climbplan.motions.measure import MEASURES, measure_motion
from climbplan.motions.motion_file import KEYS, read_motion_file, write_motion_file
from climbplan.motions.terrain_distance import FAR, measure_distances
from climbplan.motions.tracked_motion import (
    ContactSamples,
    TrackedMotion,
    build_polygon_mesh,
    compute_quaternions,
)

SPECS = Path(__file__).parents[2] / "specs"


def failed(motion: TrackedMotion, **limits: float) -> set[str]:
    return {check.name for check in measure_motion(motion, limits) if not check.passed}


def test_a_planned_motion_passes(motion: TrackedMotion) -> None:
    checks = {check.name: check for check in measure_motion(motion, {})}
    assert tuple(checks) == tuple(MEASURES)
    assert not failed(motion)
    assert checks["contact.slip"].residual < 1e-9
    assert checks["contact.penetration"].residual < 1e-9
    assert checks["contact.distance"].residual < 1e-9
    assert not checks["kinematics.bodies"].judged
    assert checks["power.peak"].margin.endswith("W")


def move_toe(motion: TrackedMotion, direction: Array) -> TrackedMotion:
    """Move a tibia by 3 mm over ten samples while its toe stands, at no speed."""
    assert motion.contacts is not None
    body = motion.contacts.body[0]
    first = int(np.flatnonzero(motion.contacts.is_touching[:, 0])[5])
    position = motion.body_position.copy()
    position[first : first + 10, body] += 3e-3 * direction
    return replace(motion, body_position=position)


def slip(motion: TrackedMotion) -> TrackedMotion:
    return move_toe(motion, np.array([0.0, 0.0, 1.0]))  # along the wall


def press_in(motion: TrackedMotion) -> TrackedMotion:
    assert motion.contacts is not None
    return move_toe(motion, -motion.contacts.normal[0, 0])


def pull_off(motion: TrackedMotion) -> TrackedMotion:
    assert motion.contacts is not None
    return move_toe(motion, motion.contacts.normal[0, 0])


def bend_too_far(motion: TrackedMotion) -> TrackedMotion:
    assert motion.bounds is not None
    upper = motion.bounds.upper.copy()
    upper[4] = motion.joint_position[:, 4].max() - 0.01
    return replace(motion, bounds=replace(motion.bounds, upper=upper))


def move_too_fast(motion: TrackedMotion) -> TrackedMotion:
    assert motion.bounds is not None
    speed = 0.9 * np.abs(motion.joint_velocity).max(axis=0)
    return replace(motion, bounds=replace(motion.bounds, speed=np.maximum(speed, 1e-3)))


def load_too_much(motion: TrackedMotion) -> TrackedMotion:
    assert motion.joint_torque is not None
    assert motion.bounds is not None
    torque = motion.joint_torque.copy()
    torque[7, 2] = 1.1 * motion.bounds.torque[2]
    return replace(motion, joint_torque=torque)


def push_sideways(motion: TrackedMotion) -> TrackedMotion:
    assert motion.contacts is not None
    assert motion.contacts.force is not None
    force = motion.contacts.force.copy()
    force[3, 1] += np.array([0.0, 50.0, 0.0])
    return replace(motion, contacts=replace(motion.contacts, force=force))


def turn_quaternions_round(motion: TrackedMotion) -> TrackedMotion:
    """In the order x, y, z, w."""
    return replace(motion, body_quaternion=motion.body_quaternion[..., [1, 2, 3, 0]])


def scale_joint_velocities(motion: TrackedMotion) -> TrackedMotion:
    return replace(motion, joint_velocity=0.5 * motion.joint_velocity)


BROKEN: dict[str, tuple[Callable[[TrackedMotion], TrackedMotion], set[str]]] = {
    "slip": (slip, {"contact.slip"}),
    "penetration": (press_in, {"contact.slip", "contact.penetration"}),
    "distance": (pull_off, {"contact.slip", "contact.distance"}),
    "position": (bend_too_far, {"joint.position"}),
    "speed": (move_too_fast, {"joint.speed"}),
    "torque": (load_too_much, {"joint.torque"}),
    "friction": (push_sideways, {"contact.friction"}),
    "joint velocities": (scale_joint_velocities, {"velocity.joints"}),
}


@pytest.mark.parametrize("name", BROKEN)
def test_each_measure_finds_what_was_broken(motion: TrackedMotion, name: str) -> None:
    break_motion, expected = BROKEN[name]
    assert failed(break_motion(motion)) - {"velocity.bodies"} == expected


def test_another_order_of_quaternions_shows_in_velocities(motion: TrackedMotion) -> None:
    assert "velocity.bodies" in failed(turn_quaternions_round(motion))


def test_limits_are_the_users_own(motion: TrackedMotion) -> None:
    slipping = slip(motion)
    assert "contact.slip" not in {
        c.name for c in measure_motion(slipping, {"contact.slip": 4e-3}) if not c.passed
    }
    assert {c.name for c in measure_motion(motion, {"power.peak": 1e-3}) if not c.passed} == {
        "power.peak"
    }
    with pytest.raises(UsageError, match=r"--limit contact.slide: expected one of contact.slip"):
        measure_motion(motion, {"contact.slide": 1.0})


def strip(path: Path, target: Path) -> Path:
    """Write only what the published converters write."""
    with np.load(path) as arrays:
        np.savez(target, **{key: arrays[key] for key in ("fps", *KEYS)})
    return target


def test_a_foreign_file_is_completed(urdf_climb: Path, tmp_path: Path) -> None:
    """Names, limits and contacts come from URDF, mesh and rule; they are those of the plan."""
    own = read_tracked_motion(urdf_climb, 50.0)
    write_motion_file(own, tmp_path / "own.npz")
    foreign = read_motion_file(strip(tmp_path / "own.npz", tmp_path / "foreign.npz"))
    assert foreign.contacts is None
    assert foreign.joint_names[0] == "joint 0"
    assert {c.name for c in measure_motion(foreign, {}) if c.judged} == {
        "velocity.joints",
        "velocity.bodies",
    }
    assert own.contacts is not None
    feet = tuple(own.body_names[body] for body in own.contacts.body)
    robot = read_robot(SPECS / "walker.urdf")
    completed, notes = complete_motion(
        foreign,
        Completion(robot=robot, terrain=own.terrain, feet=feet, foot_radius=0.0),
    )
    assert any(note.startswith("contacts by rule") for note in notes)
    assert completed.contacts is not None
    same = completed.contacts.is_touching == own.contacts.is_touching
    assert same.mean() > 0.95
    checks = {c.name: c for c in measure_motion(completed, {}, robot)}
    assert checks["kinematics.bodies"].judged
    assert checks["kinematics.bodies"].residual < 1e-5
    assert not checks["joint.torque"].judged
    assert checks["contact.penetration"].residual < 1e-6


PENDULUM = """<robot name="pendulum">
<link name="base"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"
 izz="1"/></inertial></link>
<link name="rod"><inertial><origin xyz="0.3 0 0" rpy="0 0 1.5707963267948966"/><mass value="1.5"/>
<inertia ixx="0.04" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.05"/></inertial></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="rod"/>
<origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="10" velocity="9"/></joint>
</robot>"""


def test_torques_of_a_pendulum_are_those_of_its_equation(tmp_path: Path) -> None:
    """tau = (I + m l^2) q'' - m g l cos q about y, with the rod along x at q = 0."""
    path = tmp_path / "pendulum.urdf"
    path.write_text(PENDULUM, encoding="utf-8")
    robot = read_robot(path)
    rate = 2000.0
    time = np.arange(2000) / rate
    angle, speed = 0.5 * np.sin(6 * time), 3.0 * np.cos(6 * time)
    poses = robot.links.compute_poses(
        np.zeros((2000, 3)), np.broadcast_to(np.eye(3), (2000, 3, 3)), angle[:, None]
    )
    zeros = np.zeros((2000, 2, 3))
    spin = zeros.copy()
    spin[:, 1, 1] = speed
    motion = TrackedMotion(
        name="pendulum",
        fps=rate,
        joint_names=robot.links.joint_names,
        body_names=robot.links.link_names,
        joint_position=angle[:, None],
        joint_velocity=speed[:, None],
        body_position=poses.position,
        body_quaternion=compute_quaternions(poses.rotation),
        body_velocity=zeros,
        body_angular_velocity=spin,
        bounds=robot.links.bounds,
        contacts=ContactSamples(
            names=("pivot",),
            body=np.array([0]),
            offset=np.zeros((1, 1, 3)),
            radius=np.zeros(1),
            is_touching=np.ones((2000, 1), bool),
            surface=np.zeros((2000, 1), int),
            force=np.broadcast_to([0.0, 0.0, 3.5 * 9.81], (2000, 1, 3)),
            position=np.zeros((2000, 1, 3)),
            normal=np.broadcast_to([0.0, 0.0, 1.0], (2000, 1, 3)),
        ),
    )
    dynamics = compute_dynamics(motion, robot.urdf, robot.links)
    acceleration = -18.0 * np.sin(6 * time)
    expected = (0.04 + 1.5 * 0.09) * acceleration - 1.5 * 9.81 * 0.3 * np.cos(angle)
    assert dynamics.torque[:, 0] == pytest.approx(expected[1:-1], abs=1e-4)
    assert dynamics.weight == pytest.approx(3.5 * 9.81)
    along = -0.3 * (np.cos(angle) * speed**2 + np.sin(angle) * acceleration)
    assert dynamics.unbalanced_force[:, 0] == pytest.approx(1.5 * along[1:-1], abs=1e-3)


def test_stored_torques_of_a_climb_are_those_of_inverse_dynamics(urdf_climb: Path) -> None:
    """The planner computes them from forces and stiffness, the measure from the links' motion."""
    motion = read_tracked_motion(urdf_climb, 50.0)
    robot = read_robot(SPECS / "walker.urdf")
    checks = {c.name: c for c in measure_motion(motion, {}, robot)}
    assert not checks["dynamics.stored_torque"].judged
    assert checks["dynamics.stored_torque"].residual < 2e-2
    assert checks["dynamics.balance"].residual < 0.1
    assert checks["dynamics.torque"].judged
    assert motion.bounds is not None
    weak = replace(motion.bounds, torque=0.05 * motion.bounds.torque)
    failures = {
        c.name for c in measure_motion(replace(motion, bounds=weak), {}, robot) if not c.passed
    }
    assert failures == {"joint.torque", "dynamics.torque"}


def test_soles_carry_moments(tmp_path: Path) -> None:
    """With them the torques of a biped are those of inverse dynamics, without them they are not."""
    pytest.importorskip("pinocchio")
    climbplan.plan(climbplan.load_spec(SPECS / "climb_biped.yaml")).save(tmp_path / "plan.h5")
    motion = read_tracked_motion(tmp_path / "plan.h5", 20.0)
    robot = read_robot(SPECS / "biped.urdf")

    def difference(standing: TrackedMotion) -> float:
        checks = {c.name: c for c in measure_motion(standing, {}, robot)}
        return checks["dynamics.stored_torque"].residual

    assert difference(motion) < 2e-2
    assert motion.contacts is not None
    assert motion.contacts.moment is not None
    assert motion.contacts.offset.shape[1] == 4
    wrong = replace(motion.contacts, moment=np.zeros_like(motion.contacts.moment))
    assert difference(replace(motion, contacts=wrong)) > 5e-2
    lacking = replace(motion, contacts=replace(motion.contacts, moment=None))
    checks = {c.name: c for c in measure_motion(lacking, {}, robot)}
    assert not checks["dynamics.torque"].judged


def test_contacts_need_nearness_and_rest() -> None:
    """A foot that slides over the ground touches nothing by the rule, one that stands does."""
    time = np.arange(60) / 50
    position = np.zeros((60, 2, 3))
    position[30:, 0, 0] = 0.5 * (time[30:] - time[30])
    position[:, 1, 2] = 0.1
    ground = build_polygon_mesh([np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0.0]])])
    motion = TrackedMotion(
        name="feet",
        fps=50.0,
        joint_names=(),
        body_names=("near", "far"),
        joint_position=np.zeros((60, 0)),
        joint_velocity=np.zeros((60, 0)),
        body_position=position,
        body_quaternion=np.broadcast_to([1.0, 0.0, 0.0, 0.0], (60, 2, 4)),
        body_velocity=np.zeros((60, 2, 3)),
        body_angular_velocity=np.zeros((60, 2, 3)),
        terrain=ground,
    )
    shape = FootShape(np.zeros((1, 3)), 0.01)
    found = add_contacts(motion, {"near": shape, "far": shape}, Rule(0.02, 0.15)).contacts
    assert found is not None
    assert found.is_touching[:29, 0].all()
    assert not found.is_touching[32:, 0].any()
    assert not found.is_touching[:, 1].any()
    with pytest.raises(UsageError, match="no body 'hand'; --feet: expected some of near, far"):
        add_contacts(motion, {"hand": shape}, Rule())


def test_shapes_of_feet_are_those_of_collision(tmp_path: Path) -> None:
    path = tmp_path / "feet.urdf"
    path.write_text(
        '<robot name="feet"><link name="foot"><collision><origin xyz="0 0 -0.1"/><geometry>'
        '<box size="0.2 0.1 0.02"/></geometry></collision></link></robot>'
    )
    urdf = read_robot(path).urdf
    shape = read_foot_shapes(urdf, ["foot"], None)["foot"]
    assert shape.points.min(axis=0) == pytest.approx([-0.1, -0.05, -0.11])
    assert shape.radius == 0
    with pytest.raises(UsageError, match="--foot-radius"):
        read_foot_shapes(urdf, ["hand"], None)


def test_distances_have_the_sign_of_the_side() -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    points = np.array([[0.3, 0.3, 0.1], [0.7, 0.2, -0.05], [0.5, 0.5, -0.02], [1.2, 0.5, -0.1],
                       [0.5, 0.5, 3.0], [0.4, 0.6, -2.0], [5.0, 0.5, -2.0]])  # fmt: skip
    distance = measure_distances(points, build_polygon_mesh([square]))
    assert distance == pytest.approx([0.1, -0.05, -0.02, np.hypot(0.2, 0.1), FAR, -2.0, FAR])


def test_a_free_joint_before_the_others_is_left_out(motion: TrackedMotion, tmp_path: Path) -> None:
    """Files with all coordinates of MuJoCo: 7 + J positions, 6 + J velocities."""
    write_motion_file(motion, tmp_path / "own.npz")
    with np.load(tmp_path / "own.npz") as stored:
        arrays = {key: stored[key] for key in ("fps", "joint_names", *KEYS)}
    samples = len(motion.time)
    arrays["joint_pos"] = np.hstack([np.ones((samples, 7)), arrays["joint_pos"]])
    arrays["joint_vel"] = np.hstack([np.ones((samples, 6)), arrays["joint_vel"]])
    np.savez(tmp_path / "free.npz", allow_pickle=False, **arrays)
    read = read_motion_file(tmp_path / "free.npz")
    assert read.joint_position == pytest.approx(motion.joint_position, abs=1e-6)
    assert read.joint_velocity == pytest.approx(motion.joint_velocity, abs=1e-6)


def test_names_and_rate_may_stand_in_a_file_beside(motion: TrackedMotion, tmp_path: Path) -> None:
    write_motion_file(motion, tmp_path / "own.npz")
    with np.load(tmp_path / "own.npz") as stored:
        np.savez(tmp_path / "motion.npz", allow_pickle=False, **{key: stored[key] for key in KEYS})
    with pytest.raises(UsageError, match="fps: missing, expected one rate"):
        read_motion_file(tmp_path / "motion.npz")
    names = {"joint_names": motion.joint_names, "body_names": motion.body_names}
    (tmp_path / "meta.json").write_text(json.dumps({"fps": 30, **names}), encoding="utf-8")
    read = read_motion_file(tmp_path / "motion.npz")
    assert read.fps == 30
    assert read.joint_names == motion.joint_names
    assert read.body_names == motion.body_names
    (tmp_path / "meta.json").write_text('{"fps": "fast"}', encoding="utf-8")
    with pytest.raises(UsageError, match=r"meta.json: fps: expected a rate"):
        read_motion_file(tmp_path / "motion.npz")


LIMITS = ("lower", "upper", "speed", "torque")
WRONG: dict[str, tuple[dict[str, object], str]] = {
    "key": ({"body_quat_w": None}, "no body_quat_w; expected the keys fps, joint_pos"),
    "shape": ({"joint_vel": np.zeros((3, 2))}, r"joint_vel: shape \(3, 2\), expected \(T, J\)"),
    "numbers": ({"body_pos_w": np.array(["a"])}, r"body_pos_w: expected numbers"),
    "NaN": ({"joint_pos": np.full((5, 2), np.nan)}, "joint_pos: NaN or infinite"),
    "norm": ({"body_quat_w": np.ones((5, 1, 4))}, "body_quat_w: norm 2, expected unit"),
    "rate": ({"fps": np.array([0])}, "fps: expected one rate > 0 Hz"),
    "names": ({"joint_names": np.array(["a"])}, "joint_names: 1 names, expected 2"),
    "contacts": ({"contact": np.ones((5, 1), bool)}, "contact_body: missing"),
    "points": (
        {
            "contact": np.ones((5, 1), bool),
            "contact_body": np.zeros(1, int),
            "contact_offset": np.zeros((1, 0, 3)),
        },
        "contact_offset: expected 1 point",
    ),
    "repeated names": ({"joint_names": np.array(["a", "a"])}, "joint_names: 'a' twice"),
    "infinite": ({"joint_torque": np.full((5, 2), np.inf)}, "joint_torque: infinite numbers"),
    "flag": ({"verified": np.array([True, False])}, r"verified: bool of shape \(2,\)"),
    "facts": ({"facts": np.array(3.0)}, "facts: expected a JSON object"),
    "no mesh": ({"terrain_mesh": np.array("")}, "terrain_mesh: '', expected the name"),
    "limits missing": ({"joint_limit_lower": np.zeros(2)}, "joint_limit_upper: missing"),
    "limits cross": (
        {f"joint_limit_{k}": np.full(2, v) for k, v in zip(LIMITS, (1.0, 0, 1, 1), strict=True)},
        "joint_limit_lower: expected at most joint_limit_upper",
    ),
    "limits zero": (
        {f"joint_limit_{k}": np.full(2, v) for k, v in zip(LIMITS, (0.0, 1, 0, 1), strict=True)},
        "joint_limit_speed and _torque: expected numbers > 0",
    ),
    "friction": ({"surface_friction": np.array([-1.0])}, "surface_friction: -1, expected numbers"),
}


@pytest.mark.parametrize("name", WRONG)
def test_damaged_files_are_told(tmp_path: Path, name: str) -> None:
    arrays: dict[str, object] = {
        "fps": np.array([50]),
        "joint_pos": np.zeros((5, 2)),
        "joint_vel": np.zeros((5, 2)),
        "body_pos_w": np.zeros((5, 1, 3)),
        "body_quat_w": np.broadcast_to([1.0, 0, 0, 0], (5, 1, 4)),
        "body_lin_vel_w": np.zeros((5, 1, 3)),
        "body_ang_vel_w": np.zeros((5, 1, 3)),
    }
    changes, words = WRONG[name]
    arrays |= changes
    kept = {key: np.asarray(value) for key, value in arrays.items() if value is not None}
    np.savez(tmp_path / "motion.npz", allow_pickle=False, **kept)
    with pytest.raises(UsageError, match=words):
        read_motion_file(tmp_path / "motion.npz")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"text"])
def test_files_that_are_no_archives(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "motion.npz"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"not an NPZ file of a motion"):
        read_motion_file(path)


def test_plans_and_directories_are_no_motions(tmp_path: Path) -> None:
    (tmp_path / "plan.h5").write_bytes(b"\x89HDF")
    for path in (tmp_path, tmp_path / "plan.h5"):
        with pytest.raises(UsageError, match=r"climbplan export PLAN --format motion"):
            read_motion_file(path)


def test_terrain_needs_an_attitude(motion: TrackedMotion, tmp_path: Path) -> None:
    path = tmp_path / "motion.npz"
    write_motion_file(motion, path)
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, allow_pickle=False, **arrays | {"terrain_quat": np.zeros(4)})
    with pytest.raises(UsageError, match="terrain_quat: expected a unit quaternion"):
        read_motion_file(path)


def test_commands(
    climb: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Export, measure, measure with a limit that fails, and mistakes."""
    target = tmp_path / "climb.npz"
    export = ["export", str(climb), "--format", "motion", "--rate", "30", "-o", str(target)]

    def call(*arguments: str) -> tuple[int, str, str]:
        code = int(run(list(arguments)))
        return code, *capsys.readouterr()

    assert call(*export)[:2] == (0, f"{target}\n")
    with np.load(target) as arrays:
        assert bool(arrays["verified"])
    code, _, err = call(*export)
    assert code == 2
    assert "--force replaces it" in err
    assert call(*export, "--gains", "80")[0] == 2
    code, out, _ = call("measure", str(target), str(target))
    assert code == 0
    assert out.count("contact.slip") == 2
    code, out, _ = call("measure", str(target), "--limit", "contact.slip=1e-12", "--json")
    answer = json.loads(out)
    assert code == answer["exit_code"] == 5
    assert not answer["passed"]
    assert [c["name"] for c in answer["motions"][0]["checks"] if not c["passed"]] == [
        "contact.slip"
    ]
    assert call("measure", str(tmp_path / "none.npz"))[0] == 2
    assert call("measure", str(target), "--limit", "contact.slip")[0] == 2
