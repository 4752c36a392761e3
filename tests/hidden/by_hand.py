"""Single counts in plain numbers by scipy's quadrature: the equations of the causes, one row at a time.

Positions and angles in rad and m. `row` is a row of the log as the reader gives it, history and all, `law`
the parameters of its joint, session and direction, `p` the effect's by name in people's units.
"""

from collections.abc import Callable, Mapping
from math import cos, exp, log, pi, sin, sqrt
from typing import Any

from scipy.integrate import quad

Row = Mapping[str, Any]
Numbers = Mapping[str, Any]
DEG = pi / 180


class Traverse:
    """What the step size depends on at one position; effects change it in place."""

    def __init__(self, row: Row, law: Numbers, x: float) -> None:
        self.row, self.law, self.joint = row, law, int(row["joint"])
        self.forward = 1 if row["direction"] == "+" else -1
        position = {name: float(row[name]) for name in ("q1", "q2", "q3")} | {f"q{self.joint}": x}
        self.q1, self.q2, self.q3 = position.values()
        self.theta, self.psi, self.x = row["theta"], row["psi"], x
        self.power, self.axis, self.heavier, self.share_full = 1.0, 0.0, 1.0, 0.0
        self.term, self.factor, self.steps = 0.0, 1.0, 0.0

    @property
    def load(self) -> float:
        u = [0.0, self._base(), sin(self.psi - self.q2), cos(self.psi - self.q2)][self.joint]
        published = u * (1.0 if self.joint == 1 else cos(self.theta))
        return (published + self.share_full * (self._full() - published)) * self.heavier

    def _base(self) -> float:
        return cos(self.theta) * sin(self.psi) * sin(self.q1) + sin(self.theta) * cos(self.q1)

    def _full(self) -> float:
        s1, c1, s2, c2 = sin(self.q1), cos(self.q1), sin(self.q2), cos(self.q2)
        st, ct, sp, cp = sin(self.theta), cos(self.theta), sin(self.psi), cos(self.psi)
        if self.joint == 1:
            return self._base()
        if self.joint == 2:
            return sp * c1 * c2 * ct - s1 * c2 * st - cp * s2 * ct
        return sp * c1 * s2 * ct - s1 * s2 * st + cp * c2 * ct

    @property
    def unloaded(self) -> float:
        v = self.law
        if self.joint == 3:
            return v["a"]
        if self.joint == 2:
            return v["near"] + (v["far"] - v["near"]) * self.q3 / 0.012
        return v["zero"] - v["per_m"] * (0.0375 + self.q3) * sin(self.q2)

    def step_size(self) -> float:
        v = self.law
        if self.joint == 3:
            recoil = 1 - v["b"] * abs(cos(self.q2 - self.axis)) ** self.power
            published = recoil * (self.unloaded - v["c"] * self.load)
        elif self.joint == 2:
            d = v["d_near"] + (v["d_far"] - v["d_near"]) * self.q3 / 0.012
            published = self.unloaded + d * self.load
        else:
            d = v["d_zero"] - v["d_per_m"] * (0.0375 + self.q3) * sin(self.q2)
            published = self.unloaded + d * self.load
        return (published + self.term) * self.factor


Work = Callable[[Traverse, Numbers], None]


def count(row: Row, law: Numbers, effect: Work | None = None, p: Numbers | None = None) -> float:
    """Steps of one traverse."""

    def there(x: float) -> Traverse:
        traverse = Traverse(row, law, x)
        if effect is not None:
            effect(traverse, p or {})
        return traverse

    start, stop = sorted((row["start"], row["stop"]))
    spot = [p["x0"] * 1e-3 + k * p["w"] * 1e-3 for k in (-4, -1, 0, 1, 4)] if p and "x0" in p else []
    points = [x for x in spot if start < x < stop] if row["joint"] == 3 else []
    steps, _ = quad(
        lambda x: 1 / there(x).step_size(), start, stop, epsrel=1e-11, points=points or None, limit=200
    )
    return steps + there(start).steps


