"""Every command: where it is, what it does in one line, and an example to copy. None is imported here."""

from __future__ import annotations

from typing import Any, NamedTuple


class CommandEntry(NamedTuple):
    """A command of the app.

    Attributes
    ----------
    module : str
        Of `stickslip_fit.cli`; the command is its function of the same name, or its `app`.
    line : str
        What it does, for the list of commands.
    example : str
        Without the program's name; empty where the command has commands of its own.
    """

    module: str
    line: str
    example: str


COMMANDS = {
    "check": CommandEntry(
        "logs", "Check a log for faults and summarize it.", "check data/reference/campaign.csv"
    ),
    "calibrate": CommandEntry(
        "fit",
        "Calibrate each session from its first few traverses.",
        "calibrate data/reference/campaign.csv --json today.json",
    ),
    "fit": CommandEntry(
        "fit",
        "Fit the laws' parameters for each session and direction.",
        "fit data/reference/campaign.csv --json fit.json",
    ),
    "predict": CommandEntry(
        "moves",
        "Predict the counts of a plan's traverses.",
        "predict fit.json data/reference/plan.toml -o counts.csv",
    ),
    "changed": CommandEntry(
        "changes",
        "Test whether an actuator has changed between two logs.",
        "changed march.csv november.csv",
    ),
    "anova": CommandEntry(
        "diagnose",
        "Analyse the variance: day, direction, force, position.",
        "anova data/reference/campaign.csv --joint 3 --full",
    ),
    "diagnose": CommandEntry(
        "diagnose",
        "Find what the laws miss in a log, its cause and the gain.",
        "diagnose data/reference/campaign.csv --json d.json",
    ),
    "diagnose-table": CommandEntry(
        "diagnose",
        "The same for any table and a law of your own.",
        "diagnose-table bench.csv --law friction.toml --time t",
    ),
    "report": CommandEntry(
        "logs",
        "Write the whole report of a log: one HTML page.",
        "report data/reference/campaign.csv -o report.html",
    ),
    "compare": CommandEntry(
        "strategies",
        "Compare calibration strategies by their held-out errors.",
        "compare data/reference/campaign.csv --chart time.png",
    ),
    "study": CommandEntry(
        "strategies",
        "Compare them on simulated campaigns with hidden causes.",
        "study data/reference/study.toml --campaigns 3 -o study",
    ),
    "simulate": CommandEntry(
        "logs",
        "Simulate a plan under a law; the same seed, the same log.",
        "simulate data/reference/plan.toml --law data/reference/law.toml -o log.csv",
    ),
    "plan": CommandEntry(
        "diagnose", "Propose the most informative next traverses.", "plan --example -o my-plan.toml"
    ),
    "sheet": CommandEntry(
        "logs", "Write a sheet for counts taken by hand.", "sheet my-plan.toml -o sheet.csv"
    ),
    "plan-move": CommandEntry(
        "moves",
        "Compute the steps that take the tip to a position.",
        "plan-move fit.json --at 0,-90,0 --joints 0,-60,6",
    ),
    "dead-reckon": CommandEntry(
        "moves",
        "Compute where the tip is after a run of drives.",
        "dead-reckon fit.json --at 0,-90,0 --drive 3+5000",
    ),
    "accuracy-map": CommandEntry(
        "moves",
        "Compute how far from its goal a move may end.",
        "accuracy-map fit.json --chart map.svg",
    ),
    "drive": CommandEntry(
        "drive",
        "Drive the tip by hand, and see where it is and how surely.",
        "drive fit.json --at 0,-90,6 --script path.csv --emulate",
    ),
    "compare-laws": CommandEntry(
        "changes",
        "Compare the published laws with physical ones.",
        "compare-laws data/reference/campaign.csv",
    ),
    "step": CommandEntry(
        "step",
        "Compute a stage's step from its physics.",
        "step my-stage.toml --chart step.svg",
    ),
    "demo": CommandEntry(
        "demo",
        "Find an effect hidden in a simulated campaign, step by step.",
        "demo data/reference/campaign.csv",
    ),
    "capture": CommandEntry("capture", "Drive the joints, detect the end stops, write the log.", ""),
}
CAPTURE_EXAMPLES = {
    "plan": "capture plan my-plan.toml -o log.csv --emulate --ideal-detector",
    "tune": "capture tune -o tuning.json --emulate",
    "listen": "capture listen stop.wav --tuning tuning.json",
}

APP_SETTINGS: dict[str, Any] = {
    "no_args_is_help": True,
    "add_completion": False,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


def format_example(example: str) -> str:
    """The end of a command's help."""
    # The letter \\b keeps the line as it is.
    return f"\b\nExample:\n  stickslip-fit {example}"
