"""Twenty more effects from outside the library of causes: a fifth set."""

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.effects.outside_history import end_hours, ends, same_session
from tests.hidden.effects.outside_state import of_both, of_column, z
from tests.hidden.physics import DEG, FULL, L2, MM, STROKE, Array, Place, published_load

Rng = np.random.Generator
STEPS = 400.0  # how many steps may plausibly be lost or driven too far


def positions(c: Campaign, end: bool) -> dict[str, Array]:
    """Where all joints are as each traverse begins or ends, SI."""
    there = c.plan.positions()
    own = np.where((c.plan.forward > 0) == end, there["high"], there["low"])
    return there | {f"q{j}": np.where(c.plan.joint == j, own, there[f"q{j}"]) for j in (1, 2, 3)}


def lost(steps: Array) -> Effect:
    """L times so many steps more are counted."""

    def count(c: Campaign, counts: Array, size: float) -> Array:
        return counts + size * steps

    return Effect(STEPS, sized("L", "steps", 1), count=count, either_sign=False)


def base_bearing(c: Campaign, rng: Rng) -> Array | None:
    """Ones; none where joint 1 is turned about one axis only, so that its load tells it all."""
    return np.ones(len(c)) if np.ptp(c.plan.settings[c.plan.joint == 1, 4]) else None


def lifted(p: Place) -> Array:
    """Weight keeps the base bearing seated; it lifts from its race as the axis leans, and rubs one way."""
    axial = np.cos(p.angles["theta"]) * np.cos(p.angles["psi"])
    return np.asarray(np.maximum(0.8 - axial, 0) / 0.4 * (p.forward > 0))


def microphone(c: Campaign, rng: Rng) -> Effect:
    """The stop is heard by a microphone on the base, later the farther from it the tip stops."""
    end = positions(c, True)
    reach = -(L2 + end["q3"]) * np.sin(end["q2"])
    x, y = reach * np.cos(end["q1"]) - 60 * MM, reach * np.sin(end["q1"]) + 40 * MM
    height = (L2 + end["q3"]) * np.cos(end["q2"]) - 20 * MM
    return lost((x**2 + y**2 + height**2) / (60 * MM) ** 2 * (c.plan.joint != 1))


def packets(c: Campaign, rng: Rng) -> Effect:
    """The controller sends steps in packets of 2048, and L steps of each but the first get lost."""

    def count(c: Campaign, counts: Array, size: float) -> Array:
        return counts + size * np.floor(counts / 2048)

    return Effect(STEPS, sized("L", "steps", 1), count=count, either_sign=False)


def turned(c: Campaign, rng: Rng) -> Array | None:
    """Ones; none where q1 never turns while joints 2 and 3 move."""
    return np.ones(len(c)) if np.ptp(c.plan.settings[c.plan.joint != 1, 0]) else None


def capstan(p: Place) -> Array:
    """A cable wrapped about the post by q1 is dragged round it: friction exponential in the wrap."""
    wrap = np.maximum(p.angles["q1"] + 30 * DEG, 0) / (60 * DEG)
    return np.asarray(np.expm1(wrap) / 2 * (p.forward > 0))


STATE: dict[str, Maker] = {
    "base bearing lifts, one way, joint 1": of_both(base_bearing, lifted, 1),
    "microphone far from the stop, joints 2 and 3": microphone,
    "steps lost with each packet": packets,
    "capstan of a wrapped cable, one way, joints 2 and 3": of_both(turned, capstan, 2, 3),
}


def idle_days(c: Campaign, rng: Rng) -> Array | None:
    """Grease gels over idle days, until each joint has worked it; none where idling is always the same."""
    idle = np.diff(c.plan.days) - 1
    if len(idle) < 4 or not np.ptp(idle):
        return None
    start, stop = ends(c)
    length, worked = np.abs(stop - start), np.zeros(len(c))
    for k in range(len(c)):
        b = c.before[k]
        worked[k] = worked[b] + length[b] if b >= 0 else 0.0
    return 2 * np.r_[0, np.minimum(idle, 3) / 3][c.plan.session] * np.exp(-worked / 2)


def compressor(c: Campaign, rng: Rng) -> Array:
    """A compressor runs two fifths of every four minutes or so: the share of a traverse that it ran in."""
    period, phase, duty = rng.uniform(170, 300), rng.uniform(), 0.4
    begin = (c.time - c.time[0]).astype(float) / period + phase
    takes = c.counts * c.plan.step_period / period

    def ran(t: Array) -> Array:
        return np.asarray(np.floor(t) * duty + np.minimum(t % 1, duty))

    return 2 * (ran(begin + takes) - ran(begin)) / takes


