"""A small climb with consistent forces and motion, made without the planner's optimisers.

A hexapod climbs between two walls, turning a little, past a block in front of it.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np
import yaml
from scipy.linalg import block_diag

from climbplan.arrays import Array
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import (
    ClimbPlan,
    InstantForces,
    Instants,
    Rounds,
    StepLimits,
    Trajectory,
)
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.robots.kinematics import jacobian_world, solve_inverse_kinematics, to_body, toe_world
from climbplan.robots.rotations import skew
from climbplan.schema.robots.robot import RobotSpec

SPEC = """
kind: climb
robot: hexapod
terrain:
  friction: 1.1
  walls: {gap: 1.23, along: [-0.9, 0.9], up: [-1.0, 2.0]}
  obstacles:
    - {name: block, lower: [-0.2, 0.40, 0.1], upper: [0.2, 0.8, 0.5]}
task:
  rounds: ROUNDS
  start: {com: [0.0, 0.0, 0.0]}
  goal: {com: [0.0, -0.02, HEIGHT], rpy_deg: [0.0, 0.0, 4.0]}
  payload: {mass: 0.5, offset: [0.0, 0.05, 0.02]}
  external_wrench: {force: [1.0, 0.0, -2.0], moment: [0.0, 0.1, 0.0]}
"""
FACETS = 12


# name, side, shoulder, mount yaw [deg], stance
LEGS = (
    ("RF", "right", [0.11, 0.19, 0.0], 60.0, [0.615, 0.33, -0.12]),
    ("RM", "right", [0.22, 0.0, 0.0], 0.0, [0.615, 0.0, -0.15]),
    ("RR", "right", [0.11, -0.19, 0.0], -60.0, [0.615, -0.33, -0.12]),
    ("LR", "left", [-0.11, -0.19, 0.0], 240.0, [-0.615, -0.33, -0.12]),
    ("LM", "left", [-0.22, 0.0, 0.0], 180.0, [-0.615, 0.0, -0.15]),
    ("LF", "left", [-0.11, 0.19, 0.0], 120.0, [-0.615, 0.33, -0.12]),
)


def _robot() -> RobotSpec:
    """About the size of SiLVIA, with wide joint bounds."""
    limbs = [
        {
            "name": name,
            "side": side,
            "shoulder": shoulder,
            "mount_yaw_deg": yaw,
            "link_lengths": [0.06, 0.2, 0.37],
            "max_torque": [25, 26, 27],
            "joint_stiffness": [30, 35, 40],
            "joint_lower_deg": [-80, -85, -100],
            "joint_upper_deg": [80, 95, 100],
            "max_joint_speed": [6.0, 6.0, 6.0],
            "stance": stance,
        }
        for name, side, shoulder, yaw, stance in LEGS
    ]
    return RobotSpec.model_validate(
        {
            "name": "hexapod",
            "mass": 10.0,
            "structural_compliance_share": 0.3,
            "body_half_size": [0.13, 0.22, 0.05],
            "limb_radius": 0.025,
            "workspace": {"reach": 0.6, "stance_radius": 0.2},
            "limbs": limbs,
        }
    )


@dataclass(frozen=True)
class Climb:
    """Scene and plan."""

    scene: ClimbScene
    plan: ClimbPlan


def example_climb(rounds: int = 2, spec_text: str | None = None, per_segment: int = 6) -> Climb:
    """The example with any number of rounds, 0.1 m each, or another spec's walls."""
    text = spec_text or SPEC.replace("ROUNDS", str(rounds)).replace("HEIGHT", str(0.1 * rounds))
    spec = ClimbSpec.model_validate(yaml.safe_load(text))
    scene = build_scene(spec, _robot())
    share = np.linspace(0.0, 1.0, spec.task.rounds + 1)

    def mix(a: Array, b: Array) -> Array:
        return a + share.reshape(-1, *[1] * a.ndim) * (b - a)

    toes = mix(scene.start.toes, scene.goal.toes)
    if scene.terrain.is_curved:
        tube = scene.terrain.surfaces[0]
        toes = np.array([[tube.project(toe) for toe in row] for row in toes])
    postures = Rounds(
        com=mix(scene.start.com, scene.goal.com),
        rpy=mix(scene.start.rpy, scene.goal.rpy),
        toes=toes,
        region=np.tile(scene.start.region, (len(share), 1)),
    )
    instants = plan_instants(scene, postures)
    forces = balanced_forces(scene, instants)
    return Climb(scene, _plan(scene, postures, instants, forces, text, per_segment))


