"""What follows from the equations: changes of the response, and derivatives by every parameter."""

import numpy as np
import pytest

from stickslip_fit.causes import PayloadChange, SessionJump, extend
from stickslip_fit.causes.added_steps import AddedSteps
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.proposed import NestedTerm, SmoothTerm
from tests.causes.by_hand import ROWS, SECOND
from tests.causes.table import CASES, LAWS, MACHINE, NAMED, own_values

LABELS = [case.label for case in CASES]
# What a cause may find at work when it is looked for as a second one.
BEFORE = ((), ("theta-offset",), ("end-stop-latency", "payload-change recorded"), ("guide-gradient",))


def law_with(labels, joint):
    """A law with causes in it, and values of its parameters for each row of its joint."""
    law, values = LAWS[joint], own_values(ROWS[ROWS["joint"] == joint])
    for label in labels:
        law = extend(law, NAMED[label].cause)
        values = np.concatenate([values, np.tile(NAMED[label].values[0], (len(values), 1))], axis=1)
    return law, values


@pytest.mark.parametrize("before", BEFORE, ids=lambda before: " + ".join(before) or "published")
@pytest.mark.parametrize("label", LABELS)
def test_changes_are_the_extended_prediction_less_the_law_s(label, before):
    cause, trials = NAMED[label].cause, np.array(NAMED[label].values)
    for joint in cause.joints:
        law, values = law_with(before, joint)
        rows = ROWS[ROWS["joint"] == joint]
        wanted = [
            extend(law, cause).predict(rows, np.concatenate([values, np.tile(trial, (len(rows), 1))], axis=1))
            - law.predict(rows, values)
            for trial in trials
        ]
        found = cause.changes(law, rows, values, trials)
        np.testing.assert_allclose(found, np.transpose(wanted), atol=2e-11)


def test_a_jump_acts_in_its_own_session_from_its_moment_on():
    rows = ROWS[ROWS["joint"] == 2]
    law, values = law_with((), 2)
    moments = np.array([[0.05, 8999.0], [0.05, 9000.0], [0.05, 9001.0]])
    late = (rows["session"] == SECOND).to_numpy()
    found = SessionJump(session=SECOND).changes(law, rows, values, moments)
    np.testing.assert_allclose(found, -np.log(1.05) * np.outer(late, [1, 1, 0]), atol=1e-13)


def test_a_smooth_function_is_the_logarithm_of_a_factor():
    """Where it is constant along all traverses, steps are divided by its exponential, however large it is."""
    rows = ROWS[ROWS["joint"] == 2]
    far = SmoothTerm(limits=((0.0, 1e9),), on=((2, "+"), (2, "-")))
    law = extend(LAWS[2], NestedTerm.of_parts(far, [(False, "same", (0.1,)), (False, "opposite", (0.1,))]))
    values = np.concatenate([own_values(rows), np.tile([0.7, 2.0], (len(rows), 1))], axis=1)
    found = law.predict(rows, values) - LAWS[2].predict(rows, own_values(rows))
    np.testing.assert_allclose(found, np.where(rows["direction"] == "+", -2.7, 1.3), rtol=1e-9)


def test_steps_are_added_whatever_the_length_of_a_traverse():
    """Of a function of q1 that is at its first value everywhere, and only in direction +."""
    rows = ROWS[ROWS["joint"] == 2]
    added = AddedSteps(("q1",), ((1e3, 1e4),), ((1,), (2,)), (10.0, 5.0), on=((2, "+"),))
    law, values = LAWS[2], own_values(rows)
    counts = {
        steps: np.exp(
            extend(law, added).predict(
                rows, np.column_stack([values, *np.tile([[steps], [20.0]], len(rows))])
            )
        )
        for steps in (0.0, 30.0)
    }
    forward = (rows["direction"] == "+").to_numpy()
    before = np.exp(law.predict(rows, values))
    np.testing.assert_allclose(counts[0.0], before + 20.0 * forward, rtol=1e-9)
    np.testing.assert_allclose(counts[30.0], before + 50.0 * forward, rtol=1e-9)
    slopes = added.changes(law, rows, values, np.eye(2))
    np.testing.assert_allclose(slopes, (forward / before)[:, None] * [1.0, 1.0], rtol=1e-9)


