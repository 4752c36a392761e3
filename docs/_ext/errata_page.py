"""What does not hold of the thesis, what does, what follows: ``data/published``, its numbers filled in."""

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from markdown import table

FOLDER = Path(__file__).parents[2] / "data" / "published"


def page() -> str:
    """Tables of what does not hold, of what does, and of what follows."""
    errata = _read("errata")
    wrong = table(["place", "the thesis", "what is right"], _rows(errata["erratum"], "claim", "finding"))
    right = table(["place", "the thesis"], _rows(errata["confirmed"], "claim"))
    implied = table(["place", "what follows"], _rows(errata["implied"], "claim"))
    return f"{wrong}\n\n## What holds\n\n{right}\n\n## What the p-values imply\n\n{implied}"


def numbers() -> dict[str, dict[str, Any]]:
    """Printed and derived numbers by name."""
    return {entry["name"]: entry for file in ("published", "derived") for entry in _read(file)["number"]}


def _read(name: str) -> Any:
    return tomllib.loads((FOLDER / f"{name}.toml").read_text("utf-8"))


def _rows(entries: Iterable[dict[str, str]], *keys: str) -> list[list[str]]:
    known = numbers()

    def fill(match: re.Match[str]) -> str:
        entry = known[match[1]]
        return _values(entry) if match[2] else _with_unit(entry)

    return [[entry["place"], *(re.sub(FIELD, fill, entry[key]) for key in keys)] for entry in entries]


FIELD = r"(?<![_^A-Za-z]){([a-z]\w{2,}|a|b|c)(\.value)?}"  # {name}, and not the braces of a formula


def _with_unit(entry: dict[str, Any]) -> str:
    """Values of several units each have theirs."""
    units = entry["unit"].split(", ")
    if isinstance(entry["value"], list) and len(units) == len(entry["value"]) > 1:
        return _join([f"{_plain(value)} {unit}" for value, unit in zip(entry["value"], units, strict=True)])
    unit = {"1": "", "not printed": "", "deg": "°"}.get(entry["unit"], f" {entry['unit']}")
    return _values(entry) + unit


def _values(entry: dict[str, Any]) -> str:
    values = entry["value"] if isinstance(entry["value"], list) else [entry["value"]]
    return _join([_plain(value) for value in values])


def _plain(value: float) -> str:
    return f"{value:g}".replace("e-0", "e-")


def _join(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
