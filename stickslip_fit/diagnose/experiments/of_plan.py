"""A plan on the bench: no counts yet, but laws that are about right and how well a count repeats."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from stickslip_fit.causes import Cause
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.of_log import bench_of
from stickslip_fit.diagnose.searching.testable import untestable
from stickslip_fit.diagnose.searching.too_small import too_small
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import Machine
from stickslip_fit.simulate import LawValues, simulate


def bench_of_plan(
    plan: Plan, truth: LawValues, machine: Machine, causes: Iterable[Cause] | None = None
) -> tuple[Bench, dict[str, str]]:
    """The traverses of a plan as a simulation of it makes them, with their history.

    Parameters
    ----------
    plan : Plan
        With its noise.
    truth : LawValues
    machine : Machine
    causes : iterable of Cause, optional
        The library without it.

    Returns
    -------
    bench : Bench
        With the causes that the plan could show.
    untestable : dict of str to str
        The others, and why.

    Raises
    ------
    InputError
        If the plan cannot be simulated, or has too few traverses to show anything.
    """
    log = simulate(plan, truth, machine)
    assert plan.noise is not None
    given, missing = bench_of(log, causes)
    drives = [(part.law.joint, way) for part in given.parts for way in "+-"]
    repeatability = [plan.noise.repeatability.get(drive, np.nan) for drive in drives]
    bench = replace(given, repeatability=np.array(repeatability))
    study = bench.study()
    if why := too_small(study):
        raise InputError(f"the plan has {why}")
    unable = missing | untestable(bench, study)
    return replace(bench, causes=tuple(each for each in bench.causes if each.name not in unable)), unable
