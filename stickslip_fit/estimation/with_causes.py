"""Least squares of laws with causes: start values, and calibration with the causes' parameters fixed.

A cause has one set of parameters for the whole campaign. The start is the form of each cause that
explains most of the residuals of the published laws, one cause after the other. With fixed causes,
their effect is divided out of the counts and the calibration is solved again until the parameters
converge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
import pandas as pd

from stickslip_fit._format import format_value
from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes import Cause, ExtendedLaw, explain_missing
from stickslip_fit.errors import InputError, check_type
from stickslip_fit.estimation._problem import (
    DEFAULT_OPTIONS,
    FitOptions,
    JointProblem,
    Problem,
    combined_problem,
    single_problem,
)
from stickslip_fit.estimation.noise import Flag, interval_half_widths, quadratic_interval
from stickslip_fit.estimation.result import ALL_JOINTS, JointFit, Result
from stickslip_fit.estimation.shared_estimate import find_variances
from stickslip_fit.estimation.travel import Stretches, unite_travel
from stickslip_fit.laws import Configuration, Rows, State, StepLaw
from stickslip_fit.laws.base import Counter
from stickslip_fit.machine import Machine

MAX_TRIAL_FACTOR = 20.0  # of a start value, in sizes of its trial
LOG_RATIOS = (-2.0, 10.0)  # logarithm of a smooth effect's largest signal over the noise
MIN_LEFT = 1e-12  # share of the squared residuals
SINGULAR_TOL = 1e-9


@dataclass(frozen=True, eq=False)
class ResidualProblem:
    """Residuals of the fitted published laws, shape (n,), and the rows, one joint's after the other's.

    `values` and `slopes` are each row's parameters and the derivatives of its response by them, one array of
    shape (rows, p) for each of the `problems`.
    """

    problems: tuple[JointProblem, ...]
    rows: pd.DataFrame
    values: tuple[Array, ...]
    slopes: tuple[Array, ...]
    residual: Array

    @property
    def df(self) -> int:
        """Rows less the laws' own parameters, at least 1."""
        own = sum(problem.start.size for problem in self.problems)
        return max(len(self.residual) - own, 1)

    def project_out_laws(self, columns: Array) -> Array:
        """Residuals of columns, shape (n, m), regressed on the laws' slopes, group by group."""
        remaining, first = np.empty_like(columns), 0
        for problem, slopes in zip(self.problems, self.slopes, strict=True):
            for group in range(len(problem.groups)):
                subset = np.flatnonzero(problem.groups.of_row == group)
                size = np.abs(slopes[subset]).max(axis=0)
                basis, column = slopes[subset] / np.where(size > 0, size, 1.0), columns[first + subset]
                remaining[first + subset] = column - basis @ np.linalg.lstsq(basis, column, rcond=1e-9)[0]
            first += len(problem.y)
        return remaining

    def effects(self, laws: Sequence[StepLaw], start: Array, version: Cause, trials: Array) -> Array:
        """Change of each response by each trial, in laws that have causes at `start`; shape (n, m)."""
        changes = []
        for law, problem, own in zip(laws, self.problems, self.values, strict=True):
            values = np.column_stack([own, np.tile(start, (len(own), 1))])
            affects_joint = version.acts_on(law)
            no_change = np.zeros((len(own), len(trials)))
            changes.append(version.changes(law, problem.rows, values, trials) if affects_joint else no_change)
        return self.project_out_laws(np.concatenate(changes))


def fit_published_laws(problems: Sequence[JointProblem]) -> ResidualProblem:
    """Fit every joint's published law by itself, all rows alike."""
    minima = [problem.minimize(np.ones(len(problem.y)), problem.start) for problem in problems]
    pairs = zip(problems, minima, strict=True)
    values = tuple(minimum.values[problem.groups.of_row] for problem, minimum in pairs)
    slopes = tuple(problem.model(rows)[1] for problem, rows in zip(problems, values, strict=True))
    rows = pd.concat([problem.rows for problem in problems])
    residual = np.concatenate([minimum.residual for minimum in minima])
    return ResidualProblem(tuple(problems), rows, values, slopes, residual)


