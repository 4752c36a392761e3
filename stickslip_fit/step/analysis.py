"""What a stage's step is, and what it depends on: one step in time, and sweeps of one quantity at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stickslip_fit._summary import Summarized
from stickslip_fit._typing import Array
from stickslip_fit.step.stage import (
    GRAVITY,
    Stage,
    StepSweep,
    StepTrace,
    quantity_of,
    step_or_nan,
    sweep_step,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FACTORS = np.array([0.5, 0.5**0.5, 1.0, 2**0.5, 2.0])
LOADS = np.linspace(-1.0, 1.0, 5)  # of the weight
FINER = 16  # intervals between two of these, where a step takes no time to compute
USE = (0, 10_000, 100_000, 1_000_000, 10_000_000, 100_000_000)  # steps
SMALL = 0.01  # share, for slopes
LATE, HARDLY = 0.02, 0.002  # share of the time and of the step


@dataclass(frozen=True, eq=False, repr=False)
class StageAnalysis(Summarized):
    """A stage's step.

    Attributes
    ----------
    stage : Stage
    step : float
        m.
    trace : StepTrace
        One step in time.
    sweeps : tuple of StepSweep
        Against load, from -1 g to +1 g beside the stage's own, then mass, voltage, preload and ramp time,
        from half to twice.
    elasticities : dict of str to float
        Relative change of the step over that of each of these, but the load.
    load_slope, load_curvature : float
        Step at 1 g more against the motion: change of the odd part, m, and even part over odd part; nan where
        the friction does not hold 1 g.
    coulomb_step : float
        With Coulomb friction on a foot that follows its waveform, m.
    linear_step : float
        Of a piezo with the same travel and no hysteresis, m; that of the stage if it has none.
    in_use : tuple of (int, float)
        Numbers of steps made without a pause, and the step after them, m; empty for a stage without drift.
    """

    stage: Stage
    step: float
    trace: StepTrace
    sweeps: tuple[StepSweep, ...]
    elasticities: dict[str, float]
    load_slope: float
    load_curvature: float
    coulomb_step: float
    linear_step: float
    in_use: tuple[tuple[int, float], ...] = ()

    @property
    def rests(self) -> bool:
        """Whether the slider hardly moves any more when the next step begins."""
        if self.stage.is_rigid:
            return self.stage.rests_between_steps
        late = self.trace.time >= (1 - LATE) * self.trace.time[-1]
        return bool(np.ptp(self.trace.slider[late]) <= HARDLY * abs(self.step))

    def plot_step(self) -> Figure:
        """Draw one step in time, and the sweeps."""
        from stickslip_fit.plotting.step import draw_step

        return draw_step(self)


def analyse_stage(stage: Stage, *, progress: Callable[[str, float], None] | None = None) -> StageAnalysis:
    """Compute the step of a stage, and what it depends on.

    Parameters
    ----------
    stage : Stage
    progress : callable, optional
        Called with what is done now, and the share that is done.

    Raises
    ------
    InputError
        For values that have no step; `StepLimitError` where the solver gives up.

    Examples
    --------
    >>> from stickslip_fit.step import Contact, Drive
    >>> stage = Stage("example", 5e-3, Contact(0.2, 1.25), Drive(80.0, 30e-9, 1.4e-4, 5e-6, 2.25e-4))
    >>> {name: round(value, 2) for name, value in analyse_stage(stage).elasticities.items()}
    {'mass': -1.0, 'voltage': 0.0, 'preload': 1.0, 'ramp time': 2.0}
    """
    step, quantities = stage.step(), ["mass", "voltage", "preload"]
    if stage.drive.table is None:
        quantities.append("ramp time")
    finer = FINER if stage.is_rigid else 1
    sweeps = [sweep_step(stage, "load", stage.load + GRAVITY * _refine(LOADS, finer))]
    elasticities = {}
    for place, name in enumerate(quantities, start=1):
        if progress is not None:
            progress(f"step size against {name}", place / (len(quantities) + 1))
        own = quantity_of(stage, name)
        sweeps.append(sweep_step(stage, name, own * np.exp(_refine(np.log(FACTORS), finer))))
        low, high = sweep_step(stage, name, own * np.array([1 - SMALL, 1 + SMALL])).steps
        elasticities[name] = float((high - low) / (2 * SMALL * step))
    below, above = sweeps[0].steps[[0, -1]]
    odd = (above - below) / 2
    hysteresis = stage.drive.hysteresis
    rigid = replace(stage, contact=replace(stage.contact, model="coulomb"), foot=None, base=None)
    return StageAnalysis(
        stage=stage,
        step=step,
        trace=stage.trace(),
        sweeps=tuple(sweeps),
        elasticities=elasticities,
        load_slope=float(odd),
        load_curvature=float(((above + below) / 2 - step) / -odd) if odd else float("nan"),
        coulomb_step=rigid.step(),
        linear_step=replace(stage, drive=stage.drive.without_hysteresis()).step() if hysteresis else step,
        in_use=tuple((count, step_or_nan(stage.after(count))) for count in USE if stage.drift is not None),
    )


def _refine(points: Array, finer: int) -> Array:
    """Points between those of the table, for the figure."""
    places = np.arange(len(points))
    return np.interp(np.linspace(0, len(points) - 1, finer * (len(points) - 1) + 1), places, points)
