"""What a diagnosis makes of effects that the library of causes does not have: 30, or another `--set`.

Each is hidden at two strengths. Recognised: the first finding is `unknown`. Saving: by how much the extended
law lowers the rms error on a fresh replicate (same campaign, new noise) against the published laws, beside
what the effect's true form saves there, with its size fitted to the same log.
"""

import json
from argparse import ArgumentParser
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.estimation import fit_least_squares
from tests.hidden.outside import OutsideCase, cases, rms, true_form
from tests.hidden.reading import read_hidden

STRENGTHS = (12.0, 25.0)
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Answer:
    """What the diagnosis made of a case; errors on the fresh replicate, rms, %.

    `inside`: whether the interval of recognised structure holds its size; None where it is not recognised.
    """

    case: OutsideCase
    found: tuple[str, ...]
    term: str
    carrier: str
    closest: str
    share: float
    inside: bool | None
    baseline: float
    extended: float
    true: float

    @property
    def recognised(self) -> bool:
        """Whether the structure is called unknown, and not by the name of a cause."""
        return self.found[:1] == (UNKNOWN,)


def diagnose_case(case: OutsideCase) -> Answer:
    """Diagnose the log of a case, and predict a replicate by the law that follows."""
    hidden, fresh = case.make(), case.make(replicate=1)
    log, again = read_hidden(hidden), read_hidden(fresh)
    diagnosis = diagnose(log, seed=case.seed, gain=False)
    first = diagnosis.findings[0] if diagnosis.findings else None

    def error(law) -> float:
        return 100 * rms(fresh, np.log(law.predict(again.rows)["steps"].to_numpy()))

    published = error(fit_least_squares(log))
    has_law = any(finding.version is not None for finding in diagnosis.findings)
    size = hidden.truth["effects"][0]["effect_rms_pct"]
    return Answer(
        case,
        tuple(finding.cause for finding in diagnosis.findings),
        first.term if first else "",
        first.carrier if first else "",
        first.closest if first else "",
        first.share if first else 0.0,
        bool(first.effect.low <= size / 100 <= first.effect.high)
        if first and first.cause == UNKNOWN
        else None,
        published,
        error(diagnosis.extended_law()) if has_law else published,
        100 * rms(fresh, true_form(hidden, fresh)),
    )


def main() -> None:
    """Print an answer a line, and a summary for each strength."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--strengths", nargs="+", type=float, default=list(STRENGTHS))
    parser.add_argument("--first", type=int, default=0, help="seed of the first log")
    parser.add_argument("--set", type=int, default=1, help="of effects, see tests/hidden/catalogue.py")
    parser.add_argument("--part", type=int, default=1, help="only every so many-th effect")
    parser.add_argument("--workers", type=int, default=-1)
    parser.add_argument("--out", type=Path, help="append each answer as a line of JSON")
    options = parser.parse_args()
    for strength in options.strengths:
        chosen = cases((strength,), options.first, options.set)[:: options.part]
        stream = Parallel(n_jobs=options.workers, return_as="generator")(
            delayed(diagnose_case)(case) for case in chosen
        )
        answers = []
        for answer in stream:
            answers.append(answer)
            print(describe_answer(answer), flush=True)
            if options.out:
                with options.out.open("a") as file:
                    file.write(json.dumps(asdict(answer)) + "\n")
        print(summarize(answers), flush=True)


def describe_answer(answer: Answer) -> str:
    """One line: the effect, what was found, and the errors."""
    case = answer.case
    effect = f"{case.form} ({case.name.split(':')[1]}, {case.design}, {case.noise}, {case.strength:g})"
    what = ", ".join(answer.found) or "nothing wrong"
    shape = f": {answer.term or answer.carrier}" if answer.recognised else ""
    closest = f" [{answer.closest} {100 * answer.share:.0f} %]" if answer.closest else ""
    errors = f"{answer.baseline:.3f} -> {answer.extended:.3f} (true form {answer.true:.3f})"
    return f"  {effect}\n      {what}{shape}{closest}; {errors}"


def summarize(answers: list[Answer]) -> str:
    """Rates, and the sum of what is saved as a share of what the true forms save."""
    table = pd.DataFrame(
        {
            "recognised": [answer.recognised for answer in answers],
            "cause": [bool(answer.found) and not answer.recognised for answer in answers],
            "extended": [answer.baseline - answer.extended for answer in answers],
            "true": [answer.baseline - answer.true for answer in answers],
            "squares": [answer.baseline**2 - answer.extended**2 for answer in answers],
            "true_squares": [answer.baseline**2 - answer.true**2 for answer in answers],
        }
    )
    total, inside = table.sum(), [answer.inside for answer in answers if answer.inside is not None]
    return (
        f"strength {answers[0].case.strength:g}: {total['recognised']:.0f} of {len(answers)} recognised, "
        f"{total['cause']:.0f} blamed on a cause; effect's interval holds in {sum(inside)} of {len(inside)}; "
        f"saved {total['extended']:.3f} of {total['true']:.3f} % rms: "
        f"{total['extended'] / total['true']:.2f} "
        f"(of mean squares {total['squares'] / total['true_squares']:.2f})"
    )


if __name__ == "__main__":
    main()