def balanced_forces(scene: ClimbScene, instants: Instants) -> InstantForces:
    """Forces of least elastic energy in an inscribed pyramid, and commands to match."""
    robot, k = scene.robot, instants.count
    jacobian = jacobian_world(robot, instants.rpy, instants.joint_angles)
    force = least_energy(scene, instants)
    torques = np.einsum("knij,kni->knj", jacobian, force)
    bent = torques / (robot.joint_stiffness * (1 - robot.structural_compliance_share))
    command = instants.joint_angles - bent

    normal = np.einsum("kni,kni->kn", force, instants.normal)
    tangent = np.linalg.norm(force - normal[..., None] * instants.normal, axis=-1)
    critical = np.divide(tangent, normal, out=np.zeros_like(normal), where=normal > 0)
    return InstantForces(
        force=force,
        joint_torques=torques,
        wall_deflection=np.einsum("knij,knj->kni", jacobian, bent),
        com_deflection=np.zeros((k, 6)),
        joint_command=command,
        toe_command=toe_world(robot, instants.com, instants.rpy, command),
        safety_torque=1 / (np.abs(torques) / robot.max_torque).max(axis=(1, 2)),
        safety_friction=1 / (critical / instants.mu).max(axis=1),
        mu_critical=critical,
    )


def least_energy(scene: ClimbScene, instants: Instants) -> Array:
    """Forces (K, N, 3) for which the joints store least energy."""
    robot = scene.robot
    jacobian = jacobian_world(robot, instants.rpy, instants.joint_angles)
    compliance = np.einsum("knij,nj,knlj->knil", jacobian, 1 / robot.joint_stiffness, jacobian)
    compliance /= 1 - robot.structural_compliance_share
    return np.stack(
        [_least_energy(scene, instants, i, compliance[i]) for i in range(instants.count)]
    )


def _least_energy(scene: ClimbScene, instants: Instants, i: int, compliance: Array) -> Array:
    """Forces (N, 3) of one instant by a quadratic program over pyramid edges."""
    robot, contact = scene.robot, np.flatnonzero(instants.contact[i])
    angle = np.arange(FACETS) * 2 * np.pi / FACETS
    edges = np.zeros((3 * robot.limb_count, FACETS * len(contact)))
    balance = np.zeros((6, 3 * robot.limb_count))
    for place, limb in enumerate(contact):
        normal = instants.normal[i, limb]
        along = np.cross(normal, [0.0, 0.0, 1.0])
        along /= np.linalg.norm(along)
        plane = np.stack([along, np.cross(normal, along)])
        slope = instants.mu[i, limb] / (scene.spec.force.safety_friction * 1.0001)
        pyramid = normal + slope * np.stack([np.cos(angle), np.sin(angle)], 1) @ plane
        rows = slice(3 * limb, 3 * limb + 3)
        edges[rows, FACETS * place : FACETS * (place + 1)] = pyramid.T
        balance[:3, rows] = np.eye(3)
        balance[3:, rows] = skew(instants.toes[i, limb] - instants.com[i])
    load = instants.external_wrench[i].copy()
    load[2] -= robot.mass * robot.gravity
    count = edges.shape[1]
    energy = edges.T @ block_diag(*compliance) @ edges + 1e-7 * np.eye(count)
    weights, _, flag, _ = daqp.solve(
        energy,
        np.zeros(count),
        np.vstack([balance @ edges]),
        np.concatenate([np.full(count, 1e6), -load]),
        np.concatenate([np.zeros(count), -load]),
        np.concatenate([np.zeros(count, np.int32), np.full(6, 5, np.int32)]),
    )
    assert flag == 1
    return (edges @ weights).reshape(-1, 3)


def _start_forces(scene: ClimbScene, rounds: Rounds, instants: Instants) -> Array:
    """Forces (N, 3) with all limbs standing at the start."""
    toes = rounds.toes[:1]
    row = {name: value[:1] for name, value in vars(instants).items()}
    angles = solve_inverse_kinematics(scene.robot, to_body(row["com"], row["rpy"], toes)).best()
    everyone = np.ones_like(row["contact"])
    standing = {**row, "toes": toes, "contact": everyone, "joint_angles": angles}
    return least_energy(scene, Instants(**standing))[0]


