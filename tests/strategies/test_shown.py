"""The comparison as a notebook shows it."""

from __future__ import annotations

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.report.claimed import claimed_table, claimed_text
from stickslip_fit.report.figures.pareto import pareto_picture
from stickslip_fit.strategies import ClosedForm, ConstantStep, LeastSquares, Thesis, compare
from stickslip_fit.strategies.designs import AtRandom


@pytest.fixture(scope="module")
def found(log):
    return compare(log, [ConstantStep(), ClosedForm(), LeastSquares(Thesis(), 2)])


def test_the_picture_has_every_strategy_the_bound_and_the_floor(found):
    figure = found.plot_pareto()
    assert [axis.get_title() for axis in figure.axes] == [
        "joint 1 (rotary)", "joint 2 (rotary)", "joint 3 (prismatic)"
    ]  # fmt: skip
    accuracy = found.accuracy().merge(found.cost(), on=["joint", "strategy"], suffixes=("", "_made"))
    for axis, joint in zip(figure.axes, found.joints, strict=True):
        mine, bound = (table[table["joint"] == joint] for table in (accuracy, found.bounds))
        bound_line, floor_line, *points = axis.get_lines()
        assert bound_line.get_ydata() == pytest.approx(100 * bound["rms_relative"].to_numpy())
        assert list(floor_line.get_ydata()) == pytest.approx([100 * bound["floor_relative"].iloc[0]] * 2)
        drawn = np.array([[float(point.get_xdata()[0]), float(point.get_ydata()[0])] for point in points])
        assert drawn[:, 1] == pytest.approx(100 * mine["rms_relative"].to_numpy())
        assert drawn[:, 0] == pytest.approx(mine["seconds"].to_numpy() / 60, rel=0.25)


def test_html_has_the_answer_and_a_table_for_each_joint(found):
    html = found._repr_html_()
    assert html.count("<table") == 6
    assert "Least rms:" in html
    assert "indistinguishable on this log" in html


def test_claims_are_held_against_every_strategy(found):
    """The shares counted by hand; the constant step is worse than the thesis says of it."""
    shared = found.shared
    for joint, limit, unit in ((3, 100e-9, "±100 nm"), (2, 2e-6, "±2 µrad")):
        table = claimed_table(found, joint)
        place = [column.head for column in table.columns].index(unit)
        for row in table.rows:
            mine = shared[(shared["joint"] == joint) & (shared["strategy"] == row[0])]
            within = 100 * np.mean(abs(mine["predicted"] - mine["measured"]) <= limit)
            assert row[place] == f"{within:.0f}"
        ours = dict(zip((row[0] for row in table.rows), (row[place] for row in table.rows), strict=True))
        assert ours["closed form"] == "100"
        assert float(ours["constant step"]) < 60
    assert "at up to 159 %" in " ".join(claimed_text(found).split())


def test_names_that_look_like_markup_stay_text(log):
    class Hostile(ClosedForm):
        name = "<script>alert(1)</script> $x$"

    compared = compare(log, [Hostile(), ConstantStep()])
    assert "<script>" not in compared._repr_html_()
    assert "<script>" not in str(pareto_picture(compared).svg)


def test_nothing_shared_is_said_and_not_drawn(log):
    few = log.select(log.rows["joint"] == 3)
    found = compare(few, [LeastSquares(AtRandom(), 90)])
    assert "No session is left" in str(found)
    assert found._repr_html_().count("<table") == 0
    assert pareto_picture(found).svg is None
    with pytest.raises(InputError, match="nothing to draw"):
        found.plot_pareto()
