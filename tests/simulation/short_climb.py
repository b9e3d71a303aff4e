"""A short climb between walls, which several rooms plan once and look at."""

SHORT_CLIMB = """
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.4]}
task:
  rounds: 1
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.05]}
force: {normal_force_weight: 2.0e-4}
"""
