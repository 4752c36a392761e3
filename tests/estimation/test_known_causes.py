"""Both estimators with causes whose sizes are known, beside truth, each other and their own scatter."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import EndStopLatency, ExtendedLaw, RecoilAxis, ThermalWarmUp
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_closed_form, fit_least_squares
from stickslip_fit.estimation.least_squares import profile_intervals
from stickslip_fit.logs import read_log
from tests.conftest import CALIBRATION_3, SWEEPS

A, TAU, LATE = 0.04, 1500.0, 200.0
CAUSES = (ThermalWarmUp(), EndStopLatency())
TRUTH = {1: [97.0, -0.05, -1.0, -0.35], 2: [95.0, 90.0, -15.0, -19.85], 3: [976.0, 0.30, 438.0]}
UNITS = {1: [1e-6, 1e-3, 1e-6, 1e-3], 2: [1e-6] * 4, 3: [1e-9, 1.0, 1e-9]}


def hidden(table, path, a=A, tau=TAU, late=LATE):
    """A log of a drive that warms up and a stop that is heard late, by hand."""
    time = pd.to_datetime(table["time"])
    seconds = (time - time.groupby(table["session"]).transform("min")).dt.total_seconds()
    factor = 1 + a * (1 - np.exp(-seconds / tau))
    table = table.assign(steps=np.round(table["steps"] / factor + late).astype(int), check_every=1)
    table.to_csv(path, index=False)
    return read_log(path)


@pytest.fixture(scope="module")
def fitted(campaign, tmp_path_factory):
    """A campaign with both causes in it, and its least-squares fit."""
    table = campaign(check_every=1, sessions=("2012-03-05", "2012-03-06", "2012-03-09"))
    return fit_least_squares(hidden(table, tmp_path_factory.mktemp("known") / "log.csv"), causes=CAUSES)


def told(result, values, covariance):
    """The result as if it had found other sizes of the causes."""
    joints = {}
    for joint, fit in result.joints.items():
        changed, spread = fit.values.copy(), fit.covariance.copy()
        changed[:, -3:], spread[:, -3:, -3:] = values, covariance
        joints[joint] = replace(fit, values=changed, covariance=spread)
    return replace(result, joints=joints)


@pytest.fixture(scope="module")
def truly(fitted):
    return told(fitted, [A, TAU, LATE], np.zeros((3, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("estimator", [fit_closed_form, fit_least_squares])
def test_with_the_true_causes_a_quiet_log_gives_the_truth(campaign, tmp_path, truly, estimator):
    """And without them it does not."""
    log = hidden(campaign(repeatability=0.0, check_every=1), tmp_path / "log.csv")
    knowing, blind = estimator(log, causes_from=truly), estimator(log)
    for joint, truth in TRUTH.items():
        own = np.array(UNITS[joint])
        found = knowing.joints[joint].values[0, : len(own)] / own
        # Two counts rounded to whole steps, and joint 1's reach has little leverage.
        assert found == pytest.approx(truth, rel={1: 0.02, 2: 5e-4, 3: 5e-4}[joint])
        # Least squares has warm traverses beside the first, cold ones, so that less is hidden from it.
        least = {fit_closed_form: 0.02, fit_least_squares: 0.015}[estimator]
        assert np.abs(blind.joints[joint].values[0] / own / truth - 1).max() > least


def test_it_goes_through_its_calibration_traverses(campaign, tmp_path, truly):
    result = fit_closed_form(hidden(campaign(), tmp_path / "log.csv"), causes_from=truly)
    used = result.residuals[result.residuals["used"]]
    assert len(used) == 2 * 2 * 11
    assert used["residual"].abs().max() < 1e-9


def test_least_squares_of_as_many_traverses_says_the_same(campaign, tmp_path, truly):
    """Parameters, and how their errors follow from the counts'."""
    log = hidden(campaign(("2012-03-05",), CALIBRATION_3, replicates=1), tmp_path / "log.csv")
    by_fit, solved = (
        estimator(log, causes_from=truly).joints[3] for estimator in (fit_least_squares, fit_closed_form)
    )
    np.testing.assert_allclose(by_fit.values, solved.values, rtol=1e-6)


