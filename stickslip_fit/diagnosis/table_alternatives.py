"""Unstructured alternatives for a table: what its law may lack that has no name.

Smooth in every column that the law or a candidate uses, in every two of them at low order, in the predicted
response, each also oppositely in the two directions, and where a column of texts has either of two; by group
where rows repeat; smooth or periodic in time. Where the noise grows with the response, so may what the law
lacks: functions are also shares of it.
Where settings of columns were repeated, each may have a value of its own, whatever the law: replicates tell
what is no noise (the lack-of-fit test; G. E. P. Box and N. R. Draper, Empirical Model-Building and Response
Surfaces, 1987, section 3.12).
In a sampled signal a slow wave of one session cannot be told from its noise, which the autocorrelation
describes, so that only what comes back in every session counts there. `TableAlternatives.expressions` are
the short expressions that may take the place of such a function in the law.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.levels import MAX_LEVELS
from stickslip_fit.causes.roles import TableRoles, direction_labels, direction_sign
from stickslip_fit.causes.smooth import LENGTHS, prior_sds
from stickslip_fit.causes.table_terms import (
    GROUP,
    PREDICTION,
    ColumnFunction,
    CourseTerm,
    PeriodicTableTerm,
    ProposedTableTerm,
    SettingsTerm,
    SmoothTableTerm,
    name_settings,
)
from stickslip_fit.diagnosis.alternatives import MAX_ELEMENTS, choose_periods, smooth_in_time
from stickslip_fit.diagnosis.expressions import Dictionary
from stickslip_fit.diagnosis.hypotheses import (
    EFFECT_TOL,
    Hypothesis,
    make_hypothesis,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.memory import AR1, AR1_COEFFICIENTS, Sequences
from stickslip_fit.diagnosis.session_stacks import build_per_session_hypotheses
from stickslip_fit.logs.fading import previous_rows

PAIR_LENGTH, MAX_PAIR_COLUMNS = 0.4, 7  # correlation length of a function of two columns; columns
MIN_SESSIONS = 3  # for what comes back in every session of a sampled signal
MIN_CYCLES = 2.5  # of a periodic disturbance in a session of a sampled signal
N_SLOW, PERIODS_PER_CYCLE = 120, 4.0  # periods of rows at uneven times; for each cycle more in the record
# Of the rows, those that repeat a setting; settings.
MIN_REPEATED, MAX_SETTINGS = 1.0 / 3.0, 150
AS_SHARE = ", as a share of what the law predicts"  # after the carriers of such a function
MAX_HALVES = 2  # columns of two texts
MIN_RATIO = 2.0  # of the largest to the smallest value of a column, whose logarithm is tried


@dataclass(frozen=True)
class TableAlternatives:
    """From a fit to the unstructured alternatives of its table.

    Attributes
    ----------
    columns : tuple of str
        Of numbers, on which the response may depend.
    sampled : bool
        Whether the autocorrelation of the noise is removed.
    response, unit : str
        Name and unit of the response.
    settings : tuple of tuple of str
        Columns whose settings were repeated.
    course_degree : int
        Of each session's own course in time that is told from noise that persists; 0 without.
    labels : tuple of str
        The two values of a direction that is not of numbers.
    halves : tuple of (str, tuple of str)
        Further columns of two texts each, and these.
    growing : bool
        Whether the noise grows with the response.
    """

    columns: tuple[str, ...]
    roles: TableRoles
    sampled: bool
    response: str
    unit: str
    labels: tuple[str, ...] = ()
    settings: tuple[tuple[str, ...], ...] = ()
    course_degree: int = 0
    growing: bool = False
    halves: tuple[tuple[str, tuple[str, ...]], ...] = ()

    @classmethod
    def of(
        cls, rows: pd.DataFrame, law: Any, roles: TableRoles, covariates: Sequence[str], sampled: bool
    ) -> TableAlternatives:
        """For the rows of a table, a law, and further columns that candidates use."""
        labels = direction_labels(rows[roles.direction]) if roles.direction else ()
        columns = numeric_columns(rows, law, roles, covariates)
        settings = tuple(find_settings(rows, numeric_columns(rows, law, roles, ()), roles, covariates))
        response, unit = str(law.response_name), str(law.response_unit)
        texts = [name for name in covariates if not pd.api.types.is_numeric_dtype(rows[name])]
        halves = tuple((name, direction_labels(rows[name])) for name in texts if rows[name].nunique() == 2)
        return cls(columns, roles, sampled, response, unit, labels, settings, halves=halves[:MAX_HALVES])

    def __call__(self, linearized: LinearizedFit) -> list[Hypothesis | AR1]:
        """Every alternative for which the rows have the columns."""
        waves = self._waves(linearized) if self.roles.time else []
        shapes = [*self.shapes(linearized), *self._jointly(linearized)]
        return [*shapes, *self._beside_white_noise(linearized), *waves]

    def shapes(self, linearized: LinearizedFit) -> list[Hypothesis | AR1]:
        """Those without a period."""
        prediction = np.zeros(len(linearized))
        for part in linearized.parts:
            prediction[part.rows] = part.law.predict(linearized.rows.iloc[part.rows], part.values)
        hypotheses: list[Hypothesis | AR1 | None] = []
        for name, term in self._terms(linearized, prediction):
            versions = {"": term}
            if self.growing and PREDICTION not in term.carriers:
                largest = float(np.abs(prediction).max())
                versions[AS_SHARE] = replace(term, share_of=largest)
            versions |= {
                f"{ending}{opposite}": replace(one, direction=column, labels=labels)
                for ending, one in versions.items()
                for opposite, column, labels in self._opposites()
            }
            for ending, version in versions.items():
                functions = version.functions(linearized.columns, prediction) * term.sds
                signed = linearized.whiten(version.sign(linearized.columns)[:, None] * functions)
                effects = linearized.project(signed)
                hypotheses.append(make_hypothesis(f"unknown:{name}{ending}", version, None, effects))
        hypotheses += self._groups(linearized)
        if self.roles.time:
            hypotheses += self._in_time(linearized)
        return [one for one in hypotheses if one is not None]

    def _opposites(self) -> Iterator[tuple[str, str, tuple[str, ...]]]:
        """Columns in whose two values a function may be opposite, with its name's ending and the values."""
        if self.roles.direction:
            yield " by direction", self.roles.direction, self.labels
        for column, labels in self.halves:
            yield f", oppositely where {column} is {labels[1]} and {labels[0]}", column, labels

    def _terms(self, linearized: LinearizedFit, prediction: Array) -> Iterator[tuple[str, SmoothTableTerm]]:
        """Names and smooth functions of what does not depend on time."""
        values = {name: np.asarray(linearized.columns[name], float) for name in self.columns}
        # Of one column and one session, what the law predicts is a function of that column.
        several = len(values) > 1 or len(np.unique(linearized.rows["session"].to_numpy(object))) > 1
        for name, own in (*values.items(), *([(PREDICTION, prediction)] if several else [])):
            limits, distinct = (float(own.min()), float(own.max())), len(np.unique(own))
            for length in LENGTHS if limits[1] > limits[0] else ():
                sds = prior_sds(length)[: distinct - 1]
                orders = tuple((k,) for k in range(1, len(sds) + 1))
                yield name, self._smooth((name,), (limits,), orders, tuple(map(float, sds)))
                if len(sds) == distinct - 1:
                    break
        sds = prior_sds(PAIR_LENGTH)
        for names, both in self._pairs(values):
            pairs = tuple(product(range(1, len(sds) + 1), repeat=2))
            own_sds = tuple(float(sds[first - 1] * sds[last - 1]) for first, last in pairs)
            yield " and ".join(names), self._smooth(names, both, pairs, own_sds)

    def _pairs(
        self, values: Mapping[str, Array]
    ) -> Iterator[tuple[tuple[str, str], tuple[tuple[float, float], ...]]]:
        """Every two of the columns, by their values, and the limits of both."""
        for names in combinations(list(values)[:MAX_PAIR_COLUMNS], 2):
            limits = tuple((float(values[name].min()), float(values[name].max())) for name in names)
            if all(low < high for low, high in limits):
                yield names, limits

    def _smooth(self, carriers: Any, limits: Any, orders: Any, sds: Any) -> SmoothTableTerm:
        return SmoothTableTerm(
            carriers=carriers, limits=limits, orders=orders, sds=sds, response=self.response, unit=self.unit
        )

    def _groups(self, linearized: LinearizedFit) -> list[Hypothesis | AR1 | None]:
        """An offset for each group, alike or opposite by direction."""
        if not self.roles.group:
            return []
        codes, groups = pd.factorize(linearized.rows[self.roles.group])
        if len(groups) >= len(codes) / 3 or len(groups) * len(codes) >= MAX_ELEMENTS:
            return []
        shapes = [(GROUP, np.eye(len(groups))[codes])]
        if self.roles.direction:
            sign = direction_sign(linearized.columns, self.roles.direction, self.labels)
            shapes.append((f"{GROUP} by direction", sign[:, None] * shapes[0][1]))
        return [
            make_hypothesis(f"unknown:{name}", None, None, linearized.project(linearized.whiten(columns)))
            for name, columns in shapes
        ]

    def _jointly(self, linearized: LinearizedFit) -> Iterator[Hypothesis]:
        """What columns do together: any function of two, a value for each setting that was repeated."""
        values = {name: np.asarray(linearized.columns[name], float) for name in self.columns}
        sds = np.array([1.0, *prior_sds(PAIR_LENGTH)])  # of order 0: of an rms of 1, too
        orders = tuple(product(range(len(sds)), repeat=2))[1:]
        own_sds = tuple(float(sds[first] * sds[last]) for first, last in orders)
        terms: list[tuple[str, SmoothTableTerm]] = [
            (" and ".join(names), self._smooth(names, limits, orders, own_sds))
            for names, limits in self._pairs(values)
        ]
        for columns in self.settings:
            levels = np.unique(name_settings(linearized.columns, columns))
            each = SettingsTerm.of(columns, levels, response=self.response, unit=self.unit)
            terms.append((f"settings of {join_words(columns)}", each))
        for name, term in terms:
            effects = linearized.project(linearized.whiten(term.functions(linearized.columns) * term.sds))
            if one := make_hypothesis(f"unknown:{name}", term, None, effects):
                yield one

    def _in_time(self, linearized: LinearizedFit) -> list[Hypothesis | AR1 | None]:
        rows, sessions = linearized.rows, list(split_sessions(linearized).values())
        seconds = rows["session_seconds"].to_numpy(float)
        session = pd.factorize(rows["session"].astype(object))[0]
        waves, n = smooth_in_time(seconds, session), len(rows)
        hypotheses: list[Hypothesis | AR1 | None] = []
        if len(sessions) >= MIN_SESSIONS or not self.sampled:
            alike = linearized.project(linearized.whiten(waves))
            hypotheses.append(make_hypothesis("unknown:time, the same in each session", None, None, alike))
        if term := self._course(linearized, waves.shape[1]):
            if self.course_degree:
                waves = replace(term, sessions=()).functions(linearized.columns) * term.sds
            own = linearized.whiten(waves)[:, None]
            slow = build_per_session_hypotheses(["unknown:time"], n, sessions, own)
            hypotheses += [replace(one, version=term) for one in slow]
        if not self.sampled:
            before = previous_rows(session.astype(np.int64)).astype(np.intp)
            sequences = Sequences.of(before, linearized.basis)
            hypotheses += [AR1("unknown:memory", sequences, phi) for phi in AR1_COEFFICIENTS]
        return hypotheses

    def _course(self, linearized: LinearizedFit, n_waves: int) -> SmoothTableTerm | None:
        """A function of time for each session; of a signal, a polynomial of what the law does not absorb."""
        labels = tuple(map(str, dict.fromkeys(linearized.rows["session"].astype(object))))
        sessions = labels if len(labels) > 1 else ()
        limits = ((0.0, float(linearized.rows["session_seconds"].max())),)
        if not self.sampled:
            orders = tuple((k,) for k in range(1, n_waves + 1))
            sds = tuple(1.0 / k for (k,) in orders)
            return replace(self._smooth(("session_seconds",), limits, orders, sds), sessions=sessions)
        if not self.course_degree:
            return None
        degrees = np.arange(1, self.course_degree + 1)
        attributes: Any = {
            "limits": limits,
            "response": self.response,
            "unit": self.unit,
            "sessions": sessions,
        }
        term = CourseTerm.of_degrees(degrees.tolist(), **attributes)
        columns = linearized.whiten(term.functions(linearized.columns))
        left = np.linalg.norm(linearized.project(columns), axis=0) / np.linalg.norm(columns, axis=0)
        kept = degrees[left.reshape(-1, len(degrees)).max(axis=0) > EFFECT_TOL]
        return CourseTerm.of_degrees(kept.tolist(), **attributes) if len(kept) else None

    def _beside_white_noise(self, linearized: LinearizedFit) -> list[Hypothesis]:
        """Smooth functions of the time of a sampled signal: noise that persists may be as slow."""
        if (
            not self.sampled
            or linearized.noise_filter is not None
            or linearized.rows["session"].nunique() > 1
        ):
            return []
        seconds = linearized.rows["session_seconds"].to_numpy(float)
        found = []
        for length in LENGTHS:
            sds = tuple(map(float, prior_sds(length)[: len(np.unique(seconds)) - 1]))
            orders = tuple((k,) for k in range(1, len(sds) + 1))
            term = self._smooth(("session_seconds",), ((0.0, float(seconds.max())),), orders, sds)
            effects = linearized.project(linearized.whiten(term.functions(linearized.columns) * term.sds))
            found.append(make_hypothesis("unknown:time", term, None, effects))
        return [one for one in found if one is not None]

    def _waves(self, linearized: LinearizedFit) -> list[Hypothesis]:
        rows, sessions = linearized.rows, list(split_sessions(linearized).values())
        seconds = rows["session_seconds"].to_numpy(float)
        session, labels = pd.factorize(rows["session"].astype(object))
        periods = (sampled_periods if self.sampled else unevenly_sampled_periods)(seconds, session)
        if not len(periods):
            return []
        angles = 2 * np.pi * seconds[:, None] / periods
        pairs = linearized.whiten(np.concatenate([np.cos(angles), np.sin(angles)], axis=1))
        pairs = np.stack(np.split(pairs, 2, axis=1), axis=-1)
        numbers = [str(number) for number in range(len(periods))]
        plain = PeriodicTableTerm(
            period=1.0,
            limits=((0.0, float(seconds.max())),),
            sds=(1.0, 1.0),
            sessions=tuple(map(str, labels)),
            time_unit=self.roles.time_unit,
            unit=self.unit,
        )
        found = []
        for one in build_per_session_hypotheses(numbers, len(rows), sessions, pairs):
            wave = replace(plain, period=float(periods[int(one.cause)]))
            found.append(replace(one, cause=f"unknown:{wave}", version=wave))
        return found

    def expressions(self, linearized: LinearizedFit) -> Dictionary | None:
        """Short expressions over the columns, alike in both directions or opposite; None without columns."""
        single = [
            (factor, factor.values(np.asarray(linearized.columns[name], float)))
            for name in self.columns
            for factor in _column_functions(name, np.asarray(linearized.columns[name], float))
        ]
        products: list[tuple[ColumnFunction, ...]] = [(factor,) for factor, _ in single]
        columns = [values for _, values in single]
        for (one, values), (other, others) in combinations(single, 2):
            if one.column != other.column and one.expression == other.expression == "x":
                products.append((one, other))
                columns.append(values * others)
        if not products:
            return None
        n, sets, groups = len(linearized), [""], [np.arange(len(linearized))]
        combine = np.ones((1, 1))
        if self.roles.direction:
            sign = direction_sign(linearized.columns, self.roles.direction, self.labels)
            sets = ["", self.roles.direction]
            groups = [np.flatnonzero(sign >= 0), np.flatnonzero(sign < 0)]
            combine = np.array([[1.0, 1.0], [1.0, -1.0]])

        def make(place: int, best: int, coefficients: Array) -> tuple[ProposedTableTerm, Array]:
            factors = tuple(astuple(factor) for factor in products[best])
            labels = self.labels if sets[place] else ()
            term = ProposedTableTerm(factors=factors, unit=self.unit, direction=sets[place], labels=labels)
            return term, coefficients

        return Dictionary(
            linearized,
            np.stack(columns, axis=1).reshape(n, -1),
            groups,
            combine,
            np.zeros((len(sets), len(products)), dtype=bool),
            make,
            np.array([len(product) for product in products]),
        )


