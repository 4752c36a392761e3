"""Bayes of 12 sessions, all joints, beside plain emcee, numpyro's NUTS and nutpie: one posterior, cold start.

Each contender runs in a process of its own from its imports, compilation included, until every parameter has
1,000 effective draws at R-hat below 1.01. The peers live in an environment of their own, whose interpreter is
given as PEERS_PYTHON; it needs emcee, arviz, numpyro and nutpie with pymc and numba.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

SESSIONS, TARGET, AGREED, CHAINS = 12, 1000, 1.01, 4
CAP = 240.0  # s; a contender that has not converged by then is a lower bound
THREADS = {name: "2" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}
QUANTITIES = {
    "mean": "campaign means", "spread": "spreads", "repeatability": "repeatabilities",
    "parameters": "sessions' parameters",
}  # fmt: skip
REFERENCE = Path(__file__).parents[1] / "data" / "reference"


def campaign():
    """The reference campaign's plan without replicates, on twelve days."""
    from dataclasses import replace

    from stickslip_fit.logs.plan import PlannedSession
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.simulation import read_law_values, simulate

    machine = load_machine()
    plan = read_plan(REFERENCE / "plan.toml", machine)
    first = datetime(2012, 3, 5, 8, 30)
    days = [first + timedelta(days=day) for day in range(SESSIONS)]
    sessions = tuple(PlannedSession(f"{day:%Y-%m-%d}", day) for day in days)
    plan = replace(plan, sessions=sessions, replicates=1)
    return simulate(plan, read_law_values(REFERENCE / "law.toml", machine), machine, 1)


def problem(log) -> dict[str, dict[str, np.ndarray]]:
    """Each joint and direction in plain arrays, for peers that know nothing of this package."""
    from stickslip_fit.bayes import weak_prior
    from stickslip_fit.bayes.priors import iterate_groups

    groups = {}
    for joint, direction, traverses in iterate_groups(log):
        law, rows, prior = traverses.law, traverses.rows, weak_prior(traverses.law, traverses.rows)
        ends = {name: rows[name].to_numpy() for name in ("start", "stop")}
        if joint == 3:
            geometry = {"features": law.features(rows)}
        else:
            amplitude, phase = law.swing(rows)
            geometry = {"basis": law.basis(rows), "amplitude": amplitude, "phase": phase}
        groups[f"{joint}{direction}"] = {
            "y": traverses.y, "rounding": traverses.rounding, "session": traverses.groups.of_row,
            "centre": prior.centre, "width": prior.width, "spread": prior.spread,
            "noise": np.array([prior.repeatability]), **ends, **geometry,
        }  # fmt: skip
    return groups


def log_steps(xp, group, phi):
    """The published laws written out for any array library; phi is a sequence of p arrays."""
    if len(phi) == 3:
        recoil, load = group["features"].T
        return xp.log(
            np.abs(group["stop"] - group["start"]) / ((1 - phi[1] * recoil) * (phi[0] - phi[2] * load))
        )
    near, far = group["basis"].T
    gamma0, d = near * phi[0] + far * phi[1], near * phi[2] + far * phi[3]
    e = d * group["amplitude"] / gamma0
    root = xp.sqrt(1 - e**2)
    beta = e / (1 + root)

    def eccentric(q):
        return q - 2 * xp.arctan2(beta * np.sin(q), 1 + beta * np.cos(q))

    swept = eccentric(group["stop"] - group["phase"]) - eccentric(group["start"] - group["phase"])
    return xp.log(xp.abs(swept) / (gamma0 * root))


def ours(path: str) -> dict[str, np.ndarray]:
    from stickslip_fit.bayes import fit_bayes
    from stickslip_fit.logs import read_log

    posterior = fit_bayes(read_log(path), progress=False)
    assert not posterior.result.flags, posterior.result.flags
    found = {
        f"{joint}{way} {quantity}": posterior.draws(joint, way, name)
        for joint, way in posterior.groups
        for name, quantity in QUANTITIES.items()
    }
    worst = [posterior.diagnostics["ess_bulk"].min(), posterior.diagnostics["r_hat"].max()]
    return found | {"worst": np.array(worst)}


def one_by_one(sampled, groups) -> dict[str, np.ndarray]:
    """Joints and directions one by one, as the posterior factorises; beyond the cap they are left out.

    `sampled` gives draws, (chains, draws, ...), of mean and z, centred and scaled as in the prior, and of
    level and noise, the logarithms of spread and repeatability over their medians.
    """
    found = {}
    for name, group in groups.items():
        if time.perf_counter() - BEGAN > CAP:
            print(f"    joint {name} not begun: the time is a lower bound", flush=True)
            continue
        drawn = {kind: x.reshape(-1, *x.shape[2:]) for kind, x in sampled(group).items()}
        quantities = {
            "mean": group["centre"] + group["width"] * drawn["mean"],
            "spread": group["spread"] * np.exp(drawn["level"]),
            "repeatability": group["noise"] * np.exp(drawn["noise"]),
            "parameters": group["centre"] + group["width"] * drawn["z"],
        }
        found |= {f"{name} {QUANTITIES[kind]}": x for kind, x in quantities.items()}
    return found