@pytest.mark.slow
def test_least_squares_follows_the_sizes_of_the_causes(campaign, tmp_path, fitted):
    """As fits to causes a little larger and smaller do, of which each has its own error bar."""
    log = hidden(campaign(("2012-03-05",), CALIBRATION_3), tmp_path / "log.csv")
    sizes, alike = np.array([A, TAU, LATE]), {"repeatability": {(3, "+"): 0.01, (3, "-"): 0.01}}

    def fit(values, spread=(0.0, 0.0, 0.0)):
        known = told(fitted, values, np.diag(spread) ** 2)
        return fit_least_squares(log, causes_from=known, **alike).joints[3]

    for k, step in enumerate((1e-4, 5.0, 1.0)):
        change = step * (np.arange(3) == k)
        slope = (fit(sizes + change).values - fit(sizes - change).values)[:, :3] / (2 * step)
        sure, unsure = fit(sizes), fit(sizes, 10 * change)
        variance = (10 * step) ** 2
        own = (unsure.covariance - sure.covariance)[:, :3, :3]
        wanted = slope[:, :, None] * slope[:, None, :] * variance
        np.testing.assert_allclose(own, wanted, rtol=0.01, atol=1e-4 * np.abs(wanted).max())
        np.testing.assert_allclose(
            unsure.covariance[:, :3, 3 + k],
            slope * variance,
            rtol=0.01,
            atol=1e-4 * np.abs(slope * variance).max(),
        )


@pytest.mark.slow
def test_the_result_is_one_of_the_extended_law(campaign, tmp_path, fitted):
    """The causes' sizes and error bars come along."""
    log = hidden(campaign(("2012-06-05",)), tmp_path / "log.csv")
    result = fit_closed_form(log, causes_from=fitted)
    assert isinstance(result.joints[3].law, ExtendedLaw)
    wanted, found = (
        each.parameters.set_index("name").loc[list(fit_names(each))] for each in (fitted, result)
    )
    for name in ("estimate", "standard_error", "low", "high"):
        assert list(found[name]) == pytest.approx(list(wanted[name]))
    seen = result.si.predict(log.usable)
    inside = log.usable["steps"].between(seen["low"], seen["high"])
    assert inside.mean() > 0.9


def fit_names(result):
    return result.joints[3].cause_parameters


@pytest.mark.slow
@pytest.mark.parametrize("estimator", [fit_closed_form, fit_least_squares])
def test_error_bars_hold_what_is_not_sure_of_the_causes(campaign, tmp_path, fitted, estimator):
    """Many campaigns' causes, drawn from their covariance, each with many days' calibrations."""
    days = tuple(f"2012-{month:02d}-{day:02d}" for month in (1, 2) for day in range(1, 5))
    wide = np.diag([0.004, 200.0, 60.0]) ** 2
    rng = np.random.default_rng(5)
    scores = []
    for seed in range(12):
        table = campaign(days, CALIBRATION_3, seed=seed)
        # Calibrations made after half an hour, so that they have something to warm up from.
        clock = pd.DataFrame([table.iloc[0]] * len(days)).assign(
            session=days, time=[f"{day}T08:00:00" for day in days], status="excluded"
        )
        log = hidden(pd.concat([clock, table.assign(status="ok")]), tmp_path / "log.csv")
        known = told(fitted, rng.multivariate_normal([A, TAU, LATE], wide), wide)
        fit = estimator(log, causes_from=known).joints[3]
        forwards = (fit.groups["direction"] == "+").to_numpy()
        off = fit.values[forwards, :3] / UNITS[3] - TRUTH[3]
        scores.append(off / (np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))[forwards, :3] / UNITS[3]))
    # Twelve draws of the causes bound how exactly the spread can be known.
    spread = np.sqrt(np.mean(np.square(scores), axis=(0, 1)))
    assert np.all((spread > 0.65) & (spread < 1.4)), spread


