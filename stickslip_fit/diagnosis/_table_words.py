"""What a table's diagnosis says whatever was found: of noise, of the law, of what it cannot show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtr

from stickslip_fit._format import format_duration, format_p_value, format_significant, join_words
from stickslip_fit.causes.roles import ORDER, ROW_NUMBER
from stickslip_fit.causes.table_terms import PREDICTION
from stickslip_fit.diagnosis._summary import name_cause
from stickslip_fit.diagnosis.autocorrelation import MEDIAN_OF_NORMAL
from stickslip_fit.diagnosis.finding import TO_SOME_EXTENT, Finding, TableInfo
from stickslip_fit.diagnosis.gross_errors import TAIL_DF, UNIT_MEDIAN
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.logs.schema import COVARIATE_PREFIX

FEW_VALUES, TOO_FEW_VALUES = 50, 5  # independent ones: to tell structure from noise; to judge a law by
MAX_RELATIVE_MISFIT = 1.05  # of the scatter of the response, of a law that is merely useless
MAX_NEAR_P_VALUE = 0.1  # of what is told though it raises no alarm
SUSPECT_SD, MAX_SUSPECTS = 5.0, 3  # of a row beside the others; rows
RARE_TABLES, MAX_TABLES = 1e3, 1e6  # of which noise leaves one with such a value; more are not counted
MIN_KEPT = 0.1  # least share of a residual that a fit leaves


def format_size(value: float, table: TableInfo) -> str:
    """A size in the unit of the response.

    Examples
    --------
    >>> format_size(0.26398, TableInfo("F", "N", 1.0, 600, 600.0))
    '0.264 N'
    """
    return f"{format_significant(value)} {table.unit}".rstrip()


def describe_independence(table: TableInfo, findings: Sequence[Finding] = ()) -> str:
    """How many independent values a table has beside what was found, as a sentence.

    Examples
    --------
    >>> describe_independence(TableInfo("F", "N", 1.0, 600, 120.0, 5.0))
    'The 600 values of F tell as much as about 120 independent ones: the noise persists over 5.0 rows.'
    >>> describe_independence(TableInfo("F", "N", 1.0, 600, 600.0))
    'The noise of the 600 values of F shows no autocorrelation: all count as independent.'
    """
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


def flag_law(diagnosis: Diagnosis, table: TableInfo) -> list[str]:
    """That the law predicts no better than a constant, as a sentence; none where it does.

    Its parameters count as in the adjusted coefficient of determination, which is then below 0.
    """
    if not np.isfinite(diagnosis.repeatability) or _is_too_small(table) or _is_constant(diagnosis):
        return []
    linearized = diagnosis.selection.problem.linearize()
    if diagnosis.misfit**2 * (len(linearized) - 1) <= table.response_sd**2 * linearized.df:
        return []
    left, scatter = (format_size(size, table) for size in (diagnosis.misfit, table.response_sd))
    if diagnosis.misfit <= MAX_RELATIVE_MISFIT * table.response_sd:
        return [
            f"The fitted law predicts {table.response} no better than its mean: it leaves {left} rms, and "
            f"the values themselves scatter by {scatter}. Either it has nothing to say here, or its start "
            "values are far off."
        ]
    in_order = ", and whether the rows stand in the order of measurement" * (table.roles.get("time") == ORDER)
    return [
        f"The fitted law leaves {left} rms where the values of {table.response} themselves scatter by "
        f"{scatter}: check the law and its start values{in_order}."
    ]


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


def describe_no_misfit(diagnosis: Diagnosis, table: TableInfo) -> str:
    if not np.isfinite(diagnosis.repeatability):
        return f"Nothing can be said of this table: {diagnosis.untestable[UNKNOWN]}."
    if _is_too_small(table):
        return (
            "This table cannot show whether anything is wrong: with noise that persists so long, its "
            f"{table.rows:,} values of {table.response} tell as much as {max(round(table.independent), 1)}, "
            f"too few to judge the law by. It leaves {format_size(diagnosis.misfit, table)} rms "
            f"(p {format_p_value(diagnosis.p_value, relation=True)})."
        )
    return (
        f"Nothing is wrong that this table can show: the law leaves {format_size(diagnosis.misfit, table)} "
        f"rms of {table.response}, as noise alone would "
        f"(p {format_p_value(diagnosis.p_value, relation=True)})."
    )


def describe_nearest(diagnosis: Diagnosis, table: TableInfo) -> list[str]:
    """What came closest to an alarm, as a sentence; none where nothing came near."""
    misfit = diagnosis.selection.first_misfit
    if not misfit.log_evidence_by_cause or misfit.p_value > MAX_NEAR_P_VALUE:
        return []
    cause = max(misfit.log_evidence_by_cause, key=lambda name: misfit.log_evidence_by_cause[name])
    if cause != UNKNOWN:
        what = name_table_cause(cause, diagnosis)
    else:
        carrier = misfit.best_hypothesis(UNKNOWN).cause.removeprefix(f"{UNKNOWN}:")
        what = f"{table.response} {describe_table_carrier(carrier, table)} beyond the law"
    return [
        f"Closest to an alarm, which needs p < {diagnosis.alpha:g}: {what}. More rows, or replicates of "
        "these, would show whether it is there."
    ]


def describe_suspects(diagnosis: Diagnosis, table: TableInfo) -> list[str]:
    """The rows that are far off beside the others, as a sentence; none where there are none."""
    selection = diagnosis.selection
    if not np.isfinite(diagnosis.repeatability):
        return []
    linearized = selection.problem.linearize()
    size = linearized.residual / np.sqrt(np.maximum(1.0 - linearized.leverage, MIN_KEPT))
    size /= max(float(np.median(np.abs(size))) / MEDIAN_OF_NORMAL, np.finfo(float).tiny)
    far = np.argsort(-np.abs(size))[:MAX_SUSPECTS]
    far = far[np.abs(size[far]) > SUSPECT_SD]
    if not len(far):
        return []
    left, foretold = linearized.residual * linearized.scale, ""
    # The filter's rows give the departure from what the rows before foretell.
    if linearized.noise_filter is not None:
        left = left / linearized.noise_filter.diagonal()
        foretold = " what the rows before foretell"
    numbers = selection.problem.rows[ROW_NUMBER].to_numpy() + 1
    named = join_words([f"row {numbers[row]} ({format_signed(float(left[row]))})" for row in far])
    largest = float(np.abs(size[far]).max())
    return [
        f"Check {named}: up to {format_significant(largest, 2)} standard deviations off{foretold}, by the "
        f"scatter of the others. {_describe_rarity(largest, table, diagnosis.alpha)}, so that nothing is set "
        "aside."
    ]


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
    >>> describe_table_carrier("group", table), describe_table_carrier("covariate:T to some extent", table)
    ('follows Lot', 'follows T to some extent')
    """
    if carrier.startswith("period of "):
        return f"comes and goes with a {carrier}"
    if carrier == "memory":
        return "carries over from one row to the next"
    if carrier in ("time", "time, the same in each session") and table.roles.get("time"):
        ways = ", in each session in its own way" if carrier == "time" else ", in all sessions alike"
        return f"changes slowly with time{ways if table.roles.get('session') else ''}"
    if carrier.endswith(TO_SOME_EXTENT) and not carrier.startswith(COVARIATE_PREFIX):
        return f"has something of {carrier.removesuffix(TO_SOME_EXTENT)}"
    name, _, opposite = carrier.partition(" by direction")
    names = {PREDICTION: "what the law predicts", "group": table.roles.get("group") or "group"}
    way = ", oppositely in the two directions" if opposite or carrier != name else ""
    return f"follows {names.get(name, name).removeprefix(COVARIATE_PREFIX)}{way}"


def name_table_cause(cause: str, diagnosis: Diagnosis) -> str:
    """As `name_cause`, with the column."""
    if not cause.startswith(COVARIATE_PREFIX):
        return name_cause(cause, diagnosis)
    return f"the response follows the column {cause.removeprefix(COVARIATE_PREFIX)} ({cause})"


def format_signed(value: float) -> str:
    return ("+" if value > 0 else "") + format_significant(value)
