"""What no estimator can make good numbers of: each says so, by name, and never with a silent NaN."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.bayes import fit_bayes
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_closed_form, fit_least_squares
from stickslip_fit.estimation.noise import StudentT
from tests.conftest import CALIBRATION_3

ESTIMATORS = {
    "closed-form": fit_closed_form,
    "least-squares": fit_least_squares,
    "heavy-tailed": lambda log: fit_least_squares(log, likelihood=StudentT()),
    "bayes": lambda log: fit_bayes(log, target_ess=200, progress=False).result,
}
NUMBERS = ["estimate", "standard_error", "low", "high"]
DAYS = ("2012-03-05", "2012-03-06")
CALIBRATION_2 = tuple(
    {"joint": 2, "q3_mm": q3, "theta_deg": theta} for theta in (0.0, -90.0) for q3 in (0.0, 12.0)
)
SETTINGS = (
    *CALIBRATION_3, {"joint": 3, "q2_deg": -45.0}, {"joint": 3, "q2_deg": -150.0},
    *CALIBRATION_2, {"joint": 2, "q3_mm": 6.0},
)  # fmt: skip
TRUTH = {
    "a": 976e-9, "b": 0.30, "c": 438e-9,
    "gamma0_q3_0": 95e-6, "gamma0_q3_12": 90e-6, "d_q3_0": -15e-6, "d_q3_12": -19.85e-6,
}  # fmt: skip


# By night: bayes takes longest, and tests/bayes has what is its own.
BY_NIGHT = {"bayes"}


@pytest.fixture(
    params=[
        pytest.param(name, marks=[pytest.mark.nightly] if name in BY_NIGHT else []) for name in ESTIMATORS
    ]
)
def method(request):
    return request.param


@pytest.fixture
def fit(method, read_table):
    """Fit a table; whatever is not a number is flagged, and every flag has its remark."""

    def estimate(table):
        result = ESTIMATORS[method](read_table(table))
        parameters = result.si.parameters
        unknown = parameters[NUMBERS].isna().any(axis=1)
        assert parameters.loc[unknown, "flags"].map(len).all()
        raised = {flag for flags in parameters["flags"] for flag in flags}
        assert raised <= {flag.flag for flag in result.flags}
        assert not np.isinf(parameters["estimate"]).any()
        return result

    return estimate


def flags(result):
    return {flag.flag for flag in result.flags}


def unknown(result):
    """Names of the parameters that have no estimate, in any session."""
    table = result.si.parameters
    return set(table.loc[table["estimate"].isna(), "name"])


def test_a_session_with_one_direction_only(fit, campaign):
    table = campaign(DAYS, SETTINGS)
    result = fit(table[(table["session"] == DAYS[0]) | (table["direction"] == "+")])
    assert flags(result) == set()
    for joint in result.joints.values():
        groups = list(zip(joint.groups["session"], joint.groups["direction"], strict=True))
        assert groups == [(DAYS[0], "+"), (DAYS[0], "-"), (DAYS[1], "+")]
    assert result.si.parameters[NUMBERS].notna().all(axis=None)


def test_one_configuration_repeated_shows_what_it_shows(fit, campaign):
    result = fit(campaign(DAYS, CALIBRATION_3[:1], replicates=4))
    assert flags(result) == {"not_identified"}
    assert unknown(result) == {"b", "c"}
    plain = result.si.parameters.query("name == 'a' and direction == '+'")
    assert (np.abs(plain["estimate"] - 976e-9) < 5 * plain["standard_error"]).all()


def test_one_configuration_repeated_that_shows_nothing_by_itself(fit, campaign, method):
    """Under load, joint 2's counts tell neither its step size without load nor what the load adds."""
    result = fit(campaign(DAYS, CALIBRATION_2[:1], replicates=4))
    assert "not_identified" in flags(result)
    assert unknown(result) == {"gamma0_q3_0", "gamma0_q3_12", "d_q3_0", "d_q3_12"}


