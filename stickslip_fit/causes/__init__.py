"""Why the step size is not what the law says: one file a cause."""

from stickslip_fit.causes.bearing_runout import BearingRunout
from stickslip_fit.causes.cable_torque import CableTorque
from stickslip_fit.causes.cause import Cause, CauseParameter, CountCause, FactorCause, StateCause, TermCause
from stickslip_fit.causes.covariate import Covariate
from stickslip_fit.causes.drift import Drift
from stickslip_fit.causes.end_stop_latency import EndStopLatency
from stickslip_fit.causes.end_stop_misfire import EndStopMisfire
from stickslip_fit.causes.extended import ExtendedLaw, extend
from stickslip_fit.causes.guide_gradient import GuideGradient
from stickslip_fit.causes.humidity import Humidity
from stickslip_fit.causes.inertia_quadratic import InertiaQuadratic
from stickslip_fit.causes.library import covariates, library
from stickslip_fit.causes.load_hysteresis import LoadHysteresis
from stickslip_fit.causes.load_nonlinearity import LoadNonlinearity
from stickslip_fit.causes.payload_change import PayloadChange
from stickslip_fit.causes.psi_offset import PsiOffset
from stickslip_fit.causes.q1_gravity import Q1Gravity
from stickslip_fit.causes.q2_offset import Q2Offset
from stickslip_fit.causes.recoil_axis import RecoilAxis
from stickslip_fit.causes.recoil_shape import RecoilShape
from stickslip_fit.causes.reversal_loss import ReversalLoss
from stickslip_fit.causes.saved import describe, restore
from stickslip_fit.causes.session_jump import SessionJump
from stickslip_fit.causes.side_load import SideLoad
from stickslip_fit.causes.step_rate import StepRate
from stickslip_fit.causes.supply_voltage import SupplyVoltage
from stickslip_fit.causes.temperature import Temperature
from stickslip_fit.causes.thermal_warm_up import ThermalWarmUp
from stickslip_fit.causes.theta_offset import ThetaOffset
from stickslip_fit.causes.wear import Wear
from stickslip_fit.causes.worn_spot import WornSpot

__all__ = [
    "BearingRunout",
    "CableTorque",
    "Cause",
    "CauseParameter",
    "CountCause",
    "Covariate",
    "Drift",
    "EndStopLatency",
    "EndStopMisfire",
    "ExtendedLaw",
    "FactorCause",
    "GuideGradient",
    "Humidity",
    "InertiaQuadratic",
    "LoadHysteresis",
    "LoadNonlinearity",
    "PayloadChange",
    "PsiOffset",
    "Q1Gravity",
    "Q2Offset",
    "RecoilAxis",
    "RecoilShape",
    "ReversalLoss",
    "SessionJump",
    "SideLoad",
    "StateCause",
    "StepRate",
    "SupplyVoltage",
    "Temperature",
    "TermCause",
    "ThermalWarmUp",
    "ThetaOffset",
    "Wear",
    "WornSpot",
    "covariates",
    "describe",
    "extend",
    "library",
    "restore",
]
