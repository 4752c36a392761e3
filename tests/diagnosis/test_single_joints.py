"""A stage with two guides and two turntables: what is wrong with one joint has its name there."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.estimation import load_result
from stickslip_fit.logs import read_log
from stickslip_fit.machine import load_machine

MACHINE = """[[joint]]
kind = "prismatic"
range_mm = [0.0, 40.0]
[[joint]]
kind = "prismatic"
range_mm = [-10.0, 10.0]
[[joint]]
kind = "rotary"
range_deg = [0.0, 350.0]
[[joint]]
kind = "rotary"
range_deg = [-120.0, 120.0]
"""
RANGES, UNITS = (
    {1: (0.0, 40.0), 2: (-10.0, 10.0), 3: (0.0, 350.0), 4: (-120.0, 120.0)},
    {1: "mm", 2: "mm", 3: "deg", 4: "deg"},
)
STEPS = {1: 700e-6, 2: 820e-6, 3: 0.0034, 4: 0.005}  # mm and deg
N, SESSIONS, NOISE = 400, 4, 0.008


def spot(x, outward):
    return 1 - 0.2 * np.exp(-(((x - 3) / 0.6) ** 2) / 2)


def gradient(x, outward):
    return 1 + 0.003 * (x - 20)


def runout(x, outward):
    return 1 + 0.03 * np.cos(np.radians(x - 70))


def cable(x, outward):
    return 1 + (0.04 if outward else -0.04) * (x - 175) / 175


def drive(profiles, seed):
    """Counts over partial traverses of all joints; `profiles` by joint."""
    rng, rows = np.random.default_rng(seed), []
    for k in range(N):
        session, place = divmod(k, N // SESSIONS)
        joint, outward = int(rng.integers(1, 5)), rng.random() < 0.5
        low, high = RANGES[joint]
        near = rng.uniform(low, high - 0.1 * (high - low))
        far = min(high, near + rng.uniform(0.08, 0.35) * (high - low))
        x = np.linspace(near, far, 1000)
        step = STEPS[joint] * (1.0 if outward else 0.96) * (1 + 0.02 * np.sin(session + joint))
        steps = np.trapezoid(1 / profiles.get(joint, lambda x, _: 1 + 0 * x)(x, outward), x) / step
        start = pd.Timestamp("2026-03-02T09:00:00") + pd.Timedelta(days=session, minutes=1.2 * place)
        ends = (near, far) if outward else (far, near)
        rows.append(
            {
                "session": f"{start:%Y-%m-%d}",
                "time": start.isoformat(),
                "joint": joint,
                "direction": "+" if outward else "-",
                "steps": round(steps * (1 + NOISE * rng.standard_normal())),
                "check_every": 1,
                **{f"q{one}_{UNITS[one]}": rng.uniform(*RANGES[one]) for one in RANGES if one != joint},
                f"from_{UNITS[joint]}": ends[0],
                f"to_{UNITS[joint]}": ends[1],
            }
        )
    return pd.DataFrame(rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "profile", "cause", "sizes"),
    [
        pytest.param(2, spot, "worn-spot", {"A": -0.2, "x0": 3e-3, "w": 0.6e-3}, id="spot"),
        pytest.param(
            3,
            runout,
            "bearing-runout",
            {"A": 0.03, "phi": np.radians(70)},
            id="runout",
            marks=pytest.mark.nightly,
        ),
        pytest.param(1, gradient, "guide-gradient", {"k": 3.0}, id="gradient", marks=pytest.mark.nightly),
        pytest.param(
            3, cable, "cable-torque", {"k": 0.04 * STEPS[3] / 175}, id="cable", marks=pytest.mark.nightly
        ),
    ],
)
def test_it_is_named_with_its_joint_and_size(joint, profile, cause, sizes, tmp_path):
    (tmp_path / "stage.toml").write_text(MACHINE, encoding="utf-8")
    drive({joint: profile}, seed=2).to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv", machine=load_machine(tmp_path / "stage.toml"))
    found = diagnose(log, gain=False)
    (finding,) = found.findings
    assert (finding.cause, finding.joints) == (cause, (joint,))
    # A wide spot at one end of a guide is much like a gradient.
    assert set(finding.equivalent) <= ({"worn-spot"} if profile is gradient else set())
    for parameter in finding.parameters:
        truth, margin = sizes[parameter.name], parameter.size.high - parameter.size.low
        assert abs(parameter.size.estimate - truth) < margin  # twice the half-width: 4 standard errors
    assert f"joint {joint}'s steps" in str(found).lower()


def late(frame, rng):
    """The detector stands at joint 2, and hears its end stop late."""
    frame.loc[frame["joint"] == 2, "steps"] += 150
    return "end-stop-latency", 2


def backlash(frame, rng):
    """Only joint 4 loses steps where it turns round."""
    frame["steps"] += 70 * (frame["joint"].eq(4) & turns_round(frame))
    return "reversal-loss", 4


def vacuum(frame, rng):
    """A column of the lab's own that joint 1 follows."""
    frame["vacuum_Pa"] = 2.0 + 0.2 * rng.standard_normal(len(frame)).cumsum().round(2)
    score = (frame["vacuum_Pa"] - frame["vacuum_Pa"].mean()) / frame["vacuum_Pa"].std()
    frame["steps"] = (frame["steps"] / (1 + 0.02 * score * frame["joint"].eq(1))).round().astype(int)
    return "covariate:vacuum_Pa", 1


def turns_round(frame):
    before = frame.groupby(["session", "joint"])["direction"].shift()
    return before.notna() & (before != frame["direction"])


@pytest.mark.slow
@pytest.mark.parametrize("hide", [late, pytest.param(backlash, marks=pytest.mark.nightly), vacuum])
def test_what_acts_on_one_joint_only_is_named_there(hide, tmp_path):
    (tmp_path / "stage.toml").write_text(MACHINE, encoding="utf-8")
    frame = drive({}, seed=3)
    cause, joint = hide(frame, np.random.default_rng(0))
    frame.to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv", machine=load_machine(tmp_path / "stage.toml"))
    found = diagnose(log, gain=False)
    assert [(one.cause, one.joints) for one in found.findings] == [(cause, (joint,))]
    assert f"at joint {joint} only" in " ".join(str(found).split())
    law = found.extended_law()
    law.save(tmp_path / "law.json")
    again = load_result(tmp_path / "law.json")
    (acting,) = again.joints[joint].law.causes
    assert [one for one, fit in again.joints.items() if acting.acts_on(fit.law)] == [joint]
