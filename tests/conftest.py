"""A campaign made without the laws' code, so that what fits it is tested and not echoed."""

import gc
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from stickslip_fit import cli
from stickslip_fit.logs import Log, read_log
from stickslip_fit.machine import Machine, load_machine

# Tests run side by side as it is: where "as many processes as cores" is the default, that is one.
os.environ["LOKY_MAX_CPU_COUNT"] = "1"
# Where it is installed, jsonschema builds a grammar of addresses: 3 s in each process, and no schema has one.
sys.modules["rfc3987_syntax"] = None  # type: ignore[assignment]

FULL = {1: (-120.0, 120.0), 2: (-210.0, 30.0), 3: (0.0, 12.0)}
PLACE = (
    *("joint", "direction", "q1_deg", "q2_deg", "q3_mm", "theta_deg", "psi_deg"),
    *("from_deg", "to_deg", "from_mm", "to_mm"),
)


def pytest_configure() -> None:
    """Collect no garbage while tests are collected: next to nothing of that is garbage."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Look for garbage among what tests make, and not again and again among all modules and tests."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@dataclass(frozen=True)
class Truth:
    """The parameters of each joint and direction: a, b, c in nm; gamma0 and d in µrad (per mm of reach)."""

    prismatic: dict[str, tuple[float, float, float]] = field(
        default_factory=lambda: {"+": (976.0, 0.30, 438.0), "-": (903.0, 0.27, -405.0)}
    )
    elbow: dict[str, tuple[float, float, float, float]] = field(
        default_factory=lambda: {"+": (95.0, 90.0, -15.0, -19.85), "-": (94.0, 91.0, 19.6, 25.91)}
    )
    base: dict[str, tuple[float, float, float, float]] = field(
        default_factory=lambda: {"+": (97.0, -0.05, -1.0, -0.35), "-": (96.0, -0.04, 1.2, 0.45)}
    )

    def step_size(
        self, joint: int, direction: str, q: tuple[float, float, float], base: tuple[float, float]
    ) -> float:
        """Step size in nm or µrad at joint positions in deg, deg, mm and base angles in deg."""
        q1, q2 = np.radians(q[0]), np.radians(q[1])
        theta, psi = np.radians(base)
        if joint == 3:
            a, b, c = self.prismatic[direction]
            return (1 - b * abs(np.cos(q2))) * (a - c * np.cos(psi - q2) * np.cos(theta))
        if joint == 2:
            near, far, d_near, d_far = self.elbow[direction]
            out = q[2] / 12.0
            d = d_near * (1 - out) + d_far * out
            return near * (1 - out) + far * out + d * np.sin(psi - q2) * np.cos(theta)
        zero, per_mm, d_zero, d_per_mm = self.base[direction]
        rho = -(37.5 + q[2]) * np.sin(q2)
        load = np.cos(theta) * np.sin(psi) * np.sin(q1) + np.sin(theta) * np.cos(q1)
        return zero + per_mm * rho + (d_zero + d_per_mm * rho) * load

    def steps(self, row: dict[str, object]) -> float:
        """Steps over a traverse given in a log file's columns, by scipy's quadrature."""
        joint, direction = int(str(row["joint"])), str(row["direction"])
        unit = "mm" if joint == 3 else "deg"
        start, stop = (float(row[f"{end}_{unit}"]) for end in ("from", "to"))
        position = [float(row["q1_deg"]), float(row["q2_deg"]), float(row["q3_mm"])]
        base = (float(row["theta_deg"]), float(row["psi_deg"]))

        def pace(x: float) -> float:
            there = position.copy()
            there[joint - 1] = x
            step = self.step_size(joint, direction, (there[0], there[1], there[2]), base)
            return (1e6 if joint == 3 else np.radians(1.0) * 1e6) / step

        return abs(quad(pace, start, stop, epsabs=1e-6, epsrel=1e-11)[0])


CALIBRATION_3 = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0},
)
CALIBRATION = (
    *CALIBRATION_3,
    {"joint": 2, "q3_mm": 0.0},
    {"joint": 2, "q3_mm": 12.0},
    {"joint": 2, "q3_mm": 12.0, "theta_deg": -90.0},
    {"joint": 2, "q3_mm": 0.0, "theta_deg": -90.0},
    {"joint": 1, "q2_deg": -90.0, "q3_mm": 0.0},
    {"joint": 1, "q2_deg": -90.0, "q3_mm": 12.0},
    {"joint": 1, "q2_deg": -90.0, "q3_mm": 0.0, "theta_deg": -90.0},
    {"joint": 1, "q2_deg": -90.0, "q3_mm": 12.0, "theta_deg": -90.0},
)
SWEEPS = (
    *(
        {"joint": 3, "q2_deg": q2, "theta_deg": theta}
        for q2 in (-30.0, -60.0, -150.0)
        for theta in (0.0, -45.0)
    ),
    *({"joint": 3, "q2_deg": -90.0, "psi_deg": psi} for psi in (-60.0, 45.0)),
    *(
        {"joint": 2, "q3_mm": 6.0, "from_deg": start, "to_deg": start - 60.0}
        for start in (0.0, -60.0, -120.0)
    ),
    *({"joint": 2, "q3_mm": 3.0, "psi_deg": psi} for psi in (-45.0, 30.0)),
    *({"joint": 1, "q2_deg": -45.0, "q3_mm": 6.0, "theta_deg": -theta} for theta in (0.0, 30.0, 60.0, 90.0)),
)


@pytest.fixture(scope="session")
def campaign() -> Callable[..., pd.DataFrame]:
    """A maker of campaigns in a log file's columns and units."""
    expected: dict[tuple[object, ...], float] = {}  # the quadrature takes longest, and traverses come again

    def steps_of(truth: Truth, row: dict[str, object]) -> float:
        key = (repr(truth), *(row[name] for name in PLACE))
        if key not in expected:
            expected[key] = truth.steps(row)
        return expected[key]

    def make(
        sessions: tuple[str, ...] = ("2012-03-05", "2012-03-06"),
        settings: tuple[dict[str, object], ...] = CALIBRATION + SWEEPS,
        directions: tuple[str, ...] = ("+", "-"),
        replicates: int = 2,
        repeatability: float = 0.0027,
        check_every: int = 5,
        truth: Truth | None = None,
        seed: int = 20120305,
    ) -> pd.DataFrame:
        truth, rng = truth or Truth(), np.random.default_rng(seed)
        rows = []
        for session in sessions:
            clock = pd.Timestamp(f"{session}T08:30:00")
            for _ in range(replicates):
                for setting in settings:
                    for direction in directions:
                        row = _row(session, clock, direction, setting, check_every)
                        steps = steps_of(truth, row) * np.exp(repeatability * rng.standard_normal())
                        checks = np.ceil(steps / check_every) if check_every > 1 else np.round(steps)
                        row["steps"] = int(checks) * check_every
                        rows.append(row)
                        clock += pd.Timedelta(seconds=int(steps * 0.01) + 90)
        return pd.DataFrame(rows)

    return make