def test_no_replicates_and_none_to_spare(fit, campaign, method):
    result = fit(campaign(DAYS[:1], CALIBRATION_3 + CALIBRATION_2, replicates=1))
    assert flags(result) == {"few_replicates"}
    assert result.si.parameters["estimate"].notna().all()
    # Bayes has error bars from its prior, and says that they are.
    assert result.si.parameters["standard_error"].notna().all() == (method == "bayes")


def test_a_single_traverse(fit, campaign):
    result = fit(campaign(DAYS[:1], CALIBRATION_3[:1], ("+",), replicates=1))
    assert flags(result) == {"few_replicates", "not_identified"}
    assert unknown(result) == {"b", "c"}
    assert result.si.parameters["estimate"].dropna().item() == pytest.approx(976e-9, rel=0.02)


def test_one_joint_only(fit, campaign):
    result = fit(campaign(DAYS, CALIBRATION_2))
    assert list(result.joints) == [2]
    assert flags(result) == set()


def test_a_session_of_two_rows(fit, campaign, method):
    table = campaign(DAYS, SETTINGS)
    last = table[(table["session"] == DAYS[1]) & (table["joint"] == 3)].iloc[:2]
    result = fit(pd.concat([table[table["session"] == DAYS[0]], last]))
    assert list(last["direction"]) == ["+", "-"]
    estimates = result.si.parameters.set_index(["session", "name"])["estimate"]
    assert estimates[DAYS[0]].notna().all()
    if method == "bayes":
        # The other session lends what these rows do not show.
        assert flags(result) == set()
        assert estimates.notna().all()
    else:
        assert flags(result) == {"not_identified"}
        assert set(estimates[DAYS[1]].index[estimates[DAYS[1]].isna()]) == {"b", "c"}


def test_all_steps_equal_over_full_traverses(fit, campaign):
    """As of a joint that neither load nor recoil slows down, and that repeats without fail."""
    full = CALIBRATION_3 + CALIBRATION_2
    result = fit(campaign(DAYS, full, check_every=1).assign(steps=12300))
    assert flags(result) == set()
    table = result.si.parameters.set_index("name")
    assert table.loc["a", "estimate"].to_numpy() == pytest.approx(12e-3 / 12300, rel=3e-3)
    assert table.loc["gamma0_q3_0", "estimate"].to_numpy() == pytest.approx(np.radians(240) / 12300, rel=3e-3)
    assert table.loc["b", "estimate"].to_numpy() == pytest.approx(0.0, abs=3e-3)
    assert (table["low"] <= table["high"]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", ["least-squares", pytest.param("bayes", marks=pytest.mark.nightly)], indirect=True
)
def test_all_steps_equal_though_the_traverses_are_not(fit, campaign):
    """No law gives such counts: whatever is reported as a number repeats as badly as they do."""
    shorter = tuple(
        {"joint": 2, "q3_mm": 6.0, "from_deg": end, "to_deg": end - 60.0} for end in (0.0, -120.0)
    )
    result = fit(campaign(DAYS, CALIBRATION_2 + shorter, ("+",)).assign(steps=12300))
    assert "not_converged" in flags(result) or result.joints[2].repeatability["+"].value > 0.3


def test_two_sessions_with_disjoint_joints(fit, campaign):
    table = campaign(DAYS, SETTINGS)
    result = fit(table[(table["session"] == DAYS[0]) == (table["joint"] == 3)])
    assert flags(result) == set()
    days = result.si.parameters.groupby("joint")["session"].unique()
    assert (list(days[3]), list(days[2])) == ([DAYS[0]], [DAYS[1]])


def test_no_usable_traverse(fit, campaign):
    with pytest.raises(InputError, match="no usable traverse"):
        fit(campaign(DAYS[:1], CALIBRATION_3).assign(status="interrupted"))


