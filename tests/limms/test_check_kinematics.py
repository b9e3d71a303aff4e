"""The checker's kinematics of modules against the planners', which it does not share."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.limms.check.kinematics import (
    compute_anchor_end_frame,
    compute_ground_end_frame,
    compute_mated_end_frame,
    compute_points,
)
from climbplan.limms.modules.chain import forward, forward_from_last
from climbplan.limms.modules.limbs import compute_end_rotation, compute_standing_rotation
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, FramePoses
from climbplan.limms.schema.loading import list_builtin_modules, load_builtin_module

FACING = np.diag([1.0, -1.0, -1.0])  # ends of a kind face each other, eq. (6.1)


@pytest.mark.parametrize("end", [0, 1])
def test_points_of_a_module(end: int) -> None:
    rng = np.random.default_rng(end)
    module = load_builtin_module(list_builtin_modules()[0])
    angles = rng.uniform(-3, 3, (40, 6))
    held = FramePoses(
        rng.uniform(-1, 1, (40, 3)),
        np.tile(compute_anchor_end_frame(SIDE_NORMALS[1], end), (40, 1, 1)),
    )
    own = compute_points(module, end, held, angles)
    theirs = (forward if end == 0 else forward_from_last)(module, held, angles)
    np.testing.assert_allclose(own.position, theirs.position, atol=1e-12)
    np.testing.assert_allclose(own.rotation, theirs.rotation, atol=1e-12)


def test_frames_of_ends() -> None:
    normals = [*SIDE_NORMALS, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])]
    carrying = np.stack([compute_end_rotation(normal, 0) for normal in normals])
    for end in (0, 1):
        np.testing.assert_allclose(
            compute_ground_end_frame(end), compute_standing_rotation(end), atol=1e-15
        )
        for normal in normals:
            np.testing.assert_allclose(
                compute_anchor_end_frame(normal, end), compute_end_rotation(normal, end), atol=1e-15
            )
        np.testing.assert_array_equal(compute_mated_end_frame(carrying, 1 - end, end), carrying)
        np.testing.assert_allclose(
            compute_mated_end_frame(carrying, end, end), carrying @ FACING, atol=1e-15
        )
