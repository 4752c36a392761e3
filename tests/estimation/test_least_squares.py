import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares as scipy_least_squares
from scipy.stats import t
from typer.testing import CliRunner

from stickslip_fit.cli import app
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation.least_squares import profile_intervals


@pytest.fixture(scope="module")
def log(campaign, read_table):
    return read_table(campaign())


def estimates(result, joint, direction, session):
    table = result.si.parameters
    subset = table[
        (table["joint"] == joint) & (table["direction"] == direction) & (table["session"] == session)
    ]
    return subset.set_index("name")


def test_known_truth_is_recovered_without_noise(campaign, read_table):
    exact = fit_least_squares(read_table(campaign(repeatability=0.0, check_every=1, replicates=1)))
    found = estimates(exact, 3, "+", "2012-03-05")["estimate"]
    assert found["a"] * 1e9 == pytest.approx(976.0, rel=2e-5)
    assert found["b"] == pytest.approx(0.30, abs=2e-5)
    assert found["c"] * 1e9 == pytest.approx(438.0, rel=1e-4)
    found = estimates(exact, 2, "-", "2012-03-06")["estimate"] * 1e6
    assert list(found) == pytest.approx([94.0, 91.0, 19.6, 25.91], rel=1e-4)
    found = estimates(exact, 1, "-", "2012-03-06")["estimate"]
    assert found["gamma0_reach_0"] * 1e6 == pytest.approx(96.0, rel=1e-4)
    assert found["gamma0_per_mm"] * 1e3 == pytest.approx(-0.04, abs=3e-4)
    assert found["d_per_mm"] * 1e3 == pytest.approx(0.45, abs=1e-3)


