"""A1 from `example-robot-data`: its robot file, and specs as `new robot` proposes them."""

from __future__ import annotations

from pathlib import Path

from climbplan.robots.urdf.proposal.package_urdfs import find_package_urdf

ROBOT = """kind: robot
urdf: {urdf}
forward: x
up: z
joint_stiffness: 200
structural_compliance_share: 0.1
foot: {{radius: 0.02}}
legs:
  RF: {{toe: FR_foot, posture_deg: {{FR_hip_joint: -11, FR_thigh_joint: 51, FR_calf_joint: -102}}}}
  RR: {{toe: RR_foot, posture_deg: {{RR_hip_joint: -11, RR_thigh_joint: 51, RR_calf_joint: -102}}}}
  LR: {{toe: RL_foot, posture_deg: {{RL_hip_joint: 11, RL_thigh_joint: 51, RL_calf_joint: -102}}}}
  LF: {{toe: FL_foot, posture_deg: {{FL_hip_joint: 11, FL_thigh_joint: 51, FL_calf_joint: -102}}}}
"""
CHIMNEY = """kind: climb
robot: a1.yaml
terrain:
  friction: 1
  walls: {gap: 0.4144, along: [-1.0, 1.0], up: [-1.0, 1.0]}
task:
  rounds: 1
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.03]}
  gait: [LR, LF, RR, RF]
  stance:
    RF: [0.1872, 0.0426, -0.1459]
    RR: [0.1872, -0.1219, -0.2367]
    LR: [-0.1872, -0.1219, -0.2367]
    LF: [-0.1872, 0.0426, -0.1459]
posture:
  steps: {com_shift_max: 0.157}
force: {safety_friction: 1.2}
trajectory: {swing_clearance: 0.0298}
"""
GROUND_TO_WALLS = """kind: transition
robot: a1.yaml
terrain:
  friction: 1.5
  walls: {gap: 0.4248, along: [-3.3, 3.3], up: [0, 3.3]}
  ground: {across: [-0.2124, 0.2124], along: [-3.3, 3.3]}
task:
  rounds: 4
  start:
    com: [0, 0, 0.2387]
    toes:
      RF: [0.1777, 0.1906, 0.0]
      RR: [0.1777, -0.1703, 0.0]
      LR: [-0.1741, -0.1704, 0.0]
      LF: [-0.1741, 0.1906, 0.0]
  goal: {com: [0, 0, 0.2776]}
  stance:
    RF: [0.1924, 0.1170, -0.2076]
    RR: [0.1924, -0.0967, -0.2076]
    LR: [-0.1924, -0.0967, -0.2076]
    LF: [-0.1924, 0.1170, -0.2076]
posture:
  steps: {com_shift_max: 0.156, com_max: 0.313}
search: {lateral_offset: 0.059, heights: 4}
force: {safety_torque: 1.20}
trajectory: {swing_clearance: 0.0306}
"""
WALK = """kind: mpc
robot: a1.yaml
terrain: {friction: 0.8}
task:
  knots: 16
  dt: 0.123
  min_contacts: 2
  swing_clearance: 0.039
  reference: {velocity: [0.5, 0, 0], rpy_deg: [0, 0, 0]}
weights: {velocity: [100, 100, 1000], angles: [100, 100, 10], height: 1000}
solver: {method: mpcc, initial_gait: walking trot}
"""


def a1_urdf() -> Path:
    return find_package_urdf("example-robot-data:a1_description/urdf/a1")


def written(folder: Path, spec: str) -> Path:
    """The file of a spec, beside that of the robot."""
    (folder / "a1.yaml").write_text(ROBOT.format(urdf=a1_urdf()))
    path = folder / "spec.yaml"
    path.write_text(spec)
    return path
