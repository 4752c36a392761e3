"""What a named cause does to each row, in the form fitted and in the forms that nature may prefer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.laid_out.study import Study, study_of
from stickslip_fit.diagnose.searching.search import Found, Search, own_forms
from stickslip_fit.diagnose.shapes.candidates import changes

Array = npt.NDArray[np.float64]

APART = 1e-3  # of a parameter's scale
CHANCE = 2.0  # standard deviations of what noise alone puts into so many further forms


@dataclass(frozen=True, eq=False)
class Effect:
    """A cause's effect on a log, in units of the noise, recalibration taken out.

    Attributes
    ----------
    rows : array, shape (n,)
    rms : float
        Over all rows with equal weight, relative, all that an even recalibration would absorb taken out.
    error : float
        Standard deviation of its length.
    dimensions : int
        Numbers that were fitted for it.
    """

    rows: Array
    rms: float
    error: float
    dimensions: int

    @property
    def length(self) -> float:
        """In repeatabilities."""
        return float(np.linalg.norm(self.rows))


def effect_of(searched: Search, study: Study, found: Found, mine: slice) -> Effect:
    """The effect of one of the causes found.

    Parameters
    ----------
    searched : Search
    study : Study
        Of the baseline.
    found : Found
    mine : slice
        Where its parameters stand among those of the fit.
    """
    values, covariance = searched.fit.values[mine], searched.fit.covariance[mine, mine]
    steps = APART * np.array(found.version.scale)
    trials = np.concatenate([values[None], values + np.diag(steps)])
    made = changes(study, found.version, trials)
    scaled = study.project(made / study.scale[:, None])
    form = scaled[:, 0]
    length = max(float(np.linalg.norm(form)), 1e-12)
    slopes = (scaled[:, 1:] - form[:, None]) / steps
    along = slopes.T @ form / length
    error = float(np.sqrt(max(float(along @ covariance @ along), 0.0)))
    dimensions = max(int(np.sum(np.diag(covariance) > 0)), 1)
    beyond = _beyond(searched, found)
    even = study_of(study.rows, study.parts, searched.bench.responses, np.ones(len(study)))
    rms = float(np.sqrt(np.mean(even.project(made[:, 0] + beyond * study.scale) ** 2)))
    return Effect(form + beyond, rms, max(error, 1.0), dimensions)


def _beyond(searched: Search, found: Found) -> Array:
    """What the cause's other forms explain beyond the one fitted, shape (n,); 0 where that is chance."""
    bench, fit = searched.bench, searched.fit
    plain = study_of(bench.rows, fit.parts, bench.responses, bench.scale, shared=len(fit.values))
    left, singular, _ = np.linalg.svd(plain.project(own_forms(plain, found)), full_matrices=False)
    forms = left[:, singular > 0.05]
    along = forms.T @ plain.residual
    excess = float(along @ along) - len(along)
    if not len(along) or excess < CHANCE * np.sqrt(2.0 * len(along)):
        return np.zeros(len(plain))
    return np.asarray(forms @ along * (excess / (excess + len(along))))
