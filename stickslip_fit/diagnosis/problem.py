"""DiagnosisProblem: rows, their laws, responses, noise and candidate causes, built from a log.

The problem knows nothing of actuators: laws and causes act through their interfaces only. It linearizes
the baseline fit, re-estimates the noise, refits the laws with causes in them, and removes rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse import csr_array

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes import Cause, covariates, explain_missing, library
from stickslip_fit.diagnosis.alternatives import build_unstructured_alternatives
from stickslip_fit.diagnosis.autocorrelation import Autocorrelation
from stickslip_fit.diagnosis.expressions import Dictionary, build_log_dictionary
from stickslip_fit.diagnosis.hypotheses import Hypothesis
from stickslip_fit.diagnosis.linearized import (
    ExtendedFit,
    LawBlock,
    LinearizedFit,
    RowChanges,
    cause_jacobian,
    linearize_fit,
    select_parts,
    whiten,
)
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import StructureRemoved
from stickslip_fit.diagnosis.noise import MIN_SD, NoiseEstimate, estimate_noise
from stickslip_fit.diagnosis.noise_shape import Quantization, Skewness, find_count_spacing
from stickslip_fit.diagnosis.penalized_fit import fit_penalized
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.estimation._groups import usable_rows
from stickslip_fit.estimation.drive_ratio import ratio_changes
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.laws import Laws, choose_laws
from stickslip_fit.logs import Log
from stickslip_fit.logs.log import number_configurations

MAX_COEFFICIENTS = 0.5  # with a prior, of the traverses, beside which a fit tells the noise itself
MISFIRE = "end-stop-misfire"
N_REFITS = 3
RESTART_SHARES = (0.3, 0.1)  # of the start values, for fits that do not converge
DEFAULT_REPEATABILITY = 3e-3  # where no group of the log has replicates


@dataclass(frozen=True, eq=False)
class DiagnosisProblem:
    """Rows, laws, noise and candidate causes; n rows.

    Attributes
    ----------
    table : RowTable
        The rows, with a ``session``.
    parts : tuple of LawBlock
        The baseline laws at their fitted values; between them every row once.
    responses, rounding : array, shape (n,)
        What was measured, and the variance that rounding adds.
    noise_group : array of int, shape (n,)
        Index of each row's repeatability.
    repeatability : array
        Standard deviation of the responses of each group.
    causes : tuple
        Candidates, bound to the rows. Each has `name`, `phrase`, `joints`, `session`, `parameters`,
        `null_values`, `start_values`, `scale`, `max_trial_factor`, `combine_trials`, `trials`,
        `largest_plausible`, `extend` and `changes` as a `Cause` has them.
    alternatives : callable
        From a LinearizedFit to the unstructured alternatives, which stand for ``unknown``.
    expressions : callable
        From a LinearizedFit to the short expressions that may describe them.
    configuration : array of int, shape (n,)
        Configuration of each row; the noise may depend on it.
    noise_ratio : array, shape (n,)
        Standard deviation of each row's configuration over that of its group.
    relative_sd : array, shape (n,), or float
        What a row's noise is relative to others' beside that: as a column states it, or as it grows with the
        response.
    n_shared : int
        How many of the laws' parameters, the last ones, have one value for all rows.
    autocorrelation : Autocorrelation or None
        Of the noise of a sampled signal; None for rows that are no such signal.
    outlier_cause : str
        Name of the cause of outlying rows.
    max_causes : int
        After which the search for more ends.
    smooth_columns : array, shape (n, k)
        Columns of numbers in which effects are smooth: rows next to each other there resemble each other.
    n_refits : int
        How many of the likeliest causes are refitted before one is named. Effects far above the noise are
        not linear in their parameters, and a cause that is tried at few sizes loses to another that happens
        to be tried at a better one.
    trimmed : bool
        Whether rows with gross errors were set aside, chosen by the residuals.
    least_sd : float
        Least standard deviation of the noise: with less, the law fits to within rounding.
    spacing : array, shape (n,), or None
        Of responses that are rounded more coarsely than the rows say, 0 of others; None if there are none.
    noise_columns : tuple of str
        Of rows that are no traverses, columns on which the noise may depend.
    uneven : tuple of str
        What the rows have in common whose noise is more than twice as large as others'.
    skewness : Skewness or None
        Of the noise, in units of its standard deviation; None where it is not clear.
    uncertain : tuple of (array of int, array)
        Changes of the responses that the choice of a law leaves open, see `linearize_fit`.
    """

    table: RowTable
    parts: tuple[LawBlock, ...]
    responses: Array
    rounding: Array
    noise_group: IntArray
    repeatability: Array
    causes: tuple[Any, ...]
    alternatives: Callable[[LinearizedFit], Iterable[Hypothesis | AR1]]
    expressions: Callable[[LinearizedFit], Dictionary | None]
    configuration: IntArray
    noise_ratio: Array
    relative_sd: Array | float = 1.0
    n_shared: int = 0
    autocorrelation: Autocorrelation | None = None
    outlier_cause: str = "outliers"
    max_causes: int = 4
    smooth_columns: Array = field(default_factory=lambda: np.zeros((0, 0)))
    n_refits: int = 0
    trimmed: bool = False
    least_sd: float = MIN_SD
    spacing: Array | None = None
    noise_columns: tuple[str, ...] = ()
    uneven: tuple[str, ...] = ()
    skewness: Skewness | None = None
    uncertain: tuple[RowChanges, ...] = ()

    def __len__(self) -> int:
        return len(self.responses)

    @property
    def rows(self) -> pd.DataFrame:
        """The n rows."""
        return self.table.frame

    @property
    def scale(self) -> Array:
        """Standard deviation of each response, shape (n,)."""
        return np.sqrt(self.noise_sd**2 + self.rounding)

    @property
    def noise_sd(self) -> Array:
        """The same without rounding."""
        return self.repeatability[self.noise_group] * self.relative_sd * self.noise_ratio

    def noise_beside(self, causes: Sequence[Any]) -> dict[tuple[int, str], float]:
        """A log's rms noise by joint and direction, of joints in which a fit with the causes cannot tell it.

        Functions with about as many coefficients as a joint has traverses leave no residuals.
        """
        square, known = self.noise_sd**2, {}
        directions = self.rows["direction"].to_numpy(dtype=object)
        for part in self.parts:
            acting = [one for cause in causes if cause.acts_on(part.law) for one in cause.parameters]
            if sum(np.isfinite(one.prior_sd) for one in acting) > MAX_COEFFICIENTS * len(part.rows):
                for way in np.unique(directions[part.rows]):
                    own = part.rows[directions[part.rows] == way]
                    known[part.law.joint, str(way)] = float(np.sqrt(np.mean(square[own])))
        return known

    @property
    def correlation(self) -> Array:
        """Coefficients of the noise's autoregression, of the nearest value first; empty where it has none."""
        return np.zeros(0) if self.autocorrelation is None else self.autocorrelation.coefficients

    @property
    def noise_filter(self) -> csr_array | None:
        """Prediction-error filter of the noise, shape (n, n); None for independent noise."""
        return None if self.autocorrelation is None else self.autocorrelation.noise_filter

    def linearize(self) -> LinearizedFit:
        """The baseline fit, linearized."""
        return self._linearized

    @cached_property
    def _linearized(self) -> LinearizedFit:
        return self._linearize(self.parts, self.n_shared)

    def _linearize(self, parts: Sequence[LawBlock], n_shared: int, **options: Any) -> LinearizedFit:
        options |= {"noise_filter": self.noise_filter, "uncertain": self.uncertain}
        return linearize_fit(self.table, parts, self.responses, self.scale, shared=n_shared, **options)

    @property
    def with_laws_as_chosen(self) -> DiagnosisProblem:
        """The problem of one who takes the laws as they were chosen, as a calibration does."""
        return replace(self, uncertain=())

    def linearize_extended(self, fit: ExtendedFit) -> LinearizedFit:
        """A fit of the extended laws, linearized."""
        known: Any = {"prior_sd": fit.prior_sd, "at_bound": fit.at_bound}
        return self._linearize(fit.parts, self.n_shared + len(fit.values), **known)

    def linearize_causes(self, fit: ExtendedFit) -> tuple[LinearizedFit, Array]:
        """A fit of the extended laws without calibration; the whitened slopes of its causes, shape (n, q)."""
        linearized = self.linearize_extended(replace(fit, at_bound=np.ones_like(fit.at_bound)))
        slopes = linearized.whiten(cause_jacobian(self.table, fit.parts, len(fit.values)))
        return linearized, linearized.project(slopes)

    def log_likelihood(self, fit: ExtendedFit) -> float:
        """Log likelihood of a fit of the extended laws, but for a constant."""
        residual = self.linearize_extended(fit).whiten(fit.residual[:, None])
        noise = 0.0 if self.autocorrelation is None else self.autocorrelation.log_determinant
        return noise - float(np.sum(np.log(self.scale))) - 0.5 * float(np.sum(residual**2))

    def with_autocorrelation(self, fit: ExtendedFit | None = None) -> DiagnosisProblem:
        """The problem with the noise's autocorrelation estimated anew, under a fit or the baseline.

        The baseline is refitted; other data than a sampled signal stay as they are.
        """
        if self.autocorrelation is None or self.autocorrelation.candidate_effects is None:
            return self
        parts, q = (self.parts, 0) if fit is None else (fit.parts, len(fit.values))
        priors: dict[str, Any] = {} if fit is None else {"prior_sd": fit.prior_sd, "at_bound": fit.at_bound}
        independent = linearize_fit(
            self.table, parts, self.responses, self.scale, shared=self.n_shared + q, **priors
        )
        estimate = replace(self, autocorrelation=self.autocorrelation.estimate(independent))
        if not len(self.correlation) and not len(estimate.correlation):
            return self
        return replace(estimate, parts=estimate.fit_extended().parts)

    def estimate_noise(self, linearized: LinearizedFit, left: StructureRemoved) -> NoiseEstimate:
        """The noise, from residuals without structure."""
        return estimate_noise(
            linearized,
            left,
            self.rounding,
            self.noise_group,
            self.configuration,
            self.least_sd,
            self.relative_sd,
            self.noise_columns,
        )

    def with_noise(self, noise: NoiseEstimate) -> DiagnosisProblem:
        """The same problem with other noise."""
        return replace(
            self,
            repeatability=noise.sd,
            noise_ratio=noise.ratio,
            uneven=noise.unevenness.carriers,
            skewness=noise.skewness,
        )

    def quantization(self, linearized: LinearizedFit) -> Quantization | None:
        """The coarse rounding of the responses about a fit; None where there is none."""
        if self.spacing is None:
            return None
        expected = self.responses - linearized.unwhiten(linearized.residual)
        departure = (expected - self.responses) / np.where(self.spacing > 0, self.spacing, np.inf)
        return Quantization(departure, self.spacing / self.scale)

    def refit_extended(self, versions: Sequence[Any], fit: ExtendedFit) -> ExtendedFit:
        """As `fit_extended`, from a fit in other noise."""
        near = tuple(
            replace(part, values=fitted.values[:, : part.values.shape[1]])
            for part, fitted in zip(self.parts, fit.parts, strict=True)
        )
        again = replace(self, parts=near)
        # One that has not converged is the best of all its restarts.
        return again.fit_extended(versions, fit.values) if fit.converged else again._fit(versions, fit.values)

    def fit_extended(self, versions: Sequence[Any] = (), start: Array | None = None) -> ExtendedFit:
        """The baseline extended by causes, refitted.

        A fit that does not converge is restarted nearer to zero effect, where the law is nearly linear; one
        with no finite prediction (a joint stalls) at last from zero effect.
        """
        start = np.zeros(0) if start is None else start
        best = self._fit(versions, start)
        if best.converged or not len(start):
            return best
        absent = np.concatenate([np.array(version.null_values, dtype=float) for version in versions])
        for share in (*RESTART_SHARES, 0.0):
            if not share and np.isfinite(self.chi_square(best)):
                break
            nearer = np.where(_are_sizes(versions), absent + share * (start - absent), start)
            if np.array_equal(nearer, start):
                break
            fit = self._fit(versions, nearer)
            if fit.converged or self.chi_square(fit) < self.chi_square(best):
                best = fit
            if best.converged:
                break
        return best

    def _fit(self, versions: Sequence[Any], start: Array) -> ExtendedFit:
        return fit_penalized(
            self.table,
            self.parts,
            self.responses,
            self.scale,
            versions,
            start,
            n_shared=self.n_shared,
            noise_filter=self.noise_filter,
        )

    def chi_square(self, fit: ExtendedFit) -> float:
        """The sum of squared residuals in units of the noise; infinite where a prediction is no number."""
        total = float(np.sum(whiten(fit.residual, self.scale, self.noise_filter) ** 2))
        return total if np.isfinite(total) else np.inf

    def without_rows(self, removed: IntArray) -> DiagnosisProblem:
        """The problem without some rows, the baseline refitted."""
        smaller = self.select_rows(np.setdiff1d(np.arange(len(self)), removed))
        return replace(smaller, parts=smaller.fit_extended().parts)

    def select_rows(self, kept: IntArray) -> DiagnosisProblem:
        """The problem of some rows in ascending order, the baseline as it is."""
        place = np.full(len(self), -1)
        place[kept] = np.arange(len(kept))
        return replace(
            self,
            autocorrelation=None if self.autocorrelation is None else self.autocorrelation.select(kept),
            relative_sd=np.broadcast_to(self.relative_sd, len(self))[kept],
            spacing=None if self.spacing is None else self.spacing[kept],
            smooth_columns=self.smooth_columns[kept] if self.smooth_columns.size else self.smooth_columns,
            uncertain=tuple(
                (place[rows][place[rows] >= 0], changes[place[rows] >= 0]) for rows, changes in self.uncertain
            ),
            table=RowTable(self.rows.iloc[kept].reset_index(drop=True)),
            parts=select_parts(self.parts, place),
            **{
                name: getattr(self, name)[kept]
                for name in ("responses", "rounding", "noise_group", "configuration", "noise_ratio")
            },
        )


