"""What no cause describes, in what came before a traverse, and in what is each session's own."""

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.designs import Ints
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.effects.outside_state import of_both, of_column
from tests.hidden.physics import DEG, FULL, MM, Array, Place

Rng = np.random.Generator
REST = 1 / 3  # h: how long a joint takes to settle after a traverse
LARGEST_FOLLOWING = 3.0  # of the residual before


def ends(c: Campaign) -> tuple[Array, Array]:
    """Where each traverse starts and stops, as shares of the joint's whole travel."""
    settings = c.plan.settings[:, 5:] * np.where(c.plan.joint == 3, MM, DEG)[:, None]
    begin, end = np.array([(np.nan, np.nan), *(FULL[joint] for joint in (1, 2, 3))]).T
    low, high = ((settings - begin[c.plan.joint, None]) / (end - begin)[c.plan.joint, None]).T
    forward = c.plan.forward > 0
    return np.where(forward, low, high), np.where(forward, high, low)


def end_hours(c: Campaign) -> Array:
    """When each traverse ended, hours in its session."""
    return c.hours + c.counts * c.plan.step_period / 3600


def same_session(c: Campaign, k: int) -> bool:
    """Whether the log's traverse before k is of the same session."""
    return bool(k and c.plan.session[k] == c.plan.session[k - 1])


def _length_before(c: Campaign, rng: Rng) -> Array:
    """Logarithm of the length of the joint's traverse before; of a session's first, of the whole travel."""
    start, stop = ends(c)
    return np.log(c.previous(np.abs(stop - start), first=1.0))


def reversals(c: Campaign) -> Ints:
    """How often the traverse's joint has turned around in the log so far, shape (n,)."""
    turned = (c.before >= 0) & (c.plan.forward != c.plan.forward[c.before])
    number = np.zeros(len(c), np.int64)
    for joint in (1, 2, 3):
        subset = c.plan.joint == joint
        number[subset] = np.cumsum(turned[subset])
    return number


def _by_reversals(c: Campaign, rng: Rng) -> Array:
    return np.where(reversals(c) % 14 < 7, 1.0, -1.0)


def _rest(c: Campaign, rng: Rng) -> Array:
    """How little a joint has settled since its traverse before: 1 at once, 0 at a session's first."""
    return np.exp(-(c.hours - c.previous(end_hours(c), first=-np.inf)) / REST)


def _gap(c: Campaign, rng: Rng) -> Array:
    """How far from the end of the joint's traverse before this one begins."""
    start, stop = ends(c)
    return np.where(c.before >= 0, np.abs(start - c.previous(stop)), 0.0)


def follows_residual(c: Campaign, rng: Rng) -> Effect:
    """One way, the step size follows the noise of the traverse before, of whichever joint."""
    same = np.r_[False, c.plan.session[1:] == c.plan.session[:-1]] & (c.plan.forward > 0)
    before = np.where(same, np.roll(c.innovations, 1), 0.0)

    def count(c: Campaign, counts: Array, size: float) -> Array:
        return counts * np.exp(size * c.repeatability * before)

    return Effect(LARGEST_FOLLOWING, sized("A", "1", 1.0), count=count)


def _order(c: Campaign) -> Ints:
    """Number of each traverse in its session."""
    return np.arange(len(c)) - np.searchsorted(c.plan.session, c.plan.session)


def _sawtooth(c: Campaign, rng: Rng) -> Array:
    period = int(rng.integers(8, 26))
    return (_order(c) % period) / period - 0.5


def _own_profile(c: Campaign, rng: Rng) -> Effect | None:
    """A wave along each joint's own travel, somewhere else in each session; none in a single session."""
    if not c.plan.session.max():
        return None
    phase = rng.uniform(0, 2 * np.pi, int(c.plan.session.max()) + 1)[c.plan.session]

    def factor(place: Place, size: float) -> Array:
        low, high = FULL[place.joint]
        share = (place.own - low) / (high - low)
        return np.asarray(1 + size * np.cos(2 * np.pi * share + place.of(phase)))

    return Effect(0.05, sized("A", "%", 100), factor=factor)


def _by_session(c: Campaign, rng: Rng) -> Array:
    return rng.standard_normal(int(c.plan.session.max()) + 1)[c.plan.session]


HISTORY: dict[str, Maker] = {
    "length of the traverse before": of_column(_length_before),
    "square wave in reversals": of_column(_by_reversals),
    "residual before, one way": follows_residual,
    "rest before": of_column(_rest),
    "distance from the end before": of_column(_gap),
}

SESSION: dict[str, Maker] = {
    "profile of its own": _own_profile,
    "sawtooth in order": of_column(_sawtooth),
    "sin 2 q2 of its own size, joint 3": of_both(_by_session, lambda p: np.sin(2 * p.angles["q2"]), 3),
}
