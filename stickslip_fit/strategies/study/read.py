"""A study plan from its TOML file; data/reference/README.md explains every key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import get_args

from stickslip_fit.causes import Cause
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs.plan import Plan
from stickslip_fit.logs.read_plan import LEAST_REPEATABLE, read_plan
from stickslip_fit.logs.settings import Settings, read_settings
from stickslip_fit.machine import Machine
from stickslip_fit.simulate import read_law_values
from stickslip_fit.simulate.driven import HISTORY
from stickslip_fit.simulate.law_causes import read_causes
from stickslip_fit.strategies.closed_form import ClosedForm, ConstantStep
from stickslip_fit.strategies.designs import IOptimal, Thesis
from stickslip_fit.strategies.least_squares import LeastSquares
from stickslip_fit.strategies.study.plan import GOOD_ENOUGH, Scatter, Scenario, StudyPlan
from stickslip_fit.strategies.task import Strategy
from stickslip_fit.strategies.usual import MORE, usual_strategies

MOST_CAMPAIGNS = 1_000_000
MOST_MOVES = 10_000
WIDEST = 0.1  # a tenth of a step size: beyond, drawn laws would stall
LENGTHS = (1e-6, 0.02)  # m
THERE = {"session", "session_seconds", "step_period", *HISTORY}  # of what causes look at


def read_study(path: str | Path, machine: Machine) -> StudyPlan:
    """Read and check a study plan, and the campaign plan and law file that it names.

    Parameters
    ----------
    path : path
        A TOML file: plan and law, files named from where it lies; name, campaigns, seed, strategies, more,
        good_enough_pct; tables [spread], [noise], [moves]; one [[scenario]] for each of what may be hidden.
    machine : Machine

    Raises
    ------
    InputError
        Naming every fault of the file with its key and value.
    """
    settings, path = read_settings(path), Path(path)
    plan = _file(settings, "plan", lambda file: read_plan(file, machine))
    truth = _file(settings, "law", lambda file: read_law_values(file, machine))
    spread, noise, moves = (settings.table(key) for key in ("spread", "noise", "moves"))
    usual = plan.noise.kind if plan is not None and plan.noise is not None else "gaussian"
    given = {
        "name": settings.text("name", path.stem),
        "scenarios": _scenarios(settings),
        "strategies": _strategies(settings),
        "repeatability": _repeatability(noise, plan),
        "scatter": noise.choice("kind", get_args(Scatter), usual),
        "campaigns": settings.whole("campaigns", 1, MOST_CAMPAIGNS, 1000),
        "seed": settings.whole("seed", 0, 2**63 - 1, 0),
        "between_campaigns": spread.number("campaigns", ("%",), (0.0, WIDEST), 0.0),
        "between_sessions": spread.number("sessions", ("%",), (0.0, WIDEST), 0.0),
        "moves": moves.whole("count", 0, MOST_MOVES, 20),
        "length": moves.number("length", ("mm", "µm", "m"), LENGTHS, 1e-3),
        "good_enough": settings.number("good_enough", ("%",), (1e-5, 1.0), GOOD_ENOUGH),
    }
    for table in (spread, noise, moves, settings):
        table.reject_unknown()
    settings.finish()
    assert plan is not None
    assert truth is not None
    study = StudyPlan(plan=plan, truth=truth, machine=machine, **given)
    _check_together(study, settings)
    return study


def usual_of_study(more: int = MORE) -> tuple[Strategy, ...]:
    """Those of `usual_strategies` that a study compares by default: any campaign takes them milliseconds.

    Examples
    --------
    >>> [strategy.name for strategy in usual_of_study()]  # doctest: +NORMALIZE_WHITESPACE
    ['constant step', 'closed form', 'least squares, thesis +4', 'least squares, I-optimal',
     'least squares, I-optimal +4']
    """
    return (
        ConstantStep(), ClosedForm(), LeastSquares(Thesis(), more), LeastSquares(IOptimal()),
        LeastSquares(IOptimal(), more),
    )  # fmt: skip


def _file[Part](settings: Settings, key: str, read: Callable[[Path], Part]) -> Part | None:
    """What a file that the plan names has to say; its faults are faults of the study."""
    named = settings.take(key)
    if not isinstance(named, str) or not named:
        settings.complain(key, "name a file in quotes, from where this one lies")
        return None
    try:
        return read(Path(settings.file).parent / named)
    except InputError as error:
        settings.problems.extend(error.problems)
        return None


def _scenarios(settings: Settings) -> tuple[Scenario, ...]:
    found = []
    for number, table in enumerate(settings.tables("scenario"), start=1):
        name = table.text("name", "")
        # The causes' own complaints do not say in which scenario they stand.
        inside = Settings(table.content, f"{settings.file}, scenario {number}", "", settings.problems)
        causes, sizes = read_causes(inside)
        table.take("cause")
        table.reject_unknown()
        found.append(Scenario(name, causes, sizes))
    names = [scenario.name for scenario in found]
    if len(set(names)) < len(names):
        settings.complain("scenario", f"give names that differ; these are {', '.join(names)}")
    return tuple(found)


def _strategies(settings: Settings) -> tuple[Strategy, ...]:
    more = settings.whole("more", 1, 1000, MORE)
    known = {strategy.name: strategy for strategy in usual_strategies(more, settings.content.get("seed", 0))}
    given = settings.take("strategies")
    if given is None:
        return usual_of_study(more)
    names = [name for name in given if name in known] if isinstance(given, list) else []
    if not names or names != given or len(set(names)) < len(names):
        settings.complain("strategies", f"give a list of different ones of {', '.join(map(repr, known))}")
        return ()
    return tuple(known[name] for name in names)


def _repeatability(noise: Settings, plan: Plan | None) -> dict[tuple[int, str], float]:
    """The campaign plan's, or one number for every joint and direction in its place."""
    planned = plan.noise.repeatability if plan is not None and plan.noise is not None else {}
    key, _ = noise.find("repeatability", ("%",))
    if key not in noise.content and (planned or plan is None):
        return planned
    value = noise.number("repeatability", ("%",), (1e-6, LEAST_REPEATABLE / 100))
    return {(joint, direction): value for joint in (1, 2, 3) for direction in ("+", "-")}


