"""A law with a cause as a smooth function of its column, where that is far likelier than by its equation.

A cause is named by a test in which it may bend as the data ask, whatever its equation; with that alone a law
would say next to nothing of a resonance or a threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stickslip_fit.causes.function_of_cause import FunctionOfCause
from stickslip_fit.diagnosis.extension import Extension, SelectedCause, estimate_strength, try_extension
from stickslip_fit.diagnosis.hypotheses import Hypothesis
from stickslip_fit.diagnosis.refits import advantage

MIN_MORE = 10.0  # nats: beyond the few by which the best of several correlation lengths is ahead by chance


def follow_function(
    chosen: Sequence[SelectedCause], extension: Extension
) -> tuple[list[SelectedCause], Extension]:
    """The selected causes and the law with them; the last one as a function where that is far likelier.

    The test tells whether that may be, two fits whether it is: of a large effect the test, which is linear,
    takes the curve of an equation's logarithm for one of its own.
    """
    *others, last = chosen
    shapes = [
        (evidence, one)
        for one, evidence in zip(last.test.hypotheses, last.test.log_evidence, strict=True)
        if isinstance(one, Hypothesis) and one.cause == last.cause
    ]
    bent = [one for one in shapes if isinstance(one[1].version, FunctionOfCause)]
    if not bent:
        return list(chosen), extension
    evidence, shape = max(bent, key=lambda one: one[0])
    by_equation = (one for one, own in shapes if not isinstance(own.version, FunctionOfCause))
    if evidence < max(by_equation, default=-np.inf) + MIN_MORE:
        return list(chosen), extension
    version = shape.version.with_amplitude(estimate_strength(shape, last.test.residual) / shape.length)
    function = [*others, replace(last, version=version, start=np.array(version.start_values))]
    other = try_extension(extension.problem, function)
    if other is None or advantage(other, extension) < MIN_MORE:
        return list(chosen), extension
    return function, other
