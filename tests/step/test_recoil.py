"""What a recoiling base costs of the step: closed forms against the integration with stiff bristles."""

from math import pi

import numpy as np
import pytest

from stickslip_fit.step import Foot, LuGre, RecoilBase, make_motion, recoil_share, solve_motion, step_size

MASS, FORCE, RAMP_TIME = 1e-3, 0.1, 1e-4
FRICTION = FORCE / MASS
STIFF = LuGre(FORCE, FORCE, 1e-3, 1e9, 30.0)
FLYBACK = 2e-7


def travel_along_base(amplitude, foot=None, base=None):
    motion = make_motion("ramp", amplitude, RAMP_TIME, FLYBACK, 3e-4)
    solved = solve_motion(motion, MASS, STIFF, foot=foot, base=base, periods=1, relative=1e-6)
    return solved.slider[-1] - solved.base[-1]


@pytest.mark.parametrize("ratio", [0.5, 3.0])
@pytest.mark.parametrize(("slider_share", "foot_share"), [(0.02, 1e-6), (1e-5, 0.01)], ids=["slider", "foot"])
@pytest.mark.parametrize("theta", [0.0, 1.0, 2.0, pi])
def test_the_share_lost_is_that_of_the_solver(ratio, slider_share, foot_share, theta):
    """Terms of second order are left: a tenth of mu, or of phi lambda."""
    amplitude, whole = ratio * FRICTION * RAMP_TIME**2, MASS / slider_share
    foot, base_mass = Foot(foot_share * whole), (1 - foot_share) * whole
    resonance = theta / RAMP_TIME / (2 * pi) * np.sqrt(whole / base_mass)
    moved = travel_along_base(amplitude, foot, RecoilBase(base_mass, resonance, 0.0))
    lost = 1 - moved / travel_along_base(amplitude)
    share = recoil_share(FRICTION, RAMP_TIME, amplitude, MASS, foot.mass, base_mass, resonance)
    assert float(share) == pytest.approx(lost, abs=0.1 * (slider_share + foot_share * max(ratio, 1)))


@pytest.mark.parametrize("ratio", [0.3, 3.0])
def test_a_free_base_as_light_as_the_slider_changes_friction_and_travel_exactly(ratio):
    amplitude, foot, base = ratio * FRICTION * RAMP_TIME**2, Foot(0.3e-3), RecoilBase(0.7e-3)
    mu, phi = 1.0, 0.3
    exact = step_size(FRICTION * (1 + mu), RAMP_TIME, (1 - phi) * amplitude, 0.0, FLYBACK)
    assert travel_along_base(amplitude, foot, base) == pytest.approx(float(exact), rel=0.02)


def test_what_recoil_costs_at_most_is_as_the_docs_say():
    """Why no base of several times the masses of slider and foot costs a quarter of the step."""
    theta, ratio = np.meshgrid(np.linspace(1e-3, 40, 2000), np.linspace(0.01, 1.01, 101))
    resonance, amplitude = theta / (2 * pi * RAMP_TIME), ratio * FRICTION * RAMP_TIME**2
    for mass, foot_mass, limited, reached in ((1e-6, 0.0, 0.47, 0.76), (1e-12, 1e-6, 1.02, 2.01)):
        lost = recoil_share(FRICTION, RAMP_TIME, amplitude, mass, foot_mass, 1.0, resonance) / 1e-6
        assert lost[-1].max() == pytest.approx(limited, abs=0.01)
        assert lost[:-1].max() == pytest.approx(reached, abs=0.01)


def test_outside_the_domain_there_is_no_share():
    values = (FRICTION, RAMP_TIME, 1e-6, MASS, 1e-3, 1e-2, 100.0)
    for place in range(7):
        changed = list(values)
        changed[place] = -1.0
        assert np.isnan(recoil_share(*changed))
    assert np.isfinite(recoil_share(*values))