def bind_causes(rows: pd.DataFrame, causes: Sequence[Cause], machine: Machine) -> tuple[Cause, ...]:
    """Causes with the means and ranges of a log.

    Raises
    ------
    InputError
        For one that the log cannot show, and why.
    """
    for cause in causes:
        if (reason := explain_missing(cause, rows, machine)) is not None:
            raise InputError(f"{cause.name} cannot be fitted: {reason}")
    return tuple(cause.bind(rows, machine) for cause in causes)


def initial_guess(remainder: ResidualProblem, causes: Sequence[Cause]) -> tuple[tuple[Cause, ...], Array]:
    """The version of each bound cause that explains most, one after the other, and start values.

    Raises
    ------
    InputError
        For a cause that changes no expected count.
    """
    laws: list[StepLaw] = [problem.law for problem in remainder.problems]
    chosen: list[Cause] = []
    start, remaining = np.zeros(0), remainder.residual
    for cause in causes:
        candidates = list(_candidate_starts(remainder, laws, start, cause, remaining))
        if not candidates:
            raise InputError(
                f"{cause.name} changes no expected count of this log, so that there is nothing to fit; "
                "misfires are met by a fit with heavy tails"
            )
        version, values, explained, _ = max(candidates, key=lambda candidate: candidate[3])
        laws = [version.extend(law) for law in laws]
        chosen.append(version)
        start, remaining = np.append(start, values), remaining - explained
    return tuple(chosen), start


def _candidate_starts(
    remainder: ResidualProblem, laws: Sequence[StepLaw], start: Array, cause: Cause, remaining: Array
) -> Iterator[tuple[Cause, Array, Array, float]]:
    """Each version of a cause, its values, the part of the residuals that these explain, (n,), and a score.

    The score is what is explained, of trials in combination less what noise lets as many explain, by the
    Bayesian information criterion; of smooth functions, which would explain ever more, the log evidence.
    """
    price = float(np.log(len(remaining)) * (remaining @ remaining) / remainder.df)
    for version, trials in cause.trials(remainder.rows):
        effects = remainder.effects(laws, start, version, trials)
        if hasattr(version, "with_amplitude"):
            if not effects.any():
                continue
            share, strength, evidence = _shrink(effects, remaining, remainder.df)
            if version.parameters[0].prior_sd == np.inf:
                version = version.with_amplitude(strength)
            yield version, share @ trials, effects @ share, evidence
            continue
        if version.combine_trials:
            share = np.linalg.lstsq(effects, remaining, rcond=1e-9)[0]
            explained = effects @ share
            score = float(explained @ remaining) - price * len(share)
            yield version, version.combine(share, trials), explained, score
            continue
        absent = version.null_values[0]
        for trial, effect in zip(trials, effects.T, strict=True):
            if effect @ effect > 0:
                share = np.clip(effect @ remaining / (effect @ effect), -MAX_TRIAL_FACTOR, MAX_TRIAL_FACTOR)
                values = np.append(absent + share * (trial[0] - absent), trial[1:])
                yield version, values, share * effect, float(share * effect @ remaining)


def _shrink(effects: Array, remaining: Array, df: int) -> tuple[Array, float, float]:
    """Shares of effects, (n, m) -> (m,), with independent normal priors, their likeliest sd, its evidence.

    The evidence is the log likelihood over that of noise alone, the noise of unknown size.
    """
    from scipy.optimize import minimize_scalar

    left, singular, right = svd(effects)
    along = left.T @ remaining
    total = max(float(remaining @ remaining), np.finfo(float).tiny)
    relative = singular / singular[0]

    def deviance(log_ratio: float) -> float:
        signal = (np.exp(log_ratio) * relative) ** 2
        explained = float(np.sum(along**2 * signal / (1.0 + signal))) / total
        return float(np.sum(np.log1p(signal))) + df * float(np.log(max(1.0 - explained, MIN_LEFT)))

    best = minimize_scalar(deviance, bounds=LOG_RATIOS, method="bounded")
    signal = (np.exp(best.x) * relative) ** 2
    kept = signal / (1.0 + signal)
    noise = np.sqrt(max(total - float(np.sum(along**2 * kept)), MIN_LEFT * total) / df)
    known = singular > SINGULAR_TOL * singular[0]
    share = right[known].T @ (kept * along / np.where(known, singular, 1.0))[known]
    return share, float(noise * np.exp(best.x) / singular[0]), -0.5 * float(best.fun)


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
    published = [single_problem(laws[joint], rows, DEFAULT_OPTIONS) for joint, rows in by_joint.items()]
    remainder = fit_published_laws(published)
    chosen, start = initial_guess(remainder, bind_causes(remainder.rows, causes, machine))
    options.check([*laws.values(), *(ExtendedLaw(law, chosen) for law in laws.values())])
    problems = []
    for problem, values in zip(published, remainder.values, strict=True):
        extended = single_problem(ExtendedLaw(problem.law, chosen), problem.rows, options)
        of_group = values[np.unique(problem.groups.of_row, return_index=True)[1]]
        problems.append(_begin_at(extended, of_group, start))
    if not all(
        np.isfinite(problem.model(problem.start[problem.groups.of_row])[0]).all() for problem in problems
    ):
        # Sizes by linear effects, under which a joint would stall.
        start = np.concatenate([cause.start_values for cause in chosen])
        problems = [_begin_at(one, one.start[:, : -len(start)], start) for one in problems]
    prior_sd = np.array([parameter.prior_sd for cause in chosen for parameter in cause.parameters])
    return problems, combined_problem(problems, len(start), prior_sd)


