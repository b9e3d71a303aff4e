"""URDFs of walking robots, written for tests: any number of legs of three to seven joints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

# Kinds of joints along a leg, by how many it has: yaw, roll about the leg, lift of a link, knee,
# twist about a link, ankle.
KINDS = {
    3: ("yaw", "lift", "knee"),
    4: ("yaw", "lift", "knee", "ankle"),
    5: ("yaw", "roll", "lift", "knee", "ankle"),
    6: ("yaw", "roll", "lift", "twist", "knee", "ankle"),
    7: ("yaw", "roll", "lift", "twist", "knee", "turn", "ankle"),
}
# Length of the link that each joint moves [m]; "ankle" takes its own off the last link before it.
_LENGTH = {"yaw": 0.057, "roll": 0.0, "lift": 0.195, "twist": 0.0, "knee": 0.375, "turn": 0.0}
_ANKLE = 0.10
_BOUND = {
    "yaw": 1.0,
    "roll": 0.6,
    "lift": 1.5,
    "twist": 0.8,
    "knee": 1.5,
    "turn": 0.8,
    "ankle": 1.0,
}
_AXIS = {
    "yaw": "0 0 1",
    "roll": "1 0 0",
    "lift": "0 -1 0",
    "twist": "1 0 0",
    "knee": "0 -1 0",
    "turn": "0 0 1",
    "ankle": "0 -1 0",
}


@dataclass(frozen=True)
class Walker:
    """A robot with pairs of legs; base axes x forward, y left, z up (REP 103)."""

    forward: tuple[float, ...] = (0.2, -0.2)  # of the first joints of each pair [m]
    sprawl_deg: tuple[float, ...] = (30.0, -30.0)  # direction of each pair off straight aside
    joints: int = 3
    effort: float = 60.0  # [N m]
    body_mass: float = 4.0  # [kg]
    link_mass: float = 0.2  # [kg] of each link of a leg
    half_width: float = 0.12  # [m] of the first joints off the middle
    mesh: str = ""  # collision mesh of the base, a box if left out
    pins: bool = False  # whether legs end in pins with round tips, 3 mm in radius

    def names(self) -> list[str]:
        """Legs: L1, R1, L2, ..."""
        return [f"{side}{pair + 1}" for pair in range(len(self.forward)) for side in "LR"]

    def text(self) -> str:
        """The URDF."""
        base = f'<mesh filename="{self.mesh}"/>' if self.mesh else '<box size="0.4 0.2 0.08"/>'
        parts = [
            '<?xml version="1.0"?>',
            f'<robot name="walker{2 * len(self.forward)}">',
            '  <link name="base_link">',
            f"    {_inertial(self.body_mass)}",
            f"    <collision><geometry>{base}</geometry></collision>",
            "  </link>",
        ]
        for pair, (x, sprawl) in enumerate(zip(self.forward, self.sprawl_deg, strict=True)):
            for side, sign in (("L", 1.0), ("R", -1.0)):
                parts += self._leg(f"{side}{pair + 1}", x, sign, sprawl)
        return "\n".join([*parts, "</robot>", ""])

    def write(self, path: Path) -> Path:
        """Write the URDF."""
        path.write_text(self.text(), encoding="utf-8")
        return path

    def _leg(self, name: str, x: float, sign: float, sprawl: float) -> list[str]:
        """A leg out to the side; its zero has femur outward and tibia down."""
        yaw = sign * math.pi / 2 - sign * math.radians(sprawl)
        kinds = KINDS[self.joints]
        has_ankle = "ankle" in kinds
        parent, out, effort = "base_link", [], self.effort
        at = f'xyz="{x} {sign * self.half_width} 0" rpy="0 0 {yaw}"'
        for kind in kinds:
            child = f"{name}_{kind}_link"
            bound = _BOUND[kind]
            out += [
                f'  <joint name="{name}_{kind}" type="revolute">',
                f'    <parent link="{parent}"/><child link="{child}"/>',
                f'    <origin {at}/><axis xyz="{_AXIS[kind]}"/>',
                f'    <limit lower="{-bound}" upper="{bound}" effort="{effort}" velocity="5"/>',
                "  </joint>",
            ]
            length = _LENGTH.get(kind, _ANKLE)
            down = kind in ("knee", "turn", "ankle")
            if kind == "knee" and has_ankle:
                length -= _ANKLE
                if "turn" in kinds:
                    at = 'xyz="0 0 0"'
            if kind == "turn":
                length = _LENGTH["knee"] - _ANKLE
            if kind == "knee" and "turn" in kinds:
                length = 0.0
            middle = f"0 0 {-length / 2}" if down else f"{length / 2} 0 0"
            tilt = "0 0 0" if down else f"0 {math.pi / 2} 0"
            out += [f'  <link name="{child}">', f"    {_inertial(self.link_mass, middle)}"]
            if self.pins and kind == "ankle":
                out += _PIN
            elif length > 0:
                out.append(
                    f'    <collision><origin xyz="{middle}" rpy="{tilt}"/><geometry>'
                    f'<cylinder radius="0.02" length="{length}"/></geometry></collision>'
                )
            out.append("  </link>")
            parent = child
            at = f'xyz="0 0 {-length}"' if down else f'xyz="{length} 0 0"'
        out += [
            f'  <joint name="{name}_tip" type="fixed">',
            f'    <parent link="{parent}"/><child link="{name}_toe"/><origin {at}/>',
            "  </joint>",
            f'  <link name="{name}_toe"/>',
        ]
        return out


_PIN = [
    f'    <collision><origin xyz="0 0 {at}" rpy="0 0 0"/>'
    f"<geometry><{shape}/></geometry></collision>"
    for at, shape in (
        (-0.025, 'cylinder radius="0.02" length="0.05"'),
        (-0.07425, 'cylinder radius="0.0015" length="0.0485"'),
        (-0.0985, 'sphere radius="0.0015"'),
    )
]


def _inertial(mass: float, at: str = "0 0 0") -> str:
    small = 1e-3 * mass
    return (
        f'<inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia ixx="{small}" ixy="0" '
        f'ixz="0" iyy="{small}" iyz="0" izz="{small}"/></inertial>'
    )


QUADRUPED = Walker(joints=4)
OCTOPOD = Walker(
    forward=(0.27, 0.09, -0.09, -0.27),
    sprawl_deg=(25.0, 8.0, -8.0, -25.0),
    effort=25.0,
    body_mass=5.0,
)
