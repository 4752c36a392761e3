"""What known causes would explain of unknown structure, and what each of them alone would gain."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.extension import estimate_strength, fit_causes, law_causes
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.gain import hold_out_configurations
from stickslip_fit.diagnosis.gain_interval import prepare_calibration
from stickslip_fit.diagnosis.hypotheses import Hypothesis
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.selection import Selection


def explain_structure(selection: Selection, finding: Finding) -> pd.DataFrame:
    """Each known cause alone in place of the unknown structure of a log, largest share first.

    Effects are linear in their sizes, which are estimated from the other folds; folds hold out whole
    configurations.

    Parameters
    ----------
    selection : Selection
        With unknown structure.
    finding : Finding
        Of the unknown structure.

    Returns
    -------
    DataFrame
        cause; share of the structure's square that it explains; error, the rms error on held-out traverses
        (relative) with it in the law; gain, how much less that is than without.
    """
    unknown = selection.behind(finding)
    misfit, problem = unknown.test, selection.problem
    named = [one for one in law_causes(selection.selected) if one.cause != UNKNOWN]
    linearized = problem.linearize_extended(fit_causes(problem, named)) if named else problem.linearize()
    shapes = {cause: misfit.best_subspace(cause) for cause in finding.explains}
    columns = np.concatenate(
        [linearized.residual[:, None], *(one.directions for one in shapes.values())], axis=1
    )
    errors: list[Array] = []
    for split in hold_out_configurations(selection):
        train = prepare_calibration(linearized.basis, split.train, split.train).subtract(columns)
        held_out = prepare_calibration(linearized.basis, split.calibration, split.held_out).subtract(columns)
        scale = problem.scale[split.held_out]
        errors.append(scale * _held_out_errors(train, held_out, shapes, misfit.residual))
    rms = (
        np.sqrt(np.mean(np.concatenate(errors, axis=1) ** 2, axis=1))
        if errors
        else np.full(1 + len(shapes), np.nan)
    )
    table = pd.DataFrame(
        {
            "cause": list(shapes),
            "share": [finding.explains[cause] for cause in shapes],
            "error": rms[1:],
            "gain": rms[0] - rms[1:],
        }
    )
    return table.sort_values("share", ascending=False, kind="stable", ignore_index=True)


def _held_out_errors(train: Array, held_out: Array, shapes: dict[str, Hypothesis], residual: Array) -> Array:
    """Errors without a cause and with each, shape (1 + causes, h)."""
    errors, last = [held_out[:, 0]], 1
    for shape in shapes.values():
        place = slice(last, last := last + len(shape.prior_share))
        precision = np.diag(1.0 / (estimate_strength(shape, residual) ** 2 * shape.prior_share))
        size = np.linalg.solve(
            train[:, place].T @ train[:, place] + precision, train[:, place].T @ train[:, 0]
        )
        errors.append(held_out[:, 0] - held_out[:, place] @ size)
    return np.stack(errors)