def _set(name: str, value: Callable[[Traverse, Numbers], float], joints: tuple[int, ...] = (1, 2, 3)) -> Work:
    def work(t: Traverse, p: Numbers) -> None:
        if t.joint in joints:
            setattr(t, name, value(t, p))

    return work


def _percent(
    shape: Callable[[Traverse, Numbers], float], name: str = "k", joints: tuple[int, ...] = (1, 2, 3)
) -> Work:
    return _set("factor", lambda t, p: 1 + p[name] / 100 * shape(t, p), joints)


def _turned(t: Traverse) -> bool:
    before = t.row["before_direction"]
    return before != "" and before != t.row["direction"]


def _later(t: Traverse, p: Numbers) -> bool:
    # Sessions are called by their days, in an order that text has too.
    return (t.row["session"], t.row["session_seconds"]) >= (p["session"], 60 * p["moment"] - 1e-6)


def _in_session_later(t: Traverse, p: Numbers) -> bool:
    return bool(t.row["session"] == p["session"]) and _later(t, p)


def _minutes(t: Traverse) -> float:
    return float(t.row["session_seconds"]) / 60


_MIDDLE = {1: 0.0, 2: -90 * DEG}

# The table's forms; `mean_...` and `median_...` are columns that the test adds to each row.
TABLE: dict[str, Work] = {
    "theta-offset": _set("theta", lambda t, p: t.theta + p["delta"] * DEG),
    "psi-offset": _set("psi", lambda t, p: t.psi + p["delta"] * DEG),
    "q2-offset": _set("q2", lambda t, p: t.q2 + p["delta"] * DEG),
    "q1-gravity": _set("share_full", lambda t, p: p["k"]),
    "recoil-axis": _set("axis", lambda t, p: p["phi"] * DEG),
    "recoil-shape": _set("power", lambda t, p: p["p"]),
    "payload-change": _set("heavier", lambda t, p: 1 + p["k"] / 100 * _later(t, p)),
    "load-nonlinearity": _set(
        "term", lambda t, p: p[f"k{t.joint}{t.row['direction']}"] / 100 * t.unloaded * t.load**2
    ),
    "inertia-quadratic": _set("term", lambda t, p: p["k"] * t.q3 * (t.q3 - 0.012), (2,)),
    "cable-torque": _set(
        "term", lambda t, p: p["k"] * 1e-6 / DEG * t.forward * (t.x - _MIDDLE[t.joint]), (1, 2)
    ),
    "thermal-warm-up": _percent(lambda t, p: 1 - exp(-_minutes(t) / p["tau"]), "A"),
    "drift": _percent(lambda t, p: _minutes(t) / 60),
    "session-jump": _percent(_in_session_later, "A"),
    "wear": _percent(lambda t, p: log(1 + t.row["steps_before"] / p["n0"])),
    "temperature": _percent(lambda t, p: t.row["temperature"] - t.row["mean_temperature"]),
    "humidity": _percent(lambda t, p: 100 * (t.row["humidity"] - t.row["mean_humidity"])),
    "supply-voltage": _percent(lambda t, p: t.row["supply"] - t.row["mean_supply"]),
    "step-rate": _percent(lambda t, p: log(t.row["step_period"] / t.row["median_step_period"])),
    "side-load": _percent(lambda t, p: -sqrt(1 - t.load**2), joints=(3,)),
    "load-hysteresis": _percent(lambda t, p: t.row["before_load"]),
    "bearing-runout": _percent(lambda t, p: cos(t.x - p["phi"] * DEG), "A", (1, 2)),
    "guide-gradient": _percent(lambda t, p: 1e3 * t.x - 6, joints=(3,)),
    "worn-spot": _percent(lambda t, p: exp(-(((1e3 * t.x - p["x0"]) / p["w"]) ** 2) / 2), "A", (3,)),
    "end-stop-latency": _set("steps", lambda t, p: p["L"]),
    "reversal-loss": _set("steps", lambda t, p: p["L"] * _turned(t)),
}
