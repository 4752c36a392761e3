"""Many hypotheses at once, each with functions of every session that have coefficients of their own.

Thousands of waves are tried in each test. Their directions are kept session by session, side by side, and
multiplied together. Where sessions share parameters, what these take is projected out of all sessions
together (`Coupling`), which is done with the few products of each hypothesis instead of all its rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from stickslip_fit._linalg import eigh
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL, VARIANCE_TOL, Block, Hypothesis, SessionFit

MIN_OF_STACK = 0.25  # of the hypotheses of a stack, from which all of it is multiplied at once
MAX_COUPLED_SESSIONS = 6  # with more, one has too little of a shared parameter to matter


@dataclass(frozen=True, eq=False)
class Coupling:
    """What makes directions of the columns of all sessions, which share k parameters; P hypotheses.

    Attributes
    ----------
    weights : array, shape (P, m, m)
        Of the columns of all sessions in each direction.
    along : array, shape (P, m, k)
        Products of the columns with the shared basis.
    shared : array, shape (n, k)
        Orthonormal basis of what the sessions share, in all rows.
    """

    weights: Array
    along: Array
    shared: Array

    def coefficients(self, products: Array, shared: Array) -> Array:
        """Along each direction, (..., P, m, c), from those of the columns.

        `shared`, (..., k, c), are the products of the same samples with the shared basis.
        """
        return np.asarray(self.weights @ (products - self.along @ shared[..., None, :, :]))

    def astype(self, dtype: npt.DTypeLike) -> Coupling:
        """The same in another precision."""
        return Coupling(*(one.astype(dtype) for one in (self.weights, self.along, self.shared)))


@dataclass(frozen=True, eq=False)
class DirectionStack:
    """The directions of P hypotheses that have equally many of them in the same rows, session by session.

    Attributes
    ----------
    rows : tuple of array of int, shape (s,), or slice
        Of each session.
    columns : tuple of array, shape (P, w, s)
        Of each session: its directions, unless they are coupled.
    coupling : Coupling or None
    """

    rows: tuple[IntArray | slice, ...]
    columns: tuple[Array, ...]
    coupling: Coupling | None = None

    def __len__(self) -> int:
        return len(self.columns[0])

    @property
    def width(self) -> int:
        """Number of directions of each hypothesis."""
        return sum(own.shape[1] for own in self.columns)

    def coefficients(self, residuals: Array) -> Array:
        """Along each direction, (n, c) -> (P, m, c)."""
        found, first = np.empty((len(self), self.width, residuals.shape[1])), 0
        for rows, own in zip(self.rows, self.columns, strict=True):
            last = first + own.shape[1]
            along = own.reshape(-1, own.shape[2]) @ residuals[rows]
            found[:, first:last] = along.reshape(len(own), own.shape[1], -1)
            first = last
        if self.coupling is None:
            return found
        return self.coupling.coefficients(found, self.coupling.shared.T @ residuals)

    def select(self, places: IntArray) -> DirectionStack:
        """Some of its hypotheses."""
        coupling = self.coupling
        if coupling is not None:
            coupling = Coupling(coupling.weights[places], coupling.along[places], coupling.shared)
        return DirectionStack(self.rows, tuple(own[places] for own in self.columns), coupling)

    def blocks(self, place: int) -> tuple[Block, ...]:
        """Directions of one hypothesis: a block of each session, or one of all rows if they are coupled."""
        if self.coupling is None:
            return tuple((rows, own[place].T) for rows, own in zip(self.rows, self.columns, strict=True))
        weights, along = self.coupling.weights[place], self.coupling.along[place]
        directions, first = -self.coupling.shared @ (weights @ along).T, 0
        for rows, own in zip(self.rows, self.columns, strict=True):
            last = first + own.shape[1]
            directions[rows] += own[place].T @ weights[:, first:last].T
            first = last
        return ((slice(None), directions),)


@dataclass(frozen=True, eq=False)
class StackedBlocks(Sequence[Block]):
    """The blocks of one hypothesis of a stack, each made when it is asked for.

    Thousands of waves with functions of dozens of sessions have a hundred thousand of them.
    """

    stack: DirectionStack
    place: int

    def __len__(self) -> int:
        return len(self.stack.rows) if self.stack.coupling is None else 1

    @overload
    def __getitem__(self, index: int) -> Block: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Block]: ...
    def __getitem__(self, index: int | slice) -> Block | Sequence[Block]:
        """The block of a session."""
        if isinstance(index, slice) or self.stack.coupling is not None:
            return self.stack.blocks(self.place)[index]
        return self.stack.rows[index], self.stack.columns[index][self.place].T


@dataclass(frozen=True, eq=False)
class StackMembers:
    """Some of the hypotheses of a stack.

    Attributes
    ----------
    stack : DirectionStack
    numbers, places : array of int, shape (h,)
        Their positions among all hypotheses, and in the stack.
    sign : array, shape (n,), or None
        That of those which have one.
    is_signed : array of bool, shape (h,)
    """

    stack: DirectionStack
    numbers: IntArray
    places: IntArray
    sign: Array | None
    is_signed: BoolArray

    @classmethod
    def of(cls, stack: DirectionStack, hypotheses: Sequence[Hypothesis], numbers: IntArray) -> StackMembers:
        """Those at some positions among all hypotheses, of the stack or, if they are few, of a part of it."""
        own = [hypotheses[k] for k in numbers]
        places = np.array([one.blocks.place for one in own if isinstance(one.blocks, StackedBlocks)])
        sign = next((one.sign for one in own if one.sign is not None), None)
        is_signed = np.array([one.sign is not None for one in own])
        if len(numbers) < MIN_OF_STACK * len(stack):
            some, places = np.unique(places, return_inverse=True)
            stack = stack.select(some)
        return cls(stack, numbers, places, sign, is_signed)

    def coefficients(self, residuals: Array) -> Array:
        """Along their directions, (n, c) -> (h, m, c)."""
        if self.sign is None:
            return self.stack.coefficients(residuals)[self.places]
        found = np.empty((len(self.places), self.stack.width, residuals.shape[1]))
        for is_signed, own in ((False, residuals), (True, self.sign[:, None] * residuals)):
            some = self.is_signed == is_signed
            if some.any():
                found[some] = self.stack.coefficients(own)[self.places[some]]
        return found


def find_stacks(hypotheses: Sequence[Hypothesis]) -> tuple[list[StackMembers], IntArray]:
    """The stacks of which some hypotheses are, and the positions of all others."""
    stacks: dict[int, DirectionStack] = {}
    numbers: dict[int, list[int]] = {}
    others: list[int] = []
    for number, one in enumerate(hypotheses):
        if isinstance(one.blocks, StackedBlocks) and not one.one_sided:
            stacks[id(one.blocks.stack)] = one.blocks.stack
            numbers.setdefault(id(one.blocks.stack), []).append(number)
        else:
            others.append(number)
    found = [
        StackMembers.of(stack, hypotheses, np.array(numbers[key], dtype=np.intp))
        for key, stack in stacks.items()
    ]
    return found, np.array(others, dtype=np.intp)


def build_per_session_hypotheses(
    names: Sequence[str],
    n: int,
    sessions: Sequence[SessionFit],
    effects: Array,
    versions: Sequence[Any] | None = None,
) -> list[Hypothesis]:
    """A hypothesis of each name and version, with independent coefficients in every session.

    `n` is the number of rows; `effects`, shape (n, number of names, w), are whitened.
    """
    if not names:
        return []
    versions = [None] * len(names) if versions is None else versions
    shared, parts = sessions[0].shared, [_OwnEffects.of(session, effects) for session in sessions]
    coupled = shared if 1 < len(sessions) <= MAX_COUPLED_SESSIONS else None
    try:
        stack, variance = _stack(parts) if coupled is None else _couple(parts, coupled)
    except np.linalg.LinAlgError:  # of one of them: all are left out
        return []
    total = variance.sum(axis=1)
    kept = variance > VARIANCE_TOL * total[:, None]
    whole, hypotheses = kept.all(axis=1), []
    for k in np.flatnonzero(total >= EFFECT_TOL**2).tolist():
        blocks: Sequence[Block] = StackedBlocks(stack, k)
        if not whole[k]:
            blocks = stack.blocks(k)
            ends = np.cumsum([block.shape[1] for _, block in blocks])[:-1]
            inside = np.split(kept[k], ends)
            blocks = tuple((rows, own[:, some]) for (rows, own), some in zip(blocks, inside, strict=True))
        share, length = variance[k][kept[k]] / total[k], float(np.sqrt(total[k]))
        left = shared if coupled is None else None
        hypotheses.append(Hypothesis(names[k], versions[k], None, n, blocks, share, length, shared=left))
    return hypotheses


@dataclass(frozen=True, eq=False)
class _OwnEffects:
    """What a session's own calibration leaves of the effects of P hypotheses, w of each.

    Attributes
    ----------
    rows : array of int, shape (s,)
    columns : array, shape (P, w, s)
    shared : array, shape (s, k)
        Basis of what all sessions share, still to be projected out.
    """

    rows: IntArray
    columns: Array
    shared: Array

    @classmethod
    def of(cls, session: SessionFit, effects: Array) -> _OwnEffects:
        """Of effects in all rows, shape (n, P, w)."""
        own = session.project(effects[session.rows].reshape(len(session), -1))
        columns = np.ascontiguousarray(own.T).reshape(*effects.shape[1:], len(session))
        return cls(session.rows, columns, session.shared_basis)

    @cached_property
    def products(self) -> Array:
        """Of the columns of each hypothesis, shape (P, w, w)."""
        return np.asarray(self.columns @ self.columns.transpose(0, 2, 1))

    @cached_property
    def along(self) -> Array:
        """Of the columns and the shared basis, shape (P, w, k)."""
        return np.asarray(self.columns @ self.shared)


def _stack(parts: Sequence[_OwnEffects]) -> tuple[DirectionStack, Array]:
    """The stack of sessions each by itself, and the variances along its directions, shape (P, m)."""
    columns, variances = [], []
    for part in parts:
        weights, variance = _find_directions(part.products - part.along @ part.along.transpose(0, 2, 1))
        columns.append(weights @ part.columns)
        variances.append(variance)
    stack = DirectionStack(tuple(part.rows for part in parts), tuple(columns))
    return stack, np.concatenate(variances, axis=1)


def _couple(parts: Sequence[_OwnEffects], shared: Array) -> tuple[DirectionStack, Array]:
    """As `_stack`, with what the sessions share projected out of all of them together.

    Session by session, what one loses to a shared parameter would count in the others.
    """
    along, first = np.concatenate([part.along for part in parts], axis=1), 0
    products = -along @ along.transpose(0, 2, 1)
    for part in parts:
        last = first + part.products.shape[1]
        products[:, first:last, first:last] += part.products
        first = last
    weights, variance = _find_directions(products)
    rows, columns = tuple(part.rows for part in parts), tuple(part.columns for part in parts)
    return DirectionStack(rows, columns, Coupling(weights, along, shared)), variance


def _find_directions(products: Array) -> tuple[Array, Array]:
    """Weights of columns in orthonormal directions, (P, w, w), and their variances, (P, w), from products.

    Raises
    ------
    LinAlgError
        If the eigenvalues of one of them do not converge.
    """
    variance, right = eigh(products)
    scaled = right / np.sqrt(np.maximum(variance, EFFECT_TOL**2))[:, None, :]
    return scaled.transpose(0, 2, 1), np.maximum(variance, 0.0)
