"""A table on three legs that slide up and down, as `climbplan export` would write its motion."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import h5py
import numpy as np

GRAVITY, BODY, FOOT = 9.81, 4.0, 0.5  # [m/s^2], [kg]
HEIGHT = 0.3  # [m] of the base
RADIUS = 0.02  # [m] of the feet
GAIN, DAMPING = 4000.0, 100.0  # [N/m], [N s/m]
LEGS = {"A": (0.2, 0.0), "B": (-0.1, 0.17320508), "C": (-0.1, -0.17320508)}

_LEG = """
  <joint name="{name}_slide" type="prismatic">
    <parent link="base"/><child link="{name}_foot"/>
    <origin xyz="{x} {y} 0"/><axis xyz="0 0 1"/>
    <limit lower="-0.5" upper="0.5" effort="60" velocity="1"/>
  </joint>
  <link name="{name}_foot">
    <inertial><mass value="0.5"/>
      <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>
    <visual><geometry><mesh filename="no_such_file.stl"/></geometry></visual>
    {collision}
  </link>"""
_BALL = f'<collision><geometry><sphere radius="{RADIUS}"/></geometry></collision>'


def table_urdf(*, with_feet: bool = True) -> str:
    """Return the robot; without feet its toes have no collision geometry."""
    legs = "".join(
        _LEG.format(name=name, x=x, y=y, collision=_BALL if with_feet else "")
        for name, (x, y) in LEGS.items()
    )
    return f"""<robot name="table">
  <link name="base">
    <inertial><mass value="{BODY}"/>
      <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial>
    <collision><geometry><box size="0.5 0.5 0.05"/></geometry></collision>
  </link>{legs}
</robot>"""


def write_table_plan(path: Path, urdf: str, *, obstacle: tuple[float, float] | None = None) -> None:
    """Write what the second engine reads of a plan file: the URDF and the terrain.

    obstacle: heights between which a box stands below the middle of the base [m].
    """
    with h5py.File(path, "w") as file:
        file.attrs["spec"] = "kind: climb\nrobot: table.yaml\n"
        file.attrs["format"] = "climbplan/climb"
        robot = file.create_group("robot")
        robot.attrs["name"], robot.attrs["mass"] = "table", BODY + 3 * FOOT
        robot.attrs["gravity"] = GRAVITY
        robot.attrs["source"], robot.attrs["urdf"] = "urdf: table.urdf\n", urdf
        floor = file.create_group("terrain/surfaces/0000")
        floor.attrs["kind"], floor.attrs["name"], floor.attrs["friction"] = "flat", "floor", 0.8
        floor.attrs["standoff"] = RADIUS
        corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        floor["vertices"] = np.array([(x, y, RADIUS) for x, y in corners], float)
        floor["normal"] = np.array([0.0, 0.0, 1.0])
        obstacles = file.create_group("terrain/obstacles")
        if obstacle is not None:
            box = obstacles.create_group("0000")
            box.attrs["name"] = "box"
            low, high = obstacle
            box["vertices"] = np.array(
                [(x, y, z) for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (low, high)]
            )
            box["A"] = np.concatenate([np.eye(3), -np.eye(3)])
            box["b"] = np.array([0.05, 0.05, high, 0.05, 0.05, -low])


def write_table_motion(
    directory: Path, *, seconds: float = 0.4, too_short: float = 0.0, base_link: str | None = "base"
) -> None:
    """Write `motion.csv` and its JSON: the table stands still.

    too_short: how far commands are from what bears the table [m].
    """
    time = np.linspace(0.0, seconds, 5)
    weight, own = BODY * GRAVITY / 3, FOOT * GRAVITY
    angle = RADIUS - HEIGHT
    torque = -(weight + own)  # against the contact force; the foot's own weight helps
    columns = {"time_s": time}
    for axis, value in zip("xyz", (0.0, 0.0, HEIGHT), strict=True):
        columns[f"base_{axis}_m"] = np.full(5, value)
    for axis, value in zip(("qx", "qy", "qz", "qw"), (0.0, 0.0, 0.0, 1.0), strict=True):
        columns[f"base_{axis}"] = np.full(5, value)
    for name in LEGS:
        columns[f"{name}_slide_position_m"] = np.full(5, angle + torque / GAIN + too_short)
        columns[f"{name}_slide_angle_m"] = np.full(5, angle)
        columns[f"{name}_slide_effort_N"] = np.zeros(5)
        columns[f"{name}_slide_force_N"] = np.full(5, torque)
        columns[f"{name}_slide_gravity_N"] = np.full(5, own)
        columns[f"{name}_force_x_N"] = columns[f"{name}_force_y_N"] = np.zeros(5)
        columns[f"{name}_force_z_N"] = np.full(5, weight + own)
        columns[f"{name}_contact"] = np.ones(5)
    with (directory / "motion.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(np.stack(list(columns.values()), axis=1).tolist())
    facts = {
        "format": "climbplan/motion",
        "version": 1,
        "name": "standing",
        "robot": "table",
        "base_link": base_link,
        "held_joints": {},
        "joints": [
            {
                "name": f"{name}_slide",
                "limb": name,
                "kind": "slides",
                "gain": GAIN,
                "damping": DAMPING,
                "max_torque": 60.0,
            }
            for name in LEGS
        ],
        "contacts": [
            {"name": name, "link": f"{name}_foot", "offset": [0.0, 0.0, 0.0], "radius": RADIUS}
            for name in LEGS
        ],
    }
    (directory / "motion.csv.json").write_text(json.dumps(facts))
