"""Plans of campaigns: one small session, three as in the thesis, many in a random order, days alike."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tests.hidden.physics import DEG, FULL, MM, Array

DAYS = 8
Ints = npt.NDArray[np.int64]
# joint, q1, q2, q3, theta, psi, low, high in deg and mm; the moving joint's own position is not looked at.
Setting = tuple[int, float, float, float, float, float, float, float]
_FIELDS = ("q1", "q2", "q3", "theta", "psi", "low", "high")


@dataclass(frozen=True)
class Plan:
    """Traverses in the order they are made; positions in deg and mm as a lab writes them."""

    session: Ints
    joint: Ints
    forward: Ints
    settings: Array  # columns as _FIELDS
    step_period: Array  # s
    days: Ints  # of each session, from the campaign's first
    payload: Array | None = None  # g, where it is written down
    columns: tuple[str, ...] = ()  # what else the lab writes down

    def positions(self) -> dict[str, Array]:
        """q1, q2, q3, theta, psi, low and high of each traverse, SI."""
        given = dict(zip(_FIELDS, self.settings.T, strict=True))
        length = np.where(self.joint == 3, MM, DEG)
        units = {"q3": MM, "low": length, "high": length}
        return {name: values * units.get(name, DEG) for name, values in given.items()}

    @property
    def partial(self) -> bool:
        """Whether any traverse stops short of the joint's range."""
        ends = np.array([(np.nan, np.nan), *(_full(joint) for joint in (1, 2, 3))])
        return bool(np.any(self.settings[:, 5:] != ends[self.joint]))

    def configuration(self) -> Ints:
        """A number for each configuration, whatever the session and direction."""
        moving = np.column_stack([self.joint, self.settings])
        moving[np.arange(len(moving)), self.joint] = 0.0
        return np.unique(moving, axis=0, return_inverse=True)[1].ravel()


def _full(joint: int) -> tuple[float, float]:
    low, high = (end / (MM if joint == 3 else DEG) for end in FULL[joint])
    return round(low, 9), round(high, 9)


def _prismatic(q2: float, theta: float = 0.0, psi: float = 0.0) -> Setting:
    return (3, 0.0, q2, 0.0, theta, psi, *_full(3))


def _elbow(q3: float, theta: float = 0.0, psi: float = 0.0, ends: tuple[float, float] = _full(2)) -> Setting:
    return (2, 0.0, 0.0, q3, theta, psi, *ends)


def _base(q2: float, q3: float, theta: float = 0.0, psi: float = 0.0) -> Setting:
    return (1, 0.0, q2, q3, theta, psi, *_full(1))


_CALIBRATION = (
    *(_prismatic(-90), _prismatic(0, -90), _prismatic(0)),
    *(_elbow(0), _elbow(12), _elbow(12, -90), _elbow(0, -90)),
    *(_base(-90, 0), _base(-90, 12), _base(-90, 0, -90), _base(-90, 12, -90)),
)
_GUIDE = (
    *(_prismatic(q2) for q2 in (-180, -150, -120, -60, -30, 30)),
    *(_prismatic(-90, theta) for theta in (-30, -60)),
    *(_prismatic(-90, 0, psi) for psi in (-60, -30, 45)),
    _prismatic(-150, -45),
)
_ARM = (
    *(_elbow(q3) for q3 in (3, 6, 9)),
    *(_elbow(6, theta) for theta in (-30, -60, -90)),
    *(_elbow(6, 0, psi) for psi in (-45, 45)),
    *(_elbow(3, 0, 30), _elbow(9, 0, 60), _elbow(12, 0, -60)),
)
_ARM_PIECES = tuple(_elbow(6, 0, 0, (float(low), low + 60.0)) for low in (-210, -150, -90, -30))
_TURN = (_base(-45, 6), _base(-45, 6, -60), _base(-90, 6, 0, 40))


def one_session(rng: np.random.Generator) -> Plan:
    """Thesis-like configurations in a random order, 150 to 190 traverses, some pieces of joint 2's range."""
    replicates = int(rng.choice([2, 3], p=[0.3, 0.7]))
    more = (*_GUIDE, *_ARM, *_ARM_PIECES)
    chosen = rng.permutation(len(more))[: 28 if replicates == 2 else 16]
    settings = (*_CALIBRATION, *(more[each] for each in chosen), *_TURN[:2])
    visits = np.array(settings)[rng.permutation(np.repeat(np.arange(len(settings)), replicates))]
    plan = _both_ways(np.zeros(len(visits), np.int64), visits, 0.004, rng.choice([-1, 1], len(visits)))
    return replace(plan, columns=("temperature_C", "supply_V", "air_pressure_hPa"))


