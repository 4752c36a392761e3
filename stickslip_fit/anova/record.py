"""An answer or a refusal as one flat record, for JSON and tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from stickslip_fit._format import step_unit
from stickslip_fit.anova.answer import Answer
from stickslip_fit.anova.question import Refusal
from stickslip_fit.files import write_atomically
from stickslip_fit.units import from_si

COLUMNS = (
    "analysis", "joint", "direction", "session", "configuration", "F", "df", "error_term", "p_value",
    "p_holm", "p_permutation", "p_permutation_floor", "omega_squared", "difference", "levels", "unit",
    "low", "high",
)  # fmt: skip


def save_records(records: Sequence[Mapping[str, object]], path: str | Path) -> None:
    """Write records as a JSON list.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    text = json.dumps(list(records), indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(path, text + "\n")


def record(item: Answer | Refusal) -> dict[str, object]:
    """The fields of `COLUMNS`, None where one does not apply; difference, low and high in `unit`."""
    asked = item.question if isinstance(item, Answer) else item
    found: dict[str, object] = dict.fromkeys(COLUMNS)
    found |= {name: getattr(asked, name) for name in COLUMNS[:5]}
    if isinstance(item, Refusal):
        return found
    unit = step_unit(item.question.joint)
    effect, permutation = item.effect, item.permutation
    return found | {
        "F": item.statistic,
        "df": [int(freedom) for freedom in item.squares.freedom[1:]],
        "error_term": item.question.error_term,
        "p_value": item.p_value,
        "p_holm": item.p_holm,
        "p_permutation": permutation.p_value,
        "p_permutation_floor": permutation.floor,
        "omega_squared": float(item.squares.omega_squared),
        "levels": list(item.furthest),
        "unit": unit,
        "difference": from_si(effect.difference, unit),
        "low": from_si(effect.low, unit),
        "high": from_si(effect.high, unit),
    }