def _begin_at(problem: JointProblem, own: Array, start: Array) -> JointProblem:
    """The problem with start values of each group, shape (g, p), and of the causes, (q,), within bounds."""
    first = np.column_stack([own, np.tile(start, (len(own), 1))])
    return replace(problem, start=np.clip(first, problem.lower, problem.upper))


def published_problem(problem: JointProblem) -> JointProblem:
    """The problem with the published law's parameters only."""
    if not isinstance(problem.law, ExtendedLaw):
        return problem
    own = slice(0, len(problem.law.law.parameters))
    parts = {name: getattr(problem, name)[:, own] for name in ("start", "scales", "lower", "upper")}
    sharing = replace(problem.sharing, parameters=problem.sharing.parameters[own])
    return replace(problem, law=problem.law.law, sharing=sharing, **parts)


def flag_causes(fits: Sequence[JointFit], at_bound: Sequence[np.ndarray]) -> list[Flag]:
    """Flags on the causes' parameters, once for all joints; `at_bound`, shape (g, p), is of each fit."""
    flags: list[Flag] = []
    law = fits[0].law
    assert isinstance(law, ExtendedLaw)
    causes = [cause for cause in law.causes for _ in cause.parameters]
    for k, cause in enumerate(causes, start=-len(causes)):
        parameter = law.cause_parameters[k]
        name, value = parameter.title, format_value(fits[0].values[0, k], parameter.unit, 4)
        if parameter.sudden:
            flag = "chosen"
            text = f"{name} = {value} was chosen among the gaps between traverses; it has no error bar"
        elif any(joint_at_bound[:, k].any() for joint_at_bound in at_bound):
            flag = "at_bound"
            text = f"{name} is held back by its bound at {value}; the other error bars take it for true"
        elif not all(fit.known[:, k].all() for fit in fits):
            flag = "not_identified"
            text = f"{name} cannot be known from the whole campaign; what would show it: {cause.shows_best}"
        else:
            continue
        flags.append(Flag(flag, ALL_JOINTS, "", "", (parameter.name,), text))
    return flags


SAME_LOG = (
    "the causes were fitted on this very log: its scatter is what they leave of it, not an error to expect "
    "of other traverses, and the error bars are as small; fit another log with them, or take the held-out "
    "error of the diagnosis"
)


def flag_same_log(result: Result, causes_from: Result | None) -> Result:
    """The result with a flag if the causes that it takes as known were fitted to its own log."""
    if causes_from is None or causes_from.provenance.log_sha256 != result.provenance.log_sha256:
        return result
    return replace(result, flags=(*result.flags, Flag("same_log", ALL_JOINTS, "", "", (), SAME_LOG)))


CalibrationSolver = Callable[[Array], Array]
"""Steps of each calibration traverse to parameters of the published law, (g, p) -> (g, p)."""

MAX_PASSES = 100
PARAMETER_TOL = 1e-10  # of a change of the parameter that matters
DIFFERENCE_STEP = 1e-3  # of a cause's scale
EFFECT_TOL = 1e-9


