"""The walkers of the tests as MJCF files, written with what MJCF has and URDF has not."""

from __future__ import annotations

import math

from urdf_walkers import Walker

_AXES = """
  <default>
    <joint actuatorfrcrange="-60 60"/>
    <geom type="cylinder" size="0.02"/>
    <default class="yaw">
      <joint axis="0 0 1" range="-57.29577951308232 57.29577951308232"/>
    </default>
    <default class="lift">
      <joint axis="0 -1 0" range="-85.94366926962348 85.94366926962348"/>
    </default>
  </default>"""


def mjcf_of(walker: Walker) -> str:
    """The MJCF file of a walker of three joints a leg."""
    assert walker.joints == 3
    parts = [
        f'<mujoco model="walker{2 * len(walker.forward)}">',
        '  <compiler angle="degree" autolimits="true" inertiafromgeom="false"/>' + _AXES,
        "  <worldbody>",
        '    <geom name="floor" type="plane" size="5 5 0.1"/>',
        '    <body name="base_link" pos="0 0 0.4">',
        f"      <freejoint/>{_inertial(walker.body_mass)}",
        '      <geom type="box" size="0.2 0.1 0.04"/>',
    ]
    for pair, (x, sprawl) in enumerate(zip(walker.forward, walker.sprawl_deg, strict=True)):
        for side, sign in (("L", 1.0), ("R", -1.0)):
            name, half = f"{side}{pair + 1}", math.radians(sign * (90.0 - sprawl)) / 2
            own = _inertial(walker.link_mass, "0.0285 0 0")
            turned = f'quat="{math.cos(half)!r} 0 0 {math.sin(half)!r}"'
            at = f'pos="{x} {sign * walker.half_width} 0"'
            parts += [
                f'<body name="{name}_yaw_link" {at} {turned}>',
                f'<joint name="{name}_yaw" class="yaw"/>{own}',
                '<geom fromto="0 0 0 0.057 0 0"/>',
                f'<body name="{name}_lift_link" pos="0.057 0 0">',
                f'<joint name="{name}_lift" class="lift"/>'
                + _inertial(walker.link_mass, "0.0975 0 0"),
                '<geom fromto="0 0 0 0.195 0 0"/>',
                f'<body name="{name}_knee_link" pos="0.195 0 0">',
                f'<joint name="{name}_knee" class="lift"/>'
                + _inertial(walker.link_mass, "0 0 -0.1875"),
                '<geom fromto="0 0 0 0 0 -0.375"/>',
                f'<site name="{name}_toe" pos="0 0 -0.375"/>',
                "</body></body></body>",
            ]
    return "\n".join([*parts, "    </body>", "  </worldbody>", "</mujoco>", ""])


def _inertial(mass: float, at: str = "0 0 0") -> str:
    small = 1e-3 * mass
    return f'<inertial pos="{at}" mass="{mass}" diaginertia="{small} {small} {small}"/>'


ODD = """
<mujoco model="odd">
  <compiler angle="degree" meshdir="meshes" eulerseq="zyx"/>
  <asset><mesh name="wedge" file="wedge.stl" scale="0.1 0.2 0.1"/></asset>
  <worldbody>
    <light pos="0 0 3"/>
    <body name="trunk" pos="0 0 1" euler="10 20 30">
      <freejoint name="free"/>
      <geom type="mesh" mesh="wedge" pos="0.01 0.02 0.03" euler="5 6 7" density="500"/>
      <geom type="ellipsoid" size="0.1 0.1 0.1" contype="0" conaffinity="0" mass="0.5"/>
      <body name="hip" pos="0.2 0.1 0" quat="0.7071067811865476 0 0.7071067811865476 0">
        <joint name="roll" axis="1 0 0" range="-40 40" pos="0 0 0.02"/>
        <joint name="pitch" axis="0 1 0" range="-30 60" pos="0.01 0 0" ref="10"/>
        <geom name="thigh" type="capsule" size="0.03 0.1" pos="0 0 0.1" mass="1"/>
        <frame pos="0 0 0.2" euler="90 0 0">
          <body name="shin">
            <joint name="knee" axis="0 0.6 0.8" range="-90 0" pos="0 0.01 0"/>
            <geom type="box" size="0.02 0.02 0.1" pos="0 0 -0.1" mass="0.4"/>
            <body name="ankle" pos="0 0 -0.2">
              <geom name="sole" type="sphere" size="0.03" mass="0.1"/>
              <site name="ankle" pos="0 0 -0.03"/>
            </body>
          </body>
        </frame>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="roll" gear="5" ctrlrange="-2 3" ctrllimited="true"/>
    <position name="m2" joint="pitch" kp="40" forcerange="-7 7"/>
    <motor name="m3" joint="knee"/>
  </actuator>
</mujoco>
"""
"""Two joints in one body, anchors off its origin, `ref`, frames, a mesh, motors of three kinds."""


