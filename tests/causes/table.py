"""Every cause as its row of the table says, with values to try: two sizes and signs of each."""

from dataclasses import dataclass
from math import cos, exp, log, pi, sqrt, tanh

import numpy as np
import pandas as pd

from stickslip_fit.causes import (
    AlongTravel,
    BearingRunout,
    CableTorque,
    Cause,
    Covariate,
    Drift,
    EndStopLatency,
    GuideGradient,
    Humidity,
    InertiaQuadratic,
    LoadHysteresis,
    LoadNonlinearity,
    PayloadChange,
    PsiOffset,
    Q1Gravity,
    Q2Offset,
    RecoilAxis,
    RecoilShape,
    ReversalLoss,
    SessionJump,
    SideLoad,
    StepRate,
    SupplyVoltage,
    Temperature,
    ThermalWarmUp,
    ThetaOffset,
    Wear,
    WornSpot,
)
from stickslip_fit.laws import published_law
from stickslip_fit.machine import load_machine
from tests.causes.by_hand import DEG, FIRST, MM, ROWS, SECOND, VALUES, Effect, full_load

MACHINE = load_machine()
LAWS = {joint: published_law(joint, ROWS[ROWS["joint"] == joint], MACHINE) for joint in (1, 2, 3)}
MIDDLE = {1: 0.0, 2: -pi / 2}
WAYS = [(joint, way) for joint in (1, 2, 3) for way in (1, -1)]


def own_values(rows: pd.DataFrame) -> np.ndarray:
    """The published parameters of each row."""
    keys = zip(rows["joint"], rows["direction"], strict=True)
    return np.array([VALUES[key] for key in keys])


@dataclass(frozen=True)
class Case:
    """A cause, what it does by hand, and values of its parameters, SI."""

    cause: Cause
    effect: Effect
    values: tuple[tuple[float, ...], ...]
    form: str = ""

    @property
    def label(self) -> str:
        return f"{self.cause.name} {self.form}".strip()


def bend(f):  # type: ignore[no-untyped-def]
    return Effect(term=lambda s, *k: k[WAYS.index((s.joint, s.way))] * s.free * f(s.u))


def square_and_cube(s, *k):  # type: ignore[no-untyped-def]
    place = WAYS.index((s.joint, s.way))
    return s.unloaded * (k[place] * s.u**2 + k[place + len(WAYS)] * s.u**3)


def polynomial(s, f1, f2, f3):  # type: ignore[no-untyped-def]
    def f(pressure: float) -> float:
        x = (pressure - 1010) / 20
        return f1 * x + f2 * (2 * x**2 - 1) + f3 * (4 * x**3 - 3 * x)

    return 1 + f(min(max(getattr(s, "covariate:pressure"), 990), 1030)) - f(1000)


TRAVEL = ((1, -2.5, 2.2), (2, -210 * DEG, 30 * DEG), (3, -1 * MM, 12 * MM))


def by_way(s, up, down):  # type: ignore[no-untyped-def]
    return up if s.way > 0 else down


def profile(s, sizes):  # type: ignore[no-untyped-def]
    """Cosines over the joint's travel."""
    (low, high), *_ = ((low, high) for joint, low, high in TRAVEL if joint == s.joint)
    share = (s.q - low) / (high - low)
    return sum(size * cos(k * pi * share) for k, size in enumerate(sizes, start=1))


def grown(s, sizes):  # type: ignore[no-untyped-def]
    """An exponential of these, with a mean of 1 but for third powers."""
    return exp(profile(s, sizes) - sum(size**2 for size in sizes) / 4)


BENT = ((0.02, -0.03, 0.05, 0.04, -0.06, 0.03), (-0.05, 0.02, 0.0, -0.08, 0.1, -0.1))

