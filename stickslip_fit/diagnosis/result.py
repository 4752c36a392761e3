"""Diagnosis: the result of `diagnose` and of `diagnose_table`, and what can be asked of it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._summary import Summarized
from stickslip_fit._threads import one_blas_thread
from stickslip_fit.diagnosis._methods import describe_methods, list_references
from stickslip_fit.diagnosis.explanation import explain_structure
from stickslip_fit.diagnosis.extended_table import make_table_fit
from stickslip_fit.diagnosis.finding import DataInfo, Finding, Gain, LogInfo, NextTraverse, TableInfo
from stickslip_fit.diagnosis.gain import FoldSearches, measure_gain
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.residuals import remove_effects
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.diagnosis.stage_change import StageReading
from stickslip_fit.diagnosis.table_gain import measure_table_gain
from stickslip_fit.diagnosis.withdrawal import explain_unsupported, find_unsupported, withdraw_causes
from stickslip_fit.errors import InputError, check_workers
from stickslip_fit.estimation import Result, fit_least_squares
from stickslip_fit.estimation.result import AxesArray, build_provenance, convert_table
from stickslip_fit.estimation.table_fit import TableFit
from stickslip_fit.logs import Log
from stickslip_fit.logs.history import DEPARTURES

Verdict = Literal["nothing wrong", "cause named", "cannot tell apart", "unknown cause"]


def choose_verdict(findings: tuple[Finding, ...]) -> Verdict:
    """The verdict: the first finding decides it."""
    if not findings:
        return "nothing wrong"
    if findings[0].cause == UNKNOWN:
        return "unknown cause"
    return "cannot tell apart" if findings[0].equivalent else "cause named"


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Summarized):
    """What is wrong with the published laws in a log, and the selection that it follows from.

    Attributes
    ----------
    verdict : str
    findings : tuple of Finding
        Largest effect first, structure without a name last.
    p_value : float
        Of the whole search; `misfit` says how it is computed.
    misfit : float
        Rms residual of the baseline, relative; outliers are left out.
    repeatability : float
        Repeatability standard deviation, relative; rms over the rows.
    inclusion : dict of str to float or None
        Posterior probability of each cause; None where it is untestable.
    untestable : dict of str to str
        Causes that the log could not show, with the reason.
    alpha : float
    seed : int
    seconds : float
    selection : Selection
    aliased_causes : tuple of (str, str)
        Pairs of which the second cause can produce in this log every effect of the first.
    gain, gain_new_session : Gain or None
        On held-out traverses, and on new sessions known by their calibration; None if not measured.
    next_experiment : tuple of NextTraverse
    stage : tuple of StageReading
        Which change of friction, mass, voltage or ramp time the findings of a log stand for.
    log : Log or None
        None where the data were no log.
    table : TableInfo or None
        The table, where the data were one; sizes are then in the unit of its response.
    noise_properties : tuple of str
        In which the noise is not as assumed: memory, skewed, rounded, gross errors, uneven.
    notes : tuple of str
        Sentences on what the search for a cause had to leave out.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    p_value: float
    misfit: float
    repeatability: float
    inclusion: Mapping[str, float | None]
    untestable: Mapping[str, str]
    alpha: float
    seed: int
    seconds: float
    selection: Selection
    aliased_causes: tuple[tuple[str, str], ...] = ()
    gain: Gain | None = None
    gain_new_session: Gain | None = None
    next_experiment: tuple[NextTraverse, ...] = ()
    stage: tuple[StageReading, ...] = ()
    log: Log | None = None
    table: TableInfo | None = None
    noise_properties: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def info(self) -> DataInfo:
        """What the data are called, and how sizes are shown."""
        return LogInfo() if self.table is None else self.table

    @property
    def log_file(self) -> str:
        """The first file of the log, or that of the table; empty where there is none."""
        if self.table is not None:
            return self.table.file
        return self.log.sources[0][0] if self.log is not None and self.log.sources else ""

    @property
    def log_sha256(self) -> str:
        """Hash of the log or table; empty where there is none."""
        if self.table is not None:
            return self.table.sha256
        return self.log.sha256 if self.log is not None else ""

    @property
    def files(self) -> tuple[str, ...]:
        """What was read, which no output replaces."""
        if self.table is not None:
            return self.table.files
        return self.log.files if self.log is not None else ()

    def require_log(self) -> Log:
        """The log, for what needs its machine and its laws.

        Raises
        ------
        InputError
            If the data were no log.
        """
        if self.log is None:
            raise InputError("this diagnosis is not of a log: use `diagnose` on a log instead")
        return self.log

    @one_blas_thread
    def measure_gain(self, *, workers: int = -1, progress: ProgressCallback = ignore_progress) -> Diagnosis:
        """The same diagnosis with `gain`, `gain_new_session` and the gain of each finding.

        A cause with which held-out traverses are predicted worse is no longer named: it becomes ``unknown``
        with a note (`withdrawal`), and the gain is measured again.

        `workers` are processes, all cores without it; the numbers do not depend on it.

        Raises
        ------
        InputError
            If `workers` is neither -1 nor at least 1.
        """
        check_workers(workers)
        began, selection, findings = time.perf_counter(), self.selection, self.findings
        inclusion = dict(self.inclusion)
        searches = FoldSearches(selection, self.alpha, self.seed, findings)
        options: Any = {"searches": searches, "workers": workers, "progress": progress}
        while True:
            if self.table is not None:
                measured = measure_table_gain(selection, findings, self.table, **options)
            else:
                machine = self.log.machine if self.log is not None else None
                measured = measure_gain(selection, findings, machine, **options)
            gain, new_session, findings = measured
            unsupported = find_unsupported(findings)
            if not unsupported:
                break
            for one in unsupported:
                # Something is there, and if not this cause, it has no name: probabilities change places.
                probability = inclusion[one.cause] or 0.0
                unknown = selection.behind(one).cause_set.probability.get(UNKNOWN, 0.0)
                there = max(probability, inclusion.get(UNKNOWN) or 0.0)
                inclusion |= {one.cause: min(unknown, probability), UNKNOWN: there}
            selection, findings = withdraw_causes(selection, findings, unsupported, self.info)
            options["progress"] = _say_again(progress, [one.cause for one in unsupported])
        return replace(
            self,
            verdict=choose_verdict(findings),
            findings=findings,
            selection=selection,
            inclusion=inclusion,
            gain=gain,
            gain_new_session=new_session,
            seconds=self.seconds + time.perf_counter() - began,
        )

    @property
    def withdrawn(self) -> dict[str, str]:
        """Causes that are not named since they do not predict better, with the reason as a clause."""
        every = (one for finding in self.findings for one in finding.withdrawn)
        return {one.cause: explain_unsupported(one.gain, self.info) for one in every if one.gain is not None}

    def explain_unknown(self) -> pd.DataFrame:
        """Each known cause's share of the unknown structure, and what it alone would gain.

        Returns
        -------
        DataFrame
            cause; share of the structure's square that it explains; error, the rms error of the step size
            (relative) on held-out traverses with it in the law; gain, how much less that is than without it.
            Largest share first; no rows where nothing unknown was found.

        Raises
        ------
        InputError
            If the data were no log.
        """
        self.require_log()
        for finding in self.findings:
            if finding.cause == UNKNOWN:
                return explain_structure(self.selection, finding)
        return pd.DataFrame({"cause": pd.Series(dtype=str), "share": [], "error": [], "gain": []})

    def extended_law(self, *, command: str = "") -> Result | TableFit:
        """The law extended by the named causes, fitted to the log or the table.

        Of causes that the data cannot separate, the likeliest is in the law. Outlying counts or values are
        excluded; unknown structure is in the law as the term or smooth function of its finding, if it has
        one. Rows are weighted by the noise that was found. Functions with about as many coefficients as rows
        leave no residuals to tell the repeatability, which is then that of the diagnosis. `command` is for
        the result's provenance.

        Returns
        -------
        Result or TableFit
            Of a log or of a table.

        Raises
        ------
        InputError
            If the data were neither a log nor a table.
        """
        if self.table is not None:
            return make_table_fit(self.selection.problem, self.selection.fit, self.table, command=command)
        log, problem = self.require_log(), self.selection.problem
        usable = log.rows.index[log.rows["status"] == "ok"]
        noise = pd.Series(1.0, usable)
        noise[np.delete(usable, self.selection.outliers)] = problem.noise_ratio
        for finding in self.findings:
            if finding.traverses is not None:
                log = log.exclude(usable[finding.traverses.index])
        causes = [finding.version for finding in self.findings if finding.version is not None]
        fitted = log
        if columns := [name for cause in causes for name in cause.columns if name in DEPARTURES]:
            departures = problem.rows[columns].set_axis(np.delete(usable, self.selection.outliers))
            fitted = replace(log, rows=log.rows.join(departures))
        laws = {part.law.joint: part.law for part in problem.parts}
        ratio = noise[log.rows.index[log.rows["status"] == "ok"]].to_numpy() if noise.nunique() > 1 else None
        known = problem.noise_beside(causes)
        result = fit_least_squares(
            fitted, laws=laws, causes=causes, repeatability=known, noise_ratio=ratio, command=command
        )
        flags = tuple(one for one in result.flags if not known or one.flag != "repeatability_doubted")
        return replace(result, provenance=build_provenance(log, command), flags=flags)

    def corrected_log(self) -> Log:
        """The log with the fitted effect of what extends the law taken out of its counts.

        Outlying counts are excluded. The counts are no longer whole numbers; what else follows time, day or
        position is still in them.

        Raises
        ------
        InputError
            If the data were no log.
        """
        causes = [one.cause for one in self.selection.law_causes]
        return remove_effects(self.require_log(), self.selection, causes)

    def methods(self) -> str:
        """How the log was analysed, as a paragraph to cite, with this log's numbers and its references.

        Raises
        ------
        InputError
            If the data were no log.
        """
        return "\n\n".join([*describe_methods(self), "References", "\n".join(list_references(self))])

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter of the named causes, one row each.

        cause, name, joint, direction, session (None for one of the whole campaign), unit, and in this unit
        estimate, low, high (95 %), as in the JSON; `Diagnosis.si` has them in SI.
        """
        return convert_table(self.si.parameters, ("estimate", "low", "high"))

    @property
    def si(self) -> DiagnosisInSI:
        """The table of parameters in SI."""
        return DiagnosisInSI(self._collect_parameters())

    def _collect_parameters(self) -> pd.DataFrame:
        columns = ["cause", "name", "joint", "direction", "session", "unit", "estimate", "low", "high"]
        rows = [
            (finding.cause, p.name, p.joint, p.direction, p.session, p.unit, *astuple(p.size))
            for finding in self.findings
            for p in finding.parameters
        ]
        return pd.DataFrame(rows, columns=columns)

    @property
    def residuals(self) -> pd.DataFrame:
        """The log's rows with the relative residuals `before` (published law) and `after` (extended law).

        The directions of the calibration parameters are projected out; outlying counts are left out.
        """
        first, last = self.selection.problem.linearize(), self.selection.linearized
        return self.selection.problem.rows.assign(
            before=first.unwhiten(first.residual), after=last.unwhiten(last.residual)
        )

    @property
    def ranking(self) -> pd.DataFrame:
        """Every candidate cause, likeliest first.

        cause, probability (NaN where it is untestable), untestable and withdrawn: the reason.
        """
        table = pd.DataFrame({"cause": list(self.inclusion), "probability": list(self.inclusion.values())})
        table["probability"] = table["probability"].astype(float)
        for name in ("untestable", "withdrawn"):
            table[name] = [getattr(self, name).get(cause, "") for cause in table["cause"]]
        return table.sort_values("probability", ascending=False, kind="stable", ignore_index=True)

    def plot(self) -> AxesArray:
        """Residuals before and after the first finding; without one, residuals against every quantity."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_diagnosis

        return collect_axes(plot_diagnosis(self))

    def plot_residuals(self, finding: int = 0) -> AxesArray:
        """Residuals before and after a finding, over the variable that it follows.

        Raises
        ------
        InputError
            If there is no such finding, or it has no shape.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_residuals

        return collect_axes(plot_residuals(self, finding))

    def plot_columns(self) -> AxesArray:
        """Residuals before and after against every column of a table that varied.

        Raises
        ------
        InputError
            If the data were no table, or no column varies.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.table import plot_columns

        if self.table is None:
            raise InputError("plot_columns is for the diagnosis of a table; a log's report has this figure")
        return collect_axes(plot_columns(self, self.table))

    def plot_ranking(self) -> AxesArray:
        """Probability of each cause, in each test of the residuals."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_ranking

        return collect_axes(plot_ranking(self))

    def plot_gain(self) -> AxesArray:
        """Errors on held-out traverses by session, before and after.

        Raises
        ------
        InputError
            If no gain was measured, or no cause is named.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_gain

        return collect_axes(plot_gain(self))


@dataclass(frozen=True)
class DiagnosisInSI:
    """The table of a diagnosis's parameters in SI; `Diagnosis.parameters` says its columns."""

    parameters: pd.DataFrame


def _say_again(progress: ProgressCallback, causes: Sequence[str]) -> ProgressCallback:
    """Progress of work that is done again, without some causes."""
    return lambda step, done: progress(f"{step}, again without {join_words(causes)}", done)
