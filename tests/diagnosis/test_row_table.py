"""What follows from rows alone is computed once, and anew for other rows."""

import pickle

import numpy as np
import pandas as pd

from stickslip_fit.diagnosis.carriers import find_carriers
from stickslip_fit.diagnosis.misfit import StructureRemoved
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.row_table import RowTable


def test_it_is_computed_once_for_each_thing_that_is_given():
    table, calls = RowTable(pd.DataFrame({"steps": [1, 2, 3]})), []

    def above(own, least):
        calls.append(least)
        return int((own.frame["steps"] > least).sum())

    assert [table.once(above, least) for least in (1, 2, 1, 2)] == [2, 1, 2, 1]
    assert calls == [1, 2]


def test_what_is_known_is_not_sent_to_other_processes():
    table = RowTable(pd.DataFrame({"steps": np.arange(10)}))
    before = len(pickle.dumps(table))
    assert table.once(lambda own: np.ones((1000, len(own)))).shape == (1000, 10)
    table.subset(np.arange(5))["steps"]
    assert len(pickle.dumps(table)) == before
    pd.testing.assert_frame_equal(pickle.loads(pickle.dumps(table)).frame, table.frame)


def test_fits_in_other_noise_share_it_and_fits_of_fewer_rows_do_not(drifting):
    problem, kept = problem_from_log(drifting)[0], np.arange(40)
    find_carriers(problem.table)
    linearized = problem.linearize()
    left = StructureRemoved(linearized.residual, np.zeros(len(problem)))
    assert problem.with_noise(problem.estimate_noise(linearized, left)).linearize().table is problem.table
    alone = RowTable(problem.rows.iloc[kept].reset_index(drop=True))
    for one, other in zip(find_carriers(problem.select_rows(kept).table), find_carriers(alone), strict=True):
        assert (one.name, one.low, one.high) == (other.name, other.low, other.high)
        assert len(one.values) == len(kept)
        np.testing.assert_array_equal(one.values, other.values)
