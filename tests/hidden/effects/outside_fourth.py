"""Twenty-four more effects from outside the library of causes: a fourth set."""

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.effects.outside_history import end_hours, ends, same_session
from tests.hidden.effects.outside_state import of_both, of_column, of_place, z
from tests.hidden.physics import DEG, FULL, L2, MM, STROKE, Array, Place, full_load, published_load

Rng = np.random.Generator


def three_feet(p: Place) -> Array:
    """The tilt table stands on three feet: stiff where gravity leans towards one, soft between two."""
    st, ct = np.sin(p.angles["theta"]), np.cos(p.angles["theta"])
    across = ct * np.sin(p.angles["psi"])
    return np.asarray(np.hypot(st, across) * np.cos(3 * np.arctan2(st, across) - 40 * DEG))


def flops(c: Campaign, rng: Rng) -> Effect:
    """A rotary joint flops through its play, L steps, each time its load turns over within a traverse."""
    times = np.zeros(len(c))
    for p in c.places:
        if p.joint != 3:
            over = (p.load[:, 1:] > 0) != (p.load[:, :-1] > 0)
            heavy = np.maximum(np.abs(p.load[:, 1:]), np.abs(p.load[:, :-1])) > 0.02
            times[p.rows] = np.sum(over & heavy, axis=1)

    def count(c: Campaign, counts: Array, size: float) -> Array:
        return counts + size * times

    return Effect(400.0, sized("L", "steps", 1), count=count)


def leaning(p: Place) -> Array:
    """The carriage leans on its left rail or its right one, and drawn in they differ."""
    return np.asarray(np.tanh(4 * published_load(1, **p.angles)) * (p.forward < 0))


def pieces(c: Campaign, rng: Rng) -> Array | None:
    """Ones; none where joint 1 makes whole traverses only, of which little but their mean is seen."""
    start, stop = ends(c)
    return np.ones(len(c)) if np.ptp(np.abs(stop - start)[c.plan.joint == 1]) > 0.1 else None


def tether(p: Place) -> Array:
    """A cable from the tip to the wall is slack up to 55 mm, then pulls like a spring: opposite both ways."""
    height = (L2 + p.q3) * np.cos(p.angles["q2"])
    away = p.angles["q1"] - 60 * DEG
    x, y = p.reach * np.cos(away) - 35 * MM, p.reach * np.sin(away)
    return np.asarray(np.maximum(np.sqrt(x**2 + y**2 + height**2) - 55 * MM, 0) / (7 * MM) * p.forward)


def below_edge(p: Place) -> Array:
    """The tip is in a cold draught wherever it is more than 20 mm above the elbow."""
    return np.asarray(((L2 + p.q3) * full_load(3, **p.angles) > 20 * MM).astype(float))


STATE: dict[str, Maker] = {
    "three feet of the tilt table": of_place(three_feet),
    "flops through its play, joints 1 and 2": flops,
    "left rail or right, one way, joint 3": of_place(leaning, 3),
    "tether taut beyond its length, joint 1": of_both(pieces, tether, 1),
    "tip in the draught, joints 2 and 3": of_place(below_edge, 2, 3),
}


def creep_by_decades(c: Campaign, rng: Rng) -> Array:
    """The piezo's offset creeps by as much in each decade of time: it helps one way, hinders the other."""
    return np.log10(1 + 60 * c.hours / 2) * c.plan.forward


def hunting(c: Campaign, rng: Rng) -> Array:
    """A temperature controller, switched on with the session, overshoots and settles."""
    period, phase = rng.uniform(0.35, 0.7), rng.uniform(0, 2 * np.pi)
    return 2 * np.exp(-c.hours / 0.7) * np.cos(2 * np.pi * c.hours / period + phase)


def random_walk(c: Campaign, rng: Rng) -> Array:
    """The amplifier's gain wanders at random from where it was set at the session's beginning."""
    wait = np.diff(c.hours, prepend=0.0)
    out = np.zeros(len(c))
    for k in range(len(c)):
        if same_session(c, k):
            out[k] = out[k - 1] + np.sqrt(wait[k]) * rng.standard_normal()
    return out / out.std()


def doors(c: Campaign, rng: Rng) -> Array:
    """Now and then, about every 50 min, a door lets cold air in at once; the room recovers in 8 min."""
    out = np.zeros(len(c))
    for s in np.unique(c.plan.session):
        subset = c.plan.session == s
        length = c.hours[subset].max()
        for moment in rng.uniform(0, length, int(np.ceil(length / (5 / 6)))):
            late = c.hours[subset] - moment
            out[subset] += (late >= 0) * np.exp(-np.maximum(late, 0) / (8 / 60))
    return out


