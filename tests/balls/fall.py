"""Free fall as a law of a table, and what a ball's fall or its film may have besides."""

import numpy as np

import stickslip_fit as ssf

G = 9.80665  # m/s^2
LEAST = 1e-6  # drag below which the closed forms are rounding
MIDDLE = 30.0  # m, of what the camera sees

LAW = ssf.Law(f"height ~ release + velocity*seconds - {G}/2*seconds**2")


def quadratic_drag(seconds, velocity, k):
    """What a deceleration k v |v| adds to free fall; upwards first where the ball was thrown up."""
    absent, k = k < LEAST, np.maximum(k, LEAST)
    terminal, rate = np.sqrt(G / k), np.sqrt(G * k)
    up, down = np.maximum(velocity, 0.0), np.minimum(velocity, 0.0)
    top, phase = np.arctan(up / terminal) / rate, np.arctanh(np.maximum(down / terminal, -0.999999))
    missing = np.log(np.cos(np.clip(rate * (top - seconds), 0.0, 1.5)))  # of the way up
    fallen = np.log(np.cosh(rate * np.maximum(seconds - top, 0.0) - phase)) - np.log(np.cosh(phase))
    height = np.log1p((up / terminal) ** 2) / (2 * k) + (missing - fallen) / k
    return np.where(absent, 0.0, height - (velocity * seconds - G / 2 * seconds**2))


def linear_drag(seconds, velocity, r):
    """What a deceleration r v adds to free fall."""
    absent, r = r < LEAST, np.maximum(r, LEAST)
    height = (velocity + G / r) * -np.expm1(-r * seconds) / r - G / r * seconds
    return np.where(absent, 0.0, height - (velocity * seconds - G / 2 * seconds**2))


def drags(by=""):
    """Quadratic and linear drag, of all balls alike or of each value of a column."""
    return [
        ssf.Cause("quadratic-drag", quadratic_drag, "k in 1/m", by=by, bounds={"k": (1e-4, 0.2)}),
        ssf.Cause("linear-drag", linear_drag, "r in 1/s", by=by, bounds={"r": (1e-3, 2.0)}),
    ]


SLANT = ssf.Cause("slant", f"+ s*(height - {MIDDLE})**2/2", "s in 1/m")
ANOTHER_G = ssf.Cause("another-g", "+ -change/2*seconds**2", "change in m/s^2")
CAMERA_SCALE = ssf.Cause("camera-scale", "* (1 + share)", "share in %")
CLOCK_OFFSET = ssf.Cause("clock-offset", "seconds = seconds + offset", "offset in s")
