"""Every effect that can be hidden, in the forms that nature may give it: the table's first, then others."""

from tests.hidden.effect import Maker
from tests.hidden.effects import (
    angles,
    clockwork,
    loads,
    outside,
    outside_fifth,
    outside_fourth,
    outside_history,
    outside_second,
    outside_state,
    outside_third,
    parts,
    readings,
    stops,
)

# States first, angles before loads: effects act on a state in this order.
CAUSES: dict[str, dict[str, Maker]] = {
    "theta-offset": {"table": angles.theta_offset, "sagging": angles.theta_offset_sagging},
    "psi-offset": {"table": angles.psi_offset, "sagging": angles.psi_offset_sagging},
    "q2-offset": {"table": angles.q2_offset, "eccentric": angles.q2_offset_eccentric},
    "q1-gravity": {"table": angles.q1_gravity, "scaled": angles.q1_gravity_scaled},
    "recoil-axis": {"table": angles.recoil_axis, "spread": angles.recoil_axis_spread},
    "recoil-shape": {"table": angles.recoil_shape, "ellipse": angles.recoil_shape_ellipse},
    "payload-change": {
        "table": loads.payload,
        "rubbing": loads.payload_rubbing,
        "recorded": loads.payload_recorded,
        "recorded, bending": loads.payload_recorded_bending,
    },
    "load-nonlinearity": {
        "table": loads.nonlinearity,
        "cubic": loads.nonlinearity_odd,
        "tanh": loads.nonlinearity_tanh,
        "exponential": loads.nonlinearity_exponential,
    },
    "inertia-quadratic": {"table": parts.inertia, "skewed": parts.inertia_skewed},
    "cable-torque": {"table": parts.cable, "stiffening": parts.cable_stiffening},
    "thermal-warm-up": {"table": clockwork.warm_up, "two bodies": clockwork.warm_up_of_two_bodies},
    "drift": {"table": clockwork.drift, "curved": clockwork.drift_curved, "by use": clockwork.drift_by_use},
    "session-jump": {"table": clockwork.jump, "smeared": clockwork.jump_smeared},
    "wear": {"table": clockwork.wear, "power": clockwork.wear_power},
    "temperature": {"table": readings.temperature, "curved": readings.temperature_curved},
    "humidity": {"table": readings.humidity, "saturating": readings.humidity_saturating},
    "supply-voltage": {"table": readings.supply, "curved": readings.supply_curved},
    "step-rate": {"table": readings.step_rate, "power": readings.step_rate_power},
    "side-load": {"table": loads.side_load, "blunt": loads.side_load_blunt},
    "load-hysteresis": {"table": loads.hysteresis, "fading": loads.hysteresis_fading},
    "bearing-runout": {"table": parts.runout, "two-lobed": parts.runout_two_lobed},
    "guide-gradient": {"table": parts.guide, "curved": parts.guide_curved},
    "worn-spot": {"table": parts.spot, "lorentzian": parts.spot_lorentzian},
    "covariate": {
        "straight": readings.covariate_straight,
        "threshold": readings.covariate_threshold,
        "hump": readings.covariate_hump,
    },
    "end-stop-latency": {"table": stops.latency, "two stops": stops.latency_of_two_stops},
    "reversal-loss": {"table": stops.reversal, "a length": stops.reversal_as_a_length},
    "end-stop-misfire": {"table": stops.misfire, "missed only": stops.misfire_missed_only},
}

OUTSIDE: dict[str, dict[str, Maker]] = {
    "unknown:periodic": {"in time": outside.periodic_in_time, "in traverses": outside.periodic_in_traverses},
    "unknown:harmonic": {"cos 3 q2": outside.harmonic_third, "sin 2 q2": outside.harmonic_second},
    "unknown:curvature": {"parabola": outside.curvature_parabola, "bump": outside.curvature_bump},
    "unknown:memory": {"all joints": outside.memory, "each joint": outside.memory_of_each_joint},
}

# Thirty more from outside the library of causes, for benchmarks/unknown.py.
OUTSIDE_LIBRARY: dict[str, dict[str, Maker]] = {
    "unknown:angle": outside_state.ANGLE,
    "unknown:product": outside_state.PRODUCT,
    "unknown:direction": outside_state.DIRECTION,
    "unknown:history": outside_history.HISTORY,
    "unknown:session": outside_history.SESSION,
}

# Sets by number; those after the first were written by people who had not seen the diagnosis.
OUTSIDE_SETS: dict[int, dict[str, dict[str, Maker]]] = {
    1: OUTSIDE_LIBRARY,
    2: outside_second.SECOND,
    3: outside_third.THIRD,
    4: outside_fourth.FOURTH,
    5: outside_fifth.FIFTH,
}

EFFECTS = {
    **CAUSES,
    **OUTSIDE,
    **OUTSIDE_LIBRARY,
    **outside_second.SECOND,
    **outside_third.THIRD,
    **outside_fourth.FOURTH,
    **outside_fifth.FIFTH,
}
