# `testable` is not a test, whatever its name begins with.
# ruff: noqa: PT028
"""Logs with hidden effects of a known strength.

>>> hidden = hide("many", ("drift",), strength=8, noise="t5", decoys=("walk",), seed=3)
>>> hidden.truth["effects"][0]["name"], round(hidden.truth["effects"][0]["strength"], 1)
('drift', 8.0)
>>> hidden.table["steps"].gt(0).all()
np.True_
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.hidden.campaign import Campaign, make_campaign
from tests.hidden.catalogue import CAUSES, EFFECTS
from tests.hidden.conditions import decoy
from tests.hidden.effect import Effect, change, expected
from tests.hidden.noise import seen, written
from tests.hidden.physics import Array
from tests.hidden.seeds import stream
from tests.hidden.strength import Ruler
from tests.hidden.table import write_down

CHECK_EVERY = 5
TESTABLE = 3.0
_DRAWS = 12


class UnreachableError(ValueError):
    """An effect cannot be as strong as asked in this log."""


@dataclass(frozen=True)
class Act:
    """An effect at work: its name and form, its size, and which of nature's draws it is."""

    name: str
    form: str
    effect: Effect
    size: float
    draw: int = 0


@dataclass(frozen=True)
class Hidden:
    """A log and what is hidden in it.

    Attributes
    ----------
    table : DataFrame
        The log in its file's columns.
    truth : dict
        ``effects``: for each its name, the cause that a diagnosis should name, form, parameters (name, unit,
        value), amplitude, share_of_largest, strength and effect_rms_pct; ``repeatability_pct``; ``decoys``.
    design, noise : str
    campaign : Campaign
    acts : tuple of Act
    """

    table: pd.DataFrame
    truth: dict[str, Any]
    design: str
    noise: str
    campaign: Campaign
    acts: tuple[Act, ...]

    def effect(self, name: str) -> Array:
        """What one effect alone does to the logarithm of each row's expected count, shape (n,)."""
        (act,) = (act for act in self.acts if act.name == name)
        return change(self.campaign, act.effect, act.size)

    def expected(self) -> Array:
        """Counts without noise and rounding, all effects at work, shape (n,)."""
        return expected(self.campaign, [(act.effect, act.size) for act in self.acts])

    def write(self, path: str | Path) -> None:
        """Write the log as CSV, or as Parquet where the path ends so."""
        if Path(path).suffix == ".parquet":
            self.table.to_parquet(path, index=False)
        else:
            self.table.to_csv(path, index=False)


def hide(
    design: str,
    effects: Sequence[str] = (),
    strength: float | Sequence[float] | None = None,
    noise: str = "gaussian",
    decoys: Sequence[str] = (),
    seed: int = 0,
    forms: Mapping[str, str] | None = None,
    replicate: int = 0,
) -> Hidden:
    """Make a log with effects hidden in it.

    Parameters
    ----------
    design : {'session', 'thesis', 'many'}
    effects : sequence of str
        Names of `catalogue.EFFECTS`; none for a log in which nothing is wrong.
    strength : float or sequence of float, optional
        Of each effect alone; the largest plausible size where none is given. See `strength`.
    noise : str
        One of `noise.KINDS` or `noise.OTHER_KINDS`.
    decoys : sequence of str
        Kinds of `conditions.DECOYS`; they become columns ``sensor_1``, ``sensor_2``, ...
    seed : int
        Settles everything; logs of one seed and design differ in what is asked for alone.
    forms : mapping of str to str, optional
        Form of an effect, by its name; drawn where it is not given.
    replicate : int
        Another number is the same campaign measured again, with the same effects of the same sizes.

    Raises
    ------
    UnreachableError
        If an effect shows nothing of itself in this log, or too little at any size that is possible.
    """
    unknown = set(effects) - set(EFFECTS)
    if unknown:
        raise ValueError(f"there are no effects {sorted(unknown)}; choose from {tuple(EFFECTS)}")
    campaign = make_campaign(design, noise, seed)
    strengths = np.broadcast_to(np.array(strength, dtype=object), len(effects))
    wanted = dict(zip(effects, strengths, strict=True))
    ruler = Ruler(campaign)
    acts = tuple(_act(ruler, name, wanted[name], seed, forms) for name in EFFECTS if name in wanted)
    if replicate:
        campaign = make_campaign(design, noise, seed, replicate)
        ruler, acts = Ruler(campaign), tuple(_again(campaign, act, seed, forms) for act in acts)
    counts = expected(campaign, [(act.effect, act.size) for act in acts])
    if np.any(np.isnan(counts)):
        raise UnreachableError(f"with {', '.join(effects)} at work a joint comes to a halt")
    stops = seen(counts * np.exp(campaign.repeatability * campaign.innovations), CHECK_EVERY)
    steps = written(stops, noise)
    columns = {
        f"sensor_{number}": _decoy(campaign, kind, number, seed) for number, kind in enumerate(decoys, 1)
    }
    return Hidden(
        table=write_down(campaign, steps.astype(np.int64), columns),
        truth={
            "effects": [_truth(ruler, act) for act in acts],
            "repeatability_pct": 100 * float(np.sqrt(np.mean(campaign.repeatability**2))),
            "decoys": dict(zip(columns, decoys, strict=True)),
        },
        design=design,
        noise=noise,
        campaign=campaign,
        acts=acts,
    )


