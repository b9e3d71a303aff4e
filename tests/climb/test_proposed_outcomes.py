"""What `new robot` says of plans that keep none of their margins."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from climbplan.climb.proposed_outcome import Outcome


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (None, "climbs: verified"),
        ([1.0, 0.05], "climbs: verified"),
        # A motor at its limit is no spring
        ([1.0, 0.0], "climbs: verified, but may fall: 0% of its margins (torque of RF knee)"),
        ([0.9, -0.4], "climbs: verified, but may fall: -40% of its margins (torque of RF knee)"),
    ],
)
def test_plans_that_keep_none_of_their_margins_may_fall(
    kept: list[float] | None, words: str
) -> None:
    share = None if kept is None else np.array(kept)
    forces = SimpleNamespace(margin_share=share, notes=("torque of RF knee",))
    plan: Any = SimpleNamespace(forces=forces)
    assert str(Outcome("climbs", plan, "")) == words