@pytest.mark.parametrize(
    ("joint", "place", "factor"),
    [
        (3, 1, 0.1),
        (2, 4, 10.0),
        pytest.param(3, 1, 10.0, marks=pytest.mark.nightly),
        pytest.param(2, 4, 0.1, marks=pytest.mark.nightly),
    ],
)
class TestACountWildlyOff:
    """The second of the calibration traverses, or one that calibrates nothing."""

    def spoilt(self, campaign, joint, place, factor):
        table = campaign(DAYS, SETTINGS)
        first = table.index[(table["joint"] == joint) & (table["direction"] == "+")][place]
        table.loc[first, "steps"] = 5 * round(factor * table.loc[first, "steps"] / 5)
        return table, table.loc[first, "steps"]

    def test_is_named(self, fit, method, campaign, joint, place, factor):
        """And survived by heavy tails."""
        table, count = self.spoilt(campaign, joint, place, factor)
        result = fit(table)
        [message] = [flag.message for flag in result.flags if flag.flag == "outlier"]
        assert f"joint {joint}, direction +, session {DAYS[0]}: the count {count} " in message
        if method == "heavy-tailed":
            assert flags(result) == {"outlier"}
            subset = result.si.parameters.query(f"joint == {joint} and direction == '+'")
            off = (subset["estimate"] - subset["name"].map(TRUTH)) / subset["standard_error"]
            assert np.abs(off).max() < 4.0


OF_A_LOG = (
    "fit",
    "calibrate",
    "diagnose",
    "analyze_variance",
    "compare_strategies",
    "compare_laws",
    "report",
)


@pytest.mark.parametrize("verb", OF_A_LOG)
def test_what_is_no_log_is_refused_with_the_call_that_reads_one(verb):
    for given, told in (
        ("my-log.csv", r"a str; read it with ssf.read_log\('my-log.csv'\)$"),
        (pd.DataFrame({"steps": [1]}), r"a DataFrame; .*ssf.read_log\(.*ssf.diagnose_table\("),
        (None, "a NoneType; "),
    ):
        with pytest.raises(InputError, match="^log: a Log.* is wanted, not " + told):
            getattr(ssf, verb)(given)


def test_what_is_no_law_plan_or_diagnosis_is_refused_with_the_call_that_makes_one(campaign, read_table):
    log = read_table(campaign())
    law = ssf.calibrate(log)
    for call, told in (
        (lambda: ssf.predict(law, log), r"^plan: .* not a Log; .*ssf.read_plan\(path, machine\)"),
        (lambda: ssf.predict(law, "plan.toml"), r"^plan: .*ssf.read_plan\('plan.toml', machine\)"),
        (lambda: ssf.predict(log, None), r"^fitted: .* not a Log; get one with ssf.fit\(log\)"),
        (lambda: ssf.next_experiment(log), r"^diagnosis: .* not a Log; get one with ssf.diagnose\(log\)$"),
        (lambda: ssf.calibrated_arm("law.json"), r"^result: .*with ssf.load_result\('law.json'\)$"),
        (lambda: ssf.plan_move(log, (0, 0, 0), (0, 0, 0)), r"^arm: .* not a Log; get one with ssf.fit\("),
        (lambda: ssf.detect_changes(log, "new.csv"), r"^new: .*ssf.read_log\('new.csv'\)$"),
        (lambda: ssf.held_out_errors(log, "law.json"), r"^law: .*ssf.load_result\('law.json'\)$"),
        (lambda: ssf.fit(log, causes_from="law.json"), r"^causes_from: .*ssf.load_result\('law.json'\)$"),
        (lambda: ssf.read_drives("drives.csv", log), r"^law: .* not a Log; get one with ssf.fit\("),
        (lambda: ssf.write_log("my-log.csv", "copy.csv"), "^log: a Log is wanted, not a str; "),
        (lambda: ssf.read_log(log), "^a path is wanted, not a Log; name an existing log$"),
        (lambda: ssf.read_log(["day.csv", 5]), "^a path is wanted, not an int; "),
        (lambda: ssf.read_log(log.rows), r"^a path is wanted, not a DataFrame; save it with to_csv\("),
        (lambda: ssf.load_result(law), "^a path is wanted, not a Result; name an existing result$"),
        (lambda: ssf.load_posterior(law), "^a path is wanted, not a Result; name an existing posterior$"),
        (
            lambda: ssf.read_study(log, law.machine),
            "^a path is wanted, not a Log; name an existing study file$",
        ),
        (lambda: ssf.load_machine(5), "^a path is wanted, not an int; name an existing machine file$"),
    ):
        with pytest.raises(InputError, match=told):
            call()
