"""Independent ensembles of walkers by emcee, run in turns until they agree.

D. Foreman-Mackey et al., PASP 125:306 (2013). Most steps propose from the fitted guess, wherever the
walker is, and so forget it at once; the others, by differential evolution (C. J. F. ter Braak, Stat. Comput.
16:239, 2006), need no guess and keep the walkers moving where it is poor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.bayes.agreement import effective_sizes, r_hat
from stickslip_fit.fit.bayes.laplace import Guess, LogDensity

if TYPE_CHECKING:
    from emcee import EnsembleSampler
    from emcee.backends import Backend

Array = npt.NDArray[np.float64]

WALKERS = 32
TURN = 50  # steps between looks at the agreement
SETTLING = 0.2  # share of the steps left out at the beginning
AGREED = 1.01
GUESSED = 0.7  # share of steps that propose from the guess
OVERDISPERSED = 2.0


@dataclass(frozen=True, eq=False)
class Chains:
    """What the ensembles walked through, the beginning left out.

    Attributes
    ----------
    x : array, shape (ensembles, steps, walkers, d)
    log_density : array, shape (ensembles, steps, walkers)
    steps : int
        Taken by each ensemble, the beginning included.
    """

    x: Array
    log_density: Array
    steps: int


def walk(
    log_density: LogDensity,
    guess: Guess,
    seed: tuple[int, ...],
    backends: list[Backend],
    target_ess: int,
    max_steps: int,
    on_step: Callable[[int], Any],
) -> Chains:
    """Walk until the ensembles agree and are worth `target_ess` independent draws.

    Parameters
    ----------
    log_density : callable
    guess : Guess
        Where to begin, twice as far out, and what to propose.
    seed : tuple of int
    backends : list of Backend
        One for each ensemble; what they already hold is taken up, and the outcome is that of a walk
        that was never interrupted.
    target_ess, max_steps : int
    on_step : callable
        Told the steps made since it was last told.
    """
    dimensions = len(guess.centre)
    walkers = max(WALKERS, 4 * dimensions)
    samplers = [_sampler(log_density, guess, walkers, backend) for backend in backends]
    turn = 0
    while True:
        turn += 1
        steps = min(turn * TURN, max_steps)
        for number, sampler in enumerate(samplers):
            _walk_on(sampler, guess, (*seed, number), steps, on_step)
        chains = _collect(backends, steps)
        if steps == max_steps or _settled(chains, target_ess):
            return chains


def _sampler(log_density: LogDensity, guess: Guess, walkers: int, backend: Backend) -> EnsembleSampler:
    from emcee import EnsembleSampler
    from emcee.moves import DEMove, MHMove

    def propose(x: Array, rng: np.random.RandomState) -> tuple[Array, Array]:
        proposed = guess.draw(len(x), rng)
        return proposed, guess.log_density(x) - guess.log_density(proposed)

    moves = [(MHMove(propose), GUESSED), (DEMove(), 1.0 - GUESSED)]
    return EnsembleSampler(
        walkers, len(guess.centre), log_density, moves=moves, backend=backend, vectorize=True
    )


def _walk_on(
    sampler: EnsembleSampler, guess: Guess, seed: tuple[int, ...], steps: int, on_step: Callable[[int], Any]
) -> None:
    from emcee.state import State

    done = sampler.backend.iteration
    if done:
        state = sampler.backend.get_last_sample()
    else:
        start = guess.draw(sampler.nwalkers, np.random.default_rng(seed), wider=OVERDISPERSED)
        generator = np.random.MT19937(seed).state["state"]
        state = State(start, random_state=("MT19937", generator["key"], generator["pos"], 0, 0.0))
    for _ in sampler.sample(state, iterations=max(steps - done, 0)):
        on_step(1)


def _collect(backends: list[Backend], steps: int) -> Chains:
    first = int(SETTLING * steps)
    return Chains(
        np.stack([backend.get_chain()[first:steps] for backend in backends]),
        np.stack([backend.get_log_prob()[first:steps] for backend in backends]),
        steps,
    )


def _settled(chains: Chains, target_ess: int) -> bool:
    x = np.moveaxis(chains.x, -1, 0)
    return bool(np.max(r_hat(x)) < AGREED and np.min(effective_sizes(x)) >= target_ess)