def battery(c: Campaign, rng: Rng) -> Array:
    """The drive's battery holds its voltage for long, and gives out towards the session's end."""
    length = np.zeros(int(c.plan.session.max()) + 1)
    np.maximum.at(length, c.plan.session, c.hours)
    return (c.hours / length[c.plan.session]) ** 7


TIME: dict[str, Maker] = {
    "creep by decades, opposite ways": of_column(creep_by_decades),
    "controller hunts and settles": of_column(hunting),
    "random walk of the gain": of_column(random_walk),
    "doors opened": of_column(doors),
    "battery gives out": of_column(battery),
}


def cage(c: Campaign, rng: Rng) -> Array:
    """The guide's ball cage walks downhill with each traverse, up to a stop either way, where it rubs.

    It never walks back by itself: only opposite loads take it there.
    """
    start, stop = ends(c)
    length, load, at, out = np.abs(stop - start), c.load, 0.0, np.zeros(len(c))
    for k in np.flatnonzero(c.plan.joint == 3):
        out[k] = np.sign(at) * np.maximum(np.abs(at) - 0.3, 0) / 0.7
        at = float(np.clip(at - 0.3 * load[k] * length[k], -1, 1))
    return out


def short_strokes(c: Campaign, rng: Rng) -> Array | None:
    """Grease is pushed out by short strokes; a stroke over nearly the whole travel spreads it anew."""
    if not c.plan.partial or c.plan.session.max() < 4:
        return None  # where short ones are few it is the length of the traverse before
    start, stop = ends(c)
    length, out = np.abs(stop - start), np.zeros(len(c))
    for k in range(len(c)):
        b = c.before[k]
        if b >= 0:
            out[k] = 0.0 if length[b] > 0.9 else out[b] + 1
    return 1 - np.exp(-out / 4)


def charge(c: Campaign, rng: Rng) -> Array:
    """One amplifier drives all joints: signed steps of whichever moved charge it, and leak off in 10 min."""
    end, out = end_hours(c), np.zeros(len(c))
    for k in range(1, len(c)):
        if same_session(c, k):
            driven = c.plan.forward[k - 1] * c.counts[k - 1] / c.counts.max()
            held = out[k - 1] * np.exp(-(end[k - 1] - c.hours[k - 1]) * 6)
            out[k] = (held + driven) * np.exp(-(c.hours[k] - end[k - 1]) * 6)
    return out / np.abs(out).max()


def elbow_relaxes(c: Campaign, rng: Rng) -> Effect:
    """Where joint 2 was last brought, it lags behind by delta, and creeps there within minutes."""
    q2, moves = c.plan.settings[:, 1], c.plan.joint == 2
    last = np.where(moves, np.where(c.plan.forward > 0, c.plan.settings[:, 6], c.plan.settings[:, 5]), q2)
    lag, side, moment = np.zeros(len(c)), 0.0, 0.0
    for k in range(len(c)):
        if not same_session(c, k):
            side = 0.0
        elif not moves[k] and q2[k] != last[k - 1]:
            side, moment = np.sign(last[k - 1] - q2[k]), c.hours[k]
        if not moves[k]:
            lag[k] = side * np.exp(-(c.hours[k] - moment) * 60 / 6)

    def state(p: Place, size: float) -> Place:
        return p if p.joint == 2 else p.at(q2=p.angles["q2"] + size * p.of(lag))

    return Effect(5 * DEG, sized("delta", "deg", 1 / DEG), state=state)


def overload(c: Campaign, rng: Rng) -> Array:
    """The contact is set by the greatest load that it has borne in the session, and slack below it."""
    load, most, out = np.abs(c.load), np.zeros(len(c)), np.zeros(len(c))
    for k in range(len(c)):
        b = c.before[k]
        most[k] = max(load[k], most[b] if b >= 0 else 0.0)
        out[k] = most[k] - load[k] if most[k] > 0.5 else 0.0
    return out


HISTORY: dict[str, Maker] = {
    "ball cage walks, joint 3": of_column(cage),
    "short strokes since a whole one": of_column(short_strokes),
    "charge of the shared amplifier": of_column(charge),
    "elbow relaxes after a move": elbow_relaxes,
    "below the greatest load so far": of_column(overload),
}


