"""compare_laws: the published law of each joint against the physical one. Start reading here.

Three questions for each joint. Which law predicts configurations that it has not seen (`held_out`)? Which
regime is each direction in, and what is lambda (`estimation.drive_ratio`)? And where the log cannot tell,
which traverses would (`experiments`)?
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._json import to_plain, write_json
from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._summary import Summarized
from stickslip_fit.errors import InputError, check_type
from stickslip_fit.estimation import JointFit
from stickslip_fit.estimation._groups import usable_rows
from stickslip_fit.estimation.drive_ratio import RatioProfile, likeliest_law, profile_ratio
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.estimation.noise import estimate_from_replicates
from stickslip_fit.estimation.result import Provenance, build_provenance
from stickslip_fit.law_comparison.experiments import Experiment, list_experiments
from stickslip_fit.law_comparison.held_out import HeldOutComparison, compare_held_out
from stickslip_fit.laws import FRICTION_LIMITED, published_law
from stickslip_fit.laws.physical import Physical
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine
from stickslip_fit.units import PRISMATIC

GRAVITY = 9.80665  # m/s^2
CERTAIN = 0.95
# Friction that is not Coulomb's moves r: bristles that bend by 1 % of the throw by 3 %, by 0.3 % by 1 %.
MODEL_SPREAD = 0.025
MIN_DF = 4
SCHEMA = "stickslip-fit/law-comparison/1"


@dataclass(frozen=True)
class Regime:
    """What the counts of a joint and direction say of its drive.

    Attributes
    ----------
    joint : int
    direction : str
    probability : float
        Of friction-limited steps without load, lambda > 1; half of the prior.
    ratio : tuple of float
        Interval of 95 % of lambda; 0 below or infinite above where counts do not bound it.
    best_ratio : float
        The likeliest lambda; infinite where it is above all that matters.
    share, share_interval : float, tuple of float
        Full load over friction, mean over sessions, and its interval of 95 %, with the uncertainty of lambda
        and of the kind of friction; of a rotary joint with the arm out.
    unloaded : float
        Step size without load, mean over sessions, m or rad.
    """

    joint: int
    direction: str
    probability: float
    ratio: tuple[float, float]
    best_ratio: float
    share: float
    share_interval: tuple[float, float]
    unloaded: float

    @property
    def name(self) -> str:
        """``friction-limited``, ``velocity-limited``, or ``cannot tell``."""
        if self.probability > CERTAIN:
            return "friction-limited"
        return "velocity-limited" if self.probability < 1 - CERTAIN else "cannot tell"

    @property
    def friction_acceleration(self) -> float:
        """The a_f of joint 3, whose load is its own weight, m/s^2; NaN for a rotary joint."""
        return GRAVITY / self.share if self.joint == PRISMATIC and self.share > 0 else np.nan

    @property
    def ramp_time(self) -> float:
        """The T1 of joint 3, s; NaN where it is not known."""
        if self.name == "cannot tell":
            return np.nan
        return float(np.sqrt(self.unloaded / self.friction_acceleration / min(self.best_ratio, 1.0)))

    @property
    def amplitude(self) -> tuple[float, float]:
        """The foot's D, m or rad: lowest and highest."""
        return self.unloaded * max(self.ratio[0], 1.0), self.unloaded * max(self.ratio[1], 1.0)


@dataclass(frozen=True)
class JointComparison:
    """One joint's laws compared.

    Attributes
    ----------
    joint : int
    errors : HeldOutComparison
    replicate_scatter : float
        Standard deviation of log(steps) of replicates; NaN without enough of them.
    regimes : tuple of Regime
    experiments : tuple of Experiment
        What would tell, where something is open.
    """

    joint: int
    errors: HeldOutComparison
    replicate_scatter: float
    regimes: tuple[Regime, ...]
    experiments: tuple[Experiment, ...]


