"""Derivatives from differences."""

import numpy as np


def numeric_slopes(predict, values, step=1e-6):
    """Of what `predict` gives, by each of the values, shape (n, p); of steps of one size, or one for each."""
    steps = np.diag(np.broadcast_to(step, len(values)))
    ahead, behind = ([predict(values + sign * each) for each in steps] for sign in (1, -1))
    return (np.transpose(ahead) - np.transpose(behind)) / (2 * np.diag(steps))
