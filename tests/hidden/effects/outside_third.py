"""Twenty-seven more effects from outside the library of causes: a third set."""

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.effects.outside_history import end_hours, ends
from tests.hidden.effects.outside_state import of_both, of_column, of_place
from tests.hidden.physics import DEG, FULL, MM, Array, Place

Rng = np.random.Generator


def z(c: Campaign, name: str) -> Array:
    return np.asarray((c.columns[name] - c.columns[name].mean()) / c.columns[name].std())


def minutes(c: Campaign) -> Array:
    """Since the campaign's first traverse: a clock that no session resets."""
    return (c.time - c.time[0]).astype(float) / 60


def stairs_q3(p: Place) -> Array:
    """Plateaus: the arm rests on another pair of balls from 2, 5, 8 and 11 mm on."""
    return np.asarray(
        np.select([p.q3 < 2 * MM, p.q3 < 5 * MM, p.q3 < 8 * MM, p.q3 < 11 * MM], [1.0, -0.6, 0.4, -1.0], 0.7)
    )


def recovery(p: Place) -> Array:
    """After turning round the joint recovers over the first seventh of its whole travel, by its load."""
    low, high = FULL[p.joint]
    begin = np.where(p.forward > 0, p.own.min(axis=1, keepdims=True), p.own.max(axis=1, keepdims=True))
    return np.asarray(2 * np.exp(-np.abs(p.own - begin) / (high - low) / 0.15) * p.load)


def turned(c: Campaign, rng: Rng) -> Array | None:
    """Ones; none where q1 never turns while joint 3 moves."""
    return np.ones(len(c)) if np.ptp(c.plan.settings[c.plan.joint == 3, 0]) else None


STATE: dict[str, Maker] = {
    "sin 3 (psi - q2), joint 3": of_place(lambda p: np.sin(3 * (p.angles["psi"] - p.angles["q2"])), 3),
    "sin 2 (q1 + q2), joint 3": of_both(turned, lambda p: np.sin(2 * (p.angles["q1"] + p.angles["q2"])), 3),
    "cusp in psi, joint 2": of_place(lambda p: np.sqrt(np.abs(p.angles["psi"]) / (60 * DEG)), 2),
    "exponential in theta, opposite ways": of_place(
        lambda p: np.exp(-p.angles["theta"] / (30 * DEG) - 2) * p.forward
    ),
    "stairs in q3, joint 2": of_place(stairs_q3, 2),
    "recovery from the start by load": of_place(recovery),
}


def beat(c: Campaign, rng: Rng) -> Array:
    """Two pumps that run nearly together: a fast wave under a slow envelope."""
    fast, slow = rng.uniform(8, 14), rng.uniform(70, 120)
    a, b = rng.uniform(0, 2 * np.pi, 2)
    return np.sin(2 * np.pi * minutes(c) / fast + a) * np.sin(2 * np.pi * minutes(c) / slow + b)


def wave(c: Campaign, rng: Rng) -> Array:
    period, phase = rng.uniform(12, 45), rng.uniform(0, 2 * np.pi)
    return np.sin(2 * np.pi * minutes(c) / period + phase)


def telegraph(c: Campaign, rng: Rng) -> Array:
    """Two modes of contact, switching at random about every twelve traverses, whatever the session."""
    return np.where(np.cumsum(rng.random(len(c)) < 1 / 12) % 2 == 0, 1.0, -1.0)


def ten_o_clock(c: Campaign, rng: Rng) -> Array:
    """Something in the building at a fixed time of day, for about half an hour."""
    clock = (c.time - c.time.astype("datetime64[D]")).astype(float) / 3600
    return np.exp(-(((clock - rng.uniform(9.7, 10.6)) / 0.25) ** 2) / 2)


def second_half(c: Campaign, rng: Rng) -> Array:
    length = np.zeros(int(c.plan.session.max()) + 1)
    np.maximum.at(length, c.plan.session, c.hours)
    return (c.hours > 0.5 * length[c.plan.session]).astype(float)