def write_nested_defaults_model() -> str:
    """A quadruped as public collections of models write them.

    Classes of defaults are nested, pictures are geoms of group 2 that touch nothing, collision
    geoms are of group 3, feet are spheres, limits come from position actuators, and a keyframe
    states the pose `home`.
    """
    legs = []
    for name, forward, sign in (("FL", 1, 1), ("FR", 1, -1), ("RL", -1, 1), ("RR", -1, -1)):
        legs.append(
            f"""
      <body name="{name}_hip" pos="{0.19 * forward} {0.05 * sign} 0">
        <inertial pos="0 {0.01 * sign} 0" mass="0.6" diaginertia="5e-4 6e-4 5e-4"/>
        <joint class="abduction" name="{name}_hip_joint"/>
        <geom class="visual" type="cylinder" size="0.045 0.02" quat="1 1 0 0" material="grey"/>
        <body name="{name}_thigh" pos="0 {0.09 * sign} 0">
          <inertial pos="0 0 -0.03" mass="0.9" diaginertia="5e-3 5e-3 1e-3"/>
          <joint class="hip" name="{name}_thigh_joint"/>
          <geom class="visual" type="box" size="0.02 0.02 0.11" pos="0 0 -0.1" material="grey"/>
          <geom class="collision" type="capsule" size="0.015" fromto="0 0 -0.02 0 0 -0.19"/>
          <body name="{name}_calf" pos="0 0 -0.2">
            <inertial pos="0 0 -0.1" mass="0.2" diaginertia="2e-3 2e-3 4e-5"/>
            <joint class="knee" name="{name}_calf_joint"/>
            <geom class="visual" type="box" size="0.01 0.01 0.1" pos="0 0 -0.1" material="grey"/>
            <geom class="collision" type="capsule" size="0.01" fromto="0 0 -0.02 0 0 -0.17"/>
            <geom class="foot" name="{name}"/>
          </body>
        </body>
      </body>"""
        )
    joints = ("hip", "thigh", "calf")
    motors = [
        f'<position class="{kind}" name="{name}_{joint}" joint="{name}_{joint}_joint"/>'
        for name in ("FL", "FR", "RL", "RR")
        for joint, kind in zip(joints, ("abduction", "hip", "knee"), strict=True)
    ]
    home = "0 0 0.29 1 0 0 0 " + " ".join(["0 0.8 -1.5"] * 4)
    return f"""<mujoco model="nested quadruped">
  <compiler angle="radian" autolimits="true"/>
  <option cone="elliptic" impratio="100"/>
  <default>
    <default class="quadruped">
      <geom friction="0.6" condim="1"/>
      <joint axis="0 1 0" damping="0.5" armature="0.01" frictionloss="0.2"/>
      <position kp="60" kv="2" forcerange="-24 24"/>
      <default class="abduction">
        <joint axis="1 0 0" range="-1.0 1.0"/>
      </default>
      <default class="hip">
        <joint range="-1.5 3.4"/>
      </default>
      <default class="knee">
        <joint range="-2.7 -0.85"/>
        <position forcerange="-40 40"/>
      </default>
      <default class="visual">
        <geom contype="0" conaffinity="0" group="2"/>
      </default>
      <default class="collision">
        <geom group="3"/>
        <default class="foot">
          <geom type="sphere" size="0.02" pos="0 0 -0.2" priority="1" condim="6"/>
        </default>
      </default>
    </default>
  </default>
  <asset>
    <material name="grey" rgba="0.5 0.5 0.5 1"/>
  </asset>
  <worldbody>
    <light name="light" pos="0 0 2"/>
    <body name="base" pos="0 0 0.29" childclass="quadruped">
      <inertial pos="0 0 0" mass="6" diaginertia="0.02 0.06 0.07"/>
      <freejoint/>
      <geom class="visual" type="box" size="0.2 0.06 0.05" material="grey"/>
      <geom class="collision" type="box" size="0.18 0.05 0.045"/>
      <site name="imu" pos="0 0 0"/>{"".join(legs)}
    </body>
  </worldbody>
  <actuator>
    {"".join(motors)}
  </actuator>
  <sensor>
    <gyro name="gyro" site="imu"/>
  </sensor>
  <keyframe>
    <key name="home" qpos="{home}" ctrl="{" ".join(["0 0.8 -1.5"] * 4)}"/>
  </keyframe>
</mujoco>
"""
