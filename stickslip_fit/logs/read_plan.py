"""A plan from its TOML file; data/reference/README.md explains every key."""

from __future__ import annotations

from datetime import date, datetime, time, timedelta
from itertools import pairwise
from pathlib import Path
from typing import get_args

from stickslip_fit.logs.check import DIRECTIONS
from stickslip_fit.logs.plan import Noise, NoiseKind, Order, Plan, PlannedSession, Timing
from stickslip_fit.logs.settings import Settings, is_number, read_settings
from stickslip_fit.logs.sweep import read_sweeps
from stickslip_fit.machine import JOINTS, Machine
from stickslip_fit.units import to_si

MOST_SESSIONS = 10_000
YEARS = range(1900, 2200)  # what a log's times can hold, with room for every session
MOST_REPLICATES = 10_000
MOST_TRAVERSES = 5_000_000
FASTEST_SLOWEST = (1e-5, 10.0)  # s
LEAST_REPEATABLE = 20.0  # %; beyond, the spread of log(steps) is no relative error any more


def read_plan(path: str | Path, machine: Machine) -> Plan:
    """Read and check a plan.

    Parameters
    ----------
    path : path
        A TOML file: name, seed, check_every, order, replicates; tables [sessions], [timing], [noise];
        one [[sweep]] for each set of configurations.
    machine : Machine
        Its ranges fill in full traverses and bound everything else.

    Raises
    ------
    InputError
        Naming every fault of the file with its key and value.

    Examples
    --------
    >>> import tempfile
    >>> from stickslip_fit.machine import load_machine
    >>> text = '''
    ... [sessions]
    ... dates = [2012-03-05]
    ... [[sweep]]
    ... joint = 3
    ... q2_deg = [-90, 0]
    ... theta_deg = [-90, 0]
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "plan.toml")
    ...     _ = path.write_text(text)
    ...     plan = read_plan(path, load_machine())
    >>> print(plan.rows()[["session", "joint", "direction", "q2", "theta"]].round(2).head(3))
          session  joint direction    q2  theta
    0  2012-03-05      3         + -1.57  -1.57
    1  2012-03-05      3         - -1.57  -1.57
    2  2012-03-05      3         + -1.57   0.00
    """
    settings = read_settings(path)
    plan = Plan(
        name=settings.text("name", Path(path).stem),
        sessions=_sessions(settings.table("sessions")),
        traverses=read_sweeps(settings.tables("sweep"), machine),
        replicates=settings.whole("replicates", 1, MOST_REPLICATES, 1),
        order=settings.choice("order", get_args(Order), "as-written"),
        check_every=settings.whole("check_every", 1, 10_000, 5),
        timing=_timing(settings.table("timing")),
        noise=_noise(settings.table("noise")),
        seed=settings.whole("seed", 0, 2**63 - 1, 0),
    )
    settings.reject_unknown()
    total = plan.traverses_per_session * len(plan.sessions)
    if total > MOST_TRAVERSES:
        settings.complain("replicates", f"the plan makes {total:,} traverses; keep it to {MOST_TRAVERSES:,}")
    settings.finish()
    return plan


def _sessions(settings: Settings) -> tuple[PlannedSession, ...]:
    dates = _dates(settings)
    starts = settings.take("start", "08:30")
    times = _times(starts if isinstance(starts, list) else [starts] * len(dates))
    if times is None:
        settings.complain("start", 'give a time of day such as "08:30", or a list of one for each session')
        times = [time(0)] * len(dates)
    labels = settings.take("labels", [day.isoformat() for day in dates])
    settings.reject_unknown()
    if not isinstance(labels, list) or not all(isinstance(label, str) and label for label in labels):
        settings.complain("labels", 'give texts in quotes, such as ["first day", "second day"]')
        return ()
    if len(set(labels)) < len(labels):
        settings.complain("labels", "two sessions have one label; give labels that differ")
        return ()
    if not len(labels) == len(times) == len(dates):
        found = f"{len(labels)} labels, {len(times)} starts, {len(dates)} dates"
        settings.complain("labels", f"{found}; give each session one of each")
        return ()
    begins = [datetime.combine(day, clock) for day, clock in zip(dates, times, strict=True)]
    if any(later <= earlier for earlier, later in pairwise(begins)):
        settings.complain("dates", "a session does not begin after the one before it; put them in order")
    return tuple(PlannedSession(label, moment) for label, moment in zip(labels, begins, strict=True))


def _dates(settings: Settings) -> list[date]:
    """Either every date, or the first and how many days in a row."""
    if "first_date" in settings.content:
        first = _date(settings.take("first_date"))
        count = settings.whole("count", 1, MOST_SESSIONS, 1)
        if first is None:
            settings.complain("first_date", "give a date such as 2012-03-05")
            return []
        return [first + timedelta(days=number) for number in range(count)]
    given = settings.take("dates")
    dates = [_date(value) for value in given] if isinstance(given, list) else []
    if not dates or None in dates:
        settings.complain("dates", "give dates, such as [2012-03-05, 2012-03-06]; or first_date and count")
        return []
    return [day for day in dates if day is not None]


def _date(value: object) -> date | None:
    try:
        value = date.fromisoformat(value) if isinstance(value, str) else value
    except ValueError:
        return None
    if isinstance(value, datetime) or not isinstance(value, date):
        return None
    return value if value.year in YEARS else None


def _times(values: list[object]) -> list[time] | None:
    try:
        times = [time.fromisoformat(value) if isinstance(value, str) else value for value in values]
    except ValueError:
        return None
    local = [value for value in times if isinstance(value, time) and value.tzinfo is None]
    return [value.replace(microsecond=0) for value in local] if len(local) == len(times) else None


def _timing(settings: Settings) -> Timing:
    usual, patience = Timing(), (0.0, 86_400.0)
    timing = Timing(
        step_period=settings.number("step_period", ("ms", "s"), FASTEST_SLOWEST, usual.step_period),
        pause=settings.pair("pause", ("s", "min"), patience, usual.pause),
        turn=settings.pair("turn", ("s", "min"), patience, usual.turn),
    )
    settings.reject_unknown()
    return timing


def _noise(settings: Settings) -> Noise | None:
    if not settings.content:
        return None
    noise = Noise(_repeatability(settings), settings.choice("kind", get_args(NoiseKind), "gaussian"))
    settings.reject_unknown()
    return noise


def _repeatability(settings: Settings) -> dict[tuple[int, str], float]:
    """One percentage for everything, or one for each joint and direction named."""
    named = {f"{joint}{direction}": (joint, direction) for joint in JOINTS for direction in DIRECTIONS}
    given = settings.take("repeatability_pct")
    by_name = given if isinstance(given, dict) else dict.fromkeys(named, given)
    if not all(name in named and _is_percentage(value) for name, value in by_name.items()):
        settings.complain(
            "repeatability_pct",
            f"give a percentage from 0 to {LEAST_REPEATABLE:g}, or a table of such by joint and direction: "
            '{"3+" = 0.27, "3-" = 0.3}',
        )
        return {}
    return {named[name]: to_si(float(value), "%") for name, value in by_name.items()}


def _is_percentage(value: object) -> bool:
    return is_number(value) and 0 <= value <= LEAST_REPEATABLE
