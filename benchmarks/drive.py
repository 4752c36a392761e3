"""Drives by hand on the emulator's physics: where the tip ends, beside where it is said to be.

Each campaign has laws of its own: those of the reference campaign, with each joint's and direction's
day-to-day difference drawn anew for each session. The law that drives is fitted to a simulated log of them,
never the truth itself. Every drive begins at a known place within the workspace and lasts 20 s. Its speed is
5 to 60 µm/s, its direction random and another one every 2 to 6 s. `DriveLoop` turns this into steps, which
are then made one after another by the true law, each joint and direction with one relative error that is held
for the drive.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np
from scipy.special import chdtri

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.capture.protocols import VirtualClock
from stickslip_fit.causes import ExtendedLaw, library
from stickslip_fit.drive.advice import ADVICE_SHARE
from stickslip_fit.drive.loop import TICK
from stickslip_fit.drive.rehearsal import follow_script
from stickslip_fit.drive.script import VelocityScript
from stickslip_fit.drive.state import DriveState
from stickslip_fit.estimation import Result, fit_constant_step, fit_least_squares
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs import Log
from stickslip_fit.logs.plan import Plan
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import Machine, forward, load_machine
from stickslip_fit.moves import CalibratedArm, DriveReckoning, calibrated_arm
from stickslip_fit.moves.incremental import GROUPS
from stickslip_fit.simulation import LawValues, read_law_values, simulate
from stickslip_fit.units import JOINTS
from tests.drive.rig import Shown, Steps

SECONDS = 20.0
SPEEDS = (5e-6, 60e-6)  # m/s
LEGS = (2.0, 6.0)  # s between changes of direction
ONE_STEP = 4.75e-6  # m: a rotary step at 50 mm
CHI_SQUARED_95 = float(chdtri(3, 0.05))
REPEATABILITY = 0.0027
WARM_UP = ("thermal-warm-up", (0.03, 1200.0))  # 3 % with a time constant of 20 min
MARGIN = (0.35, 0.05, 1.5e-3)  # rad, rad, m between a start and the ends of the range


@dataclass(frozen=True, eq=False)
class Bench:
    """One campaign: its true laws in its last session, and the law that was fitted to its log."""

    machine: Machine
    truth: LawValues
    session: str
    log: Log
    result: Result
    seconds: float  # since the session's first traverse, as the drives begin

    @property
    def arm(self) -> CalibratedArm:
        """The law as fitted, at the time of the drive."""
        return calibrated_arm(self.result, self.session, conditions={"session_seconds": self.seconds})

    @property
    def constant_arm(self) -> CalibratedArm:
        """One step size for each joint and direction, from the first full traverse of its kind."""
        return calibrated_arm(fit_constant_step(self.log, self.result), self.session)


def make_bench(plan: Plan, seed: int, causes: bool, fitted_causes: bool, seconds: float) -> Bench:
    """A campaign with laws drawn anew, simulated, and the law fitted to it."""
    machine, rng = load_machine(), np.random.default_rng([seed, 1])
    nominal = read_law_values("data/reference/law.toml", machine)
    cause = [one for one in library() if one.name == WARM_UP[0]]
    laws: dict[int, StepLaw] = dict(nominal.laws)
    values: dict[tuple[int, str, str | None], Array] = {}
    for session in plan.sessions:
        for group in GROUPS:
            scale = 1.0 + nominal.day_to_day.get(group, 0.0) * rng.standard_normal()
            values[*group, session.label] = scaled(nominal.values[*group, None], group[0], scale)
    if causes:
        laws = {joint: ExtendedLaw(law, cause) for joint, law in laws.items()}
        values = {key: np.append(own, WARM_UP[1]) for key, own in values.items()}
    values |= {(*group, None): values[*group, plan.sessions[-1].label] for group in GROUPS}
    truth = LawValues(laws, values)
    log = simulate(plan, truth, machine, seed)
    fitted = fit_least_squares(log, causes=cause if fitted_causes else ())
    return Bench(machine, truth, plan.sessions[-1].label, log, fitted, seconds)


def scaled(values: Array, joint: int, factor: float) -> Array:
    """Parameters of a law whose step size is so many times as large."""
    return values * np.where(np.arange(len(values)) == 1, 1.0, factor) if joint == 3 else values * factor


def draw_script(rng: np.random.Generator) -> VelocityScript:
    """Random velocities for one drive, all of one speed."""
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(*LEGS, 12))])
    directions = rng.standard_normal((len(times), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    velocities = rng.uniform(*SPEEDS) * directions[times < SECONDS]
    times = np.append(times[times < SECONDS], SECONDS)
    return VelocityScript(tuple(times.tolist()), np.vstack([velocities, np.zeros(3)]), (0,) * len(times))


def draw_start(machine: Machine, rng: np.random.Generator) -> Array:
    """A known place within the workspace."""
    ends = np.array([machine.ranges[joint] for joint in JOINTS])
    return rng.uniform(ends[:, 0] + MARGIN, ends[:, 1] - MARGIN)


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive: where it began, its steps, where it was to go, and where it was said to end."""

    start: Array
    made: list[tuple[float, int, int]]
    commanded: Array
    path: float  # m
    shown: list[DriveState]
    cpu: float  # s for each tick

    @property
    def state(self) -> DriveState:
        """At the end."""
        return self.shown[-1]


