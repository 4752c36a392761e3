"""The true calibration, whose errors are rounding to whole steps and repeatability only."""

from functools import partial

import numpy as np


def step_models_from_truth(truth):
    """From rows to true steps, by joint and direction."""
    return {group: partial(true_steps, truth, group) for group in truth.values}


def true_steps(truth, group, rows):
    number = rows["number"].to_numpy()
    values = truth.session_values(group)[number]
    added, steps = truth.added(group, rows, values), np.exp(truth.laws[group[0]].predict(rows, values))
    return added + (steps - added) / truth.factors(group)[number]
