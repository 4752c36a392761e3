"""Power spectra of checks: the sound of a few steps each."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

TAPER = 0.1  # share of a check that is faded in and out, so that hum does not leak into far frequencies


def frequencies(number: int, rate: int) -> Array:
    """Of the bins of a check of so many samples, Hz."""
    return np.fft.rfftfreq(number, 1 / rate)


def densities(values: npt.NDArray[np.floating], rate: int) -> Array:
    """Power per Hz of each check.

    Parameters
    ----------
    values : array, shape (..., number)
    rate : int
        Samples per second.

    Returns
    -------
    array, shape (..., number // 2 + 1)

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(0, 1, (200, 480))
    >>> round(float(densities(noise, 48000).mean()) * 24000, 2)
    1.0
    """
    window = tukey(values.shape[-1])
    spectrum = np.fft.rfft(values * window)
    return 2 * (spectrum.real**2 + spectrum.imag**2) / (rate * np.sum(window**2))


def tukey(number: int) -> Array:
    """A window that is 1 but for a cosine at either end, shape (number,)."""
    at = (np.arange(number) + 0.5) / number
    edge = np.minimum(np.minimum(at, 1 - at) * 2 / TAPER, 1.0)
    return np.sin(np.pi / 2 * edge) ** 2


def freedom_of(bins: int, number: int) -> float:
    """Degrees of freedom of the summed power of so many neighbouring bins of Gaussian noise.

    Each bin has two; the window takes a twentieth away, since what it fades out counts less:
    (sum w^2)^2 / (n sum w^4).
    """
    window = tukey(number)
    return float(2 * bins * np.sum(window**2) ** 2 / (number * np.sum(window**4)))