CASES = (
    Case(
        ThermalWarmUp(),
        Effect(factor=lambda s, A, tau: 1 + A * (1 - exp(-s.session_seconds / tau))),
        ((0.03, 600.0), (-0.08, 3000.0)),
    ),
    Case(Drift(), Effect(factor=lambda s, k: 1 + k * s.session_seconds), ((0.02 / 3600,), (-0.05 / 3600,))),
    Case(
        SessionJump(session=SECOND),
        Effect(factor=lambda s, A, at: 1 + A * (s.session == SECOND and s.session_seconds >= at)),
        ((0.03, 8000.0), (-0.05, 9000.0), (0.04, 9001.0)),
    ),
    Case(
        Wear(),
        Effect(factor=lambda s, k, n0: 1 + k * log(1 + s.steps_before / n0)),
        ((0.01, 1e5), (-0.02, 2e6)),
    ),
    Case(
        Temperature(mean=292.0),
        Effect(factor=lambda s, k: 1 + k * (s.temperature - 292)),
        ((0.005,), (-0.01,)),
    ),
    Case(
        Temperature(mean=292.0, form="curved", half=5.5),
        Effect(factor=lambda s, k, b: 1 + k * (s.temperature - 292) * (1 + b * (s.temperature - 292) / 5.5)),
        ((0.005, 0.5), (-0.01, -0.4)),
        form="curved",
    ),
    Case(Humidity(mean=0.41), Effect(factor=lambda s, k: 1 + k * (s.humidity - 0.41)), ((0.2,), (-0.4,))),
    Case(
        SupplyVoltage(mean=151.0), Effect(factor=lambda s, k: 1 + k * (s.supply - 151)), ((0.01,), (-0.02,))
    ),
    Case(
        StepRate(median=0.010),
        Effect(factor=lambda s, k: 1 + k * log(s.step_period / 0.010)),
        ((0.02,), (-0.05,)),
    ),
    Case(
        ThetaOffset(), Effect(angles=lambda s, delta: {"theta": s.theta + delta}), ((2 * DEG,), (-5 * DEG,))
    ),
    Case(PsiOffset(), Effect(angles=lambda s, delta: {"psi": s.psi + delta}), ((2 * DEG,), (-5 * DEG,))),
    Case(Q2Offset(), Effect(angles=lambda s, delta: {"q2": s.q2 + delta}), ((2 * DEG,), (-5 * DEG,))),
    Case(
        Q1Gravity(),
        Effect(load=lambda s, k: s.u if s.joint == 1 else (1 - k) * s.u + k * full_load(s)),
        ((1.0,), (0.4,)),
    ),
    Case(RecoilAxis(), Effect(recoil=lambda s, phi: abs(cos(s.q2 - phi))), ((6 * DEG,), (-15 * DEG,))),
    Case(RecoilShape(), Effect(recoil=lambda s, p: s.recoil**p), ((0.5,), (2.0,))),
    Case(
        SideLoad(),
        Effect(factor=lambda s, k: 1 - k * sqrt(max(1 - s.u**2, 0)) if s.joint == 3 else 1),
        ((0.05,), (-0.1,)),
    ),
    Case(LoadNonlinearity(form="square"), bend(lambda u: u**2), BENT, form="square"),
    Case(LoadNonlinearity(form="cube"), bend(lambda u: u**3), BENT, form="cube"),
    Case(LoadNonlinearity(form="tanh"), bend(lambda u: tanh(2 * u)), BENT, form="tanh"),
    Case(
        LoadNonlinearity(form="square-and-cube"),
        Effect(term=square_and_cube),
        (BENT[0] + BENT[1], BENT[1] + BENT[0]),
        form="square-and-cube",
    ),
    Case(LoadHysteresis(), Effect(factor=lambda s, k: 1 + k * s.before_load), ((0.02,), (-0.05,))),
    Case(
        PayloadChange(session=FIRST),
        Effect(load=lambda s, k, at: s.u * (1 + k * (s.session == FIRST and s.session_seconds >= at))),
        ((0.2, 1000.0), (-0.3, 2400.0)),
        form="unrecorded",
    ),
    Case(
        PayloadChange(),
        Effect(load=lambda s, k: s.u * (1 + k * s.payload)),
        ((10.0,), (-40.0,)),
        form="recorded",
    ),
    Case(
        InertiaQuadratic(),
        Effect(term=lambda s, k: k * s.q3 * (s.q3 - 12 * MM) if s.joint == 2 else 0),
        ((0.1,), (-0.2,)),
    ),
    Case(
        CableTorque(),
        Effect(term=lambda s, k: s.way * k * (s.q - MIDDLE[s.joint]) if s.joint < 3 else 0),
        ((0.02e-6 / DEG,), (-0.05e-6 / DEG,)),
    ),
    Case(
        BearingRunout(),
        Effect(factor=lambda s, A, phi: 1 + A * cos(s.q - phi) if s.joint < 3 else 1),
        ((0.02, 0.7), (0.05, -2.0)),
    ),
    Case(
        GuideGradient(),
        Effect(factor=lambda s, k: 1 + k * (s.q - 6 * MM) if s.joint == 3 else 1),
        ((5.0,), (-10.0,)),
    ),
    Case(
        WornSpot(),
        Effect(factor=lambda s, A, x0, w: 1 + A * exp(-(((s.q - x0) / w) ** 2) / 2) if s.joint == 3 else 1),
        ((0.3, 5 * MM, 0.1 * MM), (-0.5, 6.13 * MM, 1 * MM)),
    ),
    Case(
        BearingRunout(by_direction=True),
        Effect(factor=lambda s, A, f, B, g: 1 + by_way(s, A, B) * cos(s.q - by_way(s, f, g)) * (s.joint < 3)),
        ((0.02, 0.7, -0.03, 0.1), (0.05, -2.0, 0.0, 1.0)),
        form="by direction",
    ),
    Case(
        GuideGradient(by_direction=True),
        Effect(factor=lambda s, k, m: 1 + by_way(s, k, m) * (s.q - 6 * MM) * (s.joint == 3)),
        ((5.0, -3.0), (-10.0, 0.0)),
        form="by direction",
    ),
    Case(
        WornSpot(place=(4 * MM, 1 * MM)),
        Effect(
            factor=lambda s, A, B, x0, w: (
                1 + by_way(s, A, B) * exp(-(((s.q - x0) / w) ** 2) / 2) * (s.joint == 3)
            )
        ),
        ((0.3, -0.1, 5 * MM, 0.1 * MM), (-0.5, 0.2, 6.13 * MM, 1 * MM)),
        form="by direction",
    ),
    Case(
        AlongTravel(travel=TRAVEL, sds=(1.0, 0.5)),
        Effect(factor=lambda s, *c: grown(s, c[2 * s.joint - 2 : 2 * s.joint])),
        ((0.02, -0.01, 0.03, 0.01, -0.02, 0.04), (0.1, 0.1, 0.0, -0.2, 0.15, 0.0)),
    ),
    Case(
        AlongTravel(travel=TRAVEL[1:], directions=("+", "-"), sds=(1.0,), amplitude=3.0),
        Effect(
            factor=lambda s, a, b, c, d: (
                grown(s, [by_way(s, a, b), by_way(s, c, d)][s.joint - 2 :][:1]) if s.joint > 1 else 1
            )
        ),
        ((0.02, -0.01, 0.03, 0.05), (0.1, 0.1, -0.2, 0.0)),
        form="by direction",
    ),
    Case(EndStopLatency(), Effect(count=lambda s, L: L), ((40.0,), (-100.0,))),
    Case(
        ReversalLoss(),
        Effect(count=lambda s, L: L * (s.before_direction == ("-" if s.way > 0 else "+"))),
        ((40.0,), (90.0,)),
    ),
    Case(
        Covariate("pressure", mean=1000.0, low=990.0, high=1030.0),
        Effect(factor=polynomial),
        ((0.02, 0.0, 0.0), (-0.01, 0.02, 0.01)),
    ),
)

NAMED = {case.label: case for case in CASES}
