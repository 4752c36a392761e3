"""The columns that an analyst who knows the table of causes would try: what each cause would do to log steps.

First-order changes of the baseline, written in plain numpy on the node-wise laws of the log generator; shape
parameters are put on a grid. Each candidate is a cause and one column, or a few that go together.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from benchmarks.naming.problem import Array
from tests.hidden.physics import DEG, FULL, MM, STROKE, Place, full_load

Candidates = Iterator[tuple[str, Array]]
SMALL = 1e-3  # relative change of the step size that stands for a derivative
APART = 2  # traverses from one moment of change to the next


def candidates(rows: pd.DataFrame, places: Sequence[Place], counts: Array) -> Candidates:
    """Every candidate; arrays of shape (n, k)."""
    yield from _clockwork(rows)
    yield from _readings(rows)
    yield from _mounting(places)
    yield from _loads(rows, places)
    yield from _parts(places)
    turned = rows["before_direction"].to_numpy(str) != rows["direction"].to_numpy(str)
    turned &= rows["before_direction"].to_numpy(str) != ""
    yield "end-stop-latency", _together(1 / counts)
    yield "reversal-loss", _together(turned / counts)


def _together(*columns: Array) -> Array:
    return np.stack(columns, axis=1)


def _clockwork(rows: pd.DataFrame) -> Candidates:
    hours, steps = rows["session_seconds"].to_numpy() / 3600, rows["steps_before"].to_numpy(float)
    for minutes in (5, 10, 20, 40, 60):
        yield "thermal-warm-up", _together(-np.expm1(-60 * hours / minutes))
    yield "drift", _together(hours)
    for n0 in (1e4, 1e5, 1e6):
        yield "wear", _together(np.log1p(steps / n0))
    session, place = rows["session"].to_numpy(str), np.arange(len(rows))
    for first in place[1::APART]:
        yield "session-jump", _together((session == session[first]) & (place >= first)).astype(float)


def _readings(rows: pd.DataFrame) -> Candidates:
    known = {"temperature": "temperature", "humidity": "humidity", "supply-voltage": "supply"}
    own = {str(name): str(name) for name in rows if str(name).startswith("covariate:")}
    for cause, name in {**known, **own}.items():
        z = _standard(rows[name].to_numpy(float))
        yield cause, _together(z)
        yield cause, _together(z, z**2)
        if name in own:
            yield cause, _together(z, z**2, z**3)
    yield "step-rate", _together(_standard(np.log(rows["step_period"].to_numpy(float))))


def _standard(column: Array) -> Array:
    if np.isnan(column).all():
        return np.zeros(len(column))
    departure = np.nan_to_num(column - np.nanmean(column))
    return departure / (np.std(departure) or 1.0)


def _change(places: Sequence[Place], pace: Callable[[Place], Array]) -> Array:
    """Change of log counts if the step size were another, shape (n,); 0 where a joint would halt."""
    changed = np.zeros(sum(len(place.rows) for place in places))
    for place in places:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = place.counts(pace(place)) / place.counts(place.step_size())
        changed[place.rows] = np.nan_to_num(np.log(ratio))
    return changed


def _term(places: Sequence[Place], term: Callable[[Place], Array]) -> Array:
    """Effect of a small term on log counts, whatever its unit."""

    def pace(place: Place) -> Array:
        shape = np.broadcast_to(term(place), place.step_size().shape)
        largest = max(float(np.abs(term(each)).max()) for each in places)
        return place.step_size() + SMALL * np.mean(place.unloaded) * shape / (largest or 1.0)

    return _change(places, pace)


def _factor(places: Sequence[Place], factor: Callable[[Place], Array]) -> Array:
    return _change(places, lambda place: place.step_size() * (1 + SMALL * factor(place)))


def _mounting(places: Sequence[Place]) -> Candidates:
    def state(move: Callable[[Place], Place]) -> Array:
        return _change(places, lambda place: move(place).step_size())

    # Both ways: the recoil has a kink.
    for angle in ("theta", "psi", "q2"):
        for off in (DEG, -DEG):
            yield f"{angle}-offset", _together(state(lambda p, a=angle, d=off: p.at(**{a: p.angles[a] + d})))
    gravity = state(
        lambda place: replace(place, load=0.7 * place.load + 0.3 * full_load(place.joint, **place.angles))
    )
    yield "q1-gravity", _together(gravity)

    def recoil(shape: Callable[[Array], Array]) -> Array:
        return state(
            lambda p: (
                replace(p, recoil=np.broadcast_to(shape(p.angles["q2"]), p.recoil.shape))
                if p.joint == 3
                else p
            )
        )

    for phi in (6 * DEG, -6 * DEG):
        yield "recoil-axis", _together(recoil(lambda q2, phi=phi: np.abs(np.cos(q2 - phi))))
    for p in (0.75, 1.33):
        yield "recoil-shape", _together(recoil(lambda q2, p=p: np.abs(np.cos(q2)) ** p))


def _loads(rows: pd.DataFrame, places: Sequence[Place]) -> Candidates:
    guide = [place for place in places if place.joint == 3]
    side = _factor(places, lambda p: -np.sqrt(np.clip(1 - p.load**2, 0, None)) if p in guide else 0 * p.load)
    yield "side-load", _together(side)
    ways = [(place.joint, way) for place in places for way in (1.0, -1.0)]
    for power in (2, 3):
        bend = _term(places, lambda p, power=power: p.unloaded * p.load**power)
        subset = {(p.joint, way): p.rows[p.forward[:, 0] == way] for p in places for way in (1.0, -1.0)}
        columns = np.zeros((len(rows), len(ways)))
        for number, each in enumerate(ways):
            columns[subset[each], number] = bend[subset[each]]
        yield "load-nonlinearity", columns
    yield "load-hysteresis", _together(rows["before_load"].to_numpy(float))
    heavier = _change(places, lambda place: replace(place, load=1.02 * place.load).step_size())
    for first in range(1, len(rows), APART):
        yield "payload-change", _together(np.where(np.arange(len(rows)) >= first, heavier, 0.0))
    yield "payload-change", _together(heavier * np.nan_to_num(rows["payload"].to_numpy(float)))


def _parts(places: Sequence[Place]) -> Candidates:
    def on(joints: tuple[int, ...], shape: Callable[[Place], Array]) -> Callable[[Place], Array]:
        return lambda place: shape(place) if place.joint in joints else 0.0 * place.load

    yield "inertia-quadratic", _together(_term(places, on((2,), lambda p: p.q3 * (p.q3 - STROKE))))
    pull = on((1, 2), lambda p: p.forward * (p.own - sum(FULL[p.joint]) / 2))
    yield "cable-torque", _together(_term(places, pull))
    waves = [_factor(places, on((1, 2), lambda p, wave=wave: wave(p.own))) for wave in (np.cos, np.sin)]
    yield "bearing-runout", _together(*waves)
    yield "guide-gradient", _together(_factor(places, on((3,), lambda p: (p.q3 - STROKE / 2) / STROKE)))
    for x0 in np.arange(0.5, 12, 0.5) * MM:
        for w in (0.1 * MM, 0.3 * MM, MM):
            spot = on((3,), lambda p, x0=x0, w=w: np.exp(-(((p.q3 - x0) / w) ** 2) / 2))
            yield "worn-spot", _together(_factor(places, spot))
