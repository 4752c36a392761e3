"""From residuals to causes: one after the other, as long as what is left is no chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.refit import Refit
from stickslip_fit.diagnose.laid_out.study import Study, study_of
from stickslip_fit.diagnose.noise.cleared import Cleared, cleared
from stickslip_fit.diagnose.noise.misfires import misfires
from stickslip_fit.diagnose.searching.misfit import UNKNOWN, Misfit, misfit
from stickslip_fit.diagnose.searching.naming import Naming, name
from stickslip_fit.diagnose.shapes.candidates import candidates, changes
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

MISFIRE = "end-stop-misfire"
# Two looks, one for wild counts and one for all else, share the false-alarm rate. Wild counts are rarely near
# the limit, faint effects often.
# Which configurations are noisy is told by how alike the residuals within each are: so weighed, chance looks
# like structure about twice as often as in logs of flipped signs (`benchmarks/README.md`).
CHOSEN = 2
OF_WILD = 0.25
MOST_CAUSES = 4
ENOUGH = 50  # flipped logs that look worse than what is left: no second alarm, whatever others say
OWN_SHARE, MOST_FORMS = 0.003, 8
# Nats: by how much a cause that may be one of two must be likelier than nothing, and two causes than
# structure without a name; and how many first ones are tried.
FIRST_OF_TWO, PRIOR_OF_TWO, TRIED = 3.0, 3.0, 3


@dataclass(frozen=True, eq=False)
class Found:
    """A cause, or unknown structure, and the look at the residuals that showed it.

    Attributes
    ----------
    cause : str
    version : object or None
        As it acts in this log; None for unknown structure and misfires.
    start : array, shape (q,)
        Its parameters at the likeliest shape.
    naming : Naming
    misfit : Misfit or None
        None for misfires, which have no shape.
    p_value : float
    """

    cause: str
    version: Any
    start: Array
    naming: Naming
    misfit: Misfit | None
    p_value: float


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found.

    Attributes
    ----------
    bench : Bench
        Without misfired rows, the repeatability estimated anew.
    misfired : array of int
        Rows of the bench that was given.
    found : tuple of Found
        In the order found.
    first, last : Misfit
        The looks at the residuals of the baseline, and of all that was found.
    p_value : float
        Of anything at all.
    fit : Refit
        The baseline with all causes found in it.
    study : Study
        What is left under `fit`.
    """

    bench: Bench
    misfired: Indices
    found: tuple[Found, ...]
    first: Misfit
    last: Misfit
    p_value: float
    fit: Refit
    study: Study

    @property
    def versions(self) -> list[Any]:
        """The causes in `fit`, in its order."""
        return [each.version for each in self.found if each.version is not None]


def search(bench: Bench, alpha: float, flips: int, rng: np.random.Generator) -> Search:
    """Search a log for what its baseline leaves unexplained.

    Parameters
    ----------
    bench : Bench
    alpha : float
        False-alarm rate over everything that is searched.
    flips : int
        Logs in which nothing is wrong, by which that is judged.
    rng : Generator
    """
    bench, study, residual = _settled(bench)
    wild = misfires(study, residual, bench.drive, flips, rng)
    level, misfired = others_level(alpha), np.zeros(0, dtype=np.intp)
    found: list[Found] = []
    if wild.p_value < OF_WILD * alpha and len(wild.rows):
        misfired = wild.rows
        bench, study, _ = _settled(bench.without(misfired))
        naming = Naming(MISFIRE, (), {})
        found.append(Found(MISFIRE, None, np.zeros(0), naming, None, min(1.0, wild.p_value / OF_WILD)))
    first = last = look(study, bench, flips, rng)
    p_value = min(1.0, wild.p_value / OF_WILD, first.p_value / (1.0 - OF_WILD))
    fit = bench.fitted()
    named: list[Found] = []
    while last.p_value < level and len(named) < MOST_CAUSES:
        following = _name(last)
        if following.cause == UNKNOWN:
            following = _one_of_two(bench, named, last) or following
        named.append(following)
        if following.cause == UNKNOWN:
            break
        bench, fit, study = extended(bench, named)
        last = look(study, bench, flips, rng, [each.cause for each in named], ENOUGH)
    causes = [each for each in named if each.version is not None]
    if len(causes) > 1:
        again = _reconsidered(bench, causes)
        if [each.cause for each in again] != [each.cause for each in causes]:
            bench, fit, study = extended(bench, again)
        named = [*again, *(each for each in named if each.version is None)]
    return Search(bench, misfired, (*found, *named), first, last, p_value, fit, study)


def others_level(alpha: float) -> float:
    """What is left of a false-alarm rate for all but wild counts."""
    return min((1.0 - OF_WILD) * alpha, 1.0)


def look(
    study: Study,
    bench: Bench,
    flips: int,
    rng: np.random.Generator,
    without: Sequence[str] = (),
    enough: int | None = None,
) -> Misfit:
    """Judge residuals by every cause but some, and by structure that none of them has."""
    causes = [cause for cause in bench.causes if cause.name not in without]
    times = CHOSEN if np.any(bench.uneven != 1) else 1
    shapes = [*candidates(study, causes), *bench.structures(study)]
    return misfit(study, shapes, times * flips, rng, enough, times)


