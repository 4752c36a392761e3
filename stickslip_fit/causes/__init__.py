r"""Why the step size is not what the law says: one file a cause.

A cause acts at one station on the way from a state to a count, and so is one of four kinds: `StateCause`
(an angle, the load, the recoil), `TermCause` (added to the step size), `FactorCause` (times the step size) or
`CountCause` (steps added). It holds no values: they are handed to it. One of your own takes a dozen lines, in
a notebook or a file:

>>> from dataclasses import dataclass
>>> import numpy as np
>>> @dataclass(frozen=True)
... class Hum(FactorCause):
...     name = "hum"
...     phrase = "the transformer next door is on every other minute"
...     physics = "Its field adds to the drive's own, so that steps come out longer or shorter."
...     shows_best = "one configuration twice, a minute apart"
...     columns = ("session_seconds",)
...     parameters = (CauseParameter("k", "%", "change of the step size while it is on"),)
...     absent, scale = (0.0,), (0.01,)
...
...     def factor(self, state, values):
...         return 1.0 + values[0] * (state.column("session_seconds") // 60 % 2)

Added to a law it makes a law, and with the library it is looked for like any other, by
``diagnose(log, causes=library() + (Hum(),))``, or fitted by ``least_squares(log, causes=(Hum(),))``:

>>> from stickslip_fit.laws import Prismatic
>>> law = extend(Prismatic(), Hum())
>>> [parameter.name for parameter in law.parameters]
['a', 'b', 'c', 'hum.k']
>>> level = {"q2": [-np.pi / 2] * 2, "theta": [0.0] * 2, "psi": [0.0] * 2, "start": [0.0] * 2}
>>> level |= {"stop": [0.012] * 2, "session_seconds": [30.0, 90.0]}
>>> law.counts(level, np.array([976e-9, 0.3, 438e-9, 0.02]))[0].round()
array([12295., 12054.])

`columns` names what the equation needs of a row beside positions and angles; `scale` is a size that matters,
and sets what is tried; one whose effect has a kink, a place or a moment in it overrides `Cause.trials`. What
refers to the log as a whole (a mean, a range) becomes a field of the dataclass, filled in by `Cause.bound`;
fields are saved with the law, so they are numbers, text or tuples of them. A factor may depend on the
position of the joint, ``state.position``; where it has features narrower than about a tenth of a traverse,
`Cause.widest` says how narrow.

A package that is installed brings its causes along by an entry point, which names the cause or its class::

    [project.entry-points."stickslip_fit.causes"]
    hum = "our_lab.hum:Hum"
"""

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
