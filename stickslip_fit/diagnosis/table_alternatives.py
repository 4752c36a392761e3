"""Unstructured alternatives for a table: what its law may lack that has no name.

Smooth in every column that the law or a candidate uses, in every two of them at low order, in the predicted
response, each also oppositely in the two directions; by group where rows repeat; smooth or periodic in time.
In a sampled signal a slow wave of one session cannot be told from its noise, which the autocorrelation
describes, so that only what comes back in every session counts there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.roles import TableRoles, direction_labels, direction_sign
from stickslip_fit.diagnosis.alternatives import (
    MAX_ELEMENTS,
    N_WAVES,
    choose_periods,
    smooth_in_time,
)
from stickslip_fit.diagnosis.hypotheses import (
    Hypothesis,
    build_per_session_hypotheses,
    make_hypothesis,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.memory import AR1, AR1_COEFFICIENTS, Sequences
from stickslip_fit.logs.history import previous_rows

DIRECTION_TOL = 1e-3  # of the largest singular value
PAIR_WAVES, MAX_PAIR_COLUMNS = 3, 7
MIN_SESSIONS = 3  # for what comes back in every session of a sampled signal
MIN_CYCLES = 10.0  # of a periodic disturbance in a session of a sampled signal


@dataclass(frozen=True)
class TableAlternatives:
    """From a fit to the unstructured alternatives of its table.

    Attributes
    ----------
    columns : tuple of str
        Of numbers, on which the response may depend.
    roles : TableRoles
    sampled : bool
        Whether the autocorrelation of the noise is removed.
    """

    columns: tuple[str, ...]
    roles: TableRoles
    sampled: bool

    def __call__(self, linearized: LinearizedFit) -> list[Hypothesis | AR1]:
        """Every alternative for which the rows have the columns."""
        shapes = list(self._shapes(linearized))
        if self.roles.direction:
            cells = linearized.rows[self.roles.direction]
            sign = direction_sign(linearized.columns, self.roles.direction, direction_labels(cells))[:, None]
            shapes += [(f"{name} by direction", sign * waves) for name, waves in shapes]
        hypotheses: list[Hypothesis | AR1 | None] = [
            make_hypothesis(f"unknown:{name}", None, None, linearized.project(linearized.whiten(waves)))
            for name, waves in shapes
        ]
        if self.roles.time:
            hypotheses += self._in_time(linearized)
        return [one for one in hypotheses if one is not None]

    def _shapes(self, linearized: LinearizedFit) -> Iterator[tuple[str, Array]]:
        """Names and columns, shape (n, m), of what does not depend on time."""
        waves = {name: smooth_waves(linearized.columns[name]) for name in self.columns}
        yield from waves.items()
        predicted = np.zeros(len(linearized))
        for part in linearized.parts:
            predicted[part.rows] = part.law.predict(linearized.rows.iloc[part.rows], part.values)
        yield "prediction", smooth_waves(predicted)
        for one, other in combinations(self.columns[:MAX_PAIR_COLUMNS], 2):
            product = waves[one][:, :PAIR_WAVES, None] * waves[other][:, None, :PAIR_WAVES]
            yield f"{one} and {other}", product.reshape(len(product), -1)
        if self.roles.group:
            codes, groups = pd.factorize(linearized.rows[self.roles.group])
            if len(groups) < len(codes) / 3 and len(groups) * len(codes) < MAX_ELEMENTS:
                yield "group", np.eye(len(groups))[codes]

    def _in_time(self, linearized: LinearizedFit) -> list[Hypothesis | AR1 | None]:
        rows, sessions = linearized.rows, list(split_sessions(linearized).values())
        seconds = rows["session_seconds"].to_numpy(float)
        session = pd.factorize(rows["session"].astype(object))[0]
        waves, n = smooth_in_time(seconds, session), len(rows)
        hypotheses: list[Hypothesis | AR1 | None] = []
        if len(sessions) >= MIN_SESSIONS or not self.sampled:
            alike = linearized.project(linearized.whiten(waves))
            hypotheses.append(make_hypothesis("unknown:time, the same in each session", None, None, alike))
        if not self.sampled:
            own = linearized.whiten(waves)[:, None]
            hypotheses += build_per_session_hypotheses(["unknown:time"], n, sessions, own)
            before = previous_rows(session.astype(np.int64)).astype(np.intp)
            sequences = Sequences(before, linearized.basis)
            hypotheses += [AR1("unknown:memory", sequences, phi) for phi in AR1_COEFFICIENTS]
        periods = choose_periods(seconds, session)
        if self.sampled:
            periods = periods[periods < seconds.max() / MIN_CYCLES]
        angles = 2 * np.pi * seconds[:, None] / periods
        pairs = linearized.whiten(np.concatenate([np.cos(angles), np.sin(angles)], axis=1))
        pairs = np.stack(np.split(pairs, 2, axis=1), axis=-1)
        names = [f"unknown:period of {period:.3g} {self.roles.time_unit}" for period in periods]
        hypotheses += build_per_session_hypotheses(names, n, sessions, pairs) if names else []
        return hypotheses


def smooth_waves(values: Array) -> Array:
    """Cosines over the range of some values, the shorter the smaller, shape (n, m); none if all are equal."""
    values = np.asarray(values, dtype=float)
    low, extent = values.min(), np.ptp(values)
    if not extent > 0:
        return np.zeros((len(values), 0))
    number = min(N_WAVES, len(np.unique(values)) - 1)
    phase = (values - low) / extent
    return np.stack([np.cos(np.pi * k * phase) / k for k in range(1, number + 1)], axis=-1)


def numeric_columns(
    rows: pd.DataFrame, law: Any, roles: TableRoles, covariates: Sequence[str]
) -> tuple[str, ...]:
    """Columns on which the response may depend: the law's, the position, and further ones of numbers."""
    own = [name for name in law.columns if name in rows and name not in response_columns(law)]
    position = [roles.position] if roles.position else []
    names = dict.fromkeys([*position, *own, *covariates])
    return tuple(name for name in names if pd.api.types.is_numeric_dtype(rows[name]))


def response_columns(law: Any) -> tuple[str, ...]:
    """Columns of the response of a law."""
    left = getattr(law, "left", None)
    return tuple(left.names) if left is not None else (law.response_name,)


def leading_directions(effects: Sequence[Array], most: int) -> Array:
    """Directions that carry most of some effects of equal weight, each shape (n, m_i); shape (n, m)."""
    lengths = [float(np.linalg.norm(one)) for one in effects]
    columns = [one / (length or 1.0) for one, length in zip(effects, lengths, strict=True)]
    left, singular, _ = np.linalg.svd(np.concatenate(columns, axis=1), full_matrices=False)
    return np.asarray(left[:, singular > DIRECTION_TOL * max(float(singular[0]), 1e-300)][:, :most])
