import csv
import io

import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from stickslip_fit.logs.plan import write_sheet_csv
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine

PLAN = """
check_every = 10
[sessions]
dates = [2012-03-05, 2012-03-06]
[timing]
step_period_ms = 12.5
[[sweep]]
joint = 3
q2_deg = [-90, -33.3]
theta_deg = [0, 12.345678901]
[[sweep]]
joint = 2
q3_mm = [0, 4.1]
ranges_deg = [[0, -30.1], [-30.1, -60.7]]
[[sweep]]
joint = 1
q2_deg = -45
q3_mm = 12
psi_rad = 1
"""


@pytest.fixture
def plan(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return read_plan(path, load_machine())


@pytest.fixture
def sheet(plan, tmp_path):
    path = tmp_path / "sheet.csv"
    write_sheet_csv(plan, path)
    return path


def fill_in(sheet):
    """What a person does: a time and a count in every row, with a spreadsheet that knows only text."""
    rows = list(csv.DictReader(io.StringIO(sheet.read_text())))
    for minute, row in enumerate(rows):
        assert row["time"] == row["steps"] == row["note"] == row["status"] == ""
        row["time"] = f"{row['session']}T{8 + minute // 60:02}:{minute % 60:02}"
        row["steps"] = str(10 * (1 + minute))
    with sheet.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def test_a_filled_in_sheet_is_a_log_of_the_planned_traverses(plan, sheet):
    fill_in(sheet)
    made, planned = read_log(sheet).rows, plan.rows()
    assert list(made["steps"]) == [10 * number for number in range(1, len(planned) + 1)]
    assert list(made["session"]) == list(planned["session"])
    for name in ("joint", "direction", "check_every"):
        assert list(made[name]) == list(planned[name])
    numbers = ["q1", "q2", "q3", "theta", "psi", "start", "stop", "step_period"]
    pd.testing.assert_frame_equal(made[numbers], planned[numbers], rtol=1e-9, atol=1e-12)


def test_an_empty_sheet_misses_exactly_its_times_and_steps(plan, sheet):
    with pytest.raises(InputError) as caught:
        read_log(sheet)
    count = len(plan.rows())
    told = {problem.column: problem.message for problem in caught.value.problems}
    assert told.keys() == {"time", "steps"}
    assert all(
        f"{count} of {count} values are faulty, the first one in line 2" in said for said in told.values()
    )


def test_a_sheet_that_cannot_be_written_names_its_path(plan, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_sheet_csv(plan, tmp_path / "no" / "sheet.csv")
