"""One contender's answers to every log of a folder, a JSON line each; goes on where it left off.

``python -m benchmarks.naming.answering CONTENDER FOLDER``, in the environment that has what it needs.
"""

import json
import sys
import time
import traceback
import warnings
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.naming import ours, regressions, stepwise
from benchmarks.naming.problem import Answer, Contender, Problem

CONTENDERS: dict[str, Contender] = {
    "ours": ours.ours,
    "stepwise AIC": partial(stepwise.stepwise, worth=stepwise.aic),
    "stepwise BIC": partial(stepwise.stepwise, worth=stepwise.bic),
    "stepwise 1 %": partial(stepwise.stepwise, worth=stepwise.family_wise),
    "LassoCV": regressions.lasso,
    "boosted trees": regressions.trees,
    "EBM": regressions.explainable,
    "pyGAM": regressions.additive,
    "PySINDy": regressions.sparse_dynamics,
}


def lines(contender: str, folder: Path) -> Path:
    """The file of a contender's answers."""
    return folder / f"{contender.replace(' ', '-').replace('%', 'pct')}.jsonl"


def answer_all(contender: str, folder: Path, logs: list[Path]) -> None:
    """Answer every log that has no answer yet."""
    file = lines(contender, folder)
    done = {json.loads(line)["log"] for line in file.read_text().splitlines()} if file.exists() else set()
    for log in logs:
        if log.stem not in done:
            line = {"log": log.stem, "contender": contender, **_timed_answer(CONTENDERS[contender], log)}
            with file.open("a") as out:
                out.write(json.dumps(line) + "\n")


def _timed_answer(contender: Contender, log: Path) -> dict[str, object]:
    problem = Problem.load(log)
    began = time.perf_counter()
    try:
        answer = contender(problem)
    except Exception as error:
        traceback.print_exc()
        return {"failed": repr(error), "seconds": time.perf_counter() - began}
    return {
        **_to_json(answer, np.load(log.with_suffix(".fresh.npy"))),
        "seconds": time.perf_counter() - began,
    }


def _to_json(answer: Answer, fresh: np.ndarray) -> dict[str, object]:
    """An answer in plain JSON, with its error on the replicate in place of its predictions."""
    errors = np.sqrt(np.mean((fresh - answer.departures) ** 2, axis=1))
    return {
        "found": [(cause, float(score)) for cause, score in answer.found],
        "threshold": answer.threshold,
        "inclusion": answer.inclusion,
        "quiet": answer.quiet or {},
        "rivals": list(answer.rivals),
        "interval_pct": answer.interval,
        "errors_pct": [100 * float(error) for error in errors],
    }


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # peers' own; what they cost shows in the scores
    name, place, *stems = sys.argv[1:]
    answer_all(name, Path(place), [Path(place) / f"{stem}.csv" for stem in stems])