def _are_sizes(versions: Sequence[Any]) -> BoolArray:
    """Which parameters are effect sizes: the first of each cause, or all of one with joint trials."""
    return np.concatenate(
        [[one.combine_trials or k == 0 for k in range(len(one.null_values))] for one in versions]
    )


def problem_from_log(
    log: Log, causes: Iterable[Cause] | None = None, laws: Laws | None = None
) -> tuple[DiagnosisProblem, dict[str, str]]:
    """A log under its laws, see `choose_laws`, fitted to each session and direction.

    Returns
    -------
    problem : DiagnosisProblem
    missing : dict of str to str
        Causes (of the library and the lab's own columns by default) that lack a variable, with the reason.
    """
    rows = usable_rows(log)
    candidates = (*library(), *covariates(rows)) if causes is None else tuple(causes)
    reasons = [explain_missing(cause, rows, log.machine) for cause in candidates]
    missing = {cause.name: why for cause, why in zip(candidates, reasons, strict=True) if why is not None}
    parts, repeatability, uncertain = [], [], []
    responses, rounding = np.zeros(len(rows)), np.zeros(len(rows))
    drive = np.zeros(len(rows), dtype=np.intp)
    backwards = (rows["direction"] == "-").to_numpy()
    for number, (joint, law) in enumerate(choose_laws(rows, log.machine, laws).items()):
        places = np.flatnonzero((rows["joint"] == joint).to_numpy())
        fit, _, _ = fit_joint(law, rows.iloc[places], log.machine)
        block = fit.group_index(rows.iloc[places])
        responses[places], rounding[places] = fit.law.response(rows.iloc[places])
        drive[places] = 2 * number + backwards[places]
        parts.append(LawBlock(fit.law, places, block, fit.values[block]))
        uncertain += [
            (places[own], changes) for own, changes in ratio_changes(law, rows.iloc[places], log.machine)
        ]
        repeatability += [fit.repeatability[direction].value for direction in "+-"]
    steps = rows["steps"].to_numpy(float)
    spacing = find_count_spacing(
        steps, rows["check_every"].to_numpy(float), rows["session"].to_numpy(object), rows["joint"].to_numpy()
    )
    rounding = np.where(spacing > 0, (spacing / steps) ** 2 / 12.0, rounding)
    outlier_causes = {part.law.outlier_cause for part in parts}
    if MISFIRE not in outlier_causes:  # no law counts steps until a stop is heard
        missing.pop(MISFIRE, None)
        candidates = tuple(cause for cause in candidates if cause.name != MISFIRE)
    laws_of_log = [part.law for part in parts]
    sd = np.array(repeatability)
    known = np.isfinite(sd)
    problem = DiagnosisProblem(
        table=RowTable(rows),
        parts=tuple(parts),
        responses=responses,
        rounding=rounding,
        noise_group=drive,
        repeatability=np.where(known, sd, sd[known].mean() if known.any() else DEFAULT_REPEATABILITY),
        causes=tuple(
            cause.bind(rows, log.machine).for_laws(laws_of_log)
            for cause in candidates
            if cause.name not in missing
        ),
        alternatives=build_unstructured_alternatives,
        expressions=partial(build_log_dictionary, machine=log.machine),
        configuration=number_configurations(rows),
        noise_ratio=np.ones(len(rows)),
        spacing=spacing / steps if spacing.any() else None,
        uncertain=tuple(uncertain),
        outlier_cause=min(outlier_causes, default=MISFIRE),
        n_refits=N_REFITS,
    )
    return problem, missing
