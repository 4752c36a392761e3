"""StudyPlan: the campaigns to simulate and the strategies to compare, read from a TOML file.

A scenario names causes that act in the simulated campaigns but are not part of the strategies' laws.
data/reference/README.md explains every key.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from annotated_types import Interval, MinLen
from pydantic import PlainValidator, ValidationInfo, model_validator

from stickslip_fit._input import check_path
from stickslip_fit._toml import Give, Misfit, Quantity, Text, TomlTable, fault, read_toml
from stickslip_fit._typing import Array
from stickslip_fit.causes import Cause
from stickslip_fit.errors import InputError, suggest
from stickslip_fit.logs.plan import NoiseKind, Plan
from stickslip_fit.logs.plan_reader import DRIVES, MAX_REPEATABILITY_PERCENT, Seed, read_plan
from stickslip_fit.machine import Machine
from stickslip_fit.simulation import LawValues, read_law_values
from stickslip_fit.simulation.campaign import INITIAL_HISTORY
from stickslip_fit.simulation.truth import Causes, causes_of
from stickslip_fit.strategies import (
    ClosedForm,
    ConstantStepStrategy,
    IOptimal,
    LeastSquares,
    Strategy,
    Thesis,
    default_strategies,
)
from stickslip_fit.strategies.library import EXTRA_TRAVERSES

Scatter = Literal["gaussian", "t5", "uneven"]

DEFAULT_MAX_ERROR = 0.01


@dataclass(frozen=True, eq=False)
class Scenario:
    """Causes that act in the simulated campaigns, and of which the strategies' laws know nothing.

    Attributes
    ----------
    causes : tuple of Cause
        None by default.
    sizes : array, shape (q,)
        Values of the causes' parameters one after the other, SI.
    """

    name: str
    causes: tuple[Cause, ...] = ()
    sizes: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class StudyPlan:
    """Campaigns to simulate, and strategies to calibrate them.

    Attributes
    ----------
    plan : Plan
        Of every campaign; the same traverses in the same order.
    truth : LawValues
        The means over the campaigns.
    scenarios : tuple of Scenario
    strategies : tuple of Strategy
    repeatability : dict of (int, str) to float
        Standard deviation of log(steps) for each joint and direction; every strategy knows it.
    scatter : {'gaussian', 't5', 'uneven'}
        ``uneven``: Gaussian, and up to twice as large in some configurations as in others.
    campaigns : int
        Of each scenario.
    between_campaigns, between_sessions : float
        How far each parameter spreads (standard deviation), as a share of what changes a step by its own
        size, see `StepLaw.scales`; cut off at three standard deviations.
    moves : int
        How many open-loop moves the tip makes at the end of each session; the same in all of them.
    length : float
        Of each, m.
    good_enough : float
        Relative rms error of the mean step size with which the lab can live.
    """

    name: str
    plan: Plan
    truth: LawValues
    machine: Machine
    scenarios: tuple[Scenario, ...]
    strategies: tuple[Strategy, ...]
    repeatability: dict[tuple[int, str], float]
    scatter: Scatter = "gaussian"
    campaigns: int = 1000
    seed: int = 0
    between_campaigns: float = 0.0
    between_sessions: float = 0.0
    moves: int = 20
    length: float = 1e-3
    good_enough: float = DEFAULT_MAX_ERROR

    @property
    def kind(self) -> NoiseKind:
        """Distribution of the scatter in any one configuration."""
        return "t5" if self.scatter == "t5" else "gaussian"

    def sha256(self, scenario: Scenario) -> str:
        """Of everything that a campaign of a scenario depends on, which their number is not."""
        content = {
            "traverses": self.plan.rows().to_csv(),
            "sessions": [(each.label, each.begins.isoformat()) for each in self.plan.sessions],
            "timing": repr(self.plan.timing),
            "laws": {str(joint): _stable_repr(law) for joint, law in self.truth.laws.items()},
            "values": {str(key): list(own) for key, own in self.truth.values.items()},
            "day_to_day": {str(key): value for key, value in self.truth.day_to_day.items()},
            "machine": self.machine.sha256,
            "scenario": [scenario.name, repr(scenario.causes), list(scenario.sizes)],
            "strategies": [(strategy.name, _stable_repr(strategy)) for strategy in self.strategies],
            "repeatability": {str(key): value for key, value in self.repeatability.items()},
            "rest": [
                *(self.scatter, self.seed, self.between_campaigns, self.between_sessions),
                *(self.moves, self.length),
            ],
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _stable_repr(strategy: object) -> str:
    """Class and parameters, the same in every process; an object's default repr has its memory address."""
    parameters = repr(strategy) if is_dataclass(strategy) else repr(getattr(strategy, "causes", ""))
    return f"{type(strategy).__module__}.{type(strategy).__qualname__} {parameters}"


