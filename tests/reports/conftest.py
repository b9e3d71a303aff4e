"""Climb plans with made-up but plausible forces, for any number of limbs and rounds."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files

import numpy as np
import pytest
import yaml

from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import (
    ClimbPlan,
    InstantForces,
    Instants,
    Rounds,
    StepLimits,
    Study,
    Trajectory,
)
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.robots.kinematics import jacobian_world, solve_inverse_kinematics, to_body
from climbplan.robots.model import Robot
from climbplan.schema.robots.robot import RobotSpec

WALLS = {"gap": 1.23, "angle_deg": 0.0, "along": [-0.9, 0.9], "up": [-1.0, 8.0]}
BLOCK = {"name": "block", "lower": [-0.2, 0.42, 0.2], "upper": [0.2, 0.8, 0.5]}


def robot_spec(limbs: int) -> RobotSpec:
    """SiLVIA for six limbs, otherwise its middle leg repeated along both sides."""
    silvia = yaml.safe_load(files("climbplan").joinpath("robots/silvia.yaml").read_text())
    if limbs == 6:
        return RobotSpec.model_validate(silvia)
    left = limbs // 2
    legs = []
    for side, count in (("right", limbs - left), ("left", left)):
        sign = 1.0 if side == "right" else -1.0
        for i, y in enumerate(np.linspace(-0.13, 0.13, count) * (count - 1)):
            yaw = 0 if side == "right" else 180
            legs.append(
                dict(
                    silvia["limbs"][0],
                    name=f"{side[0].upper()}{i + 1}",
                    side=side,
                    shoulder=[0.2 * sign, float(y), 0.0],
                    mount_yaw_deg=yaw,
                    joint_lower_deg=[-80, -90, -90],
                    joint_upper_deg=[80, 90, 90],
                    stance=[0.615 * sign, float(y), -0.15],
                )
            )
    return RobotSpec.model_validate(dict(silvia, name=f"{limbs} limbs", limbs=legs))


def _forces(robot: Robot, instants: Instants, asked: float) -> InstantForces:
    """Weight shared by the limbs in contact, pressing with a margin that varies with the gait."""
    contact = instants.contact[..., None]
    share = contact / contact.sum(axis=1, keepdims=True)
    shear = robot.weight * share * np.array([0.0, 0.0, 1.0])
    wave = 1 + 0.15 * np.sin(np.arange(instants.count))[:, None, None]
    press = np.linalg.norm(shear, axis=-1, keepdims=True) * asked * wave / instants.mu[..., None]
    force = shear + press * instants.normal
    jacobian = jacobian_world(robot, instants.rpy, instants.joint_angles)
    torques = np.einsum("knij,kni->knj", jacobian, force)
    normal = np.einsum("kni,kni->kn", force, instants.normal)
    tangent = np.linalg.norm(force - normal[..., None] * instants.normal, axis=-1)
    critical = np.divide(tangent, normal, out=np.zeros_like(normal), where=normal > 0)
    slack = np.where(instants.contact, instants.mu / np.maximum(critical, 1e-9), np.inf)
    with np.errstate(divide="ignore"):
        load = (robot.max_torque / np.abs(torques)).min(axis=(1, 2))
    sag = np.zeros((instants.count, 6))
    sag[:, 2] = -0.02
    return InstantForces(
        force=force,
        joint_torques=torques,
        wall_deflection=-0.03 * instants.normal * contact,
        com_deflection=sag,
        joint_command=instants.joint_angles,
        toe_command=instants.toes - 0.03 * instants.normal * contact,
        safety_torque=load,
        safety_friction=slack.min(axis=1),
        mu_critical=critical,
    )


def _trajectory(robot: Robot, rounds: Rounds, instants: Instants, per_instant: int) -> Trajectory:
    """Straight lines between instants, `per_instant` samples each, from the first posture on."""
    com = np.concatenate([rounds.com[:1], instants.com])
    rpy = np.concatenate([rounds.rpy[:1], instants.rpy])
    toes = np.concatenate([rounds.toes[:1], instants.toes])
    knots = np.arange(len(com))
    s = np.linspace(0, len(com) - 1, (len(com) - 1) * per_instant + 1)

    def at(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(knots), -1)
        mixed = np.column_stack([np.interp(s, knots, column) for column in flat.T])
        return mixed.reshape(len(s), *values.shape[1:])

    # In the air while on the way up to the lifted instant and down to the next one.
    touching = np.concatenate([np.ones((1, robot.limb_count), bool), instants.contact])
    contact = touching[np.floor(s).astype(int)] & touching[np.ceil(s).astype(int)]
    pose = at(com), at(rpy)
    joints = solve_inverse_kinematics(robot, to_body(*pose, at(toes))).best()
    return Trajectory(0.5 * s, *pose, joints, contact)


@pytest.fixture(scope="session")
def make_plan() -> Callable[..., ClimbPlan]:
    """A function that builds plans: limbs, rounds, terrain, title, study."""

    def make(
        limbs: int = 6,
        rounds: int = 8,
        *,
        terrain: dict[str, object] | None = None,
        goal: tuple[float, float, float] | None = None,
        turn_deg: float = 0.0,
        name: str = "climb_test",
        title: str = "A climb between walls",
        study: Study | None = None,
        per_instant: int = 8,
    ) -> ClimbPlan:
        target = goal or (0.0, 0.0, 0.1 * rounds)
        document = {
            "kind": "climb",
            "title": title,
            "robot": "silvia",
            "terrain": {"friction": 1.0, "walls": WALLS, **(terrain or {})},
            "task": {
                "rounds": rounds,
                "start": {"com": [0.0, 0.0, 0.0]},
                "goal": {"com": list(target)},
            },
        }
        if terrain and "tube" in terrain:
            del document["terrain"]["walls"]  # type: ignore[index]
        spec = ClimbSpec.model_validate(document)
        scene = build_scene(spec, robot_spec(limbs))
        t = np.linspace(0, 1, rounds + 1)[:, None]
        turn = np.deg2rad(turn_deg) * np.sin(np.pi * t) * np.array([0.6, 0.0, 1.0])
        steps = Rounds(
            com=scene.start.com * (1 - t) + scene.goal.com * t,
            rpy=scene.start.rpy + turn,
            toes=scene.start.toes * (1 - t[..., None]) + scene.goal.toes * t[..., None],
            region=np.tile(scene.start.region, (rounds + 1, 1)),
        )
        instants = plan_instants(scene, steps)
        return ClimbPlan(
            name=name,
            robot=scene.robot,
            terrain=scene.terrain,
            rounds=steps,
            instants=instants,
            forces=_forces(scene.robot, instants, 1.9),
            trajectory=_trajectory(scene.robot, steps, instants, per_instant),
            limits=StepLimits(
                com_max=0.15,
                toe_max=0.24,
                rotation_max=np.deg2rad(10.0),
                com_min=0.0,
                toe_min=0.0,
                goal_com=scene.goal.com,
                goal_toes=scene.goal.toes,
                goal_tolerance=0.02,
                goal_rpy=scene.goal.rpy,
                goal_rotation_tolerance=np.deg2rad(5.0),
                body_clearance=0.02,
                safety_friction=1.8,
                safety_torque=1.0,
            ),
            status="optimal",
            objective=1.494,
            bound=1.494,
            gap=1e-5,
            spec_text=yaml.safe_dump(document, sort_keys=False),
            spec_sha256="0" * 64,
            seed=0,
            timings={"posture": 0.42, "force": 0.02, "verify": 0.03},
            solvers={"posture": "branch-and-bound, DAQP 0.8", "force": "DAQP 0.8"},
            sizes={"posture": {"variables": 192, "binaries": 144}, "force": {"problems": 96}},
            warnings=("rotation 17 deg: beyond 15 degrees the linear rotation is poor",),
            study=study,
            verified=True,
            created="2026-01-02T03:04:05+00:00",
            climbplan_version="0.1.0",
        )

    return make
