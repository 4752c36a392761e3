"""Published laws with causes in them: one set of the causes' parameters for the whole campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from stickslip_fit._format import format_value
from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.fit.beginning import begin, bound_to, remainder_of
from stickslip_fit.fit.problem import JointProblem, Problem, combined_problem, single_problem
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.result import EVERYWHERE, JointFit
from stickslip_fit.fit.terms import DEFAULT_OPTIONS, FitOptions
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import Machine


def problems_with_causes(
    causes: Sequence[Cause],
    laws: dict[int, StepLaw],
    by_joint: dict[int, pd.DataFrame],
    machine: Machine,
    options: FitOptions,
) -> tuple[list[JointProblem], Problem]:
    """Each joint's problem, the causes' versions chosen and their parameters last, and all of them combined.

    Raises
    ------
    InputError
        If a cause cannot be seen in these rows, or other parameters are to be shared, too.
    """
    if options.shared:
        raise InputError(
            f"{', '.join(options.shared)} cannot be the same in all sessions while causes are fitted; fit "
            "one or the other"
        )
    published = [single_problem(laws[joint], mine, DEFAULT_OPTIONS) for joint, mine in by_joint.items()]
    remainder = remainder_of(published)
    chosen, start = begin(remainder, bound_to(remainder.rows, causes, machine))
    options.check([*laws.values(), *(ExtendedLaw(law, chosen) for law in laws.values())])
    problems = []
    for problem, values in zip(published, remainder.values, strict=True):
        extended = single_problem(ExtendedLaw(problem.law, chosen), problem.rows, options)
        of_group = values[np.unique(problem.groups.of_row, return_index=True)[1]]
        first = np.column_stack([of_group, np.tile(start, (len(of_group), 1))])
        problems.append(replace(extended, start=np.clip(first, extended.lower, extended.upper)))
    return problems, combined_problem(problems, len(start))


def own_part(problem: JointProblem) -> JointProblem:
    """The problem as far as it is the published law's."""
    if not isinstance(problem.law, ExtendedLaw):
        return problem
    own = slice(0, len(problem.law.law.parameters))
    parts = {name: getattr(problem, name)[:, own] for name in ("start", "scales", "lower", "upper")}
    sharing = replace(problem.sharing, parameters=problem.sharing.parameters[own])
    return replace(problem, law=problem.law.law, sharing=sharing, **parts)


def remarks_on_causes(fits: Sequence[JointFit], at_bound: Sequence[np.ndarray]) -> list[Remark]:
    """What is to be said of the causes' parameters, once for all joints.

    Parameters
    ----------
    fits : sequence of JointFit
        With extended laws.
    at_bound : sequence of array of bool, shape (g, p)
        Of each fit.
    """
    remarks = []
    law = fits[0].law
    assert isinstance(law, ExtendedLaw)
    places = iter(range(-len(law.common), 0))
    for cause in law.causes:
        for _ in cause.parameters:
            k = next(places)
            name, value = law.common[k].name, format_value(fits[0].values[0, k], law.common[k].unit, 4)
            if law.common[k].sudden:
                text = f"{name} = {value} was chosen among the gaps between traverses; it has no error bar"
                remarks.append(_remark("chosen", name, text))
            elif any(held[:, k].any() for held in at_bound):
                text = f"{name} is held back by its bound at {value}; the other error bars take it for true"
                remarks.append(_remark("at_bound", name, text))
            elif not all(fit.known[:, k].all() for fit in fits):
                text = (
                    f"{name} cannot be known from the whole campaign; what would show it: {cause.shows_best}"
                )
                remarks.append(_remark("not_identified", name, text))
    return remarks


def _remark(flag: str, name: str, message: str) -> Remark:
    return Remark(flag, EVERYWHERE, "", "", (name,), message)
