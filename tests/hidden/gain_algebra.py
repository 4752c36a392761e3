"""How many replicates gain what the interval of a log's gain claims, without a search of each.

``python -m tests.hidden.gain_algebra --logs 40 --first 440000`` diagnoses each log as a user would, and puts
the responses of replicates through the linear algebra of its folds, in a hundredth of the time that their
diagnoses take. In all folds the causes are those of the log; what else differs between replicates, their
searches above all, is left out: see `gain_study`.
"""

import argparse

import numpy as np
import pandas as pd

from stickslip_fit.diagnosis import Diagnosis, diagnose
from stickslip_fit.diagnosis.gain import _linearize_campaign, hold_out_configurations
from stickslip_fit.diagnosis.gain_interval import Responses, _held_out_rms, prepare_split
from stickslip_fit.diagnosis.problem import problem_from_log
from tests.hidden.gain_study import KINDS, GainCase, gain_cases
from tests.hidden.reading import read_hidden

PLACE = ["session", "joint", "direction", "start", "stop", "session_seconds"]  # of a traverse in its design


def number_places(rows: pd.DataFrame) -> dict[tuple, int]:
    """Position of each traverse in a log."""
    return {place: k for k, place in enumerate(rows[PLACE].itertuples(index=False, name=None))}


def replicate_gains(found: Diagnosis, case: GainCase, replicates: int) -> np.ndarray:
    """Gain of each replicate that has all rows of the log, relative."""
    selection = found.selection
    extending = [finding for finding in found.findings if finding.version is not None]
    campaign = _linearize_campaign(selection, extending, found.alpha)
    folds = [prepare_split(campaign.basis, split) for split in hold_out_configurations(selection)]
    problem, residuals = selection.problem, []
    baseline = problem.with_laws_as_chosen.linearize().residual
    wanted = number_places(problem.rows)
    for number in range(1, replicates + 1):
        other, _ = problem_from_log(read_hidden(case.make(number)))
        places = number_places(other.rows)
        if set(wanted) <= set(places):
            change = other.responses[[places[one] for one in wanted]] - problem.responses
            residuals.append(baseline + change / problem.scale)
    values = np.stack(residuals, axis=1)
    responses = Responses.of(campaign, values - campaign.basis @ (campaign.basis.T @ values))
    numbers = [len(one.log_bayes_factor) for one in campaign.competing_causes]
    no_rival = [np.full((values.shape[1], number), -np.inf) for number in numbers]
    rms = _held_out_rms(campaign, folds, responses, no_rival)
    return rms[:, 0] - rms[:, -1]


def main() -> None:
    """Print the share of each log and of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=KINDS, default="single")
    parser.add_argument("--strength", type=float, default=25.0)
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--replicates", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="seed of the first log")
    chosen = parser.parse_args()
    shares = []
    for case in gain_cases(chosen.kind, chosen.logs, chosen.strength, chosen.first):
        hidden = case.make(0)
        found = hidden and diagnose(read_hidden(hidden), seed=case.seed, gain=False).measure_gain()
        if not found or found.gain is None or all(one.version is None for one in found.findings):
            continue
        gains = replicate_gains(found, case, chosen.replicates)
        shares.append(np.mean((gains >= found.gain.low) & (gains <= found.gain.high)))
        text = ", ".join(f"{one['name']} ({one['form']})" for one in hidden.truth["effects"])
        gain = found.gain.baseline - found.gain.extended
        print(
            f"{case.seed} {hidden.design} {hidden.noise} {text}: {100 * gain:.3f} % "
            f"({100 * found.gain.low:.3f} to {100 * found.gain.high:.3f}), replicates "
            f"{100 * gains.mean():.3f} +- {100 * gains.std():.3f} %, {shares[-1]:.2f} in it",
            flush=True,
        )
    error = np.std(shares) / np.sqrt(len(shares))
    print(f"{len(shares)} logs: {np.mean(shares):.3f} +- {error:.3f}")


if __name__ == "__main__":
    main()