@pytest.fixture(scope="session")
def read_table(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Log]:
    """A reader of a table in a log file's columns and units."""

    def read(table: pd.DataFrame, name: str = "log.csv") -> Log:
        path = tmp_path_factory.mktemp("log") / name
        table.to_csv(path, index=False)
        return read_log(path)

    return read


@pytest.fixture(scope="session")
def machine_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str | bytes], Machine]:
    """A reader of what stands in a machine file."""

    def read(content: str | bytes) -> Machine:
        path = tmp_path_factory.mktemp("machine") / "mine.toml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return load_machine(path)

    return read


def _row(
    session: str, clock: pd.Timestamp, direction: str, setting: dict[str, object], check_every: int
) -> dict[str, object]:
    joint = int(str(setting["joint"]))
    unit = "mm" if joint == 3 else "deg"
    low, high = FULL[joint]
    ends = (setting.get(f"from_{unit}", high), setting.get(f"to_{unit}", low))
    if direction == "+":
        ends = ends[::-1]
    defaults = {"q1_deg": 0.0, "q2_deg": -90.0, "q3_mm": 0.0, "theta_deg": 0.0, "psi_deg": 0.0}
    row = {"session": session, "time": clock.isoformat(), "joint": joint, "direction": direction, "steps": 0}
    row |= {name: setting.get(name, value) for name, value in defaults.items()}
    row |= {"from_deg": "", "to_deg": "", "from_mm": "", "to_mm": "", "check_every": check_every}
    row[f"from_{unit}"], row[f"to_{unit}"] = ends
    return row


@pytest.fixture
def run(monkeypatch, capsys):
    """Run the command line in this process; status, what it printed, what it complained."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["stickslip-fit", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return call


@pytest.fixture
def refused(run):
    """Run the command line, which has to end with status 2; what it complained."""

    def call(*arguments: object) -> str:
        status, _, complaint = run(*arguments)
        assert status == 2
        return complaint

    return call