@pytest.mark.slow
def test_replicates_apart_in_time_do_not_pass_for_noise(campaign, tmp_path, truly):
    """While the drive warms up for hours."""
    log = hidden(campaign(("2012-03-05",), replicates=3), tmp_path / "log.csv", tau=1e4)
    slowly = told(truly, [A, 1e4, LATE], np.zeros((3, 3)))
    knowing, blind = (fit_closed_form(log, **known).joints[3] for known in ({"causes_from": slowly}, {}))
    assert knowing.repeatability["+"].value == pytest.approx(0.0027, rel=0.35)
    assert blind.repeatability["+"].value > 2 * knowing.repeatability["+"].value


def test_a_cause_that_asks_for_what_is_not_known_leaves_it_unknown(campaign, tmp_path, fitted):
    """Recoil about another axis acts with the arm level too, so that a cannot be had without b."""
    log = hidden(campaign(("2012-03-05",), CALIBRATION_3[::2]), tmp_path / "log.csv", a=0.0, late=0.0)
    law = ExtendedLaw(fitted.joints[3].law.law, (RecoilAxis(),))
    fit = fitted.joints[3]
    values = np.column_stack([fit.values[:, :3], np.full(len(fit.values), np.radians(5.0))])
    size = (len(values), 4)
    other = replace(fit, law=law, values=values, known=np.ones(size, bool), covariance=np.zeros((*size, 4)),
                    interval=np.zeros((*size, 2)))  # fmt: skip
    found = fit_closed_form(log, causes_from=replace(fitted, joints={3: other})).joints[3]
    assert not found.known[:, :3].any()
    assert fit_closed_form(log).joints[3].known[:, 0].all()


@pytest.mark.slow
@pytest.mark.parametrize("estimator", [fit_closed_form, fit_least_squares])
def test_causes_of_the_very_log_that_is_calibrated_are_said_to_be(campaign, tmp_path, fitted, estimator):
    """Their scatter is no error to expect; of another log it is."""
    settings = tuple(one for one in CALIBRATION_3 + SWEEPS if one["joint"] == 3)
    table = campaign(("2012-03-05",), settings, check_every=1)
    log = hidden(table, tmp_path / "log.csv")
    own = estimator(log, causes_from=fit_least_squares(log, causes=CAUSES))
    assert [flag.flag for flag in own.flags].count("same_log") == 1
    assert "fitted on this very log" in str(own.summary())
    assert "same_log" not in [flag.flag for flag in estimator(log, causes_from=fitted).flags]


@pytest.mark.parametrize("estimator", [fit_closed_form, fit_least_squares])
def test_a_result_without_causes_or_of_another_machine_is_refused(campaign, tmp_path, fitted, estimator):
    log = hidden(campaign(("2012-03-05",)), tmp_path / "log.csv")
    with pytest.raises(InputError, match="no causes in them"):
        estimator(log, causes_from=fit_least_squares(log))
    with pytest.raises(InputError, match="another machine"):
        estimator(log, causes_from=replace(fitted, machine=replace(fitted.machine, sha256="0")))


def test_causes_are_either_known_or_fitted(campaign, tmp_path, fitted):
    log = hidden(campaign(("2012-03-05",)), tmp_path / "log.csv")
    for option in ({"causes": [RecoilAxis()]}, {"shared": ("b",)}):
        with pytest.raises(InputError, match="neither"):
            fit_least_squares(log, causes_from=fitted, **option)


def test_profile_intervals_of_what_sessions_share_are_refused(campaign, tmp_path, fitted):
    log = hidden(campaign(("2012-03-05",)), tmp_path / "log.csv")
    for options in ({"causes_from": fitted}, {"causes": CAUSES}):
        with pytest.raises(InputError, match="each session has all its own"):
            profile_intervals(log, fit_least_squares(log, **options))