@dataclass(frozen=True, repr=False)
class LawComparison(Summarized):
    """The published laws against the physical ones.

    Attributes
    ----------
    joints : tuple of JointComparison
    machine : Machine
    provenance : Provenance
    """

    joints: tuple[JointComparison, ...]
    machine: Machine
    provenance: Provenance

    @property
    def table(self) -> pd.DataFrame:
        """One row for each joint, errors in %."""
        return pd.DataFrame([_joint_row(one) for one in self.joints])

    @property
    def regimes(self) -> pd.DataFrame:
        """One row for each joint and direction."""
        return pd.DataFrame([_regime_row(regime) for one in self.joints for regime in one.regimes])

    def save(self, path: str | Path) -> None:
        """Write everything as JSON.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        joints = [
            _joint_row(one)
            | {
                "regimes": [_regime_row(regime) for regime in one.regimes],
                "experiments": [asdict(experiment) for experiment in one.experiments],
            }
            for one in self.joints
        ]
        content = to_plain({"schema": SCHEMA, "joints": joints, "provenance": asdict(self.provenance)})
        write_json(path, content, self.provenance.log_files)


def compare_laws(
    log: Log, *, command: str = "", progress: ProgressCallback = ignore_progress
) -> LawComparison:
    """Compare the published laws with the physical ones, on configurations that they have not seen.

    Parameters
    ----------
    log : Log
    command : str, optional
        For the provenance.
    progress : callable, optional
        Called with each step that begins and the share of the work that is done.

    Returns
    -------
    LawComparison

    Raises
    ------
    InputError
        If the log has no usable traverse, or its machine has not the published geometry.
    """
    check_type("log", log, Log)
    log.machine.require_geometry("the published and the physical laws")
    rows = usable_rows(log)
    if not len(log.joints):
        raise InputError("the log has no joint")
    joints: list[JointComparison] = []
    for joint in log.joints:
        progress(f"comparing the laws of joint {joint}", len(joints) / len(log.joints))
        joints.append(_compare_joint(joint, rows[rows["joint"] == joint], log.machine))
    return LawComparison(tuple(joints), log.machine, build_provenance(log, command))


def _compare_joint(joint: int, rows: pd.DataFrame, machine: Machine) -> JointComparison:
    profiles = profile_ratio(joint, rows, machine)
    errors = compare_held_out(joint, rows, machine, profiles)
    noise = estimate_from_replicates(published_law(joint, rows, machine), rows)
    known = [level for level in noise.values() if level.df >= MIN_DF]
    scatter = float(np.sqrt(np.mean([level.value**2 for level in known]))) if known else np.nan
    law = likeliest_law(joint, rows, machine, profiles)
    fit = fit_joint(law, rows, machine)[0]
    regimes = tuple(_regime(law, fit, way, profile) for way, profile in sorted(profiles.items()))
    is_open = not errors.better or any(regime.name == "cannot tell" for regime in regimes)
    spread = scatter if known else min(profile.noise for profile in profiles.values())
    experiments = list_experiments(joint, rows, machine, profiles, spread) if is_open else ()
    return JointComparison(joint, errors, scatter, regimes, experiments)


def _regime(law: Physical, fit: JointFit, direction: str, profile: RatioProfile) -> Regime:
    own = (fit.groups["direction"] == direction).to_numpy()
    share, low, high = profile.share_interval(spread=MODEL_SPREAD)
    return Regime(
        joint=law.joint,
        direction=direction,
        probability=profile.friction_limited,
        ratio=profile.interval(),
        best_ratio=np.inf if profile.best == FRICTION_LIMITED else profile.best,
        share=share,
        share_interval=(low, high),
        unloaded=float(np.mean(fit.values[own, 0])),
    )


def _joint_row(one: JointComparison) -> dict[str, Any]:
    row: dict[str, Any] = {"joint": one.joint, "better": one.errors.better or "cannot tell"}
    for name in ("published", "physical"):
        for key, value in asdict(getattr(one.errors, name)).items():
            row[f"{name}_error_{key}_pct"] = 100 * value
    row["error_ratio_low"], row["error_ratio_high"] = map(float, np.exp(one.errors.log_ratio))
    row |= {"replicate_scatter_pct": 100 * one.replicate_scatter}
    return row | {"configurations": one.errors.configurations, "traverses": one.errors.traverses}


def _regime_row(regime: Regime) -> dict[str, Any]:
    return {
        "joint": regime.joint,
        "direction": regime.direction,
        "regime": regime.name,
        "p_friction_limited": regime.probability,
        "lambda": regime.best_ratio,
        "lambda_low": regime.ratio[0],
        "lambda_high": regime.ratio[1],
        "r": regime.share,
        "r_low": regime.share_interval[0],
        "r_high": regime.share_interval[1],
        "friction_acceleration_m_per_s2": regime.friction_acceleration,
        "ramp_time_ms": 1e3 * regime.ramp_time,
    }