@pytest.mark.parametrize("label", ["guide-gradient", "worn-spot"])
def test_a_profile_beside_added_steps_changes_what_is_left_of_the_counts(label):
    cause, trials = NAMED[label].cause, np.array(NAMED[label].values)
    rows = ROWS[ROWS["joint"] == 3]
    law = extend(LAWS[3], AddedSteps(("q1",), ((1e3, 1e4),), on=((3, "+"),)))
    values = np.column_stack([own_values(rows), np.full(len(rows), 300.0)])
    extended = np.concatenate([values, np.tile(trials[0], (len(rows), 1))], axis=1)
    wanted = extend(law, cause).predict(rows, extended) - law.predict(rows, values)
    np.testing.assert_allclose(cause.changes(law, rows, values, trials[:1])[:, 0], wanted, atol=2e-11)


@pytest.mark.parametrize("before", [(), ("guide-gradient", "end-stop-latency")], ids=" + ".join)
@pytest.mark.parametrize("label", ["guide-gradient", "worn-spot"])
def test_a_profile_over_many_stretches_changes_them_as_over_each(label, before):
    """In both directions, some of them 10 µm long."""
    rng, cause = np.random.default_rng(5), NAMED[label].cause
    law, values = law_with(before, 3)
    chosen = rng.integers(0, len(values), 400)
    rows = ROWS[ROWS["joint"] == 3].iloc[chosen].reset_index(drop=True)
    ends = np.sort(rng.uniform(0.0, 12e-3, (400, 2)), axis=1)
    ends[:, 1] = np.where(np.arange(400) % 9, ends[:, 1], ends[:, 0] + 1e-5)
    ends[::2] = ends[::2, ::-1]
    direction = np.where(ends[:, 1] > ends[:, 0], "+", "-")
    rows = rows.assign(start=ends[:, 0], stop=ends[:, 1], direction=direction)
    versions = [(cause, np.array(NAMED[label].values)), *cause.trials(rows)]
    for version, trials in versions:
        found = version.changes(law, rows, values[:1].repeat(400, axis=0), trials)
        wanted = Cause.changes(version, law, rows, values[:1].repeat(400, axis=0), trials)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())


def test_functions_of_sessions_act_on_all_joints_where_none_is_named():
    rows = ROWS[ROWS["joint"] == 2]
    far = SmoothTerm(limits=((0.0, 1e9),), sessions=tuple(dict.fromkeys(ROWS["session"])))
    term = NestedTerm.of_parts(far, [(True, "same", (0.1,)), (False, "opposite", (0.1,))])
    assert len(term.parameters) == len(far.sessions) + 1
    values = np.concatenate(
        [own_values(rows), np.tile([*range(len(far.sessions)), 0.0], (len(rows), 1))], axis=1
    )
    found = extend(LAWS[2], term).predict(rows, values) - LAWS[2].predict(rows, own_values(rows))
    np.testing.assert_allclose(found, -rows["session"].map(far.sessions.index), rtol=1e-9, atol=1e-9)


def test_a_payload_in_a_session_without_rows_changes_nothing_beside_a_smooth_function():
    rows = ROWS[(ROWS["joint"] == 2) & (ROWS["session"] != SECOND)]
    smooth = SmoothTerm(orders=((1,), (2,)), sds=(0.01, 0.01), on=((2, "+"), (2, "-")), each=True)
    law = extend(LAWS[2], smooth)
    values = np.concatenate([own_values(rows), np.zeros((len(rows), 4))], axis=1)
    found = PayloadChange(session=SECOND).changes(law, rows, values, np.array([[0.1, 9000.0]]))
    np.testing.assert_array_equal(found, np.zeros((len(rows), 1)))


