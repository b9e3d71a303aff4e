"""The layout of climb plan files, as data: what is stored where, in which shape, unit and frame.

N limbs of J joints, M rounds (M1 = M + 1 postures), K instants, T samples, R surfaces; "*" any.
Each table's keys are the fields of the dataclass of the same name in `climb_plan`.
"""

from __future__ import annotations

from climbplan.store.hdf5_layout import Layout

FORMATS = {"climb": "climbplan/climb", "transition": "climbplan/transition"}
FORMAT = FORMATS["climb"]
FORMAT_VERSION = 1
STATUSES = ("optimal", "feasible", "infeasible", "limit")

ROBOT = {
    "shoulder_body": Layout(("N", 3), "m", "body"),
    "mount_yaw": Layout(("N",), "rad", "body"),
    "link_lengths": Layout(("N", "J"), "m"),
    "max_torque": Layout(("N", "J"), "N m"),
    "joint_stiffness": Layout(("N", "J"), "N m/rad"),
    "joint_lower": Layout(("N", "J"), "rad"),
    "joint_upper": Layout(("N", "J"), "rad"),
    "max_joint_speed": Layout(("N", "J"), "rad/s"),
    "stance_body": Layout(("N", 3), "m", "body"),
    "body_hull": Layout(("*", 3), "m", "body"),
}
ROBOT_TEXTS = {"limb_names": Layout(("N",), kind="text"), "sides": Layout(("N",), kind="text")}
ROBOT_NUMBERS = {
    "mass": "kg",
    "gravity": "m/s^2",
    "structural_compliance_share": "",
    "reach": "m",
    "stance_radius": "m",
    "limb_radius": "m",
}

# Of the group `robot/foot`; plans without it have point toes
FOOT_NUMBERS = {"radius": "m"}  # spheres about the toes, or
SOLE_NUMBERS = {"length": "m", "width": "m", "heading": "rad"}  # flat feet, with `axes_zero`:
# columns across, along and normal of the soles at zero angles
SOLE_AXES = Layout(("N", 3, 3), "", "body")

# Of the group `robot/links`, of robots whose limbs have masses, with the attribute `body_mass`
LINKS = {
    "mass": Layout(("N", "J"), "kg"),
    "middle": Layout(("N", "J", 3), "m", "body"),  # from the link's joint, at zero angles
    "inertia": Layout(("N", "J", 3, 3), "kg m^2", "body"),
    "body_middle": Layout((3,), "m", "body"),
    "body_inertia": Layout((3, 3), "kg m^2", "body"),
}

# Of the group `robot/joint_dynamics`; plans without it have what torque and speed limits say
JOINT_DYNAMICS = {
    "rotor_inertia": Layout(("N", "J"), "kg m^2"),
    "damping": Layout(("N", "J"), "N m s/rad"),
    "viscous_friction": Layout(("N", "J"), "N m s/rad"),
    "dry_friction": Layout(("N", "J"), "N m"),
}

# Stored in the group `robot/capsules`, where links are not all straight and alike; C of each limb.
CAPSULES = {
    "joint": Layout(("N", "*"), kind="int"),
    "ends": Layout(("N", "*", 2, 3), "m", "body"),
    "radius": Layout(("N", "*"), "m"),
}

BODY_PART = Layout(("*", 3), "m", "body")  # robot/body_parts/<index>
TOUCHING = Layout(("*", 4), kind="int")

ROUNDS = {
    "com": Layout(("M1", 3), "m", "world"),
    "rpy": Layout(("M1", 3), "rad", "world"),
    "toes": Layout(("M1", "N", 3), "m", "world"),
    "region": Layout(("M1", "N"), kind="int"),
}

INSTANTS = {
    "round": Layout(("K",), kind="int"),
    "lifted": Layout(("K", "N"), kind="bool"),
    "contact": Layout(("K", "N"), kind="bool"),
    "com": Layout(("K", 3), "m", "world"),
    "rpy": Layout(("K", 3), "rad", "world"),
    "toes": Layout(("K", "N", 3), "m", "world"),
    "normal": Layout(("K", "N", 3), "", "world"),
    "mu": Layout(("K", "N")),
    "region": Layout(("K", "N"), kind="int"),
    "joint_angles": Layout(("K", "N", "J"), "rad"),
    "external_wrench": Layout(("K", 6), "N, N m", "world"),
}

