"""The worst of many residuals, and where it occurs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.limits import judge
from climbplan.verification.check import Check


@dataclass
class WorstResiduals:
    """The largest residual of each check so far."""

    by_check: dict[str, tuple[float, str]] = field(default_factory=dict)

    def update(self, name: str, time: Array, residual: Array, label: str = "") -> None:
        """Compare residuals (M, ...) at times (M,) with the largest so far; NaN counts as the
        worst.
        """
        if residual.size == 0:
            self.by_check.setdefault(name, (0.0, ""))
            return
        by_time = residual.reshape(len(time), -1).max(axis=1)
        k = int(np.argmax(np.where(np.isnan(by_time), np.inf, by_time)))
        value = float(by_time[k])
        incumbent = self.by_check.get(name)
        if incumbent is None or np.isnan(value) or value > incumbent[0]:
            location = f"{time[k]:.3f} s" + (f", {label}" if label else "")
            self.by_check[name] = (value, location)

    def check(self, name: str, default: float = 0.0, gap: bool = False) -> Check:
        """Return the check of a name.

        Args:
            name: Name of the check.
            default: Residual if there was none.
            gap: Whether the residual is minus a gap.
        """
        value, location = self.by_check.get(name, (default, ""))
        margin = f"{-1e3 * value:.2f} mm left" if gap and value < 0 else ""
        return judge(name, value, location, margin)