SIMULATED_COLUMNS = {"session", "session_seconds", "step_period", *INITIAL_HISTORY}  # of what causes look at


def _of_file(read: Callable[[Path, Machine], Any]) -> PlainValidator:
    """The content of a file named from where the study file lies; its faults are faults of the study."""

    def content(name: Any, info: ValidationInfo) -> Any:
        if not isinstance(name, str) or not name:
            raise ValueError("no name")
        folder, machine = info.context  # type: ignore[misc]
        try:
            return read(folder / name, machine)
        except InputError as error:
            raise fault("cannot be used", error.problems) from None

    return PlainValidator(content, json_schema_input_type=str)


NAMED = Give("name a file in quotes, from where this one lies")
Share = Annotated[
    float, Quantity(("%",), (0.0, 0.1))
]  # beyond a tenth of a step size, drawn laws would stall


class SpreadTable(TomlTable):
    """Standard deviation of every parameter, as a share of what changes a step by its size; cut off at 3."""

    campaigns: Share = 0.0
    """From campaign to campaign."""
    sessions: Share = 0.0
    """From session to session."""


class ScatterTable(TomlTable):
    """How well counts repeat."""

    repeatability: Annotated[float | None, Quantity(("%",), (1e-6, MAX_REPEATABILITY_PERCENT / 100))] = None
    """One number for every joint and direction; the plan's if left out."""
    kind: Scatter | None = None
    """`"uneven"`: up to twice as large in some configurations as in others; the plan's if left out."""


class MovesTable(TomlTable):
    """Open-loop moves of the tip after each session, drawn once all over the workspace."""

    count: Annotated[int, Interval(ge=0, le=10_000)] = 20
    """0 for none."""
    length: Annotated[float, Quantity(("mm", "µm", "m"), (1e-6, 0.02))] = 1e-3
    """Of each."""


class ScenarioTable(TomlTable):
    """What is hidden; several causes act together."""

    name: Text
    """What is hidden, in words."""
    cause: Causes = []
    """Without any, nothing is hidden."""