@dataclass(frozen=True, eq=False)
class FixedCauses:
    """Causes as a result has them: values, shape (q,), covariance, (q, q), and interval, (q, 2).

    `travel` is where its log's traverses went, by joint, as of a `JointFit`.
    """

    causes: tuple[Cause, ...]
    values: Array
    covariance: Array
    interval: Array
    travel: dict[int, dict[str, Stretches]] = field(default_factory=dict)

    def hold(self, laws: Mapping[int, StepLaw]) -> dict[int, StepLaw]:
        """The laws of joints with these causes."""
        return {joint: FixedCauseLaw(law, self.causes, self.values) for joint, law in laws.items()}


def fixed_causes(result: Result, machine: Machine | None = None) -> FixedCauses:
    """The causes of a result, for the log of a machine if one is given.

    Raises
    ------
    InputError
        If its laws have none, their sizes are not all known, or it is of another machine.
    """
    check_type("causes_from", result, Result)
    if machine is not None and result.machine.sha256 != machine.sha256:
        raise InputError("the causes were fitted for another machine; read the log with that one")
    fits = list(result.joints.values())
    law = fits[0].law
    if not isinstance(law, ExtendedLaw):
        raise InputError("the laws of this result have no causes in them; fit a log with --cause, save that")
    last = slice(-len(law.cause_parameters), None)
    known = np.all([fit.known[:, last].all(axis=0) for fit in fits], axis=0)
    if not known.all():
        unknown = ", ".join(
            p.title for p, is_known in zip(law.cause_parameters, known, strict=True) if not is_known
        )
        raise InputError(f"this result does not know {unknown}; fit its log without that cause")
    # They are the same in all groups but those without error bars.
    variances = np.concatenate([find_variances(fit.covariance)[:, last] for fit in fits])
    interval = np.concatenate([fit.interval[:, last] for fit in fits])
    best = int(np.argmax(np.isfinite(variances).all(axis=1)))
    covariance = next(islice((group for fit in fits for group in fit.covariance), best, None))[last, last]
    travel = {joint: fit.travel for joint, fit in result.joints.items()}
    return FixedCauses(law.causes, fits[0].values[0, last], covariance, interval[best], travel)


class FixedCauseLaw(StepLaw):
    """A published law with causes whose parameters, `sizes` of shape (q,), or (n, q) by row, are fixed."""

    name = "held"

    def __init__(self, law: StepLaw, causes: Sequence[Cause], sizes: Array) -> None:
        self.law = law
        self.extended = ExtendedLaw(law, causes)
        self.sizes = sizes
        self.joint = law.joint
        self.parameters = law.parameters

    @property
    def prismatic(self) -> bool:
        return self.law.prismatic

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.extended.columns

    @property
    def max_panel(self) -> float:  # type: ignore[override]
        return self.extended.max_panel

    def whole(self, values: Array) -> Array:
        """Parameters of the extended law, (..., p) -> (..., p + q)."""
        sizes = np.broadcast_to(self.sizes, (*values.shape[:-1], self.sizes.shape[-1]))
        return np.concatenate([values, sizes], axis=-1)

    def gamma(self, state: State, values: Array) -> Array:
        return self.extended.gamma(state, self.whole(values))

    def gamma_slopes(self, state: State, values: Array) -> Array:
        return self.extended.gamma_slopes(state, self.whole(values))[..., : len(self.parameters)]

    def counter(self, rows: Rows) -> Counter:
        extended, own = self.extended.counter(rows), len(self.parameters)

        def count(values: Array) -> tuple[Array, Array]:
            counts, slopes = extended(self.whole(values))
            return counts, slopes[:, :own]

        return count

    def effect(self, rows: Rows, values: Array) -> Array:
        """By how much the causes change log(steps), shape (n,)."""
        return self.extended.predict(rows, self.whole(values)) - self.law.predict(rows, values)

    def start_values(self, mean_step: Array) -> Array:
        return self.law.start_values(mean_step)

    def scales(self, mean_step: Array) -> Array:
        return self.law.scales(mean_step)

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: those of the published law."""
        return self.law.features(rows)

    def calibration(self) -> tuple[Configuration, ...]:
        return self.law.calibration()


def law_without_causes(law: StepLaw) -> StepLaw:
    """The law that causes extend; any other as it is."""
    return law.law if isinstance(law, ExtendedLaw | FixedCauseLaw) else law


def solve_with_fixed_causes(
    law: FixedCauseLaw,
    rows: pd.DataFrame,
    picked: IntArray,
    steps: Array,
    mean_step: Array,
    solve: CalibrationSolver,
) -> Array:
    """Parameters, shape (g, p), under which the calibration traverses take their `steps`, (g, p).

    The causes' effect is divided out of the counts and the published law's equations are solved again, until
    the parameters converge. NaN where a traverse is missing, `picked` being -1, or where the effect of a
    cause on one depends on an unknown parameter.
    """
    values, scales = solve(steps), law.scales(mean_step)
    for _ in range(MAX_PASSES):
        before, values = values, solve(steps / np.exp(_fixed_effects(law, rows, picked, values, mean_step)))
        if np.nan_to_num(np.abs(values - before) / scales).max(initial=0.0) < PARAMETER_TOL:
            return values
    return np.full_like(values, np.nan)


def _fixed_effects(
    law: FixedCauseLaw, rows: pd.DataFrame, picked: IntArray, values: Array, mean_step: Array
) -> Array:
    """The causes' effect on each calibration traverse; NaN where it depends on an unknown parameter."""
    made = picked >= 0
    traverses, group = rows.iloc[picked[made]], np.nonzero(made)[0]
    typical = law.start_values(mean_step)
    effect, other_effect = (
        law.effect(traverses, np.where(np.isnan(values), substitute, values)[group])
        for substitute in (typical, typical + 0.1 * law.scales(mean_step))
    )
    effects = np.full(picked.shape, np.nan)
    effects[made] = np.where(np.abs(effect - other_effect) < EFFECT_TOL, effect, np.nan)
    return effects


