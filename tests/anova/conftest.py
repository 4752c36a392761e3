"""Logs of constant steps, made by hand: what a factor does is put in and nothing else."""

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.logs import Log

Reading = tuple[str, str, float, float]
"""Session, direction, theta in deg, step size in nm."""


@pytest.fixture
def log_of_readings(read_table) -> Callable[..., Log]:
    """A log of joint 3 at q2 = -90 degrees with exactly counted steps."""

    def make(readings: Sequence[Reading], stretch_mm: float = 12.0, pause_s: float = 300.0) -> Log:
        rows, clocks = [], {}
        for session, direction, theta, step_nm in readings:
            clock = clocks.setdefault(session, pd.Timestamp(2012, 3, 5 + len(clocks), 8, 30))
            clocks[session] = clock + pd.Timedelta(seconds=pause_s)
            ends = (0.0, stretch_mm) if direction == "+" else (stretch_mm, 0.0)
            rows.append(
                {
                    "session": session, "time": clock.isoformat(), "joint": 3, "direction": direction,
                    "steps": round(stretch_mm * 1e6 / step_nm), "q1_deg": 0.0, "q2_deg": -90.0, "q3_mm": "",
                    "theta_deg": theta, "psi_deg": 0.0, "from_mm": ends[0], "to_mm": ends[1],
                    "check_every": 1,
                }
            )  # fmt: skip
        return read_table(pd.DataFrame(rows))

    return make


@pytest.fixture
def readings_of() -> Callable[..., list[Reading]]:
    """Readings of a design, with noise: `counts` of each (session, direction, theta)."""

    def make(
        counts: dict[tuple[str, str, float], int],
        shift: Callable[[str, str, float], float] = lambda *_: 0.0,
        noise: float = 2.6,
        seed: int = 1,
    ) -> list[Reading]:
        rng = np.random.default_rng(seed)
        return [
            (*cell, 960.0 + shift(*cell) + noise * rng.standard_normal())
            for turn in range(max(counts.values()))
            for cell, count in counts.items()
            if turn < count
        ]

    return make
