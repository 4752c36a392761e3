"""The block-arrow system on its own: what it costs."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit.fit.groups import group_rows
from stickslip_fit.fit.shared import minimise_shared, share_by_direction
from stickslip_fit.laws import Prismatic


def test_the_border_converges_as_fast_as_newton_does():
    """Were the blocks' answer to a change of the border forgotten, a hundred steps would be needed."""
    rng, sessions, each = np.random.default_rng(0), 6, 20
    rows = pd.DataFrame(
        {
            "session": np.repeat([f"day {k}" for k in range(sessions)], each),
            "direction": "+",
            "q2": rng.uniform(-2.3, 0.2, sessions * each),
            "theta": rng.uniform(-1.5, 1.5, sessions * each),
            "psi": rng.uniform(-1, 1, sessions * each),
            "start": 0.0,
            "stop": 0.012,
        }
    )
    law, groups, mean_step = Prismatic(), group_rows(rows), np.full(sessions, 900e-9)
    truth = np.array([970e-9, 0.3, 430e-9]) * np.linspace(0.98, 1.02, sessions)[:, None]
    truth[:, 1] = 0.3
    y = law.predict(rows, truth[groups.of_row]) + 0.003 * rng.standard_normal(len(rows))
    found = minimise_shared(
        law.model(rows), y, np.ones(len(y)), groups, share_by_direction(("a", "b", "c"), ("b",), groups),
        law.start_values(mean_step), law.scales(mean_step),
        lower=np.full((sessions, 3), -np.inf), upper=np.full((sessions, 3), np.inf),
    )  # fmt: skip
    assert found.converged.all()
    assert found.iterations < 8
    assert np.ptp(found.values[:, 1]) == 0.0
