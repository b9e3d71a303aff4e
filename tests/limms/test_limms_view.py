"""Modules in the 3-D view."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.limms.pages.scene import read_scene as limms_scene
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports.viewer.scene import interpolate


def test_links_and_box_follow_the_motion(throw: LimmsPlan, throw_file: Path) -> None:
    scene, motion = limms_scene(throw_file), throw.motion
    assert scene.rods is not None
    assert scene.boxes is not None
    # Where modes change a time is there twice, and what comes after it is shown.
    inside = np.flatnonzero(np.diff(motion.time, append=np.inf) > 0)
    for k in inside[:: max(len(inside) // 40, 1)]:
        now = scene.moment(float(motion.time[k]))
        links = interpolate(scene.rods.ends, now).reshape(1, 7, 2, 3)
        np.testing.assert_allclose(links[:, :, 0], motion.joint_position[k][:, :-1], atol=3e-3)
        np.testing.assert_allclose(links[:, :, 1], motion.joint_position[k][:, 1:], atol=3e-3)
        np.testing.assert_allclose(
            interpolate(scene.boxes.center, now), motion.box_position[k], atol=3e-3
        )
    names = {shape.name for shape in scene.shapes}
    assert {"goal", *throw.anchor_names[4:]} <= names


def test_stages_are_stops_with_their_modes(throw: LimmsPlan, throw_file: Path) -> None:
    scene = limms_scene(throw_file)
    assert len(scene.marks) == len(throw.stages)
    for mark, (name, begin, _) in zip(scene.marks, throw.stages, strict=True):
        assert scene.time[mark] >= begin - 1e-9
        assert name in scene.caption[scene.moment(begin + 1e-6)[0]]
