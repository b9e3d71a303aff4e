"""A URDF of a humanoid with legs and arms of four joints, written for tests."""

from __future__ import annotations

from pathlib import Path

_LIMB = (
    ("yaw", "0 0 1", 0.0),
    ("roll", "1 0 0", 0.0),
    ("pitch", "0 1 0", 1.0),
    ("bend", "0 1 0", 1.0),
)
_BOUND = {"yaw": 0.5, "roll": 1.2, "pitch": 1.5, "bend": 2.2}


def humanoid(path: Path, effort: float = 150.0) -> Path:
    """Write it: base axes x forward, y left, z up; 20 kg, hips at 0, shoulders at 0.5 m."""
    pelvis = (
        '<robot name="humanoid"><link name="pelvis"><inertial><origin xyz="0 0 0.2"/>'
        '<mass value="12"/><inertia ixx="0.3" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.1"/>'
        '</inertial><collision><origin xyz="0 0 0.27"/><geometry><box size="0.16 0.2 0.5"/>'
        "</geometry></collision></link>"
    )
    parts = [pelvis]
    for side, sign in (("left", 1), ("right", -1)):
        parts += _limb(f"{side}_leg", (0.0, 0.1 * sign, 0.0), 0.35, effort)
        parts += _limb(f"{side}_arm", (0.0, 0.16 * sign, 0.5), 0.25, effort)
    path.write_text("".join([*parts, "</robot>"]), encoding="utf-8")
    return path


def _limb(name: str, at: tuple[float, float, float], length: float, effort: float) -> list[str]:
    """Two links of one length, hanging down at zero."""
    parent, out = "pelvis", []
    place = " ".join(f"{value:g}" for value in at)
    for kind, axis, long in _LIMB:
        link, half = f"{name}_{kind}", length / 2
        out.append(
            f'<joint name="{link}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit lower="{-_BOUND[kind]}" '
            f'upper="{_BOUND[kind]}" effort="{effort}" velocity="8"/></joint><link name="{link}">'
            f'<inertial><origin xyz="0 0 {-half * long:g}"/><mass value="0.5"/>'
            '<inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial>'
        )
        if long:
            out.append(
                f'<collision><origin xyz="0 0 {-half:g}"/><geometry><cylinder radius="0.03" '
                f'length="{0.9 * length:g}"/></geometry></collision>'
            )
        out.append("</link>")
        parent, place = link, f"0 0 {-length * long:g}"
    out.append(
        f'<link name="{name}_tip"/><joint name="{name}_tip" type="fixed"><parent link="{parent}"/>'
        f'<child link="{name}_tip"/><origin xyz="{place}"/></joint>'
    )
    return out
