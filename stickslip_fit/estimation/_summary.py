"""The summary of a result: control chart of the latest session, flags, tables of the parameters."""

from __future__ import annotations

from collections import Counter

import pandas as pd

from stickslip_fit._format import (
    capitalize_first,
    format_direction,
    format_percent,
    format_range,
    format_uncertain,
    format_value,
    join_words,
    joint_name,
    pluralize,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.causes.parameters import parameter_titles
from stickslip_fit.estimation.noise import Flag, NoiseLevel
from stickslip_fit.estimation.prediction import NO_ORDER, format_latest_control, has_order, latest_control
from stickslip_fit.estimation.result import ALL_JOINTS, JointFit, Result
from stickslip_fit.estimation.with_causes import law_without_causes
from stickslip_fit.laws import Parameter
from stickslip_fit.laws.published import name_of_laws
from stickslip_fit.logs.log import MAX_ROWS, file_names, latest

MAX_NAMED = 6
ALL_SESSIONS = "all sessions"
COEFFICIENTS = "coefficients of smooth functions, of no use one by one: in the saved result"
FLAGS = {
    "at_bound": "at the edge of what is possible",
    "not_identified": "cannot be known from this log",
    "not_converged": "not converged",
    "few_replicates": "too few replicates for error bars",
    "repeatability_doubted": "counts scatter unlike the repeatability given",
    "outlier": "an outlying count",
    "no_times": "the log has no times",
    "chosen": "chosen among the gaps between traverses",
    "same_log": "causes that were fitted on the same log",
}


@summarize.register
def summarize_fit(result: Result) -> Summary:
    """Latest session, flags, the parameters of causes, of every joint by session and direction."""
    files = file_names(list(result.provenance.log_files))
    method = capitalize_first(result.method.replace("-", " "))
    tables = [*departures_tables(result), *(_parameters(result, joint) for joint in result.joints)]
    return Summary(
        title=f"{method} fit of {files}" if files else f"{method} fit",
        headline=(format_latest_control(latest_control(result)) if has_order(result) else NO_ORDER,),
        sections=(Section(tables=tuple(tables)),),
        flags=tuple(flags(result)),
        provenance=result.provenance.lines(),
    )


def flags(*results: Result) -> list[str]:
    """Flags of the results as sentences; flags that differ only in their session are one sentence."""
    alike: dict[tuple[str, str], list[Flag]] = {}
    for result in results:
        for flag in result.flags:
            message = flag.message
            if flag.session:
                message = message.replace(f"session {flag.session}", "session")
            alike.setdefault((result.method, message), []).append(flag)
    methods: dict[str, list[str]] = {}
    for (method, _), same in alike.items():
        methods.setdefault(_once(same), []).append(method.replace("-", " "))
    if len(results) == 1:
        return list(methods)
    return [f"{sentence} ({join_words(by)})" for sentence, by in methods.items()]


def _once(alike: list[Flag]) -> str:
    first, *others = alike
    named = first.message.startswith(first.parameters)  # begins with a name, whose letters matter
    message = first.message if named else capitalize_first(first.message)
    if not others:
        return f"{message}."
    plural = "session" if len(others) == 1 else "sessions"
    return f"{message}. The same in {plural} {_join_some([flag.session for flag in others])}."


def _join_some(names: list[str]) -> str:
    """The first names, and how many there are besides."""
    if len(names) > MAX_NAMED:
        names = [*names[:MAX_NAMED], pluralize(len(names) - MAX_NAMED, "other")]
    return join_words(names)


def _parameters(result: Result, joint: int) -> Table:
    """One joint's parameters: sessions and directions down, parameters and flags across."""
    fit, table = result.joints[joint], result.si.parameters
    table = table[table["joint"] == joint]
    sessions = list(fit.groups["session"].unique())
    shared = table["session"].isna()
    shown = pd.concat([table[table["session"].isin(sessions[-MAX_ROWS:])], table[shared]])
    columns = (
        *words("session", "direction"),
        *(Column(p.name, p.unit.replace("1", "")) for p in own_parameters(fit)),
        Column("remarks", text=True),
    )
    rows = tuple(
        _row(fit, session, direction, group)
        for (session, direction), group in shown.groupby(["session", "direction"], sort=False, dropna=False)
    )
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], tuple(row[:-1] for row in rows)
    note = " ".join(filter(None, ["± one standard error.", _scatter(fit), latest(len(sessions))]))
    last = fit.groups["session"].iloc[-1]
    own = int((fit.groups["session"] == last).sum()) + shared.any() * fit.groups["direction"].nunique()
    caption = f"Parameters of {joint_name(joint, result.machine)}"
    return Table(caption, columns, rows, stubs=2, note=note, short=slice(-own, None))


def _row(fit: JointFit, session: str | None, direction: str, table: pd.DataFrame) -> tuple[str, ...]:
    rows = {row.name: row for row in table.itertuples(index=False)}
    cells = [
        format_uncertain(row.estimate, row.standard_error, row.unit, with_unit=False) if row else ""
        for row in (rows.get(parameter.name) for parameter in own_parameters(fit))
    ]
    label = ALL_SESSIONS if pd.isna(session) else str(session)
    return (label, format_direction(direction), *cells, _flags(table))


