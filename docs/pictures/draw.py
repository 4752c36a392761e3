"""The picture of README and front page: ``python docs/pictures/draw.py``.

The reference campaign is simulated with a warm-up in it. On the left are the residuals of the published law,
on the right those of the law extended by the cause that `diagnose` names.
"""

import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import stickslip_fit as ssf
from stickslip_fit.diagnosis import Finding
from stickslip_fit.plotting.sides import rms
from stickslip_fit.units import from_si

HERE = Path(__file__).parent
REFERENCE = HERE.parents[1] / "data" / "reference"
HIDDEN = '\n[[cause]]\nname = "thermal-warm-up"\nA = "3 %"\ntau = "90 min"\n'
TRUTH = "hidden: A = 3 %, tau = 90 min"

# Okabe and Ito's palette, lightened for dark pages.
PALETTES = {
    "light": {"ink": "#222222", "soft": "#6f6f6f", "grid": "#e3e3e3", "+": "#0072B2", "-": "#D55E00"},
    "dark": {"ink": "#e6e6e6", "soft": "#9a9a9a", "grid": "#3a3a3a", "+": "#56B4E9", "-": "#E69F00"},
}
MARKERS = {"+": "o", "-": "s"}
WIDTH, HEIGHT = 7.6, 2.75  # inches
DPI = 200  # twice what it is shown with


def main() -> None:
    """Draw both versions beside this file."""
    with tempfile.TemporaryDirectory() as folder:
        log = simulate_campaign(Path(folder))
    diagnosis = ssf.diagnose(log, gain=False)
    (finding,) = diagnosis.findings
    before, after = residuals(ssf.fit(log)), residuals(diagnosis.extended_law())
    for name, palette in PALETTES.items():
        with mpl.rc_context(_style(palette)):
            figure = draw(log, before, after, finding, palette)
            figure.savefig(
                HERE / f"diagnosis-{name}.png", dpi=DPI, transparent=True, metadata={"Software": None}
            )


def simulate_campaign(folder: Path) -> ssf.Log:
    """The reference campaign with a warm-up in it."""
    machine, law = ssf.load_machine(), folder / "law.toml"
    law.write_text((REFERENCE / "law.toml").read_text("utf-8") + HIDDEN, "utf-8")
    plan = ssf.read_plan(REFERENCE / "plan.toml", machine)
    ssf.write_log(ssf.simulate(plan, ssf.read_law_values(law, machine), machine), folder / "log.csv")
    return ssf.read_log(folder / "log.csv")


def residuals(fit: ssf.Result) -> pd.Series:
    """Residuals of the counts, per cent."""
    return 100 * np.expm1(fit.residuals["residual"])


def draw(
    log: ssf.Log, before: pd.Series, after: pd.Series, finding: Finding, palette: dict[str, str]
) -> Figure:
    """Residuals over time, before and after."""
    figure = Figure(figsize=(WIDTH, HEIGHT))
    axes = figure.subplots(1, 2, sharey=True)
    sizes = ", ".join(
        f"{parameter.name} = {from_si(parameter.size.estimate, parameter.unit):.{digits}f} {parameter.unit}"
        for parameter, digits in zip(finding.parameters, (1, 0), strict=True)
    )
    titles = {
        f"Published law: residuals {rms(before):.2f} % rms": before,
        f"With {finding.cause}: {rms(after):.2f} % rms": after,
    }
    for axis, (title, percent) in zip(axes, titles.items(), strict=True):
        _panel(axis, log, percent, palette)
        axis.set_title(title, loc="left", color=palette["ink"])
    axes[1].text(0.98, 0.93, f"estimate: {sizes}\n{TRUTH}", ha="right", va="top", transform=axes[1].transAxes)
    axes[0].set_ylabel("residual of the count (%)")
    axes[0].legend(loc="upper right", ncols=1, markerscale=2.0, handletextpad=0.1, columnspacing=1.0)
    figure.subplots_adjust(left=0.075, right=0.995, top=0.9, bottom=0.165, wspace=0.05)
    return figure


def _panel(axis: Axes, log: ssf.Log, percent: pd.Series, palette: dict[str, str]) -> None:
    rows = log.usable
    hours = from_si(rows["session_seconds"].to_numpy(float), "h")
    axis.axhline(0.0, color=palette["soft"], lw=0.8)
    for direction, marker in MARKERS.items():
        subset = (rows["direction"] == direction).to_numpy()
        label = f"direction {'−' if direction == '-' else direction}"
        style = {"ls": "", "marker": marker, "ms": 2.2, "mew": 0, "alpha": 0.75}
        axis.plot(hours[subset], percent.to_numpy()[subset], color=palette[direction], label=label, **style)
    axis.set_xlabel("hours since the session began")
    axis.set_xlim(-0.4, 21.6)
    axis.set_xticks(range(0, 21, 4))


def _style(palette: dict[str, str]) -> dict[str, object]:
    edges = ("axes.labelcolor", "text.color", "xtick.color", "ytick.color")
    colours = dict.fromkeys(edges, palette["ink"]) | {
        "axes.edgecolor": palette["soft"],
        "grid.color": palette["grid"],
    }
    lines = {"axes.grid": True, "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False}
    return {"font.size": 8.5, "axes.titlesize": 8.5, "legend.frameon": False} | colours | lines


if __name__ == "__main__":
    main()
