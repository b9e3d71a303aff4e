"""Colours shared by figures and page, told apart with any common colour blindness.

Limb colours are those of Okabe and Ito, with the two that vanish on white replaced by dark ones.
"""

from __future__ import annotations

LIMBS = (
    "#0072B2",  # blue
    "#D55E00",  # vermillion
    "#009E73",  # green
    "#CC79A7",  # pink
    "#E69F00",  # orange
    "#56B4E9",  # sky
    "#882255",  # wine
    "#7A7A2A",  # olive
)
INK = "#1F2933"
MUTED = "#697586"
GRID = "#D5DBE3"
SURFACE = "#8FA3B8"  # walls and tubes
OBSTACLE = "#B0906A"
BODY = "#4A5A6B"
FAILURE = "#C0392B"  # limits at which the robot slips or overloads
REQUIRED = "#475569"  # margins asked for
FORCE = "#123C8C"
FORCE_ON_PAGES = "#3F74D9"  # seen on white and on dark pages
TRACE = "#9AA5B1"
CONE = "#C0392B"
CONE_SHRUNK = "#E08E79"
LABELS = ("#4DA37F", "#E0A03A", "#8C5FA8")  # feasible, force-, kinematics-infeasible


def choose_ink(color: str) -> str:
    """Return the text colour on "#rrggbb": dark, or white where that has more contrast (WCAG 2)."""
    channels = [int(color[offset : offset + 2], 16) / 255 for offset in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    return INK if luminance > 0.18 else "#FFFFFF"


def choose_limb_color(limb: int) -> str:
    """Return colour of a limb; repeats after eight, where names tell limbs apart."""
    return LIMBS[limb % len(LIMBS)]
