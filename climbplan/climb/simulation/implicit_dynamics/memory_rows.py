"""Rows of the temporaries in `ScratchMemory`, one for each quantity: none overwrites another."""

# fmt: off
(  # Rows of `vectors`, three numbers each
    # A limb in the body frame: `limb_equilibrium.py` and `redundant_limb_equilibrium.py`
    TOE, TOE_ERROR, TOE_TARGET, ANGLE_STEP, TORQUE, TORQUE_ERROR, STIFFNESS, REACTION,
    # A contact in the world: `contact.py`
    OFFSET, TOE_BODY, FORCE_BODY, DISPLACEMENT, FREE_MOTION, TRIAL_FORCE, CONE_FORCE,
    TANGENT, BINORMAL, CONE_NORMAL, STIFFNESS_NORMAL, SLIDE_DIRECTION, STIFFNESS_DIRECTION,
    # A corner: `corner_contact.py`
    CORNER_POINT, CORNER_NORMAL, SURFACE_FORCE, CORNER_FORCE, REMAINDER,
    # The body: `implicit_step.py`
    GRAVITY_FORCE, MOMENT_ARM, MOMENT, ROTATION_STEP,
    # Odometry and regulator: `regulation.py`
    BODY_CENTROID, WORLD_CENTROID, ROTATED_ARM, WORLD_ARM, ARM_PRODUCT, GRADIENT,
    POSITION_ERROR, ROTATION_ERROR, ROTATION_SHIFT, TOE_OFFSET,
    # Rolling feet: `rolling_contact.py`
    TOE_BEFORE, SHIFT, SURFACE_NORMAL,
    NUM_VECTORS,
) = range(44)
(  # Rows of `matrices`, (3, 3)
    BUFFER, INVERSE, HESSIAN, RESPONSE, TOE_COMPLIANCE,
    STIFFNESS_BODY, COMPLIANCE, FULL_STIFFNESS, STIFFNESS_BLOCK,
    NORMAL_MATRIX, DESIRED_ROTATION,
    NUM_MATRICES,
) = range(12)
(  # Rows of `joint_vectors`, a number for each joint of a limb
    JOINT_TORQUE, JOINT_STIFFNESS, JOINT_STEP, JOINT_ANGLE_STEP, DEFLECTION_ERROR,
    NUM_JOINT_VECTORS,
) = range(6)
# fmt: on
