"""Robots whose legs have too few joints for climbplan: in how many directions toes can move."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.robots.urdf.pinocchio_model import import_pinocchio
from climbplan.robots.urdf.proposal.limbs import find_body_link, find_limbs
from climbplan.robots.urdf.proposal.propose_robot import read_tree

_DRAWN = 100  # postures
_STILL = 1e-6  # of the largest singular value: a direction in which a toe does not move


def short_limbs(urdf: Path, seed: int) -> str:
    """Words about limbs of fewer joints than planning takes; empty where there are none.

    Of drawn postures the largest rank of Pinocchio's Jacobian of a link that the limb's last joint
    moves, body still.
    """
    tree = read_tree(urdf)
    base = find_body_link(tree)
    pin = import_pinocchio()
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    data, rng = model.createData(), np.random.default_rng(seed)
    ranks: dict[str, int] = {}
    for end in find_limbs(tree, base).too_short:
        joints = [joint.name for joint in tree.way_to(end, base) or [] if joint.turns]
        columns = [model.idx_vs[model.getJointId(name)] for name in joints]
        moved = model.frames[int(model.getFrameId(end, pin.FrameType.BODY))].parentJoint
        frames = [k for k, frame in enumerate(model.frames) if frame.parentJoint == moved]
        for _ in range(_DRAWN):
            turned = np.zeros(model.nv)
            turned[columns] = rng.uniform(-np.pi, np.pi, len(columns))
            q = pin.integrate(model, pin.neutral(model), turned)
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            for frame in frames:
                jacobian = pin.getFrameJacobian(model, data, frame, aligned)[:3, columns]
                values = np.linalg.svd(jacobian, compute_uv=False)
                rank = int((values > _STILL * max(values.max(initial=0.0), 1e-9)).sum())
                ranks[end] = max(ranks.get(end, 0), rank)
    told = (f"{end} moves in {rank} of 3 directions" for end, rank in ranks.items())
    return f"in each of {_DRAWN} drawn postures, body still: {', '.join(told)}" if ranks else ""
