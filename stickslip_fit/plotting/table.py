"""Figures of a table's diagnosis and of its law: residuals before and after, over columns; gain; predictions.

Residuals and effects are in the unit of the response. The grey band is where means of noise alone lie in 95
of 100 tables in which nothing is wrong, the noise being as autocorrelated as here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_significant, pluralize
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.levels import LevelCause, name_levels
from stickslip_fit.causes.roles import ORDER, ROW_NUMBER, direction_labels, direction_sign
from stickslip_fit.diagnosis import Diagnosis, Finding, TableInfo
from stickslip_fit.diagnosis.extension import SelectedCause
from stickslip_fit.diagnosis.linearized import rms
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.residuals import (
    MAX_BINS,
    ResidualComparison,
    compare_residuals,
    compute_shape,
    explained_share,
    find_carrier,
    fitted_effect,
)
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import TableFit
from stickslip_fit.plotting._style import (
    BLUE,
    DIRECTION_COLOURS,
    GREY,
    INK,
    TITLE_LINE,
    make_figure,
    make_legend_entry,
    report_style,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture
from stickslip_fit.plotting.sides import (
    ColouredRows,
    caption_overview,
    choose_sides,
    draw_overview,
    draw_sides,
    envelope_entry,
    picture_sides,
)

MAX_POINTS, MAX_PANELS = 800, 24
MIN_CARRIER_SHARE = 0.5  # of an effect's square; what no column carries so far is drawn over itself
FITTED_EFFECT = "effect of the finding, as fitted"


@dataclass(frozen=True, eq=False)
class _TableRows:
    """The rows of a diagnosis as figures show them.

    Attributes
    ----------
    columns : mapping of str to array, shape (n,)
        Whatever varied, by axis label: time and position first, then the law's, then all others.
    labels : mapping of str to str
        The axis label of each column by its name.
    kinds : mapping of str to array of bool, shape (n,)
        Rows of one colour, by their label; one kind without a direction.
    """

    columns: Mapping[str, Array]
    labels: Mapping[str, str]
    kinds: Mapping[str, BoolArray]

    @property
    def by_colour(self) -> ColouredRows:
        """The same by colour."""
        return dict(zip(_colours(self.kinds).values(), self.kinds.values(), strict=True))


def _collect(diagnosis: Diagnosis, table: TableInfo) -> _TableRows:
    rows, law = diagnosis.selection.problem.rows, diagnosis.selection.problem.parts[0].law
    declared = getattr(getattr(law, "source", None), "units", None) or {}
    units = {str(name): str(unit) for name, unit in declared.items()}
    roles, used = table.roles, [name for name in getattr(law, "columns", ()) if name != table.response]
    names = [roles.get("position", ""), *used, *map(str, rows.columns)]
    hidden = {
        *("joint", "session_seconds", ROW_NUMBER),
        *(roles.get(role) for role in ("session", "group", "time")),
    }
    hidden |= {table.response, *getattr(getattr(law, "left", None), "names", ())}
    columns: dict[str, Array] = {}
    labels: dict[str, str] = {}
    if roles.get("time"):
        label = (
            "row in its session"
            if roles["time"] == ORDER
            else f"time since the session's first row ({table.time_unit})"
        )
        columns[label] = rows["session_seconds"].to_numpy(float)
        labels |= {"session_seconds": label, "time": label, roles["time"]: label}
    for name in dict.fromkeys(filter(None, names)):
        if name in hidden or not pd.api.types.is_numeric_dtype(rows[name]):
            continue
        labels[name] = f"{name} ({units[name]})" if units.get(name) else name
        columns[labels[name]] = rows[name].to_numpy(float, na_value=np.nan)
    varied = {label: values for label, values in columns.items() if _varies(values)}
    return _TableRows(varied, labels, _direction_kinds(rows, roles.get("direction", "")))


def _varies(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 1 and float(np.ptp(known)) > 0


def _direction_kinds(rows: pd.DataFrame, direction: str) -> dict[str, BoolArray]:
    if not direction:
        return {"mean": np.ones(len(rows), dtype=bool)}
    labels = direction_labels(rows[direction])
    sign = direction_sign(rows, direction, labels)
    names = labels[::-1] if len(labels) == 2 else (f"{direction} > 0", f"{direction} < 0")
    if pd.api.types.is_numeric_dtype(rows[direction]) and len(labels) == 2:
        names = (f"{direction} = {labels[1]}", f"{direction} = {labels[0]}")
    return {f"mean, {names[0]}": sign >= 0, f"mean, {names[1]}": sign < 0}


def _colours(kinds: Mapping[str, BoolArray]) -> dict[str, str]:
    return dict(zip(kinds, DIRECTION_COLOURS.values() if len(kinds) > 1 else (BLUE,), strict=False))


def _entries(kinds: Mapping[str, BoolArray], *, points: bool = True, effect: bool = False) -> list[Line2D]:
    entries = [make_legend_entry("value", GREY, marker=".")] if points else []
    entries += [make_legend_entry(label, colour, "o", "-") for label, colour in _colours(kinds).items()]
    if effect:
        entries.append(make_legend_entry("effect of the finding", INK, line="--"))
    return [*entries, envelope_entry("table")]


def finding_pictures(diagnosis: Diagnosis, table: TableInfo) -> list[Picture]:
    """Of each finding that has a shape: residuals before and after over the column that it follows."""
    comparison = compare_residuals(diagnosis.selection, diagnosis.seed)
    pictures: list[Picture] = []
    for finding in diagnosis.findings:
        selected = diagnosis.selection.behind(finding)
        if selected.misfit is None:
            continue
        label, figure = draw_table_finding(diagnosis, table, finding, selected, comparison)
        before, above = table.format_size(rms(comparison.before)), ""
        if finding.version is not None:
            above = f"what the law leaves of {table.response} ({before} rms)"
            if label == FITTED_EFFECT:
                above = f"with all but this finding in the law, what is left of {table.response}"
            above += "; dashed: the part that the finding explains"
        title = f"{finding.cause}: residuals{' before and after' if above else ''}"
        over = f"the {label}" if label == FITTED_EFFECT else label
        picture = picture_sides(finding, title, over, above, rms(comparison.after), table, figure)
        numbered = f"-{len(pictures) + 1}" * any(one.key == picture.key for one in pictures)
        pictures.append(replace(picture, key=picture.key + numbered))
    return pictures


def draw_table_finding(
    diagnosis: Diagnosis,
    table: TableInfo,
    finding: Finding,
    selected: SelectedCause,
    comparison: ResidualComparison,
) -> tuple[str, Figure]:
    """The label of a finding's carrier, and the figure of its residuals before and after."""
    rows = _collect(diagnosis, table)
    if selected.version is None:
        linearized = diagnosis.selection.problem.linearize()
        shape = linearized.unwhiten(compute_shape(selected, linearized))
    else:
        shape = fitted_effect(diagnosis.selection, selected.version)
    label, values, levels = _find_carrier_values(rows, finding, selected, shape, comparison)
    extended, is_effect = selected.version is not None, label == FITTED_EFFECT
    figure = draw_sides(
        choose_sides(comparison, without=shape if is_effect else None, extended=extended),
        table.label(label) if is_effect else label,
        values,
        {"": rows.by_colour},
        _entries(rows.kinds, effect=extended),
        table,
        effect=shape if extended else None,
        levels=levels,
    )
    return label, figure


