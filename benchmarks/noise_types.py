"""What a diagnosis says of logs in which nothing is hidden, but whose noise is not as assumed.

Gross errors are 1 % of the counts doubled; `tests.hidden.noise` has the others. With `--effect` one cause is
hidden beside the noise, and its size's interval is compared with the truth.
"""

from argparse import ArgumentParser
from collections import Counter

import numpy as np
from joblib import Parallel, delayed

from stickslip_fit.diagnosis import Diagnosis, diagnose
from tests.hidden.generate import Hidden, UnreachableError, hide
from tests.hidden.gross import spoil
from tests.hidden.noise import KINDS, OTHER_KINDS
from tests.hidden.reading import read_hidden

DESIGNS = ("session", "thesis", "many")
GROSS, GROSS_RATE = "gross", 0.01
TYPES = (*OTHER_KINDS, GROSS)
NO_CAUSE = {"end-stop-misfire", "unknown"}


def make(kind: str, seed: int, effects: tuple[str, ...] = (), strength: float | None = None) -> Hidden | None:
    """A log with this noise, designs in turn; None where an effect cannot be so strong in it."""
    designs = DESIGNS[1:] if kind == "sessions" else DESIGNS
    design, ordinary = designs[seed % len(designs)], KINDS[seed // 3 % 3]
    try:
        hidden = hide(design, effects, strength, ordinary if kind == GROSS else kind, seed=seed)
    except UnreachableError:
        return None
    if kind != GROSS:
        return hidden
    rng = np.random.default_rng([seed, 9])
    rows = np.flatnonzero(rng.random(len(hidden.table)) < GROSS_RATE)
    return spoil(hidden, rows if len(rows) else rng.integers(len(hidden.table), size=1))


def answer(hidden: Hidden, seed: int) -> Diagnosis:
    """The diagnosis, without its gain."""
    return diagnose(read_hidden(hidden), seed=seed, gain=False)


def findings(kind: str, seed: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is found where nothing is hidden: causes and noise properties."""
    hidden = make(kind, seed)
    assert hidden is not None
    found = answer(hidden, seed)
    return tuple(finding.cause for finding in found.findings), found.noise_properties


def coverage(kind: str, seed: int, effect: str, strength: float) -> tuple[bool, bool | None]:
    """Whether a hidden effect is in the answer, and if it is named first, whether its interval is right."""
    hidden = make(kind, seed, (effect,), strength)
    if hidden is None:
        return False, None
    (truth,) = hidden.truth["effects"]
    found = answer(hidden, seed)
    named = [one for one in found.findings if one.cause == truth["cause"]]
    if not named:
        return any(truth["cause"] in one.cause_set for one in found.findings), None
    low, high = 100 * named[0].effect.low, 100 * named[0].effect.high
    return True, bool(low <= truth["effect_rms_pct"] <= high)


def main() -> None:
    """Print, for each type of noise, every answer and how often it was given."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="seed of the first log")
    parser.add_argument("--types", nargs="+", choices=(*TYPES, *KINDS), default=list(TYPES))
    parser.add_argument("--effect", help="a cause to hide")
    parser.add_argument("--strength", type=float, default=12.0)
    parser.add_argument("--jobs", type=int, default=-1)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.logs)
    run = Parallel(n_jobs=options.jobs)
    for kind in options.types:
        if options.effect:
            scores = run(delayed(coverage)(kind, seed, options.effect, options.strength) for seed in seeds)
            inside = [one for _, one in scores if one is not None]
            found = sum(in_answer for in_answer, _ in scores)
            print(f"{kind}: in the answer {found} of {len(scores)}, interval {sum(inside)} of {len(inside)}")
            continue
        answers = run(delayed(findings)(kind, seed) for seed in seeds)
        physical = sum(bool(set(causes) - NO_CAUSE) for causes, _ in answers)
        print(f"{kind}: {physical} of {len(seeds)} with a physical cause", flush=True)
        for (causes, properties), n in Counter(answers).most_common():
            print(f"  {n:4} {', '.join(causes) or 'nothing wrong'}; noise: {', '.join(properties) or '-'}")


if __name__ == "__main__":
    main()