def extended(bench: Bench, named: Sequence[Found]) -> tuple[Bench, Refit, Study]:
    """The bench with causes in its laws: the fit, what is left, and the repeatability by that."""
    versions = [each.version for each in named if each.version is not None]
    start = np.concatenate([np.zeros(0), *(each.start for each in named if each.version is not None)])
    fit = bench.fitted(versions, start)
    study = _study(bench, fit, named)
    bench = bench.repeating(bench.noise_in(study, Cleared(study.residual, np.zeros(len(bench)))))
    return bench, fit, _study(bench, fit, named)


def _one_of_two(bench: Bench, named: Sequence[Found], looked: Misfit) -> Found | None:
    """The first of two causes that together are likelier than structure without a name, if there are two.

    Two causes at once look like neither, and so like nothing known.
    """
    evidence = looked.by_cause
    causes = [cause for cause in evidence if cause != UNKNOWN and evidence[cause] > FIRST_OF_TWO]
    best, likeliest = None, evidence[UNKNOWN] + PRIOR_OF_TWO
    for cause in sorted(causes, key=lambda cause: -evidence[cause])[:TRIED]:
        first = _found(looked, name(looked, cause))
        trial, _, study = extended(bench, [*named, first])
        without = [cause, *(each.cause for each in named)]
        left = look(study, trial, 0, np.random.default_rng(0), without).by_cause
        second = max((each for each in left if each != UNKNOWN), key=lambda each: left[each], default=UNKNOWN)
        together = evidence[cause] + left[second]
        if left[second] > left.get(UNKNOWN, -np.inf) and together > likeliest:
            best, likeliest = first, together
    return best


def _reconsidered(bench: Bench, causes: Sequence[Found]) -> list[Found]:
    """Each cause once more, with all the others in the law: it may be another, or have other rivals."""
    again = list(causes)
    for place in range(len(again)):
        others = [each for k, each in enumerate(again) if k != place]
        trial, _, study = extended(bench, others)
        looked = look(study, trial, 0, np.random.default_rng(0), [each.cause for each in others])
        naming = name(looked)
        if naming.cause != UNKNOWN:
            again[place] = replace(_found(looked, naming), p_value=causes[place].p_value)
    return again


def _settled(bench: Bench) -> tuple[Bench, Study, Array]:
    """The bench with its repeatability estimated anew; its study, and residuals without structure.

    These are in units of the largest noise that their configuration may have.
    """
    study = bench.study()
    looked = look(study, bench, 0, np.random.default_rng(0))
    left = cleared(study.residual, looked.hypotheses, looked.log_evidence)
    noise = bench.noise_in(study, left)
    settled = bench.repeating(noise)
    cautious = noise.uneven.at_most / settled.uneven
    return settled, settled.study(), left.residual * study.scale / settled.scale / cautious


def _name(looked: Misfit) -> Found:
    return _found(looked, name(looked))


def _found(looked: Misfit, naming: Naming) -> Found:
    shape = looked.best_of(naming.cause)
    p_value = min(1.0, looked.p_value / (1.0 - OF_WILD))
    start = np.zeros(0)
    if isinstance(shape, Hypothesis) and shape.version is not None:
        start = np.array(shape.version.absent)
        if shape.values is not None:
            # As large as it looks, and of that sign: from the other side a fit may not find back.
            seen = float(shape.along(looked.residual)[0]) / shape.length
            grown = start[0] + (shape.values[0] - start[0]) * seen
            start = np.concatenate([[grown], shape.values[1:]])
    return Found(naming.cause, shape.version, start, naming, looked, p_value)


def _study(bench: Bench, fit: Refit, named: Sequence[Found]) -> Study:
    plain = study_of(bench.rows, fit.parts, bench.responses, bench.scale, shared=len(fit.values))
    own = [own_forms(plain, each) for each in named if each.version is not None]
    if not own:
        return plain
    absorbed = np.concatenate(own, axis=1)
    return study_of(
        bench.rows, fit.parts, bench.responses, bench.scale, shared=len(fit.values), absorbed=absorbed
    )


def own_forms(study: Study, found: Found) -> Array:
    """What a named cause can do in other forms than the one fitted, in units of the noise, shape (n, m).

    These are its other shapes, and the square and the cube of its own effect: a bend in whatever it follows.
    """
    looked = found.misfit
    assert looked is not None
    shapes = [
        each.directions for each in looked.hypotheses if isinstance(each, Hypothesis) and same(each, found)
    ]
    effect = changes(study, found.version, found.start[None])
    bent = np.concatenate([effect**2, effect**3], axis=1) / study.scale[:, None]
    length = np.linalg.norm(bent, axis=0)
    columns = np.concatenate([*shapes, bent / np.where(length > 0, length, 1.0)], axis=1)
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, singular**2 > OWN_SHARE * np.sum(singular**2)][:, :MOST_FORMS]


def same(hypothesis: Hypothesis, found: Found) -> bool:
    """Whether a hypothesis is a shape of what was found, in the same version."""
    return hypothesis.cause == found.cause and bool(hypothesis.version == found.version)
