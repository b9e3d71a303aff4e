"""The layout of climb plan files, as data: what is stored where, in which shape, unit and frame.

N limbs of J joints, M rounds (M1 = M + 1 postures), K instants, T samples, R surfaces; "*" any.
Each table's keys are the fields of the dataclass of the same name in `climb_plan`.
"""

from __future__ import annotations

from climbplan.store.hdf5_layout import DatasetLayout

FORMATS = {"climb": "climbplan/climb", "transition": "climbplan/transition"}
FORMAT = FORMATS["climb"]
FORMAT_VERSION = 1
STATUSES = ("optimal", "feasible", "infeasible", "limit", "partial")

ROBOT = {
    "shoulder_body": DatasetLayout(("N", 3), "m", "body"),
    "mount_yaw": DatasetLayout(("N",), "rad", "body"),
    "link_lengths": DatasetLayout(("N", "J"), "m"),
    "max_torque": DatasetLayout(("N", "J"), "N m"),
    "joint_stiffness": DatasetLayout(("N", "J"), "N m/rad"),
    "joint_lower": DatasetLayout(("N", "J"), "rad"),
    "joint_upper": DatasetLayout(("N", "J"), "rad"),
    "max_joint_speed": DatasetLayout(("N", "J"), "rad/s"),
    "stance_body": DatasetLayout(("N", 3), "m", "body"),
    "body_hull": DatasetLayout(("*", 3), "m", "body"),
}
ROBOT_TEXTS = {
    "limb_names": DatasetLayout(("N",), kind="text"),
    "sides": DatasetLayout(("N",), kind="text"),
}
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
SOLE_AXES = DatasetLayout(("N", 3, 3), "", "body")

# Of the group `robot/links`, of robots whose limbs have masses, with the attribute `body_mass`
LINKS = {
    "mass": DatasetLayout(("N", "J"), "kg"),
    "middle": DatasetLayout(("N", "J", 3), "m", "body"),  # from the link's joint, at zero angles
    "inertia": DatasetLayout(("N", "J", 3, 3), "kg m^2", "body"),
    "body_middle": DatasetLayout((3,), "m", "body"),
    "body_inertia": DatasetLayout((3, 3), "kg m^2", "body"),
}

# Of the group `robot/joint_dynamics`; plans without it have what torque and speed limits say
JOINT_DYNAMICS = {
    "rotor_inertia": DatasetLayout(("N", "J"), "kg m^2"),
    "damping": DatasetLayout(("N", "J"), "N m s/rad"),
    "viscous_friction": DatasetLayout(("N", "J"), "N m s/rad"),
    "dry_friction": DatasetLayout(("N", "J"), "N m"),
}

# Stored in the group `robot/capsules`, where links are not all straight and alike; C of each limb.
CAPSULES = {
    "joint": DatasetLayout(("N", "*"), kind="int"),
    "ends": DatasetLayout(("N", "*", 2, 3), "m", "body"),
    "radius": DatasetLayout(("N", "*"), "m"),
}

BODY_PART = DatasetLayout(("*", 3), "m", "body")  # robot/body_parts/<index>
TOUCHING = DatasetLayout(("*", 4), kind="int")

ROUNDS = {
    "com": DatasetLayout(("M1", 3), "m", "world"),
    "rpy": DatasetLayout(("M1", 3), "rad", "world"),
    "toes": DatasetLayout(("M1", "N", 3), "m", "world"),
    "region": DatasetLayout(("M1", "N"), kind="int"),
}

INSTANTS = {
    "round": DatasetLayout(("K",), kind="int"),
    "lifted": DatasetLayout(("K", "N"), kind="bool"),
    "contact": DatasetLayout(("K", "N"), kind="bool"),
    "com": DatasetLayout(("K", 3), "m", "world"),
    "rpy": DatasetLayout(("K", 3), "rad", "world"),
    "toes": DatasetLayout(("K", "N", 3), "m", "world"),
    "normal": DatasetLayout(("K", "N", 3), "", "world"),
    "mu": DatasetLayout(("K", "N")),
    "region": DatasetLayout(("K", "N"), kind="int"),
    "joint_angles": DatasetLayout(("K", "N", "J"), "rad"),
    "external_wrench": DatasetLayout(("K", 6), "N, N m", "world"),
}

