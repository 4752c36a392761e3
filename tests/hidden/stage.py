"""Logs whose steps are made by friction, one slip after the other, instead of by a law of any form.

Joint 3 carries its own weight. A rotary joint's inertia grows with the square of a distance and the torque of
gravity with the distance itself. What changes in a stage - preload, humidity, voltage, payload, ramp time,
wear - acts on friction, inertia, throw or time, never on a law's coefficients.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tests.hidden.campaign import Campaign, make_campaign
from tests.hidden.designs import Ints
from tests.hidden.effect import Effect, Said, expected, sized, sized_since
from tests.hidden.generate import CHECK_EVERY, Act, Hidden
from tests.hidden.noise import seen
from tests.hidden.physics import L2, MM, STROKE, Array, Place
from tests.hidden.seeds import stream
from tests.hidden.slip import Bristles, coulomb_step, lugre_step
from tests.hidden.table import write_down

GRAVITY = 9.81
RATIOS = {"friction": (1.4, 3.0), "velocity": (0.3, 0.65), "both": (0.85, 1.15), "any": (0.6, 1.4)}
_PIECES = 250
_LOADS = 15  # between which the slow solver's steps are interpolated


@dataclass(frozen=True)
class Stage:
    """Three joints driven by friction.

    Attributes
    ----------
    regime : {"friction", "velocity", "both", "any"}
        Whether the slider never reaches the foot's speed, always does, or does under some loads only; or any
        of these in each joint and direction.
    bristles : Bristles or None
        LuGre's friction; Coulomb's without.
    day_to_day : float
        By which friction and throw scatter.
    """

    regime: str = "friction"
    bristles: Bristles | None = None
    day_to_day: float = 0.02

    def draw(self, joint: int, session: Ints, forward: Ints, rng: np.random.Generator) -> dict[str, Array]:
        """The drive of each traverse: one for each direction, a little different from day to day."""
        usual = {way: self.usual(joint, way, rng) for way in (1, -1)}
        days = 1 + self.day_to_day * rng.standard_normal((2, 2, int(session.max()) + 1))
        values = {name: np.where(forward > 0, usual[1][name], usual[-1][name]) for name in usual[1]}
        for name, (back, out) in zip(("friction", "throw"), days, strict=True):
            values[name] = values[name] * np.where(forward > 0, out[session], back[session])
        return values

    def usual(self, joint: int, way: int, rng: np.random.Generator) -> dict[str, float]:
        """The drive of a joint and direction, before it differs from day to day."""
        size = {3: rng.normal(976 if way > 0 else 903, 30) * 1e-9}.get(joint, rng.uniform(80, 110) * 1e-6)
        share, ratio = rng.uniform(0.18, 0.26), rng.uniform(*RATIOS[self.regime])
        # A rotary joint's ramp is as long as the guide's; its friction follows from the size of its steps.
        if joint == 3:
            friction = GRAVITY / share
            ramp = float(np.sqrt(size / friction / min(ratio, 1.0)))
        else:
            ramp = rng.uniform(1.2e-4, 1.6e-4)
            friction = size / ramp**2 / min(ratio, 1.0)
        drive = {
            "friction": friction,
            "ramp": ramp,
            "throw": size * max(ratio, 1.0),
            "flyback": ramp * rng.uniform(0.02, 0.05),
        }
        if joint == 3:
            return drive | {"b": rng.normal(0.3, 0.01)}
        near = rng.uniform(0.07, 0.11) if joint == 2 else rng.uniform(0.01, 0.02)
        far = near * rng.uniform(1.2, 1.35) if joint == 2 else rng.uniform(0.08, 0.13)
        return drive | {
            "gain": rng.uniform(0.02, 0.08),
            "lever": rng.uniform(18, 27) * MM,
            "near": friction * near,
            "far": friction * far,
        }

    def pace(self, place: Place) -> Array:
        """See `campaign.Nature`."""
        v = place.values
        if place.joint == 3:
            return (1 - v["b"] * place.recoil) * self.step(place, v["friction"], GRAVITY * place.forward)
        if place.joint == 2:
            lever, out = v["lever"], place.q3 / STROKE
            grown = ((lever + place.q3) ** 2 - lever**2) / ((lever + STROKE) ** 2 - lever**2)
        else:
            out = place.reach / (L2 + STROKE)
            grown = out**2
        inertia = 1 + v["gain"] * grown
        pull = (v["near"] + (v["far"] - v["near"]) * out) * place.forward / inertia
        return self.step(place, v["friction"] / inertia, pull)

    def step(self, place: Place, friction: Array, pull: Array) -> Array:
        """Step size where friction accelerates by at most `friction` and the full load by `pull`."""
        v = place.values
        drive = v["throw"], v["ramp"], v["flyback"]
        if self.bristles is None:
            return coulomb_step(friction, pull * place.load, *drive)
        shape = np.broadcast_shapes(friction.shape, place.load.shape)
        if shape[1] <= _LOADS:
            return lugre_step(friction, pull * place.load, *drive, self.bristles, pieces=_PIECES)
        # Along a traverse only the load differs, and the step is smooth in it but for a kink.
        load = place.load
        low, high = load.min(axis=1, keepdims=True), load.max(axis=1, keepdims=True)
        knots = low + (high - low) * (1 - np.cos(np.linspace(0, np.pi, _LOADS))) / 2
        steps = lugre_step(friction, pull * knots, *drive, self.bristles, pieces=_PIECES)
        return np.array([np.interp(*each) for each in zip(load, knots, steps, strict=True)])


Acts = Callable[[dict[str, Array], Array], dict[str, Array]]


def _scaled(name: str) -> Acts:
    return lambda values, factor: {name: values[name] * factor}


def _heavier(values: dict[str, Array], factor: Array) -> dict[str, Array]:
    """Friction drives less; what pulls by its weight grows with what it pulls."""
    return {"friction": values["friction"] / factor}


def _changed(column: Array, acts: Acts, largest: float, said: Callable[[float], Said]) -> Effect:
    """An effect that multiplies a quantity of the drive by 1 + size * column."""

    def state(place: Place, size: float) -> Place:
        values = dict(place.values)
        return replace(place, values=values | acts(values, 1 + size * place.of(column)))

    return Effect(largest, said, state=state)


def _since(acts: Acts, name: str) -> Callable[[Campaign, np.random.Generator], Effect]:
    """From some moment of a session until its end; the next one is calibrated anew."""

    def make(c: Campaign, rng: np.random.Generator) -> Effect:
        session = rng.integers(int(c.plan.session.max()) + 1)
        inside = np.flatnonzero(c.plan.session == session)
        first = int(inside[int(len(inside) * rng.uniform(0.35, 0.65))])
        column = ((np.arange(len(c)) >= first) & (c.plan.session == session)).astype(float)
        return _changed(column, acts, 0.1, sized_since(name, c, first))

    return make


def _by_column(acts: Acts, name: str) -> Callable[[Campaign, np.random.Generator], Effect | None]:
    """In proportion to what the lab wrote down; the size is that of two standard deviations."""

    def make(c: Campaign, rng: np.random.Generator) -> Effect | None:
        if name not in c.columns:
            return None
        column = c.columns[name] - c.columns[name].mean()
        return _changed(column / (2 * column.std()), acts, 0.1, sized(name, "%", 100))

    return make


def _by_use(acts: Acts) -> Callable[[Campaign, np.random.Generator], Effect]:
    """With the logarithm of the steps made."""

    def make(c: Campaign, rng: np.random.Generator) -> Effect:
        worn = np.log(1 + c.steps_before / 2e5)
        return _changed(worn / worn.max(), acts, 0.1, sized("wear", "%", 100))

    return make


QUANTITIES = {"friction": _scaled("friction"), "voltage": _scaled("throw"), "ramp time": _scaled("ramp")}


def make_change(change: str, acts: Acts) -> Callable[[Campaign, np.random.Generator], Effect | None]:
    """With the course of one of `CHANGES`, whatever it acts on."""
    if change == "wear":
        return _by_use(acts)
    if change == "friction:humidity":
        return _by_column(acts, "humidity_pct")
    return _since(acts, {"payload": "mass", "ramp-time": "ramp time"}.get(change, change))


ACTS: dict[str, Acts] = {
    "preload": QUANTITIES["friction"],
    "friction:humidity": QUANTITIES["friction"],
    "voltage": QUANTITIES["voltage"],
    "payload": _heavier,
    "ramp-time": QUANTITIES["ramp time"],
    "wear": QUANTITIES["friction"],
}
CHANGES: dict[str, Callable[[Campaign, np.random.Generator], Effect | None]] = {
    change: make_change(change, acts) for change, acts in ACTS.items()
}


def drive_days(stage: Stage, change: str, size: float, seed: int = 0) -> Hidden:
    """A log of days of the same traverses; in the later half of them one thing is another.

    Parameters
    ----------
    stage : Stage
    change : str
        One of `ACTS`, or empty for none.
    size : float
        By which share.
    seed : int
        Settles everything.
    """
    campaign = make_campaign("days", "gaussian", seed, nature=stage)
    late = (campaign.plan.session >= campaign.plan.session.max() / 2).astype(float)
    acts = (
        (Act(change, stage.regime, _changed(late, ACTS[change], 0.2, sized(change, "%", 100)), size),)
        if change
        else ()
    )
    return _count(campaign, acts, "days", "gaussian")


def drive_stage(
    design: str, stage: Stage, change: str = "", size: float = 0.1, noise: str = "gaussian", seed: int = 0
) -> Hidden:
    """A log of a stage in which one thing changes by a share `size`, or nothing.

    Parameters
    ----------
    design : {'session', 'thesis', 'many'}
    stage : Stage
    change : str, optional
        One of `CHANGES`.
    noise : str
        As of `generate.hide`.
    seed : int
        Settles everything.

    Raises
    ------
    ValueError
        For a change that this design's log cannot have.
    """
    campaign = make_campaign(design, noise, seed, nature=stage)
    acts: tuple[Act, ...] = ()
    if change:
        effect = CHANGES[change](campaign, stream(seed, change))
        if effect is None:
            raise ValueError(f"the lab writes down nothing of {change} in the design {design}")
        acts = (Act(change, stage.regime, effect, size),)
    return _count(campaign, acts, design, noise)


def _count(campaign: Campaign, acts: tuple[Act, ...], design: str, noise: str) -> Hidden:
    """What the lab writes down of a campaign on which something acts."""
    counts = expected(campaign, [(act.effect, act.size) for act in acts]) if acts else campaign.counts
    stops = seen(counts * np.exp(campaign.repeatability * campaign.innovations), CHECK_EVERY)
    truth = {
        "effects": [{"name": act.name, "form": act.form, "amplitude": act.size} for act in acts],
        "repeatability_pct": 100 * float(np.sqrt(np.mean(campaign.repeatability**2))),
        "decoys": {},
    }
    return Hidden(write_down(campaign, stops.astype(np.int64), {}), truth, design, noise, campaign, acts)