class StudyFile(TomlTable):
    """A study: strategies let loose on simulated campaigns of a plan."""

    plan: Annotated[Plan, _of_file(read_plan), NAMED]
    """A plan file, named from where the study file lies."""
    law: Annotated[LawValues, _of_file(read_law_values), NAMED]
    """A law file, named likewise."""
    name: Text = ""
    """Shown above the answer; the file's name if left out."""
    campaigns: Annotated[int, Interval(ge=1, le=1_000_000)] = 1000
    """Of each scenario."""
    seed: Seed = 0
    """A campaign depends on it, the scenario's name and the campaign's number, and on no other campaign."""
    strategies: Annotated[list[str] | None, Give("give a list of names in quotes")] = None
    """Names as `stickslip-fit compare` shows them; five that take milliseconds a campaign if left out."""
    more: Annotated[int, Interval(ge=1, le=1000)] = EXTRA_TRAVERSES
    """Traverses beyond the parameters, where least squares takes more."""
    good_enough: Annotated[float, Quantity(("%",), (1e-5, 1.0))] = DEFAULT_MAX_ERROR
    """Rms error of the mean step size with which the lab can live."""
    spread: SpreadTable
    noise: ScatterTable
    moves: MovesTable
    scenario: Annotated[list[ScenarioTable], MinLen(1)]

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        self.refuse(*self._misfits())
        return self

    def _misfits(self) -> Iterator[Misfit]:
        known = [strategy.name for strategy in default_strategies(self.more, self.seed)]
        chosen = known if self.strategies is None else self.strategies
        if not chosen or not set(chosen) <= set(known) or len(set(chosen)) < len(chosen):
            hint = next((suggest(name, known) for name in chosen if name not in known), "")
            yield f"give a list of different ones of {', '.join(map(repr, known))}{hint}", ("strategies",)
        names = [scenario.name for scenario in self.scenario]
        if len(set(names)) < len(names):
            yield f"give names that differ; these are {', '.join(names)}", ("scenario",)
        rows, spreads = self.plan.traverses, self.repeatability()
        for joint in sorted({*map(int, rows["joint"])} - {joint for joint, _, _ in self.law.values}):
            yield f"has no [[law]] of joint {joint}, which the plan drives; add it", ("law",)
        if self.law.has_stages:
            yield "has stages, which a study does not draw; write [[law]] tables in their place", ("law",)
        drives = set(zip(map(int, rows["joint"]), rows["direction"], strict=True))
        if not spreads:
            yield "give a number in %, or give the plan a [noise]", ("noise", "repeatability_pct")
        for joint, direction in sorted(drives - spreads.keys()) if spreads else ():
            yield f'its repeatability_pct has no "{joint}{direction}", which it drives', ("plan",)
        if self.moves.count and len(drives) < len(DRIVES):
            yield "the plan does not calibrate all joints both ways; set count = 0", ("moves",)
        sessions = {session.label for session in self.plan.sessions}
        for number, scenario in enumerate(self.scenario):
            for cause in causes_of(scenario.cause)[0]:
                if reason := _explain_inert(cause, sessions):
                    yield f"{cause.name} {reason}", ("scenario", number, "name")

    def repeatability(self) -> dict[tuple[int, str], float]:
        """The campaign plan's, or one number for every joint and direction in its place."""
        if self.noise.repeatability is not None:
            return dict.fromkeys(DRIVES.values(), self.noise.repeatability)
        return self.plan.noise.repeatability if self.plan.noise else {}

    def chosen(self) -> tuple[Strategy, ...]:
        """The strategies, in the order of the file."""
        if self.strategies is None:
            return default_study_strategies(self.more)
        known = {strategy.name: strategy for strategy in default_strategies(self.more, self.seed)}
        return tuple(known[name] for name in self.strategies)


def read_study(path: str | Path, machine: Machine) -> StudyPlan:
    """Read and check a study plan, and the campaign plan and law file that it names.

    Parameters
    ----------
    path : path
        A TOML file with the keys of `StudyFile`.

    Raises
    ------
    InputError
        With every fault of the file, and of those that it names.
    """
    check_path(path, "study file")
    path = Path(path)
    read = read_toml(path, StudyFile, "study file", (path.parent, machine))
    return StudyPlan(
        name=read.name or path.stem,
        plan=read.plan,
        truth=read.law,
        machine=machine,
        scenarios=tuple(Scenario(each.name, *causes_of(each.cause)) for each in read.scenario),
        strategies=read.chosen(),
        repeatability=read.repeatability(),
        scatter=read.noise.kind or (read.plan.noise.kind if read.plan.noise else "gaussian"),
        campaigns=read.campaigns,
        seed=read.seed,
        between_campaigns=read.spread.campaigns,
        between_sessions=read.spread.sessions,
        moves=read.moves.count,
        length=read.moves.length,
        good_enough=read.good_enough,
    )


def default_study_strategies(extra: int = EXTRA_TRAVERSES) -> tuple[Strategy, ...]:
    """Those of `default_strategies` that a study compares by default: milliseconds for each campaign.

    Examples
    --------
    >>> [strategy.name for strategy in default_study_strategies()]  # doctest: +NORMALIZE_WHITESPACE
    ['constant step', 'closed form', 'least squares, thesis +4', 'least squares, I-optimal',
     'least squares, I-optimal +4']
    """
    fits = (LeastSquares(Thesis(), extra), LeastSquares(IOptimal()), LeastSquares(IOptimal(), extra))
    return (ConstantStepStrategy(), ClosedForm(), *fits)


def _explain_inert(cause: Cause, sessions: set[str]) -> str:
    """Why a cause would have no effect in a simulated campaign; empty where it would."""
    if cause.session not in ("", *sessions):
        planned = ", ".join(map(repr, sorted(sessions)))
        return f"happens in session {cause.session!r}; the plan's are {planned}"
    lacking = [name for name in cause.columns if name not in SIMULATED_COLUMNS]
    return f"needs {', '.join(lacking)}, which no plan has; hide another cause" if lacking else ""
