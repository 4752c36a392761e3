"""What the names of a formula stand for in a log: where everything stands, and the columns of its rows."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.laws.base import Rows
from stickslip_fit.laws.integration import State
from stickslip_fit.logs.schema import COVARIATE_PREFIX

POSE = ("q1", "q2", "q3", "theta", "psi")
OF_GEOMETRY = ("load", "recoil")
STATE_NAMES = ("q", *POSE, *OF_GEOMETRY, "direction")
NOT_KNOWN_BEFORE = ("steps", "check_every")  # what is to be predicted
_COORDINATE = re.compile(r"q[1-9]\d?")
_COLUMNS_OF = {"load": POSE, "recoil": ("q2",), "direction": ("start", "stop"), "q": ()}


def quantity(state: State, name: str) -> Array:
    """A quantity by its name in a formula, shape (n, k) or (n, 1)."""
    if name in ("q", f"q{state.joint}"):
        return state.position
    if name == "direction":
        return state.direction_sign
    if name in STATE_NAMES:
        return np.asarray(getattr(state, name), dtype=float)
    return state.column(name if name in state.row else COVARIATE_PREFIX + name)


def known_names(rows: Rows) -> tuple[str, ...]:
    """Every name that a formula may have in these rows, besides parameters."""
    own = [
        str(name).removeprefix(COVARIATE_PREFIX)
        for name in rows
        if name not in NOT_KNOWN_BEFORE and _is_numeric(rows[name])
    ]
    return tuple(dict.fromkeys([*STATE_NAMES, *own]))


def columns_of(names: Iterable[str], rows: Rows, joint: int) -> tuple[str, ...]:
    """The columns of rows that quantities need."""
    columns: dict[str, None] = {}
    for name in names:
        if name == f"q{joint}":
            continue
        needed = _COLUMNS_OF.get(name, (name if name in rows or name in POSE else COVARIATE_PREFIX + name,))
        columns |= dict.fromkeys(column for column in needed if column != f"q{joint}")
    return tuple(columns)


def is_coordinate(name: str) -> bool:
    """Whether a name is that of a joint's position."""
    return name == "q" or _COORDINATE.fullmatch(name) is not None


def varies_with_position(names: Collection[str]) -> bool:
    """Whether any of these may vary along a traverse of some joint."""
    return any(is_coordinate(name) or name in OF_GEOMETRY for name in names)


def _is_numeric(column: object) -> bool:
    return np.asarray(column).dtype.kind in "fiub" if not isinstance(column, pd.Series) else (
        pd.api.types.is_numeric_dtype(column))  # fmt: skip