@pytest.mark.parametrize(
    "labels",
    [*((label,) for label in LABELS), ("psi-offset", "load-nonlinearity tanh", "worn-spot", "reversal-loss")],
    ids=" + ".join,
)
def test_derivatives_agree_with_differences_of_the_counts(labels):
    causes = [NAMED[label].cause for label in labels]
    for joint in {joint for cause in causes for joint in cause.joints}:
        law, values = law_with(labels, joint)
        rows = ROWS[ROWS["joint"] == joint]
        scales = law.scales(values[:, 0])
        scales[:, : len(LAWS[joint].parameters)] = np.abs(values[:, : len(LAWS[joint].parameters)])
        slopes = law.jacobian(rows, values) * scales
        for k in range(values.shape[1]):
            step = 1e-4 * scales[:, k]

            def response(by, k=k, step=step, law=law, rows=rows, values=values):
                moved = values.copy()
                moved[:, k] += by * step
                return law.predict(rows, moved)

            # Richardson's five points, coarse enough to stay clear of rounding.
            difference = (8 * (response(1) - response(-1)) - (response(2) - response(-2))) / 12e-4
            np.testing.assert_allclose(slopes[:, k], difference, atol=3e-9, err_msg=law.parameters[k].name)


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_law_s_own_derivatives_stay_what_they_were(joint):
    rows = ROWS[ROWS["joint"] == joint]
    law, values = law_with(("q1-gravity", "drift"), joint)
    law, values = law, np.concatenate([values[:, :-2], np.zeros((len(values), 2))], axis=1)
    own = len(LAWS[joint].parameters)
    wanted = LAWS[joint].jacobian(rows, values[:, :own])
    size = np.abs(wanted).max(axis=0)
    np.testing.assert_allclose(law.jacobian(rows, values)[:, :own] / size, wanted / size, atol=1e-11)


def test_parameters_carry_their_bounds_and_have_names_of_their_own():
    law = extend(extend(LAWS[3], NAMED["load-nonlinearity cube"].cause), SessionJump(session="Monday"))
    law = extend(extend(law, SessionJump(session=SECOND)), NAMED["worn-spot"].cause)
    names = [parameter.name for parameter in law.parameters]
    assert len(set(names)) == len(names) == 3 + 6 + 2 + 2 + 3
    assert {"load-nonlinearity.k[3+]", "session-jump.A[Monday]", "worn-spot.w"} <= set(names)
    bounds = {parameter.name: (parameter.lower, parameter.upper) for parameter in law.parameters}
    assert bounds["worn-spot.w"] == (1e-4, 6e-3)
    assert bounds["a"] == (0.0, np.inf)


def test_a_law_says_which_columns_it_needs_and_asks_for_those_that_nothing_can_stand_in_for():
    from stickslip_fit.errors import InputError

    law = extend(extend(LAWS[3], NAMED["drift"].cause), NAMED["temperature"].cause)
    assert {"session_seconds", "temperature", "q1"} <= set(law.columns)
    bare = ROWS[ROWS["joint"] == 3].drop(columns=["session_seconds", "temperature"])
    values = np.array([976e-9, 0.3, 438e-9, 0.0, 0.01])
    with pytest.raises(InputError, match="time since the session's first traverse"):
        law.counts(bare, values)
    warm = bare.assign(session_seconds=0.0)
    np.testing.assert_allclose(law.counts(warm, values)[0], LAWS[3].counts(warm, values[:3])[0])


def test_means_and_ranges_come_from_the_log():
    bound = {each: NAMED[each].cause.bind(ROWS, MACHINE) for each in ("temperature curved", "step-rate")}
    assert bound["temperature curved"].mean == pytest.approx(ROWS["temperature"].mean())
    assert bound["temperature curved"].half == pytest.approx(5.5)
    assert bound["step-rate"].median == pytest.approx(0.010)
    column = NAMED["covariate:pressure"].cause.bind(ROWS, MACHINE)
    assert (column.low, column.high) == (985.0, 1030.0)
    cable = NAMED["cable-torque"].cause.bind(ROWS, MACHINE)
    assert cable.ranges == tuple((joint, *MACHINE.ranges[joint]) for joint in (1, 2))