@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_agrees_with_scipy_on_every_group(log, spread):
    """The same weighted problem, written out again and solved by another library."""
    ratio = np.exp(spread * np.random.default_rng(0).standard_normal(len(log.usable)))
    result = fit_least_squares(log, noise_ratio=ratio if spread else None)
    rows = log.usable.assign(ratio=ratio)[log.usable["joint"] == 3]
    rows["ratio"] /= np.sqrt((rows["ratio"] ** 2).groupby(rows["direction"].astype(str)).transform("mean"))
    squares, df = {"+": 0.0, "-": 0.0}, {"+": 0, "-": 0}
    for (session, direction), subset in rows.groupby(["session", "direction"], observed=True):
        noise = result.joints[3].repeatability[direction].value
        counts = subset["steps"].to_numpy() - 2.5
        sigma = np.hypot(noise * subset["ratio"], 5 / np.sqrt(12) / counts).to_numpy()
        recoil = np.abs(np.cos(subset["q2"]))
        load = np.cos(subset["psi"] - subset["q2"]) * np.cos(subset["theta"])

        def misfit(p, counts=counts, sigma=sigma, recoil=recoil, load=load):
            gamma = (1 - p[1] * recoil) * (p[0] - p[2] * load) * 1e-6
            return (np.log(counts) - np.log(0.012 / gamma)) / sigma

        other = scipy_least_squares(misfit, [1.0, 0.2, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
        covariance = np.linalg.inv(other.jac.T @ other.jac)
        ours = estimates(result, 3, direction, session)
        unit = np.array([1e6, 1.0, 1e6])
        assert ours["estimate"].to_numpy() * unit == pytest.approx(other.x, rel=1e-6)
        assert ours["standard_error"].to_numpy() * unit == pytest.approx(
            np.sqrt(np.diag(covariance)), rel=1e-3
        )
        squares[direction] += 2.0 * other.cost
        df[direction] += len(subset) - len(other.x)
    assert squares == pytest.approx(df, rel=1e-3)


def test_noise_of_each_traverse_is_positive_and_known_of_all(log):
    n = len(log.usable)
    for wrong in (np.ones(n - 1), np.zeros(n), np.full(n, np.nan)):
        with pytest.raises(InputError, match=f"noise_ratio must be {n} positive numbers"):
            fit_least_squares(log, noise_ratio=wrong)


def test_repeatability_is_found(log):
    for fit in fit_least_squares(log).joints.values():
        for found in fit.repeatability.values():
            assert found.value == pytest.approx(0.0027, rel=4 / np.sqrt(2 * found.df))


def test_interrupted_and_excluded_traverses_are_not_fitted(campaign, read_table):
    table = campaign(sessions=("2012-03-05",))
    clean = fit_least_squares(read_table(table)).si.parameters["estimate"]
    spoilt = pd.concat([table, table.iloc[:6].assign(steps=5000)], ignore_index=True)
    spoilt["status"] = [""] * len(table) + ["interrupted", "excluded"] * 3
    spoilt.loc[len(table):, "time"] = [f"2012-03-05T23:0{minute}:00" for minute in range(6)]  # fmt: skip
    again = fit_least_squares(read_table(spoilt)).si.parameters["estimate"]
    assert again.to_numpy() == pytest.approx(clean.to_numpy(), rel=1e-12)


def test_a_log_without_a_gravity_free_traverse_names_what_is_missing(campaign, read_table):
    settings = ({"joint": 3, "q2_deg": 0.0}, {"joint": 3, "q2_deg": -90.0, "psi_deg": -60.0})
    result = fit_least_squares(read_table(campaign(settings=settings, directions=("+",))))
    flag = next(flag for flag in result.flags if flag.flag == "not_identified")
    assert flag.parameters == ("a", "b", "c")
    assert "q2 = -90°" in flag.message
    table = estimates(result, 3, "+", "2012-03-05")
    assert table["estimate"].isna().all()
    assert all("not_identified" in flags for flags in table["flags"])


def test_what_is_known_is_given_though_another_parameter_is_not(campaign, read_table):
    settings = ({"joint": 3, "q2_deg": -90.0}, {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0})
    result = fit_least_squares(read_table(campaign(settings=settings)))
    table = estimates(result, 3, "+", "2012-03-05")
    assert table.loc["a", "estimate"] * 1e9 == pytest.approx(976, rel=0.01)
    assert table.loc["b", "estimate"] == pytest.approx(0.30, rel=0.05)
    assert np.isnan(table.loc["c", "estimate"])
    message = next(flag.message for flag in result.flags if flag.flag == "not_identified")
    assert "c cannot be known" in message
    assert "theta = 0°" in message


def test_one_traverse_per_parameter_gives_no_error_bars_and_says_so(campaign, read_table):
    settings = (
        {"joint": 3, "q2_deg": -90.0},
        {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
        {"joint": 3, "q2_deg": 0.0},
    )
    result = fit_least_squares(read_table(campaign(("2012-03-05",), settings, replicates=1)))
    table = result.si.parameters
    assert table["estimate"].notna().all()
    assert table["standard_error"].isna().all()
    assert {flag for flags in table["flags"] for flag in flags} == {"few_replicates"}


def test_a_log_without_usable_rows_is_refused(campaign, read_table):
    table = campaign(("2012-03-05",)).assign(status="excluded")
    with pytest.raises(InputError, match="no usable traverse"):
        fit_least_squares(read_table(table))


def test_joint_1_at_one_reach_has_constants(campaign, read_table):
    settings = tuple(
        {"joint": 1, "q2_deg": -90.0, "q3_mm": 0.0, "theta_deg": theta} for theta in (0.0, -90.0)
    )
    result = fit_least_squares(read_table(campaign(settings=settings, repeatability=0.0, check_every=1)))
    table = estimates(result, 1, "+", "2012-03-05")
    assert list(table.index) == ["gamma0_reach_0", "d_reach_0"]
    assert table.loc["gamma0_reach_0", "estimate"] * 1e6 == pytest.approx(97 - 0.05 * 37.5, rel=1e-4)
    assert table.loc["d_reach_0", "estimate"] * 1e6 == pytest.approx(-1.0 - 0.35 * 37.5, rel=1e-3)


@pytest.mark.slow
def test_profile_intervals_end_where_another_library_puts_them(campaign, read_table):
    """Noise of 15 %, so that the likelihood is asymmetric: fixed at an end, the rest is fitted anew."""
    written = campaign(repeatability=0.15, replicates=1, sessions=("2012-03-05",))
    log = read_table(written[written["joint"] == 3])
    fit = fit_least_squares(log)
    table = profile_intervals(log, fit)
    table = table[(table["joint"] == 3) & (table["direction"] == "+")].set_index("name")
    rows = log.usable[(log.usable["joint"] == 3) & (log.usable["direction"] == "+")]
    noise = fit.joints[3].repeatability["+"]
    counts = rows["steps"].to_numpy() - 2.5
    sigma = np.hypot(noise.value, 5 / np.sqrt(12) / counts)
    recoil, load = np.abs(np.cos(rows["q2"])), np.cos(rows["psi"] - rows["q2"]) * np.cos(rows["theta"])

    def misfit(p):
        gamma = (1 - p[1] * recoil) * (p[0] - p[2] * load) * 1e-6
        return (np.log(counts) - np.log(0.012 / gamma)) / sigma

    def least(index, fixed):
        others = scipy_least_squares(lambda p: misfit(np.insert(p, index, fixed)), np.delete(best.x, index))
        return 2 * others.cost

    best = scipy_least_squares(misfit, [1.0, 0.2, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    reach = t.ppf(0.975, noise.df)
    half = reach * np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    for index, (name, unit) in enumerate((("a", 1e6), ("b", 1.0), ("c", 1e6))):
        for end in ("profile_low", "profile_high"):
            excess = least(index, table[end][name] * unit) - 2 * best.cost
            assert np.sqrt(excess) == pytest.approx(reach, rel=1e-3)
        ends = table.loc[name, ["profile_low", "profile_high"]].to_numpy(float) * unit
        off = np.abs(ends - best.x[index] - [-half[index], half[index]]).max() / half[index]
        assert table["differs"][name] == (off > 0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "says"), [(0.15, "differ from the quadratic"), (0.002, "agree with the")])
def test_who_asks_for_profile_intervals_reads_first_whether_they_differ(campaign, tmp_path, noise, says):
    table = campaign(repeatability=noise, replicates=1, sessions=("2012-03-05",))
    table[table["joint"] == 3].to_csv(tmp_path / "log.csv", index=False)
    done = CliRunner().invoke(app, ["fit", str(tmp_path / "log.csv"), "--profile"])
    assert says in " ".join(done.output.split("\n\n")[0].split())