def _find_carrier_values(
    rows: _TableRows, finding: Finding, selected: SelectedCause, shape: Array, comparison: ResidualComparison
) -> tuple[str, Array, tuple[str, ...]]:
    """The column that a finding follows: what its cause names, if that varied; else what explains it best.

    Where no column carries most of it, as of a product of two, the effect itself. Labels have the places
    0, 1, ... and come third.
    """
    assert selected.misfit is not None
    best = selected.misfit.best_hypothesis(selected.cause)
    if isinstance(best, AR1):
        before = np.where(best.before >= 0, comparison.after[best.before], np.nan)
        return "the residual of the row before", before, ()
    named = [finding.carrier, finding.carrier.removesuffix(" by direction")]
    named += list(getattr(selected.version, "columns", ()))
    own = {rows.labels.get(name, ""): None for name in named}
    candidates = {label: rows.columns[label] for label in own if label in rows.columns} or dict(rows.columns)
    version, levels = selected.version, tuple[str, ...]()
    if isinstance(version, LevelCause) and len(version.levels) <= MAX_BINS:
        levels = version.levels
        cells = pd.Categorical(name_levels(comparison.rows[version.column]), categories=list(levels))
        candidates = {version.column: np.where(cells.codes < 0, np.nan, cells.codes)}
    groups = np.zeros(len(shape), dtype=np.intp)
    for number, kind in enumerate(rows.kinds.values()):
        groups[kind] = number
    if not candidates:
        return "row", np.arange(len(shape), dtype=float), ()
    label = find_carrier(shape, candidates, groups)
    if version is not None and explained_share(shape, candidates[label], groups) < MIN_CARRIER_SHARE:
        return FITTED_EFFECT, shape, ()
    return label, candidates[label], levels