def snaps_back(c: Campaign, rng: Rng) -> Array:
    """A stiff hose creeps away with time, and snaps back when it has gone too far, never twice the same."""
    out, most = np.zeros(len(c)), rng.uniform(0.2, 0.5)
    for k in range(1, len(c)):
        if same_session(c, k):
            out[k] = out[k - 1] + c.hours[k] - c.hours[k - 1]
            if out[k] > most:
                out[k], most = 0.0, rng.uniform(0.2, 0.5)
    return out / 0.25


def heat_pulse(c: Campaign, rng: Rng) -> Array:
    """Heat of switching on passes through the arm: joint 1 is warm first, joint 3 an hour later."""
    t = c.hours / np.array([np.nan, 0.15, 0.4, 1.0])[c.plan.joint]
    return t**2 * np.exp(2 - 2 * t)


TIME: dict[str, Maker] = {
    "gelled over idle days": of_column(idle_days),
    "share of the traverse with a compressor on": of_column(compressor),
    "creeps away and snaps back": of_column(snaps_back),
    "heat passes from joint to joint": of_column(heat_pulse),
}


def dents(c: Campaign, rng: Rng) -> Effect:
    """Where a joint stands it sinks in, within 6 min; L steps get lost if its next traverse crosses there."""
    plan, crossing = c.plan, np.zeros(len(c))
    for k in range(len(c)):
        own, since = plan.joint[k] - 1, k
        stood = plan.settings[k - 1, own]
        while same_session(c, since) and plan.joint[since - 1] != plan.joint[k]:
            if plan.settings[since - 1, own] != stood:
                break
            since -= 1
        if since < k and plan.settings[k, 5] < stood < plan.settings[k, 6]:
            crossing[k] = 1 - np.exp(-(c.hours[k] - c.hours[since]) * 60 / 6)
    return lost(crossing)


def rubber_feet(c: Campaign, rng: Rng) -> Effect:
    """Rubber feet give way slowly to the tilt, within ten minutes, about both axes, and recover as slowly."""
    lean = np.sin(c.plan.settings[:, 3:5] * DEG)
    slow = np.zeros((len(c), 2))
    for k in range(1, len(c)):
        if same_session(c, k):
            kept = np.exp(-(c.hours[k] - c.hours[k - 1]) / 0.15)
            slow[k] = slow[k - 1] * kept + lean[k - 1] * (1 - kept)

    def state(p: Place, size: float) -> Place:
        theta, psi = (p.of(size * each) for each in slow.T)
        return p.at(theta=p.angles["theta"] + theta, psi=p.angles["psi"] + psi)

    return Effect(8 * DEG, sized("delta", "deg", 1 / DEG), state=state)


def debris(c: Campaign, rng: Rng) -> Array | None:
    """Each traverse sweeps most debris off its path and heaps it up where it stops; the next there rubs."""
    if not c.plan.partial:
        return None
    cells, out = 24, np.zeros(len(c))
    begin, end = np.clip(np.round(np.array(ends(c)) * cells), 0, cells).astype(int)
    lying = np.full((4, cells), 1 / cells)
    for k, joint in enumerate(c.plan.joint):
        low, high = sorted((begin[k], end[k]))
        path = lying[joint, low:high]
        out[k] = path.mean() * cells
        swept = 0.6 * path.sum()
        path *= 0.4
        lying[joint, high - 1 if c.plan.forward[k] > 0 else low] += swept
        lying[joint] = 0.97 * lying[joint] + 0.03 / cells  # some falls off, some comes anew
    return np.minimum(out - 1, 3)


def parked(c: Campaign, rng: Rng) -> Array | None:
    """Where it was parked overnight a joint's seal has set: it pulls there, less with each traverse."""
    if c.plan.session.max() < 4:
        return None
    where = positions(c, True)
    out, number = np.zeros(len(c)), np.zeros(len(c))
    for k, joint in enumerate(c.plan.joint):
        first = np.searchsorted(c.plan.session, c.plan.session[k])
        b = c.before[k]
        number[k] = number[b] + 1 if b >= 0 else 0
        if first:
            low, high = FULL[int(joint)]
            share = (where[f"q{joint}"][first - 1] - low) / (high - low)
            out[k] = (2 * share - 1) * np.exp(-number[k] / 8) * c.plan.forward[k]
    return 1.5 * out


HISTORY: dict[str, Maker] = {
    "dent where it stood": dents,
    "rubber feet give way": rubber_feet,
    "heaps of debris": of_column(debris),
    "set from parking overnight, opposite ways": of_column(parked),
}


def soaked(c: Campaign, rng: Rng) -> Array | None:
    """A nylon cage takes up the air's water within minutes, and gives it off within hours."""
    damp = z(c, "humidity_pct")
    if damp is None:
        return None
    out = damp.copy()
    for k in range(1, len(c)):
        if same_session(c, k):
            tau = 0.1 if damp[k] > out[k - 1] else 1.5
            out[k] = damp[k] + (out[k - 1] - damp[k]) * np.exp(-(c.hours[k] - c.hours[k - 1]) / tau)
    return out


