"""What a person should know about a posterior."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.fit.bayes.sample import TRUSTED, Sample
from stickslip_fit.fit.identifiability import configuration_rows, describe, known_parameters
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.result import EVERYWHERE
from stickslip_fit.machine import Machine

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

AS_BEFORE = 0.8  # standard deviations of the prior; a posterior as wide has learnt nothing


def remarks(sample: Sample, machine: Machine, direction: str, values: Array) -> tuple[list[Remark], Mask]:
    """Remarks on one joint and direction, and which parameters its log knows, shape (p,).

    Parameters
    ----------
    sample : Sample
    machine : Machine
    direction : str
    values : array, shape (S, p)
        The posterior means.
    """
    slopes = sample.traverses.law.jacobian(sample.traverses.rows, values[sample.traverses.groups.of_row])
    known, *_ = known_parameters((slopes.T @ slopes)[None], sample.prior.width[None])
    found = _not_converged(sample, direction)
    if not known.all():
        found.append(_not_identified(sample, machine, direction, slopes, known[0]))
    freedom = len(slopes) - _campaign_rank(sample, slopes)
    if freedom < 1:
        found.append(_few_replicates(sample, direction))
    return found, known[0]


def known_sizes(sample: Sample) -> Mask:
    """Which parameters of causes the log knows better than the prior, shape (q,); held ones are given."""
    if sample.causes is None:
        return np.zeros(0, dtype=bool)
    eta = sample.causes.at(sample.draws.mean[:, len(sample.prior.names) :])
    return eta.std(axis=0) < AS_BEFORE


def remarks_on_sizes(sample: Sample) -> list[Remark]:
    """What is to be said of the causes' parameters, once for all joints."""
    if sample.causes is None or not sample.converged:
        return []
    law, found = sample.traverses.law, []
    assert isinstance(law, ExtendedLaw)
    whose = [cause for cause in law.causes for _ in cause.parameters]
    for cause, (name, told), free, known in zip(
        whose, sample.causes.lines(), sample.causes.free, known_sizes(sample), strict=True
    ):
        if not free:
            text = f"{name} is {told}, where least squares chose it; it has no error bar"
            found.append(Remark("chosen", EVERYWHERE, "", "", (name,), text))
        elif not known:
            text = f"{name} would be what the prior says, {told}; what would show it: {cause.shows_best}"
            found.append(Remark("not_identified", EVERYWHERE, "", "", (name,), text))
    return found


def _not_converged(sample: Sample, direction: str) -> list[Remark]:
    if sample.converged:
        return []
    worst = sample.quality
    k_hat, agreement, size = worst["k_hat"].max(), worst["r_hat"].max(), worst["ess_bulk"].min()
    if sample.trusted:
        what = (
            f"the ensembles are not worth enough independent draws after {sample.steps} steps each (R-hat "
            f"{agreement:.3f}, {size:.0f} effective draws of {sample.target_ess}); allow more steps, and "
            "where that does not help use tighter priors or log more traverses"
        )
    else:
        what = (
            f"the importance weights cannot be trusted (k-hat {k_hat:.2f}, above {TRUSTED}): the law bends "
            "too much over what the counts leave open; use tighter priors or log more traverses"
        )
    return [_remark("not_converged", sample, direction, f"{what}. No numbers are given")]


def _not_identified(sample: Sample, machine: Machine, direction: str, slopes: Array, known: Mask) -> Remark:
    """Names the calibration traverses that would show what no traverse of the log does."""
    law, prior = sample.traverses.law, sample.prior
    _, singular, right = np.linalg.svd(slopes * prior.width, full_matrices=True)
    singular = np.append(singular, np.zeros(len(right) - len(singular)))
    unseen = right[singular < 1e-4 * singular[0]]
    rows = configuration_rows(law.calibration(), law.joint, direction, machine)
    shown = np.abs(law.jacobian(rows, prior.centre) * prior.width @ unseen.T).max(axis=1) > 0.01
    wanted = [candidate for candidate, shows in zip(law.calibration(), shown, strict=True) if shows]
    told = " or ".join(describe(configuration) for configuration in wanted)
    unknown = tuple(name for name, fine in zip(prior.names, known, strict=True) if not fine)
    what = f"{', '.join(unknown)} would be what the prior says, for no session has a traverse that tells"
    return _remark("not_identified", sample, direction, f"{what}; missing: {told}", parameters=unknown)


def _few_replicates(sample: Sample, direction: str) -> Remark:
    what = (
        "no traverse is left over to show how well one repeats, so the repeatability, and with it every "
        "interval, leans on the prior; make each calibration traverse twice"
    )
    return _remark("few_replicates", sample, direction, what)


def _campaign_rank(sample: Sample, slopes: Array) -> int:
    """How many numbers the sessions, each by itself, take from the counts."""
    padded = sample.traverses.padded(slopes * sample.prior.width, 0.0)
    return int(np.linalg.matrix_rank(padded, tol=1e-4).sum())


def _remark(
    flag: str, sample: Sample, direction: str, what: str, parameters: tuple[str, ...] | None = None
) -> Remark:
    joint = sample.traverses.law.joint
    message = f"joint {joint}, direction {direction}: {what}"
    return Remark(flag, joint, direction, "", parameters or sample.prior.names, message)
