"""The worst of many residuals, and where it was."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.limits import judge
from climbplan.verification.check import Check


@dataclass
class Worst:
    """Largest residual of each check so far."""

    found: dict[str, tuple[float, str]] = field(default_factory=dict)

    def look(self, name: str, time: Array, residual: Array, what: str = "") -> None:
        """Residuals (M, ...) at times (M,); NaN counts as the worst."""
        if residual.size == 0:
            self.found.setdefault(name, (0.0, ""))
            return
        flat = residual.reshape(len(time), -1).max(axis=1)
        k = int(np.argmax(np.where(np.isnan(flat), np.inf, flat)))
        value = float(flat[k])
        before = self.found.get(name)
        if before is None or np.isnan(value) or value > before[0]:
            place = f"{time[k]:.3f} s" + (f", {what}" if what else "")
            self.found[name] = (value, place)

    def check(self, name: str, none: float = 0.0, gap: bool = False) -> Check:
        """The check of that name; `none` if nothing was looked at. gap: residual is minus a gap."""
        value, place = self.found.get(name, (none, ""))
        margin = f"{-1e3 * value:.2f} mm left" if gap and value < 0 else ""
        return judge(name, value, place, margin)
