"""All causes that come with the toolkit, and those that installed packages add."""

from __future__ import annotations

from importlib.metadata import entry_points

import pandas as pd

from stickslip_fit.causes.bearing_runout import BearingRunout
from stickslip_fit.causes.cable_torque import CableTorque
from stickslip_fit.causes.cause import Cause
from stickslip_fit.causes.covariate import Covariate
from stickslip_fit.causes.drift import Drift
from stickslip_fit.causes.end_stop_latency import EndStopLatency
from stickslip_fit.causes.end_stop_misfire import EndStopMisfire
from stickslip_fit.causes.guide_gradient import GuideGradient
from stickslip_fit.causes.humidity import Humidity
from stickslip_fit.causes.inertia_quadratic import InertiaQuadratic
from stickslip_fit.causes.load_hysteresis import LoadHysteresis
from stickslip_fit.causes.load_nonlinearity import LoadNonlinearity
from stickslip_fit.causes.payload_change import PayloadChange
from stickslip_fit.causes.psi_offset import PsiOffset
from stickslip_fit.causes.q1_gravity import Q1Gravity
from stickslip_fit.causes.q2_offset import Q2Offset
from stickslip_fit.causes.recoil_axis import RecoilAxis
from stickslip_fit.causes.recoil_shape import RecoilShape
from stickslip_fit.causes.reversal_loss import ReversalLoss
from stickslip_fit.causes.session_jump import SessionJump
from stickslip_fit.causes.side_load import SideLoad
from stickslip_fit.causes.step_rate import StepRate
from stickslip_fit.causes.supply_voltage import SupplyVoltage
from stickslip_fit.causes.temperature import Temperature
from stickslip_fit.causes.thermal_warm_up import ThermalWarmUp
from stickslip_fit.causes.theta_offset import ThetaOffset
from stickslip_fit.causes.wear import Wear
from stickslip_fit.causes.worn_spot import WornSpot
from stickslip_fit.logs.columns import COVARIATE

ENTRY_POINT = "stickslip_fit.causes"


def library() -> tuple[Cause, ...]:
    """Every cause, in the order of the documentation; then those of installed packages.

    A package adds its own by the entry point ``stickslip_fit.causes``, which names a cause or a function
    without arguments that returns one.

    Examples
    --------
    >>> [cause.name for cause in library()][:3]
    ['thermal-warm-up', 'drift', 'session-jump']
    """
    own = (
        ThermalWarmUp(), Drift(), SessionJump(), Wear(), Temperature(), Humidity(), SupplyVoltage(),
        StepRate(), ThetaOffset(), PsiOffset(), Q2Offset(), Q1Gravity(), RecoilAxis(), RecoilShape(),
        SideLoad(), LoadNonlinearity(), LoadHysteresis(), PayloadChange(), InertiaQuadratic(),
        CableTorque(), BearingRunout(), GuideGradient(), WornSpot(), EndStopLatency(), ReversalLoss(),
        EndStopMisfire(),
    )  # fmt: skip
    return own + tuple(_loaded(point.load()) for point in entry_points(group=ENTRY_POINT))


def covariates(rows: pd.DataFrame) -> tuple[Covariate, ...]:
    """A cause for every numeric column that the lab added."""
    return tuple(
        Covariate(name.removeprefix(COVARIATE)) for name in rows.columns if name.startswith(COVARIATE)
    )


def _loaded(found: object) -> Cause:
    return found if isinstance(found, Cause) else found()  # type: ignore[operator]