def restless(c: Campaign, rng: Rng) -> Array | None:
    """A supply that hunts makes ragged pulses: how much its last six readings jump, not their mean."""
    supply = z(c, "supply_V")
    if supply is None:
        return None
    out = np.zeros(len(c))
    for k in range(len(c)):
        first = max(k - 5, int(np.searchsorted(c.plan.session, c.plan.session[k])))
        recent = supply[first : k + 1]
        out[k] = np.abs(np.diff(recent)).mean() if len(recent) > 1 else 0.0
    return out / out.std()


def clamped(c: Campaign, rng: Rng) -> Array | None:
    """Off the temperature at which it was clamped in the morning a contact leans: opposite both ways."""
    temperature = z(c, "temperature_C")
    if temperature is None:
        return None
    off = temperature - temperature[np.searchsorted(c.plan.session, c.plan.session)]
    return np.tanh(off / off.std()) * c.plan.forward


def new_payload(c: Campaign, rng: Rng) -> Array | None:
    """After a change of the payload its glued bond creeps for ten minutes, in proportion to the change."""
    payload = c.plan.payload
    if payload is None or not np.ptp(payload):
        return None
    out = np.zeros(len(c))
    for k in range(1, len(c)):
        if same_session(c, k):
            left = out[k - 1] * np.exp(-(c.hours[k] - c.hours[k - 1]) / 0.15)
            out[k] = left + (payload[k] - payload[k - 1]) / 10
    return out


COLUMN: dict[str, Maker] = {
    "soaks fast, dries slowly": of_column(soaked),
    "restless supply": of_column(restless),
    "off the temperature of clamping, opposite ways": of_column(clamped),
    "creep after a new payload": of_column(new_payload),
}


def cheeks(c: Campaign, rng: Rng) -> Array:
    """The elbow lies on one cheek or the other, and slides across when enough weight is along its axis."""
    side, out = 1.0, np.zeros(len(c))
    tilt = {name: c.plan.settings[:, column] * DEG for name, column in (("theta", 3), ("psi", 4))}
    along = [
        published_load(1, q1=where["q1"], q2=where["q2"], **tilt)
        for where in (positions(c, False), positions(c, True))
    ]
    for k in range(len(c)):
        for moment in along:
            side = np.sign(moment[k]) if np.abs(moment[k]) > 0.3 else side
        out[k] = side
    return out


def fold_back(c: Campaign, rng: Rng) -> Array:
    """The amplifier warms with every joint's steps, more by fast ones, and gives less once it is too warm."""
    end, tau, heat, out = end_hours(c), 0.08, 0.0, np.zeros(len(c))
    for k in range(len(c)):
        cooled = np.exp(-(c.hours[k] - end[k - 1]) / tau) if same_session(c, k) else 0.0
        out[k] = heat * cooled
        kept = np.exp(-(end[k] - c.hours[k]) / tau)
        heat = out[k] * kept + 0.004 / c.plan.step_period[k] * (1 - kept)
    over = np.maximum(out - np.quantile(out, 0.6), 0)
    return over / over.std()


def stalling(c: Campaign, rng: Rng) -> Effect | None:
    """Against its load, on a low supply or stepping fast, a motor's force runs short, and so do its steps."""
    supply = z(c, "supply_V")
    if supply is None:
        return None
    wanting = 0.004 / c.plan.step_period - 1 - 0.25 * supply

    def factor(p: Place, size: float) -> Array:
        return np.asarray(1 + 2 * size * np.maximum(p.load * p.forward + p.of(wanting) - 0.3, 0))

    return Effect(0.05, sized("A", "%", 100), factor=factor)


def loop_side(c: Campaign, rng: Rng) -> Array:
    """To which side the cable loop lies: it was left behind when joint 1 last turned, logged or not."""
    begin, end, out = positions(c, False)["q1"], positions(c, True)["q1"], np.ones(len(c))
    for k in range(1, len(c)):
        came, turns = begin[k] - end[k - 1], end[k - 1] - begin[k - 1]
        out[k] = -np.sign(came) or -np.sign(turns) or out[k - 1]
    return out


MIXED: dict[str, Maker] = {
    "elbow slides from cheek to cheek, joint 2": of_both(cheeks, lambda p: np.ones((1, 1)), 2),
    "amplifier folds back": of_column(fold_back),
    "force runs short": stalling,
    "side of the cable loop and q3, joint 2": of_both(
        loop_side, lambda p: 1.5 * p.forward * p.q3 / STROKE, 2
    ),
}

FIFTH = {
    "unknown:state of set 5": STATE,
    "unknown:time of set 5": TIME,
    "unknown:history of set 5": HISTORY,
    "unknown:column of set 5": COLUMN,
    "unknown:several of set 5": MIXED,
}
