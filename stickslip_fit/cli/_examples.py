"""A line to copy for each command, at the end of its help."""

from __future__ import annotations

EXAMPLES = {
    "check": "check data/reference/campaign.csv",
    "calibrate": "calibrate data/reference/campaign.csv --json today.json",
    "fit": "fit data/reference/campaign.csv --json fit.json",
    "predict": "predict fit.json data/reference/plan.toml -o counts.csv",
    "changed": "changed march.csv november.csv",
    "anova": "anova data/reference/campaign.csv --joint 3 --full",
    "diagnose": "diagnose data/reference/campaign.csv --json d.json",
    "diagnose-table": "diagnose-table bench.csv --law friction.toml --time t",
    "report": "report data/reference/campaign.csv -o report.html",
    "compare-laws": "compare-laws data/reference/campaign.csv --json laws.json",
    "compare": "compare data/reference/campaign.csv --chart time.png",
    "study": "study data/reference/study.toml --campaigns 3 -o study",
    "simulate": "simulate data/reference/plan.toml --law data/reference/law.toml -o log.csv",
    "plan": "plan --example -o my-plan.toml",
    "sheet": "sheet my-plan.toml -o sheet.csv",
    "plan-move": "plan-move fit.json --at 0,-90,0 --joints 0,-60,6",
    "dead-reckon": "dead-reckon fit.json --at 0,-90,0 --drive 3+5000",
    "accuracy-map": "accuracy-map fit.json --chart map.svg",
    "demo": "demo data/reference/campaign.csv",
    "capture plan": "capture plan my-plan.toml -o log.csv --emulate --ideal-detector",
    "capture tune": "capture tune -o tuning.json --emulate",
    "capture listen": "capture listen stop.wav --tuning tuning.json",
}


def example_of(command: str) -> str:
    """The end of a command's help."""
    # The letter \\b keeps the line as it is.
    return f"\b\nExample:\n  stickslip-fit {EXAMPLES[command]}"
