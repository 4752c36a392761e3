"""The summary of a table's fit: what is left, how many values count, and the parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MISSING,
    capitalize_first,
    format_measured,
    format_measured_range,
    format_significant,
    join_words,
    pluralize,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize
from stickslip_fit.causes.parameters import parameter_titles
from stickslip_fit.estimation.table_fit import TableFit
from stickslip_fit.units import UNITS, Interval, from_si

MAX_ROWS = 60
ALL_SESSIONS = "all"


@summarize.register
def summarize_table_fit(fit: TableFit) -> Summary:
    """What the law leaves, flags, and its parameters."""
    source = fit.source
    name = Path(source.file).name or f"{fit.law.response_name} over {pluralize(source.rows, 'row')}"
    return Summary(
        title=f"Law fitted to {name}",
        headline=(typeset_text(describe_fit(fit)),),
        sections=(Section(tables=(parameters_table(fit),)),),
        flags=tuple(f"{capitalize_first(flag)}." for flag in fit.flags),
        provenance=(
            (name, f"sha256 {source.sha256}" if source.sha256 else "no hash"),
            ("law", fit.law.name),
            ("versions", ", ".join(f"{name} {version}" for name, version in source.versions.items())),
            ("command", source.command or "none: made from Python"),
        ),
    )


ALMOST_ALL = 0.999  # from here on, the share that is left says more than the one that is explained


def describe_fit(fit: TableFit) -> str:
    """What a law leaves of its response, and of how many values, as a sentence."""
    unit, law = fit.law.response_unit, fit.law
    measured = fit.residuals["measured"].to_numpy(float)
    share = 1.0 - fit.rms**2 / float(np.var(measured)) if np.var(measured) > 0 else np.nan
    percent = f"{100 * share:.1f} %" if share < ALMOST_ALL else f"more than {100 * ALMOST_ALL:.1f} %"
    explained = f", {percent} of its variance explained" if np.isfinite(share) else ""
    left = f"{format_significant(fit.rms)} {unit}".rstrip()
    rows = fit.source.rows
    counted = ""
    if round(fit.source.independent) < rows:
        counted = f", which count as about {round(fit.source.independent):,} independent ones"
    return (
        f"The law {law.name}, fitted to {rows:,} values{counted}, leaves {left} rms of "
        f"{law.response_name}{explained}."
    )


def parameters_table(fit: TableFit) -> Table:
    """Every parameter with its standard error and interval; session by session where it has its own."""
    table = fit.parameters
    by_session = fit.n_own > 0 and len(fit.sessions) > 1
    has_units = bool(table["unit"].any())
    columns = (
        Column("parameter", text=True),
        *((Column("session", text=True),) if by_session else ()),
        *numbers("estimate", "standard error", "95 % interval"),
        *((Column("unit", text=True),) if has_units else ()),
    )
    titles = parameter_titles(fit.law.parameters)
    rows = [
        (
            titles[row.name],
            *((row.session or ALL_SESSIONS,) if by_session else ()),
            *_cells(row)[: 3 + has_units],
        )
        for row in table.head(MAX_ROWS).itertuples(index=False)
    ]
    notes = [f"The first {MAX_ROWS} of {len(table):,}."] if len(table) > MAX_ROWS else []
    smooth = {one.name.rpartition(".")[0]: None for one in fit.law.parameters if "coefficient" in one.meaning}
    if smooth:
        notes.append(
            f"Of {join_words(list(smooth))}: coefficients of a smooth function, of no use one by one."
        )
    beside = {
        one.name.partition("[")[0].rpartition(".")[0]: one.meaning.rpartition(" beside ")[2]
        for one in fit.law.parameters
        if " beside " in one.meaning
    }
    notes += [f"Of {cause}: differences from {level}." for cause, level in beside.items()]
    if len(fit.autocorrelation):
        notes.append("Standard errors allow for the autocorrelation of the noise.")
    stubs = 2 if by_session else 1
    return Table("Parameters of the law", columns, tuple(rows), stubs=stubs, note=" ".join(notes))


def _cells(row: pd.Series) -> tuple[str, ...]:
    values = np.array([row.estimate, row.low, row.high, row.standard_error], dtype=float)
    unit = row.unit
    if unit in UNITS:
        values = np.asarray(from_si(values, unit))
    size, error = Interval(*map(float, values[:3])), float(values[3])
    if not np.isfinite(error):
        return (format_significant(size.estimate), MISSING, MISSING, unit)
    return (format_measured(size), format_significant(error, 2), format_measured_range(size), unit)