def _check_together(study: StudyPlan, settings: Settings) -> None:
    """What is right by itself must fit together."""
    rows = study.plan.traverses
    lacking = sorted({*map(int, rows["joint"])} - {joint for joint, _, _ in study.truth.values})
    for joint in lacking:
        settings.complain("law", f"has no [[law]] of joint {joint}, which the plan drives; add it")
    drives = set(zip(map(int, rows["joint"]), rows["direction"], strict=True))
    for joint, direction in sorted(drives - study.repeatability.keys()):
        settings.complain("plan", f'its repeatability_pct has no "{joint}{direction}", which it drives')
    if study.moves and len(drives) < 6:
        settings.complain("moves", "the plan does not calibrate all joints both ways; set count = 0")
    sessions = {session.label for session in study.plan.sessions}
    for scenario in study.scenarios:
        for cause in scenario.causes:
            if why := _inert(cause, sessions):
                settings.problems.append(
                    Problem(f"{cause.name} {why}", settings.file, column="scenario", value=scenario.name)
                )
    settings.finish()


def _inert(cause: Cause, sessions: set[str]) -> str:
    """Why a cause could do nothing in a simulated campaign; empty where it could."""
    if cause.session not in ("", *sessions):
        planned = ", ".join(map(repr, sorted(sessions)))
        return f"happens in session {cause.session!r}; the plan's are {planned}"
    lacking = [name for name in cause.columns if name not in THERE]
    return f"needs {', '.join(lacking)}, which no plan has; hide another cause" if lacking else ""
