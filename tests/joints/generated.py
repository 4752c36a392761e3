"""Machines of any joints and their logs, generated here without the package."""

import csv
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

UNITS = {"rotary": "deg", "prismatic": "mm"}
# A step without scatter, in the unit of the joint's positions, in each direction; 2 % more each session.
STEPS = {"rotary": {"+": 0.011, "-": 0.0095}, "prismatic": {"+": 1.1e-4, "-": 0.95e-4}}
GROWTH = 0.02
MACHINES = {
    "one slide": ([("prismatic", (0.0, 25.0))]),
    "another order": [("prismatic", (0.0, 25.0)), ("rotary", (-90.0, 90.0)), ("rotary", (0.0, 360.0))],
    "six joints": [
        *(("rotary", ends) for ends in ((-180.0, 180.0), (-90.0, 90.0), (0.0, 360.0))),
        *(("prismatic", ends) for ends in ((0.0, 10.0), (0.0, 20.0), (-5.0, 5.0))),
    ],
    "two turns": [("rotary", (0.0, 720.0)), ("rotary", (-360.0, 360.0))],
}


def machine_text(joints) -> str:
    """A machine file."""
    return "".join(
        f'[[joint]]\nkind = "{kind}"\nrange_{UNITS[kind]} = [{low}, {high}]\n' for kind, (low, high) in joints
    )


def write_log(
    path: Path, joints, *, timed=True, sessions=3, n=8, scatter=0.01, drift=0.0, seed=0, cross=None
) -> None:
    """A log of partial traverses, none of which repeats another; `drift` per hour of a session.

    With `cross`, (joint, other joint, slope), the step of the first grows by that slope for each mm or degree
    of the second, and joints that do not move stand anywhere.
    """
    rng = np.random.default_rng(seed)
    kinds = dict.fromkeys(UNITS[kind] for kind, _ in joints)
    columns = ["session", *(["time"] if timed else []), "joint", "direction", "steps", "check_every"]
    columns += [f"q{number}_{UNITS[kind]}" for number, (kind, _) in enumerate(joints, start=1)]
    columns += [f"{end}_{unit}" for unit in kinds for end in ("from", "to")]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        for session in range(sessions):
            begin = moment = datetime(2026, 3, 2 + session, 9)
            for index in rng.permutation(len(joints) * n):
                number = 1 + int(index) % len(joints)
                kind, (low, high) = joints[number - 1]
                for direction in "+-":
                    ends = low + (high - low) * np.array([0.45, 0.55] + rng.uniform(-0.4, 0.4, 2) * [1, -1])
                    start, stop = sorted(map(float, ends), reverse=direction == "-")
                    hours = (moment - begin).total_seconds() / 3600
                    step = STEPS[kind][direction] * (1 + GROWTH * session) * (1 + drift * hours)
                    row = {}
                    for k, (other, e) in enumerate(joints, start=1):
                        if k != number:
                            at = sum(e) / 2 if cross is None else round(rng.uniform(*e), 2)
                            row[f"q{k}_{UNITS[other]}"] = at
                            step *= 1 + cross[2] * at if cross and cross[:2] == (number, k) else 1
                    steps = round(abs(stop - start) / step * np.exp(scatter * rng.standard_normal()))
                    row |= {"session": f"2026-03-0{2 + session}", "joint": number, "direction": direction}
                    row |= {"steps": steps, "check_every": 1}
                    row |= {f"from_{UNITS[kind]}": repr(start), f"to_{UNITS[kind]}": repr(stop)}
                    writer.writerow(row | ({"time": moment.isoformat()} if timed else {}))
                    moment += timedelta(minutes=3)
