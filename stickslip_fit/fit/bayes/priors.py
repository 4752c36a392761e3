"""What is believed before the counts are seen, for each joint and direction, in users' units when printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import e
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._format import format_value
from stickslip_fit._summary import Column, Table, numbers
from stickslip_fit.errors import InputError
from stickslip_fit.fit.bayes.cause_priors import CausePriors
from stickslip_fit.fit.bayes.traverses import each_group
from stickslip_fit.laws import Rows, StepLaw, travel
from stickslip_fit.logs import Log

Array = npt.NDArray[np.float64]
Group = tuple[int, str]

# Shares of what changes a step by its own size, see `StepLaw.scales`.
WIDTH = 0.5
SPREAD = 0.02
REPEATABILITY = 0.003


@dataclass(frozen=True, eq=False)
class Prior:
    """The prior of one joint and direction.

    A session's parameters are normal about the campaign's mean. The mean is normal itself; how much the
    parameters spread from session to session, and the repeatability, are log-normal.

    Attributes
    ----------
    names, units : tuple of str
        Of the law's p parameters.
    centre, width : array, shape (p,)
        Mean and standard deviation of the campaign's mean, SI.
    spread : array, shape (p,)
        Median of the standard deviation between sessions, SI.
    repeatability : float
        Median of the standard deviation of log(steps).
    spread_factor, repeatability_factor : float
        One standard deviation of their logarithms, as a factor.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    centre: Array
    width: Array
    spread: Array
    repeatability: float
    spread_factor: float = e
    repeatability_factor: float = e

    def levels(self, x: Array) -> tuple[Array, Array]:
        """Spread, shape (..., p), and repeatability, shape (...,), at standard normal x, (..., p + 1)."""
        spread = self.spread * self.spread_factor ** x[..., :-1]
        return spread, self.repeatability * self.repeatability_factor ** x[..., -1]

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Campaign means, (size, p), spreads, (size, p), and repeatabilities, (size,), from the prior."""
        spread, repeatability = self.levels(rng.standard_normal((size, len(self.centre) + 1)))
        return self.centre + self.width * rng.standard_normal(spread.shape), spread, repeatability


@dataclass(frozen=True)
class Priors:
    """The priors of a fit; prints as a table.

    Attributes
    ----------
    of : mapping of (int, str) to Prior
        By joint and direction.
    causes : CausePriors or None
        Where the laws have causes in them.
    """

    of: Mapping[Group, Prior]
    causes: CausePriors | None = None

    def __str__(self) -> str:
        return "\n\n".join(table.as_text() for table in self.tables())

    def tables(self) -> tuple[Table, ...]:
        """Those of sessions, and those of causes where there are some."""
        heads = ("joint", "direction", "parameter")
        columns = (
            *(Column(head, text=True) for head in heads),
            *numbers("campaign mean", "between sessions (95 %)"),
        )
        rows = tuple(tuple(line) for group, prior in self.of.items() for line in _lines(group, prior))
        of_sessions = Table("Priors", columns, rows, stubs=len(heads))
        if self.causes is None:
            return (of_sessions,)
        columns = (Column("cause", text=True), Column("for the whole campaign (95 %)"))
        rows = tuple(tuple(line) for line in self.causes.lines())
        return of_sessions, Table("Priors of causes", columns, rows)

    def prior(self, joint: int, direction: str) -> Prior:
        """The prior of a joint and direction.

        Raises
        ------
        InputError
            If there is none.
        """
        if (joint, direction) not in self.of:
            raise InputError(f"the priors have no entry for joint {joint}, direction {direction}; add one")
        return self.of[joint, direction]

    def to_json(self) -> list[dict[str, Any]]:
        """Plain JSON types that `from_json` reads."""
        of_causes = [] if self.causes is None else [{"causes": self.causes.to_json()}]
        return of_causes + [
            {"joint": joint, "direction": direction}
            | {
                name: value.tolist() if isinstance(value, np.ndarray) else value
                for name, value in asdict(prior).items()
            }
            for (joint, direction), prior in self.of.items()
        ]

    @classmethod
    def from_json(cls, content: list[dict[str, Any]]) -> Priors:
        """The priors that `to_json` wrote."""
        causes = [CausePriors.from_json(item["causes"]) for item in content if "causes" in item]
        of = {
            (item["joint"], item["direction"]): _prior_from_json(item) for item in content if "joint" in item
        }
        return cls(of, *causes)


def weak_prior(law: StepLaw, rows: Rows) -> Prior:
    """A prior that knows no more than how long a step is in these rows.

    The campaign's mean may be anywhere within the step size or so of a law without effects; sessions
    differ by 2 % of a step within a factor of 7 either way, and a count repeats to 0.3 %, as widely.
    """
    y, _ = law.response(rows)
    step = np.exp(np.mean(np.log(travel(rows)) - y, keepdims=True))
    scale = law.scales(step)[0]
    return Prior(
        names=tuple(parameter.name for parameter in law.parameters),
        units=tuple(parameter.unit for parameter in law.parameters),
        centre=law.start_values(step)[0],
        width=WIDTH * scale,
        spread=SPREAD * scale,
        repeatability=REPEATABILITY,
    )


def weak_priors(log: Log) -> Priors:
    """The prior of `weak_prior` for every joint and direction of a log; change what you know better.

    Raises
    ------
    InputError
        If the log has no usable traverse.
    """
    return Priors(
        {
            (joint, direction): weak_prior(traverses.law, traverses.rows)
            for joint, direction, traverses in each_group(log)
        }
    )


def _lines(group: Group, prior: Prior) -> list[list[str]]:
    joint, direction = group
    lines = []
    for name, unit, centre, width, spread in zip(
        prior.names, prior.units, prior.centre, prior.width, prior.spread, strict=True
    ):
        digits = 3 if unit in ("1", "µrad/mm") else 1
        mean = f"{format_value(centre, unit, digits)} ± {format_value(width, unit, digits)}"
        lines.append([str(joint), direction, name, mean, _within(spread, prior.spread_factor, unit, digits)])
    noise = _within(prior.repeatability, prior.repeatability_factor, "%", 2)
    return [*lines, [str(joint), direction, "repeatability", "", noise]]


def _within(median: float, factor: float, unit: str, digits: int) -> str:
    low, high = median * factor**-1.96, median * factor**1.96
    return f"{format_value(low, unit, digits)} to {format_value(high, unit, digits)}"


def _prior_from_json(item: dict[str, Any]) -> Prior:
    return Prior(
        names=tuple(item["names"]),
        units=tuple(item["units"]),
        centre=np.array(item["centre"]),
        width=np.array(item["width"]),
        spread=np.array(item["spread"]),
        repeatability=item["repeatability"],
        spread_factor=item["spread_factor"],
        repeatability_factor=item["repeatability_factor"],
    )