def columns_picture(diagnosis: Diagnosis, table: TableInfo) -> Picture:
    """Residuals against every column that varied."""
    key, title = "everything", "Residuals against each column"
    rows = _collect(diagnosis, table)
    if not rows.columns:
        return make_missing_picture(key, title, "It would need a column that varies.")
    comparison = compare_residuals(diagnosis.selection, diagnosis.seed)
    left_out = len(rows.columns) - MAX_PANELS
    caption = caption_overview(comparison, np.ones(len(comparison.rows), dtype=bool), table)
    caption += f" {pluralize(left_out, 'column')} left out." * (left_out > 0)
    return make_picture(key, title, caption, plot_columns(diagnosis, table))


def plot_columns(diagnosis: Diagnosis, table: TableInfo) -> Figure:
    """A panel for each column that varied; raises InputError if none did."""
    rows = _collect(diagnosis, table)
    if not rows.columns:
        raise InputError("there is nothing to draw: no column of the table varies")
    comparison = compare_residuals(diagnosis.selection, diagnosis.seed)
    shown = dict(list(rows.columns.items())[:MAX_PANELS])
    return draw_overview(shown, comparison, rows.by_colour, _entries(rows.kinds, points=False), table)


def measured_picture(fit: TableFit) -> Picture:
    """Measured against predicted values."""
    key, title = "measured", "Measured and predicted"
    response, unit = fit.law.response_name, str(fit.law.response_unit)
    caption = (
        f"{response} as measured over what the law with its fitted parameters predicts; below, the "
        "difference. "
        f"{format_significant(fit.rms)} {unit}".rstrip()
        + " rms. All values that were used took part in the fit."
    )
    return make_picture(key, title, caption, plot_measured(fit))


def plot_measured(fit: TableFit) -> Figure:
    """Measured over predicted values, and the residuals below."""
    table, unit = fit.residuals, str(fit.law.response_unit)
    beside = f" ({unit})" if unit else ""
    index = np.arange(len(table))
    if len(index) > MAX_POINTS:
        index = np.sort(np.random.default_rng(0).choice(index, MAX_POINTS, replace=False))
    x, y, left = (table[name].to_numpy(float)[index] for name in ("predicted", "measured", "residual"))
    with report_style():
        figure, axes = make_figure([2.4, 1.0], 1, down=0.14, top=TITLE_LINE)
        points = {"ls": "", "marker": "o", "ms": 2.2, "mew": 0, "alpha": 0.5, "color": BLUE}
        ends = [float(x.min()), float(x.max())]
        axes[0, 0].plot(ends, ends, color=INK, lw=0.8)
        axes[0, 0].plot(x, y, **points)
        axes[0, 0].set_ylabel(f"{fit.law.response_name} measured{beside}")
        axes[1, 0].axhline(0.0, color=INK, lw=0.7)
        axes[1, 0].plot(x, left, **points)
        axes[1, 0].set_ylabel(f"residual{beside}")
        axes[1, 0].set_xlabel(f"{fit.law.response_name} predicted{beside}")
        figure.align_ylabels(axes[:, 0])
    return figure