# Stored in the same group as the instants.
FORCES = {
    "force": DatasetLayout(("K", "N", 3), "N", "world"),
    "joint_torques": DatasetLayout(("K", "N", "J"), "N m", "J^T force; motors bring minus it"),
    "wall_deflection": DatasetLayout(("K", "N", 3), "m", "world"),
    "com_deflection": DatasetLayout(("K", 6), "m, rad", "world"),
    "joint_command": DatasetLayout(("K", "N", "J"), "rad"),
    "toe_command": DatasetLayout(("K", "N", 3), "m", "world"),
    "safety_torque": DatasetLayout(("K",), may_be_infinite=True),
    "safety_friction": DatasetLayout(("K",), may_be_infinite=True),
    "mu_critical": DatasetLayout(("K", "N")),
}

# Of robots with flat feet, in the same group: forces at the corners of soles, in turn from the one
# behind on the left; `force` is their sum.
CORNER_FORCE = DatasetLayout(("K", "N", 4, 3), "N", "world")

# Of robots whose links have masses, in the same group: torques of their own weight; motors hold
# these and `joint_torques`
LINK_TORQUES = DatasetLayout(
    ("K", "N", "J"), "N m", "of the links' weight about the joints; motors bring minus it"
)

TRAJECTORY = {
    "time": DatasetLayout(("T",), "s"),
    "com": DatasetLayout(("T", 3), "m", "world"),
    "rpy": DatasetLayout(("T", 3), "rad", "world"),
    "joint_command": DatasetLayout(("T", "N", "J"), "rad"),
    "contact": DatasetLayout(("T", "N"), kind="bool"),
}

# Of motions that are timed by the dynamics of their links, in the same group, with the moments of
# flat feet; torques are those of contact forces, weight and inertia of the links
PACED = {
    "force": DatasetLayout(("T", "N", 3), "N", "world"),
    "torque": DatasetLayout(("T", "N", "J"), "N m", "motors bring minus it"),
}
PACED_MOMENT = DatasetLayout(("T", "N", 3), "N m", "world, about the toes")

LIMITS = {
    "goal_com": DatasetLayout((3,), "m", "world"),
    "goal_toes": DatasetLayout(("N", 3), "m", "world"),
    "goal_rpy": DatasetLayout((3,), "rad", "world"),
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
    "vertices": DatasetLayout(("*", 3), "m", "world"),
    "normal": DatasetLayout((3,), "", "world"),
    "A": DatasetLayout(("*", 3), "", "world"),
    "b": DatasetLayout(("*",), "m"),
}
# terrain/surfaces/<index>/hold, attribute `undercut` [rad]: how a gripper can grip it
HOLD = {"axis": DatasetLayout((3,), "", "world"), "orientation": DatasetLayout((3,), "rad")}
TUBE = {"center": DatasetLayout((2,), "m", "world")}
TUBE_NUMBERS = ("radius", "lower", "upper")
ALLOWED = DatasetLayout(("N", "R"), kind="bool")

# terrain/obstacles/<index> and terrain/free_choices/<index>/<index>: {x : A x <= b}
VERTICES = DatasetLayout(("*", 3), "m", "world")
HALF_SPACES = {"A": DatasetLayout(("*", 3), "", "world"), "b": DatasetLayout(("*",), "m")}

# terrain/scan, attributes `flatness` and `toe_radius` [m]: the raw surface near the way
SCAN = {
    "vertices": DatasetLayout(("*", 3), "m", "world"),
    "triangles": DatasetLayout(("*", 3), kind="int"),
}
SCAN_NUMBERS = ("flatness", "toe_radius")
SCAN_DEPTH = "finger_depth"  # only where grippers hold what was scanned

SEQUENCES = {
    "cost": DatasetLayout(("Q",)),
    "safety_torque": DatasetLayout(("Q",), may_be_infinite=True),
    "safety_friction": DatasetLayout(("Q",), may_be_infinite=True),
}
SEQUENCES_TEXTS = {
    "name": DatasetLayout(("Q",), kind="text"),
    "outcome": DatasetLayout(("Q",), kind="text"),
}

TEXTS = DatasetLayout(("*",), kind="text")
STUDY_LABEL = DatasetLayout(("*", "*"), kind="int")
STUDY_VALUES = DatasetLayout(("*",))
