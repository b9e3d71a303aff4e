"""When a robot counts as fallen, in every engine."""

from __future__ import annotations

import numpy as np

FALLEN = 0.15  # [m] below where it should be
TUMBLED = np.deg2rad(45)  # away from where it should be