def _flags(table: pd.DataFrame) -> str:
    """Flags of the parameters of a row: "b, c: cannot be known from this log"."""
    names_of: dict[str, list[str]] = {}
    for name, flags in zip(table["name"], table["flags"], strict=True):
        for flag in dict.fromkeys(flags):
            names_of.setdefault(flag, []).append(name)
    return "; ".join(
        f"{join_words(names) if len(names) < len(table) else 'all'}: "
        f"{FLAGS.get(flag, flag.replace('_', ' '))}"
        for flag, names in names_of.items()
    )


SCATTER_NAMES = {
    "replicates": "Replicate scatter",
    "residuals": "Residual scatter",
    "given": "Repeatability, as given,",
    "posterior": "Repeatability by the posterior",
}


def _scatter(fit: JointFit) -> str:
    """What the error bars are made of, by direction."""
    sentences = []
    for source, name in SCATTER_NAMES.items():
        levels = [
            f"{format_percent(noise.value)} ({format_direction(sign)}{_df_text(noise)})"
            for sign, noise in fit.repeatability.items()
            if noise.df > 0 and noise.source == source
        ]
        if levels:
            sentences.append(f"{name} {join_words(levels)}.")
    return " ".join(sentences) or "No scatter is known: nothing was repeated, and the fit leaves no residual."


def _df_text(noise: NoiseLevel) -> str:
    return "" if noise.source in ("given", "posterior") else f", {noise.df:,} df"


def own_parameters(fit: JointFit) -> list[Parameter]:
    """Parameters of the published law, without those of causes."""
    of_causes = set(fit.cause_parameters)
    return [parameter for parameter in fit.law.parameters if parameter.name not in of_causes]


def departures_tables(result: Result) -> list[Table]:
    """The parameters of causes, where the laws have some: one number each for the whole campaign.

    Of the coefficients of a smooth function, of no use one by one, their number.
    """
    table = result.si.parameters
    table = table[table["joint"] == ALL_JOINTS]
    parameters = [one for fit in result.joints.values() for one in fit.law.parameters]
    meanings, titles = {one.name: one.meaning for one in parameters}, parameter_titles(parameters)
    rows, smooth = [], Counter[str]()
    for row in table.itertuples(index=False):
        if "coefficient" in meanings[row.name]:
            smooth[row.name.partition(".")[0]] += 1
        else:
            estimate = format_uncertain(row.estimate, row.standard_error, row.unit)
            rows.append((titles[row.name], estimate, meanings[row.name]))
    rows += [(f"{cause}.*", f"{count:,} numbers", COEFFICIENTS) for cause, count in smooth.items()]
    columns = (Column("parameter", text=True), Column("estimate"), Column("what it is", text=True))
    only = any(title != name for name, title in titles.items())
    note = "One number each for all joints, directions and sessions"
    note += f"{', but where it is named for some' if only else ''}. ± one standard error."
    name = name_of_laws(law_without_causes(fit.law) for fit in result.joints.values())
    return [Table(f"Departures from the {name}s", columns, tuple(rows), note=note)] if rows else []


def profile_section(table: pd.DataFrame) -> Section:
    """Both intervals of each parameter, as `profile_intervals` gives them; `*` where they differ."""
    known = table[table["estimate"].notna() & table["profile_low"].notna()]
    columns = (
        *(Column(head, text=True) for head in ("joint", "session", "parameter")),
        Column("estimate"),
        *numbers("quadratic", "profile", group="95 %"),
    )
    rows = []
    for row in known.itertuples(index=False):
        decimals = {"1": 5, "nm": 2, "µrad": 3}.get(row.unit, 4)
        rows.append(
            (
                f"{row.joint} {format_direction(row.direction)}",
                str(row.session),
                row.name,
                format_value(row.estimate, row.unit, decimals),
                format_range(row.low, row.high, row.unit, decimals),
                format_range(row.profile_low, row.profile_high, row.unit, decimals)
                + (" *" if row.differs else "  "),
            )
        )
    note = "* The likelihood is asymmetric here: use the profile." if known["differs"].any() else ""
    return Section(tables=(Table("Profile likelihood", columns, tuple(rows), stubs=3, note=note),))


def describe_profile(table: pd.DataFrame) -> str:
    """Whether the quadratic intervals may be used, from what `profile_intervals` gives."""
    known = table[table["estimate"].notna() & table["profile_low"].notna()]
    differ = known[known["differs"]]
    if differ.empty:
        return f"Profile likelihood: all {len(known):,} intervals of 95 % agree with the quadratic ones."
    places = [
        f"{row.name} of joint {row.joint} {format_direction(row.direction)} in {row.session}"
        for row in differ.itertuples(index=False)
    ]
    return (
        f"Profile likelihood: {len(differ):,} of {len(known):,} intervals of 95 % differ from the quadratic "
        f"ones ({_join_some(places)}); use the profile there."
    )
