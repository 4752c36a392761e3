"""Twenty-four more effects from outside the library of causes: a second set."""

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.effects.outside_history import end_hours, ends
from tests.hidden.effects.outside_state import of_both, of_column, of_place
from tests.hidden.physics import DEG, MM, Array, Place

Rng = np.random.Generator


def ones(c: Campaign, rng: Rng) -> Array:
    return np.ones(len(c))


def triangle_q2(p: Place) -> Array:
    """Asymmetric: rises over 40 degrees from -180 to -140, falls over 100 to -40."""
    q2 = p.angles["q2"] / DEG
    return np.asarray(np.interp(q2, [-180, -140, -40], [0.0, 1.0, 0.0]))


def lorentz_reach_load(p: Place) -> Array:
    return np.asarray(3 * p.load / (1 + ((p.reach - 37.5 * MM) / (6 * MM)) ** 2))


def chirp_q3(p: Place) -> Array:
    return np.asarray(np.sin(2 * np.pi * 2 * (p.q3 / (12 * MM)) ** 2))


def dead_zone_theta(p: Place) -> Array:
    t = p.angles["theta"] / DEG
    return np.asarray(np.sign(t) * np.maximum(np.abs(t) - 40, 0) / 50)


STATE: dict[str, Maker] = {
    "half-wave of sin psi": of_place(lambda p: np.maximum(np.sin(p.angles["psi"]), 0)),
    "dead zone in theta": of_place(dead_zone_theta),
    "triangle in q2, joint 3": of_place(triangle_q2, 3),
    "cogging and load, joint 2": of_place(lambda p: np.tanh(2 * np.sin(4 * p.angles["q2"])) * p.load, 2),
    "chirp in q3, joint 2": of_place(chirp_q3, 2),
    "load over lorentzian of reach, joint 1": of_place(lorentz_reach_load, 1),
    "sin theta and sin psi, joint 2": of_place(
        lambda p: np.sin(p.angles["theta"]) * np.sin(p.angles["psi"]), 2
    ),
    "half-wave of theta + psi, one way": of_place(
        lambda p: np.maximum(np.sin(p.angles["theta"] + p.angles["psi"]), 0) * (p.forward < 0)
    ),
}


def bump_theta_moving(c: Campaign, rng: Rng) -> Effect:
    """Only downward, about one tilt, that moves from session to session."""
    s = c.plan.session - c.plan.session.max() / 2
    centre = (-50 + 40 * s / max(1.0, float(c.plan.session.max()))) * DEG

    def factor(p: Place, size: float) -> Array:
        return np.asarray(
            1 + size * (p.forward < 0) * np.exp(-(((p.angles["theta"] - p.of(centre)) / (18 * DEG)) ** 2))
        )

    return Effect(0.05, sized("A", "%", 100), factor=factor)


def chirp_time(c: Campaign, rng: Rng) -> Array:
    """A wave in the session's time that becomes faster: five waves in all in the longest session."""
    return np.sin(2 * np.pi * 5 * (c.hours / c.hours.max()) ** 2)


def pulses(c: Campaign, rng: Rng) -> Array:
    """On for a fifth of every 25 min or so, whatever the session."""
    period, phase = rng.uniform(20, 35), rng.uniform()
    minutes = (c.time - c.time[0]).astype(float) / 60
    return ((minutes / period + phase) % 1 < 0.2).astype(float)


TIME: dict[str, Maker] = {
    "bump in theta, one way, moving with session": bump_theta_moving,
    "chirp in time": of_column(chirp_time),
    "pulses in time": of_column(pulses),
    "warm-up and cos q2, joint 3": of_both(
        lambda c, rng: 1 - np.exp(-c.hours / 0.5), lambda p: np.cos(p.angles["q2"]), 3
    ),
}


def since_another(c: Campaign, rng: Rng) -> Array:
    """Minutes since another joint last moved, saturating after 5."""
    end, out = end_hours(c), np.ones(len(c))
    for k in range(len(c)):
        others = np.flatnonzero(
            (c.plan.session[:k] == c.plan.session[k]) & (c.plan.joint[:k] != c.plan.joint[k])
        )
        if len(others):
            out[k] = 1 - np.exp(-(c.hours[k] - end[others[-1]]) * 60 / 5)
    return out


def others_steps(c: Campaign, rng: Rng) -> Array:
    """Steps that the two other joints together made in the 20 min before, in shares of the most."""
    out = np.zeros(len(c))
    for k in range(len(c)):
        earlier = (c.plan.session[:k] == c.plan.session[k]) & (c.plan.joint[:k] != c.plan.joint[k])
        recent = earlier & (c.hours[:k] > c.hours[k] - 1 / 3)
        out[k] = c.counts[:k][recent].sum()
    return out / (out.max() or 1.0)