def sampled_periods(seconds: Array, session: IntArray) -> Array:
    """Periods that a sampled signal may show: those of which a session has many cycles."""
    periods = choose_periods(seconds, session)
    return periods[periods < seconds.max() / MIN_CYCLES]


def unevenly_sampled_periods(seconds: Array, session: IntArray) -> Array:
    """Periods that rows at any times may show: the slow ones so close that none is missed between two."""
    periods, longest = choose_periods(seconds, session), float(seconds.max())
    if not len(periods):
        return periods
    rates = 1.0 / periods.max() + np.arange(N_SLOW) / (PERIODS_PER_CYCLE * longest)
    slow = 1.0 / rates[rates < 1.0 / periods.min()]
    return np.sort(np.concatenate([slow, periods[periods < slow.min(initial=np.inf)]]))[::-1]


def _column_functions(name: str, values: Array) -> Iterator[ColumnFunction]:
    """Short functions of a column, in units in which they are of the order of 1."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return
    middle, unit = _round((low + high) / 2), _round((high - low) / 2)
    yield from (ColumnFunction(expression, name, middle, unit) for expression in ("x", "x^2", "|x|"))
    if low > 0 and high > MIN_RATIO * low:
        yield ColumnFunction("log(x)", name, 0.0, _round(float(np.exp(np.mean(np.log(values))))))


def _round(value: float) -> float:
    """To four significant digits, so that a formula is what it says."""
    return float(f"{value:.4g}")


def numeric_columns(
    rows: pd.DataFrame, law: Any, roles: TableRoles, covariates: Sequence[str]
) -> tuple[str, ...]:
    """Columns on which the response may depend: the law's, the position, and further ones of numbers."""
    own = [name for name in law.columns if name in rows and name not in response_columns(law)]
    position = [roles.position] if roles.position else []
    names = dict.fromkeys([*position, *own, *covariates])
    return tuple(name for name in names if pd.api.types.is_numeric_dtype(rows[name]))