def _trajectory(
    scene: ClimbScene, rounds: Rounds, instants: Instants, forces: InstantForces, per_segment: int
) -> Trajectory:
    """Unload, lift, swing, lower, wait and push, `per_segment` samples each."""
    names = ("com", "rpy", "toes", "force", "contact")
    stop: dict[str, Any] = {
        "com": rounds.com[0],
        "rpy": rounds.rpy[0],
        "toes": rounds.toes[0],
        "force": _start_forces(scene, rounds, instants),
        "contact": np.ones(scene.robot.limb_count, bool),
    }
    samples: dict[str, list[Any]] = {name: [] for name in names}

    def go(**changes: Any) -> None:
        nonlocal stop
        target = {**stop, **changes}
        for share in np.arange(per_segment) / per_segment:
            for name in ("com", "rpy", "toes", "force"):
                samples[name].append((1 - share) * stop[name] + share * target[name])
            samples["contact"].append(target["contact"])
        stop = target

    for k in range(0, instants.count, 2):
        limb = int(np.flatnonzero(instants.lifted[k])[0])
        everyone, others = np.ones(scene.robot.limb_count, bool), ~instants.lifted[k]
        before, after = stop["toes"], instants.toes[k + 1]

        def swung(toe: Array, limb: int = limb, before: Array = before) -> Array:
            toes = before.copy()
            toes[limb] = toe
            return toes

        above = after[limb] + scene.spec.trajectory.swing_clearance * instants.normal[k + 1, limb]
        go(force=forces.force[k], contact=everyone)
        go(toes=swung(instants.toes[k, limb]), contact=others)
        go(toes=swung(above), contact=others)
        go(toes=after, contact=others)
        go(contact=everyone)
        go(com=instants.com[k + 1], rpy=instants.rpy[k + 1], force=forces.force[k + 1])
    go()
    robot, arrays = scene.robot, {name: np.array(values) for name, values in samples.items()}
    solution = solve_inverse_kinematics(
        robot, to_body(arrays["com"], arrays["rpy"], arrays["toes"])
    )
    assert solution.valid.all()
    angles = solution.best()
    jacobian = jacobian_world(robot, arrays["rpy"], angles)
    torques = np.einsum("tnij,tni->tnj", jacobian, arrays["force"])
    bent = torques / (robot.joint_stiffness * (1 - robot.structural_compliance_share))
    return Trajectory(
        time=np.arange(len(angles)) / scene.spec.trajectory.rate,
        com=arrays["com"],
        rpy=arrays["rpy"],
        joint_command=angles - bent,
        contact=arrays["contact"],
    )


def _plan(
    scene: ClimbScene,
    rounds: Rounds,
    instants: Instants,
    forces: InstantForces,
    text: str,
    per_segment: int,
) -> ClimbPlan:
    spec = scene.spec
    weights = spec.posture.weights
    cost = (
        weights.com * np.sum(np.diff(rounds.com, axis=0) ** 2)
        + weights.toe * np.sum(np.diff(rounds.toes, axis=0) ** 2)
        + weights.rotation * np.sum(np.diff(rounds.rpy, axis=0) ** 2)
    )
    return ClimbPlan(
        name="example",
        robot=scene.robot,
        terrain=scene.terrain,
        rounds=rounds,
        instants=instants,
        forces=forces,
        trajectory=_trajectory(scene, rounds, instants, forces, per_segment),
        limits=StepLimits(
            com_max=spec.posture.steps.com_max,
            toe_max=spec.posture.steps.toe_max,
            rotation_max=float(np.deg2rad(spec.posture.steps.rotation_max_deg)),
            com_min=0.0,
            toe_min=0.0,
            goal_com=scene.goal.com,
            goal_toes=scene.goal.toes,
            goal_tolerance=spec.task.goal.tolerance,
            goal_rpy=scene.goal.rpy,
            goal_rotation_tolerance=float(np.deg2rad(spec.task.goal.rotation_tolerance_deg)),
            body_clearance=spec.posture.body_clearance,
            safety_friction=spec.force.safety_friction,
            safety_torque=spec.force.safety_torque,
        ),
        status="feasible",
        objective=float(cost),
        bound=0.9 * float(cost),
        gap=0.1,
        spec_text=text,
        spec_sha256=hashlib.sha256(text.encode()).hexdigest(),
        seed=spec.seed,
        timings={"posture": 0.25, "force": 0.125},
        solvers={"posture": "none", "force": "HiGHS"},
        sizes={"posture": {"variables": 48, "binaries": 0}},
        warnings=("made for tests: größer als üblich",),
        created="2026-01-02T03:04:05+00:00",
        climbplan_version="0.1.0",
        summary=("example", "force ok"),
    )