def since_rest(c: Campaign, rng: Rng) -> Array:
    """Saturating number of the joint's traverses since it last rested for 15 min."""
    end, out = end_hours(c), np.zeros(len(c))
    for k in range(len(c)):
        b = c.before[k]
        out[k] = out[b] + 1 if b >= 0 and c.hours[k] - end[b] < 0.25 else 0
    return 1 - np.exp(-out / 3)


def first_after_another(c: Campaign, rng: Rng) -> Array:
    """Only downward, and only the first traverse after another joint's."""
    other = np.r_[
        False, (c.plan.joint[1:] != c.plan.joint[:-1]) & (c.plan.session[1:] == c.plan.session[:-1])
    ]
    return (other & (c.plan.forward < 0)).astype(float)


def turning_point(c: Campaign, rng: Rng) -> Array:
    """A wave of where the joint last turned round, as a share of its travel."""
    start, _ = ends(c)
    out = np.zeros(len(c))
    for k in range(len(c)):
        b = c.before[k]
        if b < 0:
            out[k] = start[k]
        else:
            out[k] = start[k] if c.plan.forward[k] != c.plan.forward[b] else out[b]
    return np.sin(2 * np.pi * out + 0.7)


def own_steps_wave(c: Campaign, rng: Rng) -> Array:
    period, phase = rng.uniform(0.08, 0.2), rng.uniform(0, 2 * np.pi)
    out = np.zeros(len(c))
    for joint in (1, 2, 3):
        subset = c.plan.joint == joint
        out[subset] = np.sin(
            2 * np.pi * c.steps_before[subset] / (period * c.steps_before[subset].max()) + phase
        )
    return out


def every_third(c: Campaign, rng: Rng) -> Array:
    """Every third traverse of a joint, counted in the whole log."""
    out = np.zeros(len(c))
    for joint in (1, 2, 3):
        subset = np.flatnonzero(c.plan.joint == joint)
        out[subset] = np.arange(len(subset)) % 3 == 0
    return out


def settling(c: Campaign, rng: Rng) -> Array:
    """1 at the first traverse after the base was turned, then less: a third of it lost with each traverse."""
    tilt = c.plan.settings[:, 3:5]
    out, n = np.zeros(len(c)), 99
    for k in range(len(c)):
        same = k > 0 and c.plan.session[k] == c.plan.session[k - 1]
        if not same:
            n = 99
        elif np.any(tilt[k] != tilt[k - 1]):
            n = 0
        else:
            n += 1
        out[k] = (2 / 3) ** n
    return out


def duty(c: Campaign, rng: Rng) -> Array:
    """Share of the last 12 min in which the joint itself was moving."""
    end, out = end_hours(c), np.zeros(len(c))
    for k in range(len(c)):
        own = np.flatnonzero(
            (c.plan.session[:k] == c.plan.session[k]) & (c.plan.joint[:k] == c.plan.joint[k])
        )
        low = c.hours[k] - 0.2
        out[k] = np.maximum(0, end[own] - np.maximum(c.hours[own], low)).sum() / 0.2
    return out


HISTORY: dict[str, Maker] = {
    "since another joint moved": of_column(since_another),
    "steps of the other joints in 20 min": of_column(others_steps),
    "traverses since a rest": of_column(since_rest),
    "first after another joint, one way": of_column(first_after_another),
    "turning point": of_column(turning_point),
    "period in own steps": of_column(own_steps_wave),
    "every third of the joint": of_column(every_third),
    "settling after a new tilt": of_column(settling),
    "duty of the joint": of_column(duty),
}


def rate_of_temperature(c: Campaign, rng: Rng) -> Array | None:
    """Slope of the room's temperature over the 20 min around."""
    if "temperature_C" not in c.columns:
        return None
    T, out = c.columns["temperature_C"], np.zeros(len(c))
    for k in range(len(c)):
        near = (c.plan.session == c.plan.session[k]) & (np.abs(c.hours - c.hours[k]) < 1 / 6)
        if near.sum() > 2:
            out[k] = np.polyfit(c.hours[near] - c.hours[k], T[near], 1)[0]
    return np.asarray(out / out.std())


def temperature_and_supply(c: Campaign, rng: Rng) -> Array | None:
    if "temperature_C" not in c.columns or "supply_V" not in c.columns:
        return None
    z = [(c.columns[n] - c.columns[n].mean()) / c.columns[n].std() for n in ("temperature_C", "supply_V")]
    return np.asarray(z[0] * z[1])


def fast_one_way(c: Campaign, rng: Rng) -> Array:
    return ((c.plan.step_period < 0.0036) & (c.plan.forward > 0)).astype(float)


COLUMN: dict[str, Maker] = {
    "rate of temperature": of_column(rate_of_temperature),
    "temperature and supply": of_column(temperature_and_supply),
    "fast stepping, one way": of_column(fast_one_way),
}

SECOND = {
    "unknown:state of set 2": STATE,
    "unknown:time of set 2": TIME,
    "unknown:history of set 2": HISTORY,
    "unknown:column of set 2": COLUMN,
}