def plain_emcee(group) -> dict[str, np.ndarray]:
    import emcee
    from arviz_stats.base import array_stats

    p, sessions = len(group["centre"]), int(group["session"].max()) + 1
    dimensions = 2 * p + 1 + sessions * p
    walkers = 4 * dimensions
    rng = np.random.default_rng(1)
    samplers = [
        emcee.EnsembleSampler(walkers, dimensions, _joint_density(group), vectorize=True)
        for _ in range(CHAINS)
    ]
    states = [0.02 * rng.standard_normal((walkers, dimensions)) for _ in samplers]
    while True:
        for k, sampler in enumerate(samplers):
            states[k] = sampler.run_mcmc(states[k], 500, skip_initial_state_check=True)
        steps = samplers[0].iteration
        x = np.stack(
            [sampler.get_chain(discard=steps // 2, thin=max(steps // 500, 1)) for sampler in samplers]
        )
        # Every fifth quantity serves to tell: the looking is not to be counted against the sampler.
        some = np.moveaxis(x[..., ::5], -1, 0)
        size = np.min(array_stats.ess(some.swapaxes(2, 3).reshape(len(some), -1, some.shape[2])[:, ::4])) * 4
        r_hat = np.max(array_stats.rhat(some.reshape(len(some), CHAINS, -1)[..., ::20]))
        if (size >= TARGET and r_hat < AGREED) or time.perf_counter() - BEGAN > CAP:
            print(
                f"    {dimensions} dimensions, {steps} steps, ESS {size:.0f}, R-hat {r_hat:.3f}", flush=True
            )
            mean, level, noise, z = np.split(x.reshape(CHAINS, -1, dimensions), [p, 2 * p, 2 * p + 1], axis=2)
            z = z.reshape(CHAINS, -1, sessions, p)
            return {"mean": mean, "level": level, "noise": noise[..., 0], "z": z}


def _joint_density(group):
    p, sessions = len(group["centre"]), int(group["session"].max()) + 1

    def density(x):
        mean, level, noise = x[:, :p], x[:, p : 2 * p], x[:, 2 * p]
        tau = group["spread"] / group["width"] * np.exp(level)
        z = x[:, 2 * p + 1 :].reshape(-1, sessions, p)
        phi = (group["centre"] + group["width"] * z)[:, group["session"]]
        variance = (group["noise"] * np.exp(noise)[:, None]) ** 2 + group["rounding"]
        with np.errstate(invalid="ignore"):
            misfit = group["y"] - log_steps(np, group, np.moveaxis(phi, -1, 0))
        value = -0.5 * np.sum(misfit**2 / variance + np.log(variance), axis=1)
        value -= 0.5 * np.sum(x[:, : 2 * p + 1] ** 2, axis=1) + sessions * np.sum(np.log(tau), axis=1)
        value -= 0.5 * np.sum(((z - mean[:, None]) / tau[:, None]) ** 2, axis=(1, 2))
        return np.where(np.isfinite(value), value, -np.inf)

    return density


def numpyro_nuts(group) -> dict[str, np.ndarray]:
    """With a dense mass matrix, since a law's parameters are correlated."""
    import jax
    import jax.numpy as jnp
    import numpyro
    import numpyro.distributions as dist
    from numpyro.infer import MCMC, NUTS, init_to_value

    numpyro.set_host_device_count(CHAINS)
    numpyro.enable_x64()
    p, sessions = len(group["centre"]), int(group["session"].max()) + 1

    def model():
        mean = numpyro.sample("mean", dist.Normal(jnp.zeros(p), 1.0))
        level = numpyro.sample("level", dist.Normal(jnp.zeros(p), 1.0))
        noise = numpyro.sample("noise", dist.Normal(0.0, 1.0))
        tau = jnp.exp(level) * (group["spread"] / group["width"])
        z = numpyro.sample("z", dist.Normal(jnp.broadcast_to(mean, (sessions, p)), tau))
        phi = (group["centre"] + group["width"] * z)[group["session"]]
        scale = jnp.sqrt((group["noise"][0] * jnp.exp(noise)) ** 2 + group["rounding"])
        numpyro.sample("y", dist.Normal(log_steps(jnp, group, list(phi.T)), scale), obs=group["y"])

    start = init_to_value(values={"z": np.zeros((sessions, p)), "mean": np.zeros(p)})
    kernel = NUTS(model, init_strategy=start, dense_mass=True)
    mcmc = MCMC(kernel, num_warmup=500, num_samples=500, num_chains=CHAINS, progress_bar=False)
    mcmc.run(jax.random.PRNGKey(0))
    draws = mcmc.get_samples(group_by_chain=True)
    while not _agreed(draws) and time.perf_counter() - BEGAN < CAP:
        mcmc.post_warmup_state = mcmc.last_state
        mcmc.run(mcmc.post_warmup_state.rng_key)
        more = mcmc.get_samples(group_by_chain=True)
        draws = {name: np.concatenate([draws[name], more[name]], axis=1) for name in draws}
    return {name: np.asarray(x) for name, x in draws.items()}


def nutpie_nuts(group) -> dict[str, np.ndarray]:
    """With a low-rank mass matrix, for the same reason; more draws are taken anew, and counted alone."""
    import nutpie
    import pymc as pm
    import pytensor.tensor as pt

    p, sessions = len(group["centre"]), int(group["session"].max()) + 1
    with pm.Model() as model:
        mean, level, noise = pm.Normal("mean", shape=p), pm.Normal("level", shape=p), pm.Normal("noise")
        tau = pt.exp(level) * (group["spread"] / group["width"])
        z = pm.Normal("z", mean, tau, shape=(sessions, p))
        phi = (group["centre"] + group["width"] * z)[group["session"]]
        scale = pt.sqrt((group["noise"][0] * pt.exp(noise)) ** 2 + group["rounding"])
        expected = log_steps(pt, group, [phi[:, k] for k in range(p)])
        pm.Normal("y", expected, scale, observed=group["y"])
    compiled = nutpie.compile_pymc_model(model)
    for draws in 500, 1000, 2000, 4000:
        trace = nutpie.sample(
            compiled, draws=draws, tune=500, chains=CHAINS, cores=2, seed=1, progress_bar=False,
            init_mean=np.zeros(compiled.n_dim), adaptation="low_rank",
        )  # fmt: skip
        found = {name: trace.posterior[name].to_numpy() for name in ("mean", "level", "noise", "z")}
        if _agreed(found) or time.perf_counter() - BEGAN > CAP:
            break
    return found


def _agreed(draws: dict[str, np.ndarray]) -> bool:
    from arviz_stats.base import array_stats

    flat = np.concatenate([np.moveaxis(x.reshape(*x.shape[:2], -1), -1, 0) for x in draws.values()])
    size, r_hat = np.min(array_stats.ess(flat)), np.max(array_stats.rhat(flat))
    seconds = time.perf_counter() - BEGAN
    print(f"    {seconds:.0f} s: {flat.shape[2]} draws, ESS {size:.0f}, R-hat {r_hat:.4f}", flush=True)
    return bool(size >= TARGET and r_hat < AGREED)


def run(contender: str, python: str, given: Path, out: Path) -> tuple[float, float]:
    """Wall and processor time of a process of its own, s."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([python, __file__, contender, str(given), str(out)], check=True, env=os.environ | THREADS)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - began, processor


def main() -> None:
    peers = os.environ.get("PEERS_PYTHON")
    with tempfile.TemporaryDirectory() as folder:
        log, base = campaign(), Path(folder)
        log.to_csv(base / "log.csv")
        np.savez(base / "problem.npz", problem=np.array(problem(log), dtype=object))
        print(f"{SESSIONS} sessions, {len(log)} traverses, joints 1 to 3, both directions")
        own, own_cpu = run("ours", sys.executable, base / "log.csv", base / "ours.npz")
        with np.load(base / "ours.npz") as draws:
            reference = dict(draws)
        size, r_hat = reference.pop("worst")
        print(f"ours: {own:.1f} s (processor {own_cpu:.1f} s); ESS {size:.0f}, R-hat {r_hat:.4f}", flush=True)
        if peers is None:
            print("peers not run: set PEERS_PYTHON to their environment's interpreter")
            return
        for contender in ("nutpie_nuts", "numpyro_nuts", "plain_emcee"):
            print(f"{contender}:", flush=True)
            wall, cpu = run(contender, peers, base / "problem.npz", base / "peer.npz")
            print(
                f"    {wall:.1f} s (processor {cpu:.1f} s): {wall / own:.1f} ({cpu / own_cpu:.1f}) times ours"
            )
            _compare(base / "peer.npz", reference)


def _compare(path: Path, reference: dict[str, np.ndarray]) -> None:
    """How far posterior means lie apart, in standard deviations; two of 1,000 draws differ by 0.045."""
    with np.load(path) as found:
        apart = {name: _apart(found[name], x) for name, x in reference.items() if name in found}
    for quantity in QUANTITIES.values():
        every = np.concatenate([x for name, x in apart.items() if name.endswith(quantity)])
        print(
            f"    {quantity} ({len(every)}): means differ from ours by {np.sqrt(np.mean(every**2)):.3f} "
            f"standard deviations (root mean square), at most {every.max():.3f}",
            flush=True,
        )


def _apart(theirs: np.ndarray, ours: np.ndarray) -> np.ndarray:
    return np.ravel(np.abs(theirs.mean(axis=0) - ours.mean(axis=0)) / ours.std(axis=0))


if __name__ == "__main__":
    BEGAN = time.perf_counter()
    if len(sys.argv) == 1:
        main()
    else:
        contender, given, out = sys.argv[1:]
        if contender == "ours":
            found = ours(given)
        else:
            problems = np.load(given, allow_pickle=True)["problem"].item()
            found = one_by_one(globals()[contender], problems)
        np.savez(out, **found)
