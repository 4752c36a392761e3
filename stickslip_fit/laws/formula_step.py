"""FormulaStepLaw: the step size of a joint by a formula, ``gamma ~ expression``, for logs.

It is the law of one joint in one log: the log tells which names are its columns, and where parameters begin.
The steps over a traverse are length / gamma where gamma is constant along it, else an integral.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite
from typing import Any

import numpy as np

from stickslip_fit._expression import Expression
from stickslip_fit._function import NumericFunction
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.laws.base import (
    Configuration,
    Counter,
    Parameter,
    Rows,
    StepLaw,
    expected_steps,
    float_column,
    traverse_length,
)
from stickslip_fit.laws.integration import State, state_at
from stickslip_fit.laws.quantities import OF_GEOMETRY, columns_of, quantity, varies_with_position
from stickslip_fit.laws.table import TableLaw, similar_name
from stickslip_fit.laws.table_check import check_identifiable
from stickslip_fit.laws.table_start import find_linear
from stickslip_fit.machine import Machine
from stickslip_fit.units import UNITS, TableUnit, to_si

RESPONSE = "gamma"
GOLDEN_RATIO = (np.sqrt(5.0) - 1.0) / 2.0  # its multiples, modulo 1, spread evenly
PANELS = 4  # of the longest traverse, at least
TYPICAL_STEP = {True: 1e-6, False: 1e-4}  # m of a prismatic joint, rad of another; where rows have no counts
N_STATES = 200  # at random, to tell parameters apart


@dataclass(frozen=True, eq=False, kw_only=True)
class FormulaStepLaw(StepLaw):
    """A formula or function as the law of a joint.

    Attributes
    ----------
    source : object
        The `Law` that it comes from.
    right : Expression or NumericFunction
    joint : int
    slides : bool
        Whether the joint is prismatic.
    parameters : tuple of Parameter
        Bounds in SI.
    columns : tuple of str
    max_panel : float
    typical_step : float
        Mean step size of the log that it was made for, rad or m.
    typical, sizes : tuple of float
        Values of the parameters there, and changes of them that matter.
    proportional : tuple of bool
        Which of the parameters are proportional to the step size.
    """

    source: Any
    right: Expression | NumericFunction
    joint: int
    slides: bool
    parameters: tuple[Parameter, ...]
    columns: tuple[str, ...]  # type: ignore[misc]
    max_panel: float
    typical_step: float
    typical: tuple[float, ...]
    sizes: tuple[float, ...]
    proportional: tuple[bool, ...]

    @property
    def name(self) -> str:  # type: ignore[override]
        """The law's name, or its formula."""
        return str(self.source.name or self.source.text)

    @property
    def prismatic(self) -> bool:
        """See `StepLaw.prismatic`."""
        return self.slides

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Of each parameter."""
        return tuple(parameter.name for parameter in self.parameters)

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""
        return self._evaluate(state, values, ())[0]

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`."""
        return self._evaluate(state, values, self.parameter_names)[1]

    def _evaluate(self, state: State, values: Array, by: tuple[str, ...]) -> tuple[Array, Array]:
        own = {name: values[:, k, None] for k, name in enumerate(self.parameter_names)}
        others = {name: quantity(state, name) for name in self.right.names if name not in own}
        gamma, slopes = self.right.function(by)(others | own)
        return np.atleast_2d(gamma), slopes

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        return self._at(mean_step, self.typical)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return self._at(mean_step, self.sizes)

    def _at(self, mean_step: Array, values: tuple[float, ...]) -> Array:
        share = mean_step[:, None] / self.typical_step
        return np.where(np.array(self.proportional), share, 1.0) * np.array(values)

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: the columns that it uses."""
        state = state_at(self.joint, rows, float_column(rows, "start")[:, None])
        named = [name for name in self.right.names if name not in self.parameter_names]
        columns = [np.broadcast_to(quantity(state, name), (len(state.position), 1)) for name in named]
        return np.hstack([np.zeros((len(state.position), 0)), *columns])

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`: a formula names none."""
        return ()

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`; in closed form where the step size is constant along a traverse."""
        start, stop = float_column(rows, "start"), float_column(rows, "stop")
        arrays = {name: float_column(rows, name) for name in self.columns}
        ends = state_at(self.joint, arrays, np.stack([start, stop], axis=-1))
        first = np.tile(np.array(self.typical), (len(start), 1))
        if self.gamma(ends, first).shape[1] > 1:
            return super().counter(rows)
        length = traverse_length(rows)

        def count(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (len(start), len(self.parameters)))
            gamma, slopes = self._evaluate(ends, values, self.parameter_names)
            gamma = np.broadcast_to(gamma[:, 0], length.shape)
            slopes = np.broadcast_to(slopes[:, 0], (len(length), len(self.parameters)))
            with np.errstate(divide="ignore", invalid="ignore"):
                counts = np.where(gamma > 0, length / gamma, np.nan)
                return counts, -slopes * (counts / gamma)[:, None]

        return count

    def moves_in(self, rows: Rows) -> bool:
        """Whether every traverse has a count at the start values; so without traverses."""
        if not len(float_column(rows, "start")):
            return True
        with np.errstate(all="ignore"):
            return bool(np.isfinite(self.predict(rows, np.array(self.typical))).all())

    def describe(self) -> dict[str, Any]:
        """What `restore_step_law` needs to build it again; plain JSON types.

        Raises
        ------
        InputError
            For a function that cannot be imported by a name.
        """
        fields = (
            *("joint", "slides", "columns", "max_panel"),
            *("typical_step", "typical", "sizes", "proportional"),
        )
        return {
            "name": self.name,
            "formula_law": self.source.describe(),
            "parameters": self.parameter_names,
        } | {name: getattr(self, name) for name in fields}


def make_step_law(
    source: Any, names: Sequence[str], joint: int, rows: Rows, machine: Machine
) -> FormulaStepLaw:
    """The law of a joint of a log; `names` are its parameters. See `Law.step_law`."""
    right, slides = source.right, machine.is_prismatic(joint)
    _check_geometry(right.names, machine)
    parameters = tuple(_parameter(source, name) for name in names)
    start = {name: to_si(float(value), _unit(source, name)) for name, value in source.start.items()}
    used = [name for name in right.names if name not in names]
    first, last = float_column(rows, "start"), float_column(rows, "stop")
    # Not the middle, where what is odd about it, such as sin(q), would not show in whole traverses.
    positions = first + (last - first) * (GOLDEN_RATIO * np.arange(len(first)) % 1.0)
    frame = {
        name: np.broadcast_to(quantity(state_at(joint, rows, positions[:, None]), name)[:, 0], len(positions))
        for name in used
    }
    mean_step = TYPICAL_STEP[slides] * np.ones(len(positions))
    if "steps" in rows and len(positions):
        mean_step = traverse_length(rows) / expected_steps(rows["steps"], rows["check_every"])
    table = TableLaw(
        source=replace(source, start=start), left=source.right, right=right, columns=tuple(used),
        parameters=parameters, n_shared=0, response_unit=TableUnit(""),
    )  # fmt: skip
    frame = frame or {"": mean_step}
    typical_step = float(np.exp(np.mean(np.log(mean_step)))) if len(positions) else TYPICAL_STEP[slides]
    typical = table.start_values(frame, mean_step) if len(positions) else np.ones(len(names))
    sizes, proportional = _sizes(table, frame, typical, typical_step)
    _check_told_apart(table, frame, typical)
    longest = float(traverse_length(rows).max(initial=0.0))
    return FormulaStepLaw(
        source=source, right=right, joint=joint, slides=slides, parameters=parameters,
        columns=columns_of(used, rows, joint),
        max_panel=longest / PANELS if longest and varies_with_position(used) else inf,
        typical_step=typical_step, typical=tuple(typical.tolist()), sizes=sizes, proportional=proportional,
    )  # fmt: skip


def restore_step_law(description: Mapping[str, Any], source: Any) -> FormulaStepLaw:
    """The law that `FormulaStepLaw.describe` described; `source` is its `Law`, built again."""
    fields = dict(description)
    names = fields.pop("parameters")
    del fields["name"], fields["formula_law"]
    parameters = tuple(_parameter(source, name) for name in names)
    tuples = {name: tuple(value) for name, value in fields.items() if isinstance(value, list | tuple)}
    return FormulaStepLaw(source=source, right=source.right, parameters=parameters, **fields | tuples)


def _check_geometry(names: Sequence[str], machine: Machine) -> None:
    if needed := [name for name in names if name in OF_GEOMETRY]:
        machine.require_geometry(f"{' and '.join(needed)} in a formula")


def _unit(source: Any, name: str) -> str:
    unit = str(source.units.get(name, "1"))
    if unit in UNITS:
        return unit
    similar = similar_name(unit, UNITS)
    hint = f"did you mean {similar}? " if similar else ""
    raise InputError(
        f"the unit {unit!r} of {name} is not known for a log; {hint}there are {', '.join(UNITS)}. Leave it "
        "out where none fits: values are in SI"
    )


def _parameter(source: Any, name: str) -> Parameter:
    unit = _unit(source, name)
    low, high = source.bounds.get(name, (None, None))
    lower = -inf if low is None or not isfinite(low) else to_si(float(low), unit)
    upper = inf if high is None or not isfinite(high) else to_si(float(high), unit)
    return Parameter(name, unit, "", lower, upper)


def _sizes(
    table: TableLaw, frame: Mapping[str, Array], typical: Array, step: float
) -> tuple[tuple[float, ...], tuple[bool, ...]]:
    """Changes of the parameters that matter, and which are proportional to the step size."""
    model = table.model(frame)
    linear = find_linear(model, typical, range(len(typical)))
    slopes = np.sqrt(np.mean(model(typical)[1] ** 2, axis=0))
    sizes = np.where(np.abs(typical) > 0, np.abs(typical), 1.0)
    for k in linear:
        sizes[k] = step / slopes[k] if slopes[k] > 0 else sizes[k]
    without = typical.copy()
    without[linear] = 0.0
    is_homogeneous = bool(np.all(np.abs(model(without)[0]) < 1e-9 * step))
    proportional = tuple(is_homogeneous and k in linear for k in range(len(typical)))
    return tuple(sizes.tolist()), proportional


def _check_told_apart(table: TableLaw, frame: Mapping[str, Array], typical: Array) -> None:
    """Refuse parameters that no log could tell apart: those that states at random do not."""
    rng, states = np.random.default_rng(0), {}
    for name, values in frame.items():
        known = values[np.isfinite(values)]
        low, high = (known.min(), known.max()) if len(known) else (0.0, 1.0)
        spread = max(high - low, 0.3 * abs(high), 0.3)
        states[name] = rng.uniform(low - spread, high + spread, N_STATES)
        if name == "direction":
            states[name] = np.sign(states[name])
    predicted, slopes = table.model(states)(typical)
    good = np.isfinite(predicted) & np.isfinite(slopes).all(axis=1)
    if good.sum() > 2 * len(typical):
        check_identifiable(table, {name: values[good] for name, values in states.items()}, None, typical)