def drive(arm: CalibratedArm, start: Array, script: VelocityScript) -> Drive:
    """Drive by a law."""
    clock, shown = VirtualClock(), Shown()
    controller = Steps(clock)
    began = process_time()
    loop = follow_script(DriveReckoning(arm, start), script, controller, clock, shown, tolerance=1.0)
    cpu = (process_time() - began) / (SECONDS / TICK)
    path = float(np.linalg.norm(script.velocities[0])) * SECONDS
    return Drive(start, controller.made, np.array(loop.commanded_tip), path, shown.states, cpu)


def step_truly(benches: Sequence[Bench], drives: Sequence[Drive], rng: np.random.Generator) -> Array:
    """True joints after every command of each drive, shape (n, most commands + 1, 3), by single steps.

    A drive that has ended stands where it is.
    """
    most = max(len(one.made) for one in drives)
    q = np.array([one.start for one in drives])
    joint, steps = np.zeros((2, len(drives), most), int)
    time = np.zeros((len(drives), most))
    for row, one in enumerate(drives):
        for number, made in enumerate(one.made):
            time[row, number], joint[row, number], steps[row, number] = made
    deviation = {group: np.exp(-REPEATABILITY * rng.standard_normal(len(drives))) for group in GROUPS}
    values = {
        group: np.array([bench.truth.values[*group, bench.session] for bench in benches]) for group in GROUPS
    }
    seconds = np.array([bench.seconds for bench in benches])
    sessions = np.array([bench.session for bench in benches], object)
    laws, path = benches[0].truth.laws, np.empty((len(drives), most + 1, 3))
    path[:, 0] = q
    for number in range(most):
        for group in GROUPS:
            sign = 1 if group[1] == "+" else -1
            moving = np.flatnonzero((joint[:, number] == group[0]) & (sign * steps[:, number] > 0))
            if not len(moving):
                continue
            position = q[moving, group[0] - 1]
            rows = {f"q{k}": q[moving, k - 1] for k in JOINTS} | {"session": sessions[moving]}
            rows |= dict.fromkeys(("theta", "psi"), np.zeros(len(moving)))
            rows |= {"start": position, "stop": position + sign}
            rows["session_seconds"] = seconds[moving] + time[moving, number]
            gamma = laws[group[0]].step_size(rows, position[:, None], values[group][moving])[:, 0]
            made = steps[moving, number] * deviation[group][moving]
            q[moving, group[0] - 1] = position + gamma * made
        path[:, number + 1] = q
    return path


@dataclass(frozen=True)
class Study:
    """Shares of the drives.

    Attributes
    ----------
    near : float
        That end within one rotary step and the 95 % radius of the path as commanded.
    covered : float
        Whose true tip is inside the 95 % ellipsoid.
    tolerance : float
        That half of the drives exceed, m.
    advised : float
        Of those that exceed it, with the advice before.
    off_path : float
        Median distance from the end of the commanded path, over the length of the path.
    radius : float
        Median 95 % radius, m.
    cpu : float
        Mean CPU time of a tick, s.
    """

    near: float
    covered: float
    tolerance: float
    advised: float
    off_path: float
    radius: float
    cpu: float


