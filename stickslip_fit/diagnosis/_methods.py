"""The methods of a diagnosis as paragraphs that can be cited, filled with its log's numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stickslip_fit._format import (
    format_p_value,
    format_percent,
    format_share,
    join_words,
    joint_name,
    pluralize,
    typeset_text,
)
from stickslip_fit.diagnosis._unknown_summary import describe_scatter
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.estimation.result import library_versions
from stickslip_fit.laws import is_published
from stickslip_fit.laws.published import name_of_laws
from stickslip_fit.logs import Log

if TYPE_CHECKING:
    from stickslip_fit.diagnosis import Diagnosis

REFERENCES = {
    "Damani 2013": "A. Damani, An Empirical Model of Piezoelectric Stick-Slip Actuation of the Kleindiek "
    "MM3A Micromanipulator, M.S. thesis, University of Utah, 2013.",
    "Davies 1987": "R. B. Davies, Hypothesis testing when a nuisance parameter is present only under the "
    "alternative, Biometrika 74:33, 1987.",
    "Horowitz 2019": "J. L. Horowitz, Bootstrap methods in econometrics, Annu. Rev. Econ. 11:193, 2019.",
    "Huber 1964": "P. J. Huber, Robust estimation of a location parameter, Ann. Math. Stat. 35:73, 1964.",
    "Lange et al. 1989": "K. L. Lange, R. J. A. Little, J. M. G. Taylor, Robust statistical modeling using "
    "the t distribution, J. Am. Stat. Assoc. 84:881, 1989.",
    "MacKinnon and White 1985": "J. G. MacKinnon, H. White, Some heteroskedasticity-consistent covariance "
    "matrix estimators with improved finite sample properties, J. Econometrics 29:305, 1985.",
    "Marquardt 1963": "D. W. Marquardt, An algorithm for least-squares estimation of nonlinear parameters, "
    "SIAM J. Appl. Math. 11:431, 1963.",
    "Rubin 1984": "D. B. Rubin, Bayesianly justifiable and relevant frequency calculations for the applied "
    "statistician, Ann. Stat. 12:1151, 1984.",
    "Zellner 1986": "A. Zellner, On assessing prior distributions and Bayesian regression analysis with "
    "g-prior distributions, in: Bayesian Inference and Decision Techniques, North-Holland, 1986.",
}


def describe_methods(diagnosis: Diagnosis) -> list[str]:
    """Paragraphs: data and law, the search, and what it found and gained."""
    log = diagnosis.require_log()
    paragraphs = [_describe_fit(diagnosis, log), _describe_search(diagnosis), _describe_result(diagnosis)]
    return [typeset_text(each) for each in paragraphs]


def list_references(diagnosis: Diagnosis) -> list[str]:
    """The works that `describe_methods` names."""
    text = " ".join(describe_methods(diagnosis))
    return [work for name, work in REFERENCES.items() if name in text]


def _describe_fit(diagnosis: Diagnosis, log: Log) -> str:
    problem = diagnosis.selection.problem
    joints = join_words([joint_name(part.law.joint, log.machine) for part in problem.parts])
    published = " (Damani 2013)" if any(is_published(part.law) for part in problem.parts) else ""
    sessions = pluralize(problem.rows["session"].nunique(), "session")
    law = name_of_laws(part.law for part in problem.parts)
    return (
        f"The step counts of {pluralize(len(problem), 'traverse')} in {sessions} of {joints} were fitted by "
        f"the {law}{published}: weighted nonlinear least squares on the logarithm of the count, with "
        "parameters of its own for each session and direction (Levenberg-Marquardt, Marquardt "
        "1963). The weights hold the repeatability and the rounding of the count by the interval between "
        f"checks of the end stop. The law leaves {format_percent(diagnosis.misfit)} rms; "
        f"{describe_scatter(diagnosis)}."
    )


def _describe_search(diagnosis: Diagnosis) -> str:
    outlying = [one.traverses for one in diagnosis.findings if one.traverses is not None]
    excluded = f"; {pluralize(len(outlying[0]), 'count')} excluded" if outlying else ""
    n_causes = sum(value is not None for value in diagnosis.inclusion.values())
    return (
        "Outlying counts were looked for under Student's t noise (Lange et al. 1989)"
        f"{excluded}. The residuals, projected off the calibration parameters, were compared with "
        f"{pluralize(n_causes, 'cause')} and with unstructured alternatives by Bayes factors under a g-prior "
        "(Zellner 1986), averaged over shape parameters that do not exist under the null hypothesis (Davies "
        "1987). The p-value is that of the whole search: a wild bootstrap flips the signs of "
        "leverage-adjusted, winsorized residuals (Huber 1964; MacKinnon and White 1985; Horowitz 2019) and "
        f"repeats the search in each sample, at a false-alarm rate of {format_percent(diagnosis.alpha)} "
        f"(seed {diagnosis.seed}): "
        f"p {format_p_value(diagnosis.p_value, relation=True)}."
    )


def _describe_result(diagnosis: Diagnosis) -> str:
    named = [one for one in diagnosis.findings if one.version is not None]
    names = join_words(list(map(_describe_finding, named)))
    gain = diagnosis.gain
    sentences = [f"The law was extended by {names}." if named else "No cause extended the law."]
    if gain is not None:
        error = f"its error was {format_percent(gain.baseline)} rms"
        if named:
            error = (
                f"the error was {format_percent(gain.baseline)} rms without and "
                f"{format_percent(gain.extended)} with the extension (gain, with its 95 % interval for a "
                f"replicate of the campaign, {format_share(gain.cut)}, by approximate Bayesian computation, "
                "Rubin 1984)"
            )
        sentences.append(
            "In tenfold cross-validation over configurations, with the search repeated in each fold, "
            f"{error}; repeatability and rounding alone make {format_percent(gain.noise_floor)}."
        )
    if any(one.cause == UNKNOWN for one in diagnosis.findings):
        sentences.append("Structure that no known cause describes was found, and is reported as unknown.")
    versions = ", ".join(f"{name} {version}" for name, version in library_versions().items())
    return " ".join([*sentences, f"Computed with {versions}."])


def _describe_finding(finding: Finding) -> str:
    name = finding.cause
    if name == UNKNOWN:
        name = f"the proposed term {finding.term}" if finding.term else "a smooth function, cause unknown"
    return f"{name} ({format_percent(finding.effect.estimate)} rms)"