def testable(design: str, seed: int = 0, strength: float | None = None, noise: str = "gaussian") -> list[str]:
    """Names of the causes that can show in the log of this seed: strength 3 at their largest plausible size.

    With a `strength`, those that `hide` can give it at a plausible size.
    """
    ruler = Ruler(make_campaign(design, noise, seed))
    return [
        name
        for name in CAUSES
        if any(_plausible(ruler, effect, strength) for _, effect in _draws(ruler.campaign, name, seed, None))
    ]


testable.__test__ = False  # type: ignore[attr-defined]


def _act(ruler: Ruler, name: str, strength: float | None, seed: int, forms: Mapping[str, str] | None) -> Act:
    """The first draw that is plausible at this strength, else the one that is least implausible."""
    found: list[Act] = []
    for draw, (form, effect) in enumerate(_draws(ruler.campaign, name, seed, (forms or {}).get(name))):
        size = effect.largest if strength is None else ruler.size(effect, strength)
        if size is None or size < effect.smallest:
            continue
        found.append(Act(name, form, effect, size, draw))
        if size <= effect.largest:
            return found[-1]
    if not found:
        raise UnreachableError(f"{name} cannot be of strength {strength} in this log")
    return min(found, key=lambda act: act.size / act.effect.largest)


def _again(campaign: Campaign, act: Act, seed: int, forms: Mapping[str, str] | None) -> Act:
    """An effect in a replicate: that of noise follows the replicate's own."""
    _, effect = _draws(campaign, act.name, seed, (forms or {}).get(act.name))[act.draw]
    return replace(act, effect=effect)


def _draws(campaign: Campaign, name: str, seed: int, form: str | None) -> list[tuple[str, Effect]]:
    """An effect drawn again and again, in a form that this log allows: its shape and sign are nature's."""
    rng, drawn = stream(seed, name), []
    forms = list(EFFECTS[name]) if form is None else [form]
    for _ in range(_DRAWS):
        made = [(each, EFFECTS[name][each](campaign, rng)) for each in rng.permutation(forms)]
        possible = [(str(each), effect) for each, effect in made if effect is not None]
        if possible:
            each, effect = possible[0]
            turn = effect.either_sign and rng.random() < 0.5
            drawn.append((each, effect.reversed() if turn else effect))
    return drawn


def _plausible(ruler: Ruler, effect: Effect, strength: float | None) -> bool:
    if not ruler.strength(effect, effect.largest) >= max(TESTABLE, strength or 0.0):
        return False
    return strength is None or not effect.smallest or ruler.strength(effect, effect.smallest) <= strength


def _truth(ruler: Ruler, act: Act) -> dict[str, object]:
    return {
        "name": act.name,
        "cause": act.effect.cause or act.name.split(":")[0],
        "form": act.form,
        "parameters": act.effect.said(act.size),
        "amplitude": act.size,
        "share_of_largest": act.size / act.effect.largest,
        "strength": ruler.strength(act.effect, act.size),
        "effect_rms_pct": 100 * ruler.rms(act.effect, act.size),
    }


def _decoy(campaign: Campaign, kind: str, number: int, seed: int) -> Array:
    real = campaign.columns or {"hours": campaign.hours}
    return decoy(kind, campaign.hours, campaign.plan.session, real, stream(seed, f"decoy {number} {kind}"))
