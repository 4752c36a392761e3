"""What the verb `fit` does between reading a log and printing: estimate, tell, save."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from stickslip_fit.cli.arguments import bound_of, command, repeatabilities_of
from stickslip_fit.cli.options import Method
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import check_folder

if TYPE_CHECKING:
    from collections.abc import Iterable

    from stickslip_fit.causes import Cause
    from stickslip_fit.fit import Result
    from stickslip_fit.fit.bayes import Posterior
    from stickslip_fit.logs import Log


@dataclass(frozen=True)
class Estimator:
    """How to fit, as the options say it.

    Attributes
    ----------
    method : Method
    heavy_tails, profile : bool
        Of least squares, as are the next three.
    campaign_wide : tuple of str
        Parameters that all sessions share.
    bounds : tuple of str
        As typed: NAME=LOW:HIGH.
    repeatability : tuple of str
        As typed: PERCENT or JOINT±=PERCENT.
    seed : int
    walks : Path or None
        Of Bayes.
    causes : tuple of str
        Names of causes to fit with the laws; not by the closed form.
    causes_from : Path or None
        Of the closed form: a saved result whose causes are known.
    """

    method: Method
    heavy_tails: bool = False
    profile: bool = False
    campaign_wide: tuple[str, ...] = ()
    bounds: tuple[str, ...] = ()
    repeatability: tuple[str, ...] = ()
    seed: int = 0
    walks: Path | None = None
    causes: tuple[str, ...] = ()
    causes_from: Path | None = None


@dataclass(frozen=True)
class Outputs:
    """Files to write beside what is printed: the result, its control chart, the posterior's tree."""

    json: Path | None = None
    chart: Path | None = None
    tree: Path | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """A result, what is printed of it, and by Bayes the posterior behind it."""

    result: Result
    text: str
    posterior: Posterior | None = None


def refuse(how: Estimator, outputs: Outputs) -> None:
    """Refuse options that do not go together and files that could not be written, before any work.

    Raises
    ------
    InputError
    """
    least_squares = how.method is Method.least_squares
    if (not least_squares and (how.heavy_tails or how.profile)) or (how.heavy_tails and how.profile):
        raise InputError("--profile and --heavy-tails are two ways of --method least-squares; choose one")
    for option, texts in (
        ("--campaign-wide", how.campaign_wide),
        ("--bound", how.bounds),
        ("--repeatability", how.repeatability),
    ):
        if texts and not least_squares:
            raise InputError(f"{option} belongs to --method least-squares")
    for option, given in (("--walks", how.walks), ("--tree", outputs.tree)):
        if how.method is not Method.bayes and given is not None:
            raise InputError(f"{option} belongs to --method bayes")
    if how.causes and how.method is Method.closed_form:
        raise InputError("the closed form fits no cause; take those of a saved result by --causes-from")
    if how.causes_from is not None and how.method is not Method.closed_form:
        raise InputError("--causes-from belongs to the closed form; fit causes by --cause")
    for path in (outputs.json, outputs.chart, outputs.tree):
        if path is not None:
            check_folder(path)
    if outputs.chart is not None:
        from stickslip_fit.report.chart import check_suffix

        check_suffix(outputs.chart)
    if outputs.tree is not None and outputs.tree.suffix != ".nc":
        raise InputError(Problem("is netCDF: end its name in .nc", column="--tree", value=str(outputs.tree)))


def estimate(log: Log, how: Estimator) -> Estimate:
    """Fit a log and put the result into words."""
    from stickslip_fit.fit import closed_form, least_squares, load_result
    from stickslip_fit.fit.likelihood import Gaussian, StudentT

    if how.method is Method.bayes:
        return _bayes(log, how)
    if how.method is Method.closed_form:
        known = load_result(how.causes_from) if how.causes_from else None
        result = closed_form(log, causes_from=known, command=command())
    else:
        likelihood = StudentT() if how.heavy_tails else Gaussian()
        result = least_squares(
            log,
            causes=causes_of(how.causes, log),
            likelihood=likelihood,
            shared=how.campaign_wide,
            bounds=dict(bound_of(text, "--bound") for text in how.bounds),
            repeatability=repeatabilities_of(how.repeatability, "--repeatability"),
            command=command(),
        )
    summary = result.summary()
    if how.profile:
        from stickslip_fit.fit.profile import profile_intervals
        from stickslip_fit.fit.summary import profile_section

        profile = profile_section(profile_intervals(log, result))
        summary = replace(summary, sections=(*summary.sections, profile))
    return Estimate(result, str(summary))


def causes_of(names: Iterable[str], log: Log) -> tuple[Cause, ...]:
    """The causes of the library, and the log's own columns, that are named.

    Raises
    ------
    InputError
        For a name that is none, and for a cause that the log cannot show; with those that it can.
    """
    from stickslip_fit.causes import covariates, library

    rows = log.usable
    known = {cause.name: cause for cause in (*library(), *covariates(rows))}
    missing = {name: why for name, cause in known.items() if (why := cause.missing(rows)) is not None}
    missing["end-stop-misfire"] = "it changes no expected count; misfires are met by --heavy-tails"
    names = list(dict.fromkeys(names))
    faults = [
        Problem(missing.get(name, "is no cause that is known"), column="--cause", value=name)
        for name in names
        if name not in known or name in missing
    ]
    if faults:
        there = ", ".join(name for name in known if name not in missing)
        raise InputError([*faults, Problem(f"this log can show {there}")])
    return tuple(known[name] for name in names)


def save(found: Estimate, outputs: Outputs) -> list[str]:
    """Write the files that were asked for; a line for each."""
    lines = []
    if outputs.json is not None:
        from stickslip_fit.fit import save_result

        save_result(found.result, outputs.json)
        lines.append(f"saved to {outputs.json}")
    if outputs.tree is not None and found.posterior is not None:
        from stickslip_fit.fit.bayes import save_posterior

        save_posterior(found.posterior, outputs.tree)
        lines.append(f"draws saved to {outputs.tree}, their result to {outputs.tree.with_suffix('.json')}")
    if outputs.chart is not None:
        from stickslip_fit.report.chart import write_chart

        write_chart(found.result, outputs.chart)
        lines.append(f"control chart written to {outputs.chart}")
    return lines


def _bayes(log: Log, how: Estimator) -> Estimate:
    import sys

    from stickslip_fit.fit.bayes import bayes
    from stickslip_fit.fit.bayes.checks_text import checks_section

    watched = sys.stderr.isatty()
    causes = causes_of(how.causes, log)
    posterior = bayes(
        log, causes=causes, seed=how.seed, backend=how.walks, progress=watched, command=command()
    )
    summary = posterior.summary()
    summary = replace(summary, sections=(*summary.sections, checks_section(posterior)))
    return Estimate(posterior.result, str(summary), posterior)