def find_settings(
    rows: pd.DataFrame, own: Sequence[str], roles: TableRoles, covariates: Sequence[str]
) -> Iterator[tuple[str, ...]]:
    """Columns whose settings were repeated: a law's `own`, with each other column, and with all of them.

    And every two columns of few values each, as of a designed experiment.
    """
    law = [*own, *([roles.direction] if roles.direction else [])]
    few = [name for name in dict.fromkeys([*law, *covariates]) if rows[name].nunique() <= MAX_LEVELS]
    pairs = list(combinations(few, 2)) if len(few) <= MAX_PAIR_COLUMNS else []
    sets = [law, *([*law, name] for name in covariates), *pairs, [*law, *covariates]]
    known = set[tuple[int, ...]]()
    for columns in dict.fromkeys(map(tuple, sets)):
        if len(columns) < 2:  # of one column a smooth function has as many values
            continue
        place, names = pd.factorize(name_settings(rows, columns))
        repeated = len(rows) - len(names)
        if (
            1 < len(names) <= MAX_SETTINGS
            and repeated >= MIN_REPEATED * len(rows)
            and tuple(place) not in known
        ):
            known.add(tuple(place))
            yield columns


def response_columns(law: Any) -> tuple[str, ...]:
    """Columns of the response of a law."""
    left = getattr(law, "left", None)
    return tuple(left.names) if left is not None else (law.response_name,)
