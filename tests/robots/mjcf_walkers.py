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