def three_sessions(rng: np.random.Generator) -> Plan:
    """The thesis's campaign: sweep after sweep in a fixed order, three days, whole ranges, replicates."""
    settings = np.array((*_CALIBRATION, *_GUIDE, *_ARM, *_TURN[:2]))
    visits = np.tile(np.repeat(settings, 3, axis=0), (3, 1))
    session = np.repeat(np.arange(3), len(visits) // 3)
    plan = _both_ways(session, visits, 0.004, np.ones(len(visits), np.int64))
    return replace(plan, days=np.cumsum([0, *rng.integers(1, 4, 2)]), columns=("step_period_ms",))


def days_alike(rng: np.random.Generator) -> Plan:
    """The same traverses on each of eight days."""
    visits = np.array((*_CALIBRATION, *_GUIDE, *_ARM))
    session = np.repeat(np.arange(DAYS), len(visits))
    return _both_ways(session, np.tile(visits, (DAYS, 1)), 0.004, np.ones(len(session), np.int64))


def many_sessions(rng: np.random.Generator) -> Plan:
    """Twelve to fifteen short sessions in a random order: everything is varied and written down."""
    sessions = int(rng.integers(12, 16))
    pools = {joint: _pool(joint, size, rng) for joint, size in ((3, 40), (2, 36), (1, 16))}
    visits, session, period = [], [], []
    for number in range(sessions):
        base = 7 if number % 3 == 0 else 0
        rest = round(325 / sessions) - base
        shares = {1: base, 2: rest // 2, 3: rest - rest // 2}
        drawn = np.concatenate([_visits(pools[joint], share, rng) for joint, share in shares.items()])
        visits.append(drawn[rng.permutation(len(drawn))])
        session += [number] * len(drawn)
        usual = rng.choice([0.003, 0.004, 0.005])
        period.append(np.round(usual * rng.choice([0.75, 1.0, 1.0, 1.0, 1.25], len(drawn)), 6))
    stacked = np.concatenate(visits)
    first = rng.choice([-1, 1], len(stacked))
    plan = _both_ways(np.array(session), stacked, np.concatenate(period), first)
    payload = _payload(len(stacked), rng) if rng.random() < 0.5 else None
    columns = ("temperature_C", "humidity_pct", "supply_V", "step_period_ms")
    return replace(
        plan,
        days=np.cumsum(rng.integers(1, 5, sessions)),
        payload=None if payload is None else np.repeat(payload, 2),
        columns=(*columns, "air_pressure_hPa", "operator_load"),
    )


DESIGNS: dict[str, Callable[[np.random.Generator], Plan]] = {
    "session": one_session,
    "thesis": three_sessions,
    "many": many_sessions,
    "days": days_alike,
}


def _pool(joint: int, size: int, rng: np.random.Generator) -> Array:
    """Configurations of one joint that a campaign comes back to."""
    low, high = _full(joint)
    lengths = (2.0, 3.0, 4.0, 6.0) if joint == 3 else (30.0, 60.0, 90.0, 120.0)
    length = rng.choice(lengths, size)
    begin = low + np.floor(rng.uniform(0, high - low - length + 1))
    whole = rng.random(size) < 0.4
    q2 = rng.choice(
        [-180, -150, -120, -90, -90, -60, -30, 0] if joint == 3 else [-150, -120, -90, -60, -30], size
    )
    return np.column_stack(
        [
            np.full(size, float(joint)),
            rng.choice([-90, -60, -30, 0, 0, 30, 60, 90], size),
            q2,
            rng.choice([0, 2, 4, 6, 8, 10, 12], size),
            rng.choice([0, 0, -30, -60, -90, 30], size),
            rng.choice([0, 0, -45, -30, 30, 45], size),
            np.where(whole, low, begin),
            np.where(whole, high, begin + length),
        ]
    )


def _visits(pool: Array, share: int, rng: np.random.Generator) -> Array:
    """So many visits, about a fifth of them to a configuration already seen in the session."""
    again = share // 5
    new = rng.permutation(len(pool))[: share - again]
    return pool[np.concatenate([new, rng.choice(new, again)])] if share else pool[:0]


def _payload(visits: int, rng: np.random.Generator) -> Array:
    """What hangs at the tip, g: changed every five to ten visits."""
    changes = np.cumsum(rng.random(visits) < 1 / 7)
    return np.array([0.0, 10.0, 20.0])[rng.integers(3, size=visits + 1)][changes]


def _both_ways(session: Ints, visits: Array, step_period: float | Array, first: Ints) -> Plan:
    twice = np.repeat(visits, 2, axis=0)
    return Plan(
        session=np.repeat(session, 2),
        joint=twice[:, 0].astype(np.int64),
        forward=np.column_stack([first, -first]).ravel(),
        settings=twice[:, 1:].astype(float),
        step_period=np.repeat(np.broadcast_to(step_period, len(visits)), 2),
        days=np.arange(int(session.max()) + 1),
    )