TIME: dict[str, Maker] = {
    "slow beat": of_column(beat),
    "wave in time and load": of_both(wave, lambda p: p.load),
    "telegraph": of_column(telegraph),
    "bump at ten o'clock": of_column(ten_o_clock),
    "second half under positive load": of_both(second_half, lambda p: (p.load > 0).astype(float)),
}


def play(c: Campaign, rng: Rng) -> Effect | None:
    """The tilt table has play: theta is off by delta, to the side that it was last turned to.

    None where the tilts are few: there it is a theta-offset.
    """
    if c.plan.session.max() < 4:
        return None
    theta, side = c.plan.settings[:, 3], np.zeros(len(c))
    for k in range(1, len(c)):
        side[k] = np.sign(theta[k] - theta[k - 1]) or side[k - 1]

    def state(p: Place, size: float) -> Place:
        return p.at(theta=p.angles["theta"] + size * p.of(side))

    return Effect(5 * DEG, sized("delta", "deg", 1 / DEG), state=state)


def other_load(c: Campaign, rng: Rng) -> Array:
    """Published load of the last traverse of any other joint in the session."""
    load, out = c.load, np.zeros(len(c))
    for k in range(len(c)):
        others = np.flatnonzero(
            (c.plan.session[:k] == c.plan.session[k]) & (c.plan.joint[:k] != c.plan.joint[k])
        )
        if len(others):
            out[k] = load[others[-1]]
    return out


def long_rest(c: Campaign, rng: Rng) -> Array:
    """Whether the joint stood still for more than a quarter of an hour."""
    return (c.hours - c.previous(end_hours(c), first=np.inf) > 0.25).astype(float)


def elbow_since_base(c: Campaign, rng: Rng) -> Array:
    """Grease dragged along: joint 2's traverses since joint 1's last in the session, saturating."""
    out, n = np.zeros(len(c)), 0
    for k in range(len(c)):
        if k and c.plan.session[k] != c.plan.session[k - 1]:
            n = 0
        out[k] = n
        n = 0 if c.plan.joint[k] == 1 else n + (c.plan.joint[k] == 2)
    return 1 - np.exp(-out / 3)


HISTORY: dict[str, Maker] = {
    "play in the tilt table": play,
    "load of another joint before": of_column(other_load),
    "long rest under load": of_both(long_rest, lambda p: np.abs(p.load)),
    "joint 2 since joint 1, joint 3": of_both(elbow_since_base, lambda p: np.ones((1, 1)), 3),
}


def late_temperature(c: Campaign, rng: Rng) -> Array | None:
    """What a body of an hour's time constant has of the room's temperature; as warm in the morning."""
    if "temperature_C" not in c.columns or c.plan.session.max() < 4:
        return None  # in one session it is the temperature, curved
    T, out = c.columns["temperature_C"], np.zeros(len(c))
    for k in range(len(c)):
        if k == 0 or c.plan.session[k] != c.plan.session[k - 1]:
            out[k] = T[k]
        else:
            out[k] = T[k] + (out[k - 1] - T[k]) * np.exp(-(c.hours[k] - c.hours[k - 1]))
    return np.asarray((out - out.mean()) / out.std())


def damp_one_way(c: Campaign, rng: Rng) -> Array | None:
    """Nothing up to half a standard deviation above the mean, then linear; outward only."""
    if "humidity_pct" not in c.columns:
        return None
    return np.maximum(z(c, "humidity_pct") - 0.5, 0) * (c.plan.forward > 0)


def ratchet(c: Campaign, rng: Rng) -> Array | None:
    """How far the room is below the warmest it has been in the session so far."""
    if "temperature_C" not in c.columns:
        return None
    T, out = c.columns["temperature_C"], np.zeros(len(c))
    for s in np.unique(c.plan.session):
        subset = c.plan.session == s
        out[subset] = np.maximum.accumulate(T[subset]) - T[subset]
    return np.asarray(out / (out.std() or 1.0))


def log_period(c: Campaign, rng: Rng) -> Array | None:
    return np.log(c.plan.step_period / 0.004) if np.ptp(c.plan.step_period) else None