def evaluate(benches: Sequence[Bench], drives: Sequence[Drive], rng: np.random.Generator) -> Study:
    """Compare drives with where single steps by the true laws take the tip."""
    machine = benches[0].machine
    tips = forward(machine, step_truly(benches, drives, rng))
    ends = tips[:, -1]
    commanded = np.array([one.commanded for one in drives])
    off = np.linalg.norm(ends - commanded, axis=1)
    radius = np.array([one.state.tip_radius for one in drives])
    error = ends - np.array([one.state.tip for one in drives])
    covariance = np.array([one.state.tip_covariance for one in drives])
    distance = np.einsum("ni,nij,nj->n", error, np.linalg.pinv(covariance, rcond=1e-9), error)
    errors = [_errors_over_time(one, path) for one, path in zip(drives, tips, strict=True)]
    tolerance = float(np.median([own.max() for own in errors]))
    exceeds = [own.max() >= tolerance for own in errors]
    advised = [
        _first(np.array([state.tip_radius for state in one.shown]) >= ADVICE_SHARE * tolerance)
        < _first(own > tolerance)
        for one, own, does in zip(drives, errors, exceeds, strict=True)
        if does
    ]
    length = np.array([one.path for one in drives])
    return Study(
        near=float(np.mean(off <= ONE_STEP + radius)),
        covered=float(np.mean(distance <= CHI_SQUARED_95)),
        tolerance=tolerance,
        advised=float(np.mean(advised)),
        off_path=float(np.median(off / length)),
        radius=float(np.median(radius)),
        cpu=float(np.mean([one.cpu for one in drives])),
    )


def _errors_over_time(one: Drive, tips: Array) -> Array:
    """Distance of the true tip from where it was said to be, whenever that was shown."""
    times = np.array([made[0] for made in one.made])
    number = np.searchsorted(times, np.array([state.time for state in one.shown]) - 1e-9, side="right")
    return np.linalg.norm(tips[number] - np.array([state.tip for state in one.shown]), axis=1)


def _first(happens: BoolArray) -> float:
    return float(np.argmax(happens)) if happens.any() else np.inf


def run(
    campaigns: int, drives: int, seed: int, warm: bool = False, fitted: bool = False, constant: bool = False
) -> Study:
    """A study of so many campaigns with so many drives each.

    Parameters
    ----------
    warm : bool
        Whether the drive truly warms up by 3 %, and the drives begin 2 min after the session.
    fitted : bool
        Whether the law that drives has this cause in it.
    constant : bool
        Whether a constant step size drives instead.
    """
    plan = read_plan("data/reference/plan.toml", load_machine())
    rng = np.random.default_rng([seed, 2])
    benches, made = [], []
    for number in range(campaigns):
        bench = make_bench(plan, 1000 * seed + number, warm, fitted, 120.0)
        arm = bench.constant_arm if constant else bench.arm
        for _ in range(drives):
            benches.append(bench)
            made.append(drive(arm, draw_start(bench.machine, rng), draw_script(rng)))
    return evaluate(benches, made, rng)


def main(drives: int = 1000, seed: int = 1) -> None:
    """Print a line for each study; their drives in 20 campaigns."""
    campaigns = min(20, drives)
    print("law, truth                 near   inside   radius  off/path  tolerance  advised     tick")
    for name, how in {
        "published, as fitted": {},
        "constant step size": {"constant": True},
        "published, warms up": {"warm": True},
        "extended, warms up": {"warm": True, "fitted": True},
    }.items():
        found = run(campaigns, drives // campaigns, seed, **how)
        print(
            f"{name:24s} {100 * found.near:5.1f} % {100 * found.covered:5.1f} % {1e6 * found.radius:5.1f} µm "
            f"{100 * found.off_path:6.2f} % {1e6 * found.tolerance:7.1f} µm {100 * found.advised:6.1f} % "
            f"{1e3 * found.cpu:6.3f} ms",
            flush=True,
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
