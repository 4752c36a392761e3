"""What the diagnosis of a table says of its findings, its noise, and what it cannot show.

Nothing here converts a unit: a table is in whatever units its columns have.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import stdtr

from stickslip_fit._format import (
    capitalize_first,
    format_duration,
    format_measured,
    format_p_value,
    format_significant,
    join_words,
    pluralize,
)
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.roles import ORDER, ROW_NUMBER
from stickslip_fit.causes.table_terms import GROUP, PREDICTION
from stickslip_fit.diagnosis._noise_words import describe_noise
from stickslip_fit.diagnosis._unknown_summary import (
    PERIOD_OF,
    SETTINGS_OF,
    describe_stand_in,
    name_in_sentence,
)
from stickslip_fit.diagnosis._words import Words, largest_departures, lower_first
from stickslip_fit.diagnosis.autocorrelation import MEDIAN_OF_NORMAL
from stickslip_fit.diagnosis.finding import GIVEN_BEFORE, TO_SOME_EXTENT, Finding, TableInfo, shown_size
from stickslip_fit.diagnosis.gross_errors import TAIL_DF, UNIT_MEDIAN
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.residuals import fitted_effect
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.logs.schema import COVARIATE_PREFIX

FEW_VALUES, TOO_FEW_VALUES = 50, 5  # independent ones: to tell structure from noise; to judge a law by
MAX_RELATIVE_MISFIT = 1.05  # of the scatter of the response, of a law that is merely useless
MAX_NEAR_P_VALUE = 0.1  # of what is told though it raises no alarm
SUSPECT_SD, MAX_SUSPECTS = 5.0, 3  # of a row beside the others; rows
RARE_TABLES, MAX_TABLES = 1e3, 1e6  # of which noise leaves one with such a value; more are not counted
CLEAR_CORRELATION, CLIP_SD = 3.0, 3.0  # standard errors of one of neighbours; of residuals in it
MIN_KEPT = 0.1  # least share of a residual that a fit leaves
FEW_ROWS, MAX_FEW_ROWS, MIN_SHARE_OF_FEW = 0.05, 5, 2.0 / 3.0  # of the rows; of what speaks for a finding
SHARE_OF_ROUNDING = 1e-6  # of the scatter of the response
MAX_PARAMETERS_NAMED, MAX_OUTLIERS_NAMED = 4, 5


@dataclass(frozen=True)
class TableWords(Words):
    """What is said of a table."""

    @property
    def table(self) -> TableInfo:
        """The table."""
        assert self.diagnosis.table is not None
        return self.diagnosis.table

    def outlier_cells(self, row: pd.Series) -> dict[str, str]:
        """See `Words`: rows count from 1, below the header."""
        columns = [self.table.roles.get(role, "") for role in ("session", "time")]
        cells = {name: row[name] for name in columns if name in row}
        shown = {name: f"{one:g}" if isinstance(one, float) else str(one) for name, one in cells.items()}
        return {"row below the header": str(row[ROW_NUMBER] + 1), **shown}

    def flags(self) -> list[str]:
        """See `Words`: that the law predicts no better than a constant.

        Its parameters count as in the adjusted coefficient of determination, which is then below 0.
        """
        diagnosis, table = self.diagnosis, self.table
        if not np.isfinite(diagnosis.repeatability) or _is_too_small(table) or _is_constant(diagnosis):
            return []
        linearized = diagnosis.selection.problem.linearize()
        if diagnosis.misfit**2 * (len(linearized) - 1) <= table.response_sd**2 * linearized.df:
            return []
        left, scatter = map(table.format_size, (diagnosis.misfit, table.response_sd))
        if diagnosis.misfit <= MAX_RELATIVE_MISFIT * table.response_sd:
            return [
                f"The fitted law predicts {table.response} no better than its mean: it leaves {left} rms, "
                f"and the values themselves scatter by {scatter}. Either it has nothing to say here, or its "
                "start values are far off."
            ]
        in_order = ", and whether the rows stand in the order of measurement" * (
            table.roles.get("time") == ORDER
        )
        return [
            f"The fitted law leaves {left} rms where the values of {table.response} themselves scatter by "
            f"{scatter}: check the law and its start values{in_order}."
        ]

    def notes(self) -> tuple[str, ...]:
        """See `Words`; how much the table tells."""
        alike = correlate_neighbours(self.diagnosis.selection.linearized)
        told = describe_independence(self.table, self.diagnosis.findings, alike)
        return (*self.table.notes, *self.diagnosis.notes, told)

    def name_cause(self, cause: str) -> str:
        """See `Words`; with the column."""
        if not cause.startswith(COVARIATE_PREFIX):
            return super().name_cause(cause)
        return f"the response follows the column {cause.removeprefix(COVARIATE_PREFIX)} ({cause})"

    def tell_no_finding(self) -> list[str]:
        noise = describe_noise(self.diagnosis)
        return [self._describe_no_misfit(), *self._describe_nearest(), *noise, *self._describe_suspects()]

    def tell_findings(self) -> list[str]:
        first, *others = self.diagnosis.findings
        sides = map(self.describe_side_effect, others)
        told = f"{self.warn_of_new_session()}{self.describe_finding(first)}."
        noise = describe_noise(self.diagnosis)
        few = self._tell_few_rows()
        return [told, *sides, self._describe_gain(), *few, *noise, *self._describe_suspects()]

    def _tell_few_rows(self) -> list[str]:
        """Which findings rest on few rows, as sentences: by what their law predicts these better."""
        selection, linearized = self.diagnosis.selection, self.diagnosis.selection.linearized
        in_law = {id(one.version) for one in selection.law_causes}
        found, told = [one for one in self.diagnosis.findings if id(one.version) in in_law], []
        if not (number := min(int(FEW_ROWS * len(linearized)), MAX_FEW_ROWS)):
            return []
        for name, finding in zip(name_in_sentence(found), found, strict=True):
            effect = linearized.whiten(fitted_effect(selection, finding.version)[:, None])[:, 0]
            better = (linearized.residual + effect) ** 2 - linearized.residual**2
            rows = np.argsort(-better)[:number]
            share = float(better[rows].sum()) / max(float(better.sum()), np.finfo(float).tiny)
            if MIN_SHARE_OF_FEW < share <= 1.0:
                numbers = join_words([str(one + 1) for one in sorted(linearized.rows[ROW_NUMBER].iloc[rows])])
                told.append(
                    f"{100 * share:.0f} % of what speaks for {name} is in "
                    f"{pluralize(number, 'row')} of {len(linearized):,} ({numbers}): check "
                    f"{'these' if number > 1 else 'it'} first."
                )
        return told

    def describe_carrier(self, carrier: str) -> str:
        return describe_table_carrier(carrier, self.table)

    def describe_effect(self, finding: Finding) -> str:
        if finding.traverses is not None:
            return self._describe_outliers(finding.traverses)
        if getattr(finding.version, "sentence", ""):
            text = str(finding.version.describe(finding.shown_parameters))
            return text if finding.parameters else f"{text}, by {self.format_rms(finding)}"
        phrase = capitalize_first(getattr(finding.version, "phrase", "") or finding.cause)
        source = getattr(finding.version, "source", None)
        if source is not None and not source.phrase:  # the phrase is then the formula, which does not name it
            phrase = f"{capitalize_first(finding.cause)}: {lower_first(phrase)}"
        sizes = _list_sizes(finding)
        if 0 < len(sizes) <= MAX_PARAMETERS_NAMED:
            return f"{phrase} ({', '.join(sizes)})"
        return f"{phrase}, by {self.format_rms(finding)}"

    def _describe_outliers(self, outliers: pd.DataFrame) -> str:
        """Which rows do not belong to the rest, the largest departures first."""
        largest = largest_departures(outliers, MAX_OUTLIERS_NAMED)
        named = self._name_rows(largest[ROW_NUMBER], largest["departure"])
        if more := len(outliers) - len(largest):
            named.append(f"{more:,} more")
        count, do = pluralize(len(outliers), "value"), "does" if len(outliers) == 1 else "do"
        return f"{count} of {self.table.response} {do} not belong to the rest: {join_words(named)}"

    def _name_rows(self, numbers: Iterable[int], departures: Iterable[float]) -> list[str]:
        """Rows, counted from 0, each with by how much it is off."""
        signed, unit = self.table.format_signed, f" {self.table.unit}".rstrip()
        return [
            f"row {number + 1} ({signed(float(off))}{unit})"
            for number, off in zip(numbers, departures, strict=True)
        ]

    def describe_proposal(self, finding: Finding) -> str:
        text = (
            f"What the law leaves of {self.table.response} {self.describe_carrier(finding.carrier)}, by "
            f"{self.format_rms(finding)}, in a way that no cause that was searched describes"
        )
        if finding.term:
            sizes = ", ".join([finding.term, *_list_sizes(finding)])
            return f"{text}; a term is proposed: {sizes}{self.describe_way(finding)}"
        carriers = getattr(finding.version, "carriers", ())
        what = f"a smooth function of {'both' if len(carriers) > 1 else 'it'}"
        if finding.carrier == GROUP:  # a function of other columns, which tells what to expect of a new one
            what = f"a smooth function of {join_words(carriers)}"
        if finding.carrier.startswith(PERIOD_OF):
            what = "a wave"
        elif finding.carrier.startswith(SETTINGS_OF):
            what = "an offset for each"
        return f"{text}; {what} is proposed{self.describe_way(finding)}"

    def _describe_gain(self) -> str:
        """What the named causes gain together; of what has no name, what to do about it."""
        diagnosis, table, gain = self.diagnosis, self.table, self.diagnosis.gain
        size = table.format_size
        noise, left = size(diagnosis.repeatability), size(diagnosis.misfit)
        named = [finding for finding in diagnosis.findings if finding.version is not None]
        if not named:
            if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
                return f"{self.advice_on_unknown}, where the noise is {noise}."
            alone = sum(len(one.traverses) for one in diagnosis.findings if one.traverses is not None) == 1
            left_out = "It is left out" if alone else "They are left out"
            return f"{left_out}; of all others the law leaves {left} rms."
        names = name_in_sentence(named)
        what = f"The law extended by {join_words(names)}"
        if gain is None:
            last = diagnosis.selection.linearized
            rms_after = float(np.sqrt(np.mean(last.unwhiten(last.residual) ** 2)))
            cut = f"leaves {size(rms_after)} rms, instead of {left}"
        else:
            cut = self.describe_cut(gain)
        if gain is not None and gain.given_before:
            before, after = map(size, gain.given_before)
            cut += f" ({GIVEN_BEFORE}: from {before} to {after})"
        advice = "".join(_what_separates(finding, diagnosis) for finding in named)
        unnamed = [finding for finding in named if finding.cause == UNKNOWN]
        if any(finding.carrier == GROUP for finding in unnamed) and "session" not in table.roles:
            advice += (
                f" Name {table.roles[GROUP]} as the session, if each of its values has parameters of its own."
            )
        if unnamed:
            advice += (
                f" What to do: find out what {describe_stand_in(unnamed[0])}, put that into the table as a "
                "column or offer it as a cause of your own, and diagnose again."
            )
        if self._is_rounding:
            return (
                f"{what} {cut}. Over all rows it leaves no more than rounding; no measurement is so exact. "
                f"If {table.response} was computed from these columns, leave them out, and diagnose again."
            )
        return f"{what} {cut}; the noise is {noise}.{advice}"

    @property
    def _is_rounding(self) -> bool:
        """Whether a law predicts the response as exactly as its numbers are written."""
        return self.diagnosis.repeatability < SHARE_OF_ROUNDING * self.table.response_sd

    def _describe_no_misfit(self) -> str:
        diagnosis, table = self.diagnosis, self.table
        if not np.isfinite(diagnosis.repeatability):
            return f"Nothing can be said of this table: {diagnosis.untestable[UNKNOWN]}."
        left = f"{table.format_size(diagnosis.misfit)} rms"
        p = format_p_value(diagnosis.p_value, relation=True)
        if _is_too_small(table):
            return (
                "This table cannot show whether anything is wrong: with noise that persists so long, its "
                f"{table.rows:,} values of {table.response} tell as much as "
                f"{max(round(table.independent), 1)}, too few to judge the law by. It leaves {left} (p {p})."
            )
        return (
            f"Nothing is wrong that this table can show: the law leaves {left} of {table.response}, as noise "
            f"alone would (p {p})."
        )

    def _describe_nearest(self) -> list[str]:
        """What came closest to an alarm, as a sentence; none where nothing came near."""
        diagnosis, table = self.diagnosis, self.table
        misfit = diagnosis.selection.first_misfit
        if not misfit.log_evidence_by_cause or misfit.p_value > MAX_NEAR_P_VALUE:
            return []
        cause = max(misfit.log_evidence_by_cause, key=lambda name: misfit.log_evidence_by_cause[name])
        if cause != UNKNOWN:
            what = self.name_cause(cause)
        else:
            carrier = misfit.best_hypothesis(UNKNOWN).cause.removeprefix(f"{UNKNOWN}:")
            what = f"{table.response} {self.describe_carrier(carrier)} beyond the law"
        return [
            f"Closest to an alarm, which needs p < {diagnosis.alpha:g}: {what}. More rows, or replicates of "
            "these, would show whether it is there."
        ]

    def _describe_suspects(self) -> list[str]:
        """The rows that are far off beside the others, as a sentence; none where there are none."""
        diagnosis, selection = self.diagnosis, self.diagnosis.selection
        if not np.isfinite(diagnosis.repeatability) or self._is_rounding:
            return []
        linearized = selection.linearized
        size, is_far = _measure_departures(linearized, diagnosis.alpha)
        far = np.argsort(-np.where(is_far, size, 0.0))[: min(MAX_SUSPECTS, int(is_far.sum()))]
        if not len(far):
            return []
        left, foretold = linearized.residual * linearized.scale, ""
        # The filter's rows give the departure from what the rows before foretell.
        if linearized.noise_filter is not None:
            left = left / linearized.noise_filter.diagonal()
            foretold = " what the rows before foretell"
        named = join_words(self._name_rows(linearized.rows[ROW_NUMBER].iloc[far], left[far]))
        largest = float(size[far].max())
        check = (
            f"Check {named}: {'up to ' * (len(far) > 1)}{format_significant(largest, 2)} standard deviations "
            f"off{foretold}, by the scatter of the others."
        )
        if diagnosis.findings:
            return [f"{check} A mistake there would bear on all of this: correct it, and repeat."]
        rarity = _describe_rarity(largest, self.table, diagnosis.alpha)
        return [f"{check} {rarity}, so that nothing is set aside."]


def _measure_departures(linearized: LinearizedFit, alpha: float) -> tuple[Array, BoolArray]:
    """How many standard deviations each row is off by the scatter of the others, and which are far off.

    By their median; in few rows, which one departure may turn about itself, also without that row, where a
    normal distribution leaves one so far off in a share `alpha` of tables at most (externally studentized
    residuals; R. D. Cook and S. Weisberg, Residuals and Influence in Regression, 1982, section 2.2.2).
    """
    kept = np.maximum(1.0 - linearized.leverage, MIN_KEPT)
    off, tiny = np.abs(linearized.residual) / np.sqrt(kept), np.finfo(float).tiny
    by_median = off / max(float(np.median(off)) / MEDIAN_OF_NORMAL, tiny)
    df = max(linearized.df - 1, 1)
    by_others = off / np.sqrt(np.maximum(np.sum(linearized.residual**2) - off**2, tiny) / df)
    size, is_rare = np.maximum(by_median, by_others), 2.0 * len(off) * stdtr(df, -by_others) < alpha
    return size, (by_median > SUSPECT_SD) | ((by_others > SUSPECT_SD) & is_rare)


def _list_sizes(finding: Finding) -> list[str]:
    return [f"{one.name} = {format_measured(shown_size(one), one.unit)}" for one in finding.shown_parameters]


def _what_separates(finding: Finding, diagnosis: Diagnosis) -> str:
    """Which data would separate a cause from its rivals, where the causes say what shows them best."""
    if not finding.equivalent:
        return ""
    known = {cause.name: getattr(cause, "shows_best", "") for cause in diagnosis.selection.problem.causes}
    advice = [f"for {name}, {known[name]}" for name in finding.cause_set if known.get(name)]
    if not advice:
        return " Data in which the two differ more would separate them."
    return f" What would separate them: {'; '.join(advice)}."


def correlate_neighbours(linearized: LinearizedFit) -> float:
    """Lag-1 correlation of residuals in the order of the table, within sessions; 0 where it is not clear."""
    session = linearized.rows["session"].to_numpy(object)
    size = np.clip(linearized.residual, -CLIP_SD, CLIP_SD)
    pairs = session[1:] == session[:-1]
    if not pairs.any():
        return 0.0
    correlation = float(np.mean((size[1:] * size[:-1])[pairs])) / (float(np.mean(size**2)) or 1.0)
    return correlation if correlation * np.sqrt(pairs.sum()) > CLEAR_CORRELATION else 0.0


def describe_independence(table: TableInfo, findings: Sequence[Finding] = (), neighbours: float = 0.0) -> str:
    """How many independent values a table has beside what was found, as sentences.

    Without a time the residuals of `neighbours` in the table may correlate all the same.

    Examples
    --------
    >>> describe_independence(TableInfo("F", "N", 1.0, 600, 120.0, 5.0, roles={"time": "t"}))
    'The 600 values of F tell as much as about 120 independent ones: the noise persists over 5.0 rows.'
    >>> describe_independence(TableInfo("F", "N", 1.0, 600, 600.0, roles={"time": "t"}))
    'The noise of the 600 values of F shows no autocorrelation: all count as independent.'
    >>> describe_independence(TableInfo("F", "N", 1.0, 600, 600.0))
    'All 600 values of F count as independent, as no column was named as the time.'
    """
    if "time" not in table.roles:
        told = (
            f"All {table.rows:,} values of {table.response} count as independent, as no column was named as "
            "the time."
        )
        if not neighbours:
            return told
        advice = "if the rows stand in the order of measurement, name 'order' as the time"
        if table.unnamed_time:
            advice = f"name {table.unnamed_time!r}, which has times, as the time"
        return (
            f"{told} But what the law leaves of neighbouring rows is alike (correlation {neighbours:.2f}): "
            f"{advice}, which allows for noise that persists. Until then an alarm may be due to that alone."
        )
    if not table.is_correlated and any(one.carrier == "memory" for one in findings):
        return (
            f"All {table.rows:,} values of {table.response} count as independent: what carries over from one "
            "row to the next counts as found, not as noise."
        )
    if not table.is_correlated:
        return (
            f"The noise of the {table.rows:,} values of {table.response} shows no autocorrelation: "
            "all count as independent."
        )
    swing = ""
    if np.isfinite(table.noise_period):
        period = format_duration(table.noise_period, table.time_unit)
        swing = f"swings with a period of about {period}: what repeats so passes for noise"
    if swing and round(table.independent) == table.rows:
        return f"The noise of the {table.rows:,} values of {table.response} {swing}."
    span = f"{format_significant(table.correlation_rows, 2)} rows"
    if np.isfinite(table.correlation_time) and table.time_unit != "rows":
        span += f" ({format_duration(table.correlation_time, table.time_unit)})"
    warnings = f" It {swing}." if swing else ""
    if table.independent < FEW_VALUES:
        warnings += " What changes as slowly as that passes for noise: a longer record would tell them apart."
    return (
        f"The {table.rows:,} values of {table.response} tell as much as about {round(table.independent):,} "
        f"independent ones: the noise persists over {span}.{warnings}"
    )


def _is_too_small(table: TableInfo) -> bool:
    """Whether so few values count as independent that no law can be judged by them."""
    return table.is_correlated and round(table.independent) <= TOO_FEW_VALUES


def _is_constant(diagnosis: Diagnosis) -> bool:
    """Whether the law has one value in each session: that of autocorrelated noise is not the mean."""
    problem = diagnosis.selection.problem
    return all(
        np.ptp(part.law.predict(problem.rows.iloc[rows], part.values[inside])) == 0
        for part in problem.parts
        for block in np.unique(part.block)
        for inside in [part.block == block]
        for rows in [part.rows[inside]]
    )


def _describe_rarity(size: float, table: TableInfo, alpha: float) -> str:
    """How often noise leaves a value so many robust standard deviations off, without a full stop."""
    deviation = size / MEDIAN_OF_NORMAL * UNIT_MEDIAN
    tables = 1.0 / max(2.0 * table.rows * float(stdtr(TAIL_DF, -deviation)), 1.0 / MAX_TABLES)
    if tables < RARE_TABLES:
        return f"Noise with heavy tails leaves such a value of {table.response} now and then"
    count = f"1 of {float(f'{tables:.2g}'):,.0f}" if tables < MAX_TABLES else "fewer than 1 of 1,000,000"
    return (
        f"Even noise with heavy tails (Student t, {TAIL_DF:g} df) leaves such a value of {table.response} in "
        f"only {count} tables, but p over all that was tested is not below {alpha:g}"
    )


def describe_table_carrier(carrier: str, table: TableInfo) -> str:
    """What unknown structure does, as the end of a sentence.

    Examples
    --------
    >>> table = TableInfo("F", "N", 1.0, 600, 600.0, roles={"time": "t", "group": "Lot"})
    >>> describe_table_carrier("time", table), describe_table_carrier("memory", table)
    ('changes slowly with time', 'carries over from one row to the next')
    >>> describe_table_carrier("settings of d and tube", table)
    'differs between settings of d and tube'
    >>> describe_table_carrier("group", table), describe_table_carrier("covariate:T to some extent", table)
    ('differs between values of Lot', 'follows T to some extent')
    """
    if carrier.startswith(PERIOD_OF):
        return f"comes and goes with a {carrier}"
    if carrier.startswith(SETTINGS_OF):
        return f"differs between {carrier}"
    if carrier == "memory":
        return "carries over from one row to the next"
    if carrier in ("time", "time, the same in each session") and table.roles.get("time"):
        ways = ", in each session in its own way" if carrier == "time" else ", in all sessions alike"
        return f"changes slowly with time{ways if table.roles.get('session') else ''}"
    if carrier.endswith(TO_SOME_EXTENT) and not carrier.startswith(COVARIATE_PREFIX):
        return f"has something of {carrier.removesuffix(TO_SOME_EXTENT)}"
    name, _, opposite = carrier.partition(" by direction")
    way = ", oppositely in the two directions" if opposite or carrier != name else ""
    if name == GROUP:
        return f"differs between values of {table.roles.get(GROUP) or GROUP}{way}"
    shown = "what the law predicts" if name == PREDICTION else name.removeprefix(COVARIATE_PREFIX)
    return f"follows {shown}{way}"
