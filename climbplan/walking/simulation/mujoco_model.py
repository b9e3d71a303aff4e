"""The MuJoCo model of a walk: one rigid body with massless legs, and point feet on the terrain.

It has the planner's robot of chapter 8.2: a mass with an inertia and forces at its toes. Each toe
is a small mass that stands by friction. A leg pushes the body with the planned force and the toe
with the opposite force; the simulator computes the contact.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.simulation.attributes import format_numbers
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.physical_inertia import repair_inertia
from climbplan.walking.plan.foot_centres import compute_steepness
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import POSITION

TIME_STEP = 1e-3  # [s]
TOE_RADIUS = 0.005  # [m]
# [kg] in addition to the robot's mass; it limits the speed of slipping toes
TOE_MASS = 0.1
_MARGIN = 2.0  # [m] of terrain beyond the walk, for unbounded regions
_GROUND_THICKNESS = 0.2  # [m] of the ground
_HALF_HEIGHT = 0.04  # [m] of the body's collision box
BODY_CONTACT, TOE_CONTACT = 4, 1  # contact types of MuJoCo


@dataclass(frozen=True)
class GroundMjcf:
    """The terrain's part of a model."""

    meshes: str  # assets
    geoms: str


def build_walk_mjcf(plan: WalkPlan, conditions: Conditions) -> str:
    """Build the model of a walk under given conditions; positions are set later."""
    toes = "\n".join(_build_toe(leg) for leg in range(plan.task.body.leg_count))
    return build_world_mjcf(
        plan, build_ground_mjcf(plan, conditions), f"{_build_body(plan, conditions)}\n{toes}"
    )


def build_world_mjcf(plan: WalkPlan, ground: GroundMjcf, robot: str, ties: str = "") -> str:
    """Build a model from terrain, robot, and equality constraints between joints."""
    return f"""
<mujoco model="climbplan walk">
<option timestep="{TIME_STEP}" gravity="0 0 {-plan.task.body.gravity}" cone="elliptic"
 impratio="100" integrator="implicitfast" noslip_iterations="4"/>
<compiler angle="radian" autolimits="true"/>
<visual><global offwidth="1280" offheight="960"/>
<headlight ambient=".5 .5 .5" diffuse=".5 .5 .5"/></visual>
<default><geom condim="3" solref="0.004 1" solimp="0.98 0.999 0.0005"/></default>
<asset>
<texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="48"/>
<texture name="tiles" type="2d" builtin="checker" rgb1=".50 .52 .56" rgb2=".60 .62 .65"
 width="64" height="64"/>
<material name="ground" texture="tiles" texrepeat="5 5" texuniform="true"/>
<material name="body" rgba="0.16 0.23 0.35 1"/>
<material name="toe" rgba="0.85 0.25 0.20 1"/>
{ground.meshes}
</asset>
<worldbody>
<light pos="0 -2 3" dir="0 0.5 -1" directional="true"/>
{ground.geoms}
{robot}
</worldbody>
<equality>{ties}</equality>
</mujoco>"""


def build_ground_mjcf(plan: WalkPlan, conditions: Conditions, sunk: float = 0.0) -> GroundMjcf:
    """Build the terrain of a walk.

    Args:
        plan: the walk.
        conditions: of the simulation, for friction.
        sunk: depth by which regions are lowered along their normals, for spherical feet [m].
    """
    task = plan.task
    coefficients = task.ground.find_friction(np.arange(task.ground.count)) * conditions.friction
    xy = np.concatenate(
        [plan.trajectory.state[:, :2], plan.trajectory.toes[..., :2].reshape(-1, 2)]
    )
    low, high = xy.min(axis=0) - _MARGIN, xy.max(axis=0) + _MARGIN
    meshes, ground = [], []
    level = not (task.ground.corners.size or task.ground.slope.any())
    for index in range(task.ground.count):
        corners = task.ground.outline(index, low, high)
        if not len(corners):
            continue
        shared = (
            f' friction="{max(float(coefficients[index]), 1e-5):.6g} 0 0" contype="0"'
            f' conaffinity="{TOE_CONTACT | BODY_CONTACT}" material="ground"/>'
        )
        corners = corners - [0, 0, sunk * float(compute_steepness(task.ground.slope[index]))]
        if level:
            lower, upper = corners.min(axis=0), corners.max(axis=0)
            center = 0.5 * (lower + upper) - [0, 0, _GROUND_THICKNESS / 2]
            half = [*(upper - lower)[:2] / 2, _GROUND_THICKNESS / 2]
            ground.append(
                f'<geom name="ground{index}" type="box" pos="{format_numbers(center)}"'
                f' size="{format_numbers(half)}"{shared}'
            )
            continue
        solid = np.concatenate([corners, corners - [0, 0, _GROUND_THICKNESS]])
        meshes.append(f'<mesh name="ground{index}" vertex="{format_numbers(solid)}"/>')
        # The compiler moves meshes to their centres, and geoms back
        ground.append(f'<geom name="ground{index}" type="mesh" mesh="ground{index}"{shared}')
    return GroundMjcf("".join(meshes), "".join(ground))


def compute_hips(plan: WalkPlan) -> Array:
    """Return the points (L, 3) where legs are drawn to begin, body frame [m]."""
    return np.asarray(plan.task.body.toe_center * [0.75, 0.75, 0.0])


def _build_body(plan: WalkPlan, conditions: Conditions) -> str:
    """Build the rigid body with its free joint."""
    body = plan.task.body
    matrix = repair_inertia(body.inertia, "the body")
    inertia = [*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]]
    half = [*np.abs(compute_hips(plan)).max(axis=0)[:2], _HALF_HEIGHT]
    start = plan.trajectory.state[0, POSITION]
    return (
        f'<body name="body" pos="{format_numbers(start)}"><freejoint name="free"/>'
        f'<inertial pos="0 0 0" mass="{body.mass + conditions.payload:.9g}"'
        f' fullinertia="{format_numbers(inertia)}"/>'
        f'<geom name="body" type="box" size="{format_numbers(half)}" material="body"'
        f' contype="{BODY_CONTACT}" conaffinity="0"/></body>'
    )


def _build_toe(leg: int) -> str:
    """Build a toe with three sliding joints."""
    slides = "".join(
        f'<joint name="toe{leg}{name}" type="slide" axis="{axis}"/>'
        for name, axis in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    return (
        f'<body name="toe{leg}" gravcomp="1">{slides}<geom name="toe{leg}" type="sphere"'
        f' size="{TOE_RADIUS}" mass="{TOE_MASS}" material="toe" friction="0 0 0"'
        f' contype="{TOE_CONTACT}" conaffinity="0"/></body>'
    )
