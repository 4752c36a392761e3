"""The picture of README and front page: ``python docs/pictures/draw.py``.

The reference campaign is simulated once more with a warm-up hidden in it. On the left is what the published
law leaves over, on the right what is left once `diagnose` has named the cause.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stickslip_fit.diagnosis import Finding, diagnose
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.logs import Log, read_log, write_log
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values, simulate
from stickslip_fit.units import from_si

HERE = Path(__file__).parent
REFERENCE = HERE.parents[1] / "data" / "reference"
HIDDEN = '\n[[cause]]\nname = "thermal-warm-up"\nA = "3 %"\ntau = "90 min"\n'
SAID = "hidden: A = 3 %, tau = 90 min"

# Okabe and Ito's palette, lightened for dark pages.
LOOKS = {
    "light": {"ink": "#222222", "soft": "#6f6f6f", "grid": "#e3e3e3", "+": "#0072B2", "-": "#D55E00"},
    "dark": {"ink": "#e6e6e6", "soft": "#9a9a9a", "grid": "#3a3a3a", "+": "#56B4E9", "-": "#E69F00"},
}
MARKERS = {"+": "o", "-": "s"}
WIDE, TALL = 7.6, 2.75  # inches
DOTS = 200  # an inch: twice as many as it is shown with


def main() -> None:
    """Draw both versions beside this file."""
    with tempfile.TemporaryDirectory() as folder:
        log = hidden_campaign(Path(folder))
    (found,) = diagnose(log, gain=False).findings
    before, after = left_over(log), left_over(log, found)
    for name, look in LOOKS.items():
        with mpl.rc_context(_style(look)):
            figure = draw(log, before, after, found, look)
            figure.savefig(
                HERE / f"diagnosis-{name}.png", dpi=DOTS, transparent=True, metadata={"Software": None}
            )


def hidden_campaign(folder: Path) -> Log:
    """The reference campaign with a warm-up in it."""
    machine, law = load_machine(), folder / "law.toml"
    law.write_text((REFERENCE / "law.toml").read_text("utf-8") + HIDDEN, "utf-8")
    plan = read_plan(REFERENCE / "plan.toml", machine)
    write_log(simulate(plan, read_law_values(law, machine), machine), folder / "log.csv")
    return read_log(folder / "log.csv")


def left_over(log: Log, found: Finding | None = None) -> pd.Series:
    """Departures of each count from the law, per cent, recalibrated with or without what was found."""
    causes = () if found is None else (found.version,)
    return 100 * np.expm1(fit_least_squares(log, causes=causes).residuals["residual"])


def draw(log: Log, before: pd.Series, after: pd.Series, found: Finding, look: dict[str, str]) -> Figure:
    """Residuals over time, before and after."""
    figure = Figure(figsize=(WIDE, TALL))
    axes = figure.subplots(1, 2, sharey=True)
    sizes = ", ".join(
        f"{each.name} = {from_si(each.size.estimate, each.unit):.{digits}f} {each.unit}"
        for each, digits in zip(found.parameters, (1, 0), strict=True)
    )
    titles = {
        f"Published law: {_rms(before):.2f} % rms left": before,
        f"With {found.cause}: {_rms(after):.2f} % rms left": after,
    }
    for axis, (title, departures) in zip(axes, titles.items(), strict=True):
        _panel(axis, log, departures, look)
        axis.set_title(title, loc="left", color=look["ink"])
    axes[1].text(0.98, 0.93, f"found: {sizes}\n{SAID}", ha="right", va="top", transform=axes[1].transAxes)
    axes[0].set_ylabel("steps counted less law (%)")
    axes[0].legend(loc="upper right", ncols=1, markerscale=2.0, handletextpad=0.1, columnspacing=1.0)
    figure.subplots_adjust(left=0.075, right=0.995, top=0.9, bottom=0.165, wspace=0.05)
    return figure


def _panel(axis: Axes, log: Log, departures: pd.Series, look: dict[str, str]) -> None:
    rows = log.usable
    hours = from_si(rows["session_seconds"].to_numpy(float), "h")
    axis.axhline(0.0, color=look["soft"], lw=0.8)
    for way, marker in MARKERS.items():
        subset = (rows["direction"] == way).to_numpy()
        y = departures.to_numpy()[subset]
        label = f"direction {'−' if way == '-' else way}"
        axis.plot(
            hours[subset], y, ls="", marker=marker, ms=2.2, mew=0, alpha=0.75, color=look[way], label=label
        )
    axis.set_xlabel("hours since the session began")
    axis.set_xlim(-0.4, 21.6)
    axis.set_xticks(range(0, 21, 4))


def _rms(departures: pd.Series) -> float:
    return float(np.sqrt(np.mean(departures**2)))


def _style(look: dict[str, str]) -> dict[str, object]:
    return {
        "font.size": 8.5, "axes.titlesize": 8.5, "legend.frameon": False,
        "text.color": look["ink"], "axes.labelcolor": look["ink"], "axes.edgecolor": look["soft"],
        "xtick.color": look["ink"], "ytick.color": look["ink"], "axes.grid": True, "axes.axisbelow": True,
        "grid.color": look["grid"], "axes.spines.top": False, "axes.spines.right": False,
    }  # fmt: skip


if __name__ == "__main__":
    main()