def fixed_cause_effect(law: StepLaw, rows: pd.DataFrame, values: Array, mean_step: Array) -> Array | float:
    """By how much fixed causes change each row's log(steps); typical values stand for unknown parameters."""
    if not isinstance(law, FixedCauseLaw):
        return 0.0
    return law.effect(rows, np.where(np.isnan(values), law.start_values(mean_step), values))


def difference_sensitivity(
    fit: JointFit, known: FixedCauses, solve: Callable[[FixedCauseLaw], Array]
) -> Array:
    """Change of calibrated parameters with each size of a fixed cause, by differences; shape (g, p, q).

    `solve` goes from a `FixedCauseLaw` to its calibrated parameters, shape (g, p).
    """
    law, q = fit.law, len(known.values)
    assert isinstance(law, FixedCauseLaw)
    sensitivity = np.zeros((*fit.values.shape, q))
    for k in np.flatnonzero(np.diagonal(known.covariance) != 0):
        step = DIFFERENCE_STEP * law.extended.sizes[k] * (np.arange(q) == k)
        upper, lower = (
            solve(FixedCauseLaw(law.law, known.causes, known.values + sign * step)) for sign in (1, -1)
        )
        sensitivity[:, :, k] = (upper - lower) / (2 * step[k])
    return sensitivity


def release_causes(fit: JointFit, known: FixedCauses, sensitivity: Array) -> JointFit:
    """A calibration with fixed causes as one of the extended law, with the causes' covariance propagated.

    `sensitivity`, shape (g, p, q), is the change of the law's own parameters with each size of a cause.
    """
    law = fit.law
    assert isinstance(law, FixedCauseLaw)
    groups, own, q = len(fit.values), len(law.parameters), len(known.values)
    both = np.concatenate([sensitivity, np.broadcast_to(np.eye(q), (groups, q, q))], axis=1)
    covariance = both @ known.covariance @ both.swapaxes(1, 2)
    covariance[:, :own, :own] += fit.covariance
    values = law.whole(fit.values)
    interval = quadratic_interval(values, covariance, interval_half_widths(fit.groups, fit.repeatability))
    interval[:, own:] = known.interval
    is_known = np.concatenate([fit.known, np.ones((groups, q), dtype=bool)], axis=1)
    travel = unite_travel(fit.travel, known.travel.get(law.joint, {}))
    changes = {"values": values, "covariance": covariance, "interval": interval, "known": is_known}
    return replace(fit, law=law.extended, travel=travel, **changes)