def resonance(c: Campaign, rng: Rng) -> Effect | None:
    """The arm resonates with the stepping: at 3 ms drawn in, at 5 ms drawn out."""
    if not np.ptp(c.plan.step_period):
        return None

    def factor(p: Place, size: float) -> Array | float:
        if p.joint != 2:
            return 1.0
        off = p.of(c.plan.step_period) * 1e3 - (3 + 2 * p.q3 / (12 * MM))
        return np.asarray(1 + size / (1 + (off / 0.5) ** 2))

    return Effect(0.05, sized("A", "%", 100), factor=factor)


COLUMN: dict[str, Maker] = {
    "temperature an hour late": of_column(late_temperature),
    "humidity above a threshold, one way": of_column(damp_one_way),
    "ratchet of temperature": of_column(ratchet),
    "resonance of period and q3, joint 2": resonance,
    "Stribeck: period at low load": of_both(log_period, lambda p: np.exp(-np.abs(p.load) / 0.25)),
}


def sessions_in_turn(c: Campaign, rng: Rng) -> Array | None:
    return np.where(c.plan.session % 2 == 0, 1.0, -1.0) if c.plan.session.max() else None


def late_under_load(c: Campaign, rng: Rng) -> Effect:
    """The stop is heard later under load: L times the load where the traverse ends."""
    load = np.zeros(len(c))
    for p in c.places:
        last = np.where(p.forward[:, 0] > 0, -1, 0)
        full = np.broadcast_to(p.load, np.broadcast_shapes(p.load.shape, p.weights.shape))
        load[p.rows] = full[np.arange(len(p.rows)), last]

    def count(c: Campaign, counts: Array, size: float) -> Array:
        return counts + size * load

    return Effect(400.0, sized("L", "steps", 1), count=count)


def from_last_four(c: Campaign, rng: Rng) -> Array:
    """How far the traverse's middle is from where the joint has lately been: its last four middles."""
    start, stop = ends(c)
    middle, out = (start + stop) / 2, np.zeros(len(c))
    for k in range(len(c)):
        own = np.flatnonzero(
            (c.plan.session[:k] == c.plan.session[k]) & (c.plan.joint[:k] == c.plan.joint[k])
        )[-4:]
        if len(own):
            out[k] = np.tanh((middle[k] - middle[own].mean()) / 0.15)
    return out


def v_operator(c: Campaign, rng: Rng) -> Array | None:
    return np.abs(z(c, "operator_load")) if "operator_load" in c.columns else None


def own_travel_v(c: Campaign, rng: Rng) -> Array:
    """V of the distance that the joint has travelled in the session, least at six whole lengths."""
    start, stop = ends(c)
    length, out = np.abs(stop - start), np.zeros(len(c))
    for k in range(len(c)):
        own = (c.plan.session[:k] == c.plan.session[k]) & (c.plan.joint[:k] == c.plan.joint[k])
        out[k] = np.abs(length[:k][own].sum() - 6) / 6
    return np.minimum(out, 2)


MIXED: dict[str, Maker] = {
    "sign of load and reach, joint 1": of_place(
        lambda p: np.sign(p.load) * (p.reach - 40 * MM) / (8 * MM), 1
    ),
    "guide and sin theta, joint 3": of_place(lambda p: (p.q3 / (6 * MM) - 1) * np.sin(p.angles["theta"]), 3),
    "cube of load, sessions in turn": of_both(sessions_in_turn, lambda p: p.load**3),
    "stop late by load": late_under_load,
    "far from its last four": of_column(from_last_four),
    "V of operator load and sin theta": of_both(v_operator, lambda p: np.sin(p.angles["theta"])),
    "V of own travel": of_column(own_travel_v),
}

THIRD = {
    "unknown:state of set 3": STATE,
    "unknown:time of set 3": TIME,
    "unknown:history of set 3": HISTORY,
    "unknown:column of set 3": COLUMN,
    "unknown:several of set 3": MIXED,
}