# Stored in the same group as the instants.
FORCES = {
    "force": Layout(("K", "N", 3), "N", "world"),
    "joint_torques": Layout(("K", "N", "J"), "N m", "J^T force; motors bring minus it"),
    "wall_deflection": Layout(("K", "N", 3), "m", "world"),
    "com_deflection": Layout(("K", 6), "m, rad", "world"),
    "joint_command": Layout(("K", "N", "J"), "rad"),
    "toe_command": Layout(("K", "N", 3), "m", "world"),
    "safety_torque": Layout(("K",), may_be_infinite=True),
    "safety_friction": Layout(("K",), may_be_infinite=True),
    "mu_critical": Layout(("K", "N")),
}

# Of robots with flat feet, in the same group: forces at the corners of soles, in turn from the one
# behind on the left; `force` is their sum.
CORNER_FORCE = Layout(("K", "N", 4, 3), "N", "world")

# Of robots whose links have masses, in the same group: torques of their own weight; motors hold
# these and `joint_torques`
LINK_TORQUES = Layout(
    ("K", "N", "J"), "N m", "of the links' weight about the joints; motors bring minus it"
)

TRAJECTORY = {
    "time": Layout(("T",), "s"),
    "com": Layout(("T", 3), "m", "world"),
    "rpy": Layout(("T", 3), "rad", "world"),
    "joint_command": Layout(("T", "N", "J"), "rad"),
    "contact": Layout(("T", "N"), kind="bool"),
}

LIMITS = {
    "goal_com": Layout((3,), "m", "world"),
    "goal_toes": Layout(("N", 3), "m", "world"),
    "goal_rpy": Layout((3,), "rad", "world"),
}
LIMITS_NUMBERS = {
    "com_max": "m",
    "toe_max": "m",
    "rotation_max": "rad",
    "com_min": "m",
    "toe_min": "m",
    "goal_tolerance": "m",
    "goal_rotation_tolerance": "rad",
    "body_clearance": "m",
    "safety_friction": "",
    "safety_torque": "",
    "shift_max": "m",
}
LATER_LIMITS = ("shift_max",)  # that plan files of before do not have: zero then

# terrain/surfaces/<index>, attribute `kind` "flat" (with the half-spaces of its edges) or "tube"
FLAT = {
    "vertices": Layout(("*", 3), "m", "world"),
    "normal": Layout((3,), "", "world"),
    "A": Layout(("*", 3), "", "world"),
    "b": Layout(("*",), "m"),
}
# terrain/surfaces/<index>/hold, attribute `undercut` [rad]: how a gripper can grip it
HOLD = {"axis": Layout((3,), "", "world"), "orientation": Layout((3,), "rad")}
TUBE = {"center": Layout((2,), "m", "world")}
TUBE_NUMBERS = ("radius", "lower", "upper")
ALLOWED = Layout(("N", "R"), kind="bool")

# terrain/obstacles/<index> and terrain/free_choices/<index>/<index>: {x : A x <= b}
VERTICES = Layout(("*", 3), "m", "world")
HALF_SPACES = {"A": Layout(("*", 3), "", "world"), "b": Layout(("*",), "m")}

# terrain/scan, attributes `flatness` and `toe_radius` [m]: the raw surface near the way
SCAN = {
    "vertices": Layout(("*", 3), "m", "world"),
    "triangles": Layout(("*", 3), kind="int"),
}
SCAN_NUMBERS = ("flatness", "toe_radius")
SCAN_DEPTH = "finger_depth"  # only where grippers hold what was scanned

SEQUENCES = {
    "cost": Layout(("Q",)),
    "safety_torque": Layout(("Q",), may_be_infinite=True),
    "safety_friction": Layout(("Q",), may_be_infinite=True),
}
SEQUENCES_TEXTS = {"name": Layout(("Q",), kind="text"), "outcome": Layout(("Q",), kind="text")}

TEXTS = Layout(("*",), kind="text")
STUDY_LABEL = Layout(("*", "*"), kind="int")
STUDY_VALUES = Layout(("*",))
