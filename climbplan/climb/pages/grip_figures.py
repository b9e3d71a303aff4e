"""The key figures of grips: gripping forces, pull-out margins by hold, wrists, spines."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.gripper import WRIST_JOINTS

UNITS = {
    "grips.gripping_force.*": "N",
    "grips.max_force": "N",
    "grips.least_pull_margin.margin": "N",
    "grips.holds.spines": "N",
    "grips.holds.gripping_force": "N",
    "grips.holds.pull": "N",
    "grips.holds.pull_margin": "N",
    "grips.moment": "N m",
    "grips.wrist_torque.torque": "N m",
    "grips.wrist_torque.max_torque": "N m",
}


def compute_grip_figures(plan: ClimbPlan) -> dict[str, Any]:
    """Return the section "grips" of a report; empty for robots without grippers.

    Pulls and margins are those of limbs in contact, worst over the instants; a margin that no pull
    uses up is null.
    """
    gripper, grips = plan.robot.gripper, plan.grips
    if gripper is None or grips is None:
        return {}
    instants, names = plan.instants, plan.robot.limb_names
    contact = instants.contact
    force = grips.instants.grip
    onto = np.einsum("kni,kni->kn", plan.forces.force, instants.normal)
    margin = np.where(contact, grips.pull_margin, np.inf)
    k, limb = (int(i) for i in np.unravel_index(int(np.argmin(margin)), margin.shape))
    torque_ratio = np.abs(grips.wrist_torque) / gripper.wrist_max_torque
    w, wrist, joint = (
        int(i) for i in np.unravel_index(int(np.argmax(torque_ratio)), torque_ratio.shape)
    )
    holds = []
    for region in np.unique(instants.region[contact]):
        on_hold = contact & (instants.region == region)
        min_margin = float(margin[on_hold].min())
        holds.append(
            {
                "hold": plan.terrain.surfaces[region].name,
                "limbs": [names[i] for i in np.flatnonzero(on_hold.any(axis=0))],
                "spines": float(grips.spines[region]),
                "gripping_force": float(force[on_hold].max()),
                "pull": float(max(-onto[on_hold].min(), 0.0)),
                "pull_margin": min_margin if np.isfinite(min_margin) else None,
            }
        )
    grip = {names[i]: float(force[contact[:, i], i].max(initial=0.0)) for i in range(len(names))}
    section = {
        "risk": grips.risk,
        "max_force": gripper.max_force,
        "gripping_force": {"least": float(force[contact].min()), "most": float(force.max())},
        "gripping_force_by_limb": grip,
        "least_pull_margin": {
            "margin": float(margin[k, limb]) if np.isfinite(margin[k, limb]) else None,
            "where": instants.label(k, names),
            "limb": names[limb],
            "hold": plan.terrain.surfaces[instants.region[k, limb]].name,
        },
        "moment": float(np.linalg.norm(grips.instants.moment, axis=-1).max()),
        "wrist_torque": {
            "torque": float(abs(grips.wrist_torque[w, wrist, joint])),
            "max_torque": float(gripper.wrist_max_torque[joint]),
            "where": instants.label(w, names),
            "limb": names[wrist],
            "joint": WRIST_JOINTS[joint],
        },
        "holds": holds,
    }
    return {"grips": section}
