"""What an exported motion of a climb is on the URDF itself, by Pinocchio and nothing of ours."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from climbplan.exports.motion import RobotMotion
from climbplan.exports.sidecar import collect_facts


class Statics(NamedTuple):
    """Largest departures over all samples."""

    toe: float  # [m] of links of toes from where they are said to be
    torque: float  # [N m] of torque and gravity from what holds the links
    wrench: float  # [N, N m] that is left on the root link


class Played:
    """A motion on its URDF, root link and joints placed as the motion says."""

    def __init__(self, motion: RobotMotion, urdf: str) -> None:
        self.motion, self.facts = motion, collect_facts(motion)
        self.model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        assert motion.joints is not None
        self.joints = motion.joints

    def configuration(self, sample: int, angles: np.ndarray) -> np.ndarray:
        """Pinocchio's coordinates at a sample."""
        base, facts = self.motion.base, self.facts
        assert base is not None
        assert base.name == facts["base_link"]
        named: dict[str, float] = dict(zip(self.joints.names, angles[sample].tolist(), strict=True))
        held: Any = facts["held_joints"]
        mimics: Any = facts["mimic_joints"]
        named |= held
        for name, by in mimics.items():
            named[name] = by["multiplier"] * named[by["joint"]] + by["offset"]
        q = pin.neutral(self.model)
        q[:7] = [*base.position[sample], *base.quaternion[sample]]
        for name, angle in named.items():
            joint = self.model.getJointId(name)
            at = self.model.idx_qs[joint]
            turns_on = self.model.joints[joint].nq == 2
            q[at : at + 1 + turns_on] = [np.cos(angle), np.sin(angle)] if turns_on else [angle]
        return q

    def toe(self, contact: dict[str, Any]) -> tuple[int, np.ndarray]:
        """Frame and place (3,) of a toe, at the configuration computed last."""
        frame = self.model.getFrameId(contact["link"], pin.FrameType.BODY)
        placed = self.data.oMf[frame]
        return frame, placed.translation + placed.rotation @ np.array(contact["offset"])

    def statics(self, samples: np.ndarray) -> Statics:
        """Of some samples, at the links' own angles."""
        joints, contacts = self.joints, self.motion.contacts
        assert contacts is not None
        assert joints.link_angle is not None
        told: Any = self.facts["contacts"]
        mimics: Any = self.facts["mimic_joints"]
        worst = np.zeros(3)
        for k in samples.tolist():
            q = self.configuration(k, joints.link_angle)
            pin.computeJointJacobians(self.model, self.data, q)
            pin.updateFramePlacements(self.model, self.data)
            tau = pin.computeGeneralizedGravity(self.model, self.data, q).copy()
            for c, contact in enumerate(told):
                if not contacts.touching[k, c]:
                    continue
                frame, toe = self.toe(contact)
                off = np.linalg.norm(toe - contacts.point[k, c]) - contact["radius"]
                whole = pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED)
                arm = contacts.point[k, c] - self.data.oMf[frame].translation
                tau -= (whole[:3] - pin.skew(arm) @ whole[3:]).T @ contacts.force[k, c]
                worst[0] = max(worst[0], abs(off))
            worst[2] = max(worst[2], np.abs(tau[:6]).max())
            column = {n: self.model.idx_vs[self.model.getJointId(n)] for n in self.model.names[2:]}
            for name, by in mimics.items():
                tau[column[by["joint"]]] += by["multiplier"] * tau[column[name]]
            held = np.array([tau[column[name]] for name in joints.names])
            off = np.abs(held - joints.torque[k] - joints.gravity[k]).max()
            worst[1] = max(worst[1], off)
        return Statics(*worst.tolist())