def booster(c: Campaign, rng: Rng) -> Array | None:
    """A booster cuts in when the supply is low, and out only when it is well up again."""
    supply, on = z(c, "supply_V"), False
    if supply is None:
        return None
    out = np.zeros(len(c))
    for k in range(len(c)):
        on = supply[k] < 0.5 if on else supply[k] < -0.5
        out[k] = on
    return out


def slipping_mount(c: Campaign, rng: Rng) -> Array | None:
    """Two metals in one clamp: stress grows with the room's temperature either way, up to where it slips."""
    temperature = z(c, "temperature_C")
    if temperature is None:
        return None
    out = np.zeros(len(c))
    for k in range(1, len(c)):
        out[k] = np.clip(out[k - 1] + (temperature[k] - temperature[k - 1]) / 0.12, -1, 1)
    return out


def new_period(c: Campaign, rng: Rng) -> Array | None:
    """The generator's output settles after its period was changed, within two traverses or so."""
    if not np.ptp(c.plan.step_period):
        return None
    period, out = np.log(c.plan.step_period), np.zeros(len(c))
    for k in range(1, len(c)):
        if same_session(c, k):
            out[k] = out[k - 1] * 0.3 + (period[k] - period[k - 1]) / 0.3
    return out


def tired_operator(c: Campaign, rng: Rng) -> Effect | None:
    """The operator notices the stop later, the longer the session and the more there is to do besides."""
    busy = z(c, "operator_load")
    if busy is None:
        return None
    late = np.maximum(busy, 0) * c.hours / c.hours.max()

    def count(c: Campaign, counts: Array, size: float) -> Array:
        return counts + size * late

    return Effect(400.0, sized("L", "steps", 1), count=count)


COLUMN: dict[str, Maker] = {
    "booster on low supply, with hysteresis": of_column(booster),
    "thermal stress that slips": of_column(slipping_mount),
    "after a change of the step period": of_column(new_period),
    "tired operator": tired_operator,
}


def air_springs(c: Campaign, rng: Rng) -> Effect | None:
    """The bench floats on air springs and leans about both axes as the air pressure changes."""
    pressure = z(c, "air_pressure_hPa")
    if pressure is None:
        return None

    def state(p: Place, size: float) -> Place:
        lean = size * p.of(pressure)
        return p.at(theta=p.angles["theta"] + lean, psi=p.angles["psi"] - lean / 2)

    return Effect(5 * DEG, sized("delta", "deg", 1 / DEG), state=state)


def drawer(p: Place) -> Array:
    """Pushed outward, the carriage jams like a drawer once side load times overhang is too much."""
    moment = np.abs(published_load(2, **p.angles)) * p.q3 / STROKE
    return np.asarray(np.maximum(moment - 0.25, 0) / 0.5 * (p.forward > 0))


def water_film(c: Campaign, rng: Rng) -> Array | None:
    """Air damper than usual puts a film of water into a contact at rest; moving wipes it off."""
    damp = z(c, "humidity_pct")
    if damp is None:
        return None
    rest = c.hours - c.previous(end_hours(c), first=-np.inf)
    return np.asarray(damp.clip(0) * (1 - np.exp(-rest * 60 / 15)))


def bumper(p: Place) -> Array:
    """How much the rubber bumper ahead is pressed: from an eighth of the whole travel before its stop."""
    low, high = FULL[p.joint]
    ahead = np.where(p.forward > 0, high - p.own, p.own - low) / (high - low)
    return np.asarray(4 * np.maximum(1 - ahead / 0.125, 0))


def sun(c: Campaign, rng: Rng) -> Array:
    """The sun comes through the window for two and a half hours of the morning."""
    clock = (c.time - c.time.astype("datetime64[D]")).astype(float) / 3600
    return np.sin(np.pi * np.clip((clock - rng.uniform(8.8, 9.8)) / 2.5, 0, 1))


MIXED: dict[str, Maker] = {
    "bench on air springs": air_springs,
    "drawer jams, one way, joint 3": of_place(drawer, 3),
    "film of water at rest": of_both(water_film, lambda p: np.ones((1, 1))),
    "rubber bumper in the cold": of_both(lambda c, rng: z(c, "temperature_C"), bumper),
    "sun on the tilted base": of_both(sun, lambda p: np.maximum(-np.sin(p.angles["theta"]), 0)),
}

FOURTH = {
    "unknown:state of set 4": STATE,
    "unknown:time of set 4": TIME,
    "unknown:history of set 4": HISTORY,
    "unknown:column of set 4": COLUMN,
    "unknown:several of set 4": MIXED,
}
