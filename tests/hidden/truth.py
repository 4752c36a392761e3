"""What a log's actuators are really like: the laws' parameters, drawn for each session and direction."""

import numpy as np
import numpy.typing as npt

from tests.hidden.physics import MM, PARAMETERS, Array

DAY_TO_DAY = 0.025
# By direction, in nm, µrad and µrad per mm.
_PRISMATIC = {1: (976.0, 0.30, 430.0), -1: (903.0, 0.30, -430.0)}
_LOADED = {1: (-16.0, -20.0), -1: (20.0, 26.0)}
_BASE_LOADED = {1: (-1.0, -0.35), -1: (1.2, 0.45)}


def draw_truth(
    joint: int, session: npt.NDArray[np.int64], forward: npt.NDArray[np.int64], rng: np.random.Generator
) -> dict[str, Array]:
    """The parameters of one joint's law at each traverse, SI, shape (n,) each."""
    usual = {way: _usual(joint, way, rng) for way in (1, -1)}
    days = 1 + DAY_TO_DAY * rng.standard_normal((2, int(session.max()) + 1, len(PARAMETERS[joint])))
    values = np.where((forward > 0)[:, None], usual[1] * days[0, session], usual[-1] * days[1, session])
    return dict(zip(PARAMETERS[joint], values.T.copy(), strict=True))


def _usual(joint: int, way: int, rng: np.random.Generator) -> Array:
    if joint == 3:
        a, b, c = np.array(_PRISMATIC[way]) * (1 + 0.03 * rng.standard_normal(3))
        return np.array([a * 1e-9, b, c * 1e-9])
    gamma0 = rng.uniform(80.0, 110.0)
    if joint == 2:
        near, far = (d * rng.uniform(0.7, 1.0) for d in _LOADED[way])
        return 1e-6 * np.array([gamma0, gamma0 * rng.uniform(0.92, 1.0), near, far])
    d, d_per_mm = (d * rng.uniform(0.7, 1.0) for d in _BASE_LOADED[way])
    return 1e-6 * np.array([gamma0, rng.uniform(-0.1, -0.03) / MM, d, d_per_mm / MM])
