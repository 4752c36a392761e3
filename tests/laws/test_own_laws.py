"""Laws of one's own: each estimator's numbers, messages for bad ones, saving, names, the command line."""

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares

import stickslip_fit as ssf
from stickslip_fit.laws import ConstantStep, Parameter, Prismatic, installed_laws, registry

JOINT_3 = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0},
    {"joint": 3, "q2_deg": -45.0},
    {"joint": 3, "q2_deg": -45.0, "psi_deg": 30.0},
    {"joint": 3, "q2_deg": -30.0, "theta_deg": -45.0},
)
THESIS = ("a", "b", "c")
OWN = ("free", "recoil", "weight")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The laboratory's module, imported as a lab has it: a file in a folder of its own."""
    folder = tmp_path_factory.mktemp("lab")
    shutil.copy(Path(__file__).with_name("laboratory.py"), folder / "laboratory.py")
    sys.path.insert(0, str(folder))
    import laboratory

    yield laboratory
    sys.path.remove(str(folder))


@pytest.fixture(scope="module")
def table(campaign):
    return campaign(settings=JOINT_3)


@pytest.fixture(scope="module")
def path(table, tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "campaign.csv"
    table.to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def log(path):
    return ssf.read_log(path)


def parameters(result, names):
    table = result.si.parameters.set_index(["name", "direction", "session"]).loc[list(names)]
    return table[["estimate", "standard_error", "low", "high"]].to_numpy(float)


@pytest.mark.parametrize("method", ["least-squares", "student-t"])
def test_the_published_law_as_ones_own_gives_the_same_numbers(method, log, lab):
    own, published = ssf.fit(log, method, laws={3: lab.Guide()}), ssf.fit(log, method)
    np.testing.assert_allclose(parameters(own, OWN), parameters(published, THESIS), rtol=1e-9)
    np.testing.assert_allclose(own.si.predict(log.usable), published.si.predict(log.usable), rtol=1e-9)


def test_a_law_that_names_the_thesis_s_configurations_is_calibrated_as_in_closed_form(log, lab):
    class Guide(lab.Guide):
        configurations = Prismatic().calibration()

    own, published = ssf.calibrate(log, laws={3: Guide()}), ssf.calibrate(log)
    np.testing.assert_allclose(parameters(own, OWN), parameters(published, THESIS), rtol=1e-6)
    assert list(own.residuals["used"]) == list(published.residuals["used"])


def test_a_law_that_names_none_is_calibrated_from_as_many_traverses_as_it_has_parameters(log, lab):
    result = ssf.calibrate(log, laws={3: lab.GUIDE})
    used = log.usable[result.residuals["used"]]
    assert list(used.groupby(["session", "direction"], observed=True).size()) == [3] * 4
    assert np.abs(result.residuals["residual"][result.residuals["used"]]).max() < 1e-9
    np.testing.assert_allclose(
        parameters(result, ["free"])[:, 0], [976e-9, 903e-9, 976e-9, 903e-9], rtol=0.02
    )
    assert result.flags == ()


def test_a_calibration_that_cannot_be_names_parameters_and_no_traverse(log, lab):
    level = log.select(log.rows["q2"] < -1.5)
    for result in (ssf.calibrate(level, laws={3: lab.GUIDE}), ssf.fit(level, laws={3: lab.GUIDE})):
        flags = [flag for flag in result.flags if flag.flag == "not_identified"]
        assert len(flags) == 4
        assert all({"recoil"} <= set(flag.parameters) for flag in flags)
        assert not any("missing" in flag.message or "traverse at" in flag.message for flag in flags)


def test_a_constant_step_is_the_mean(log):
    one = log.select(log.rows["q2"] < -1.5)
    fitted = ssf.fit(one, laws={3: ConstantStep(3)}).si.parameters
    rows = one.usable.assign(step=lambda row: np.log(0.012 / (row["steps"] - 2.5)))
    mean = np.exp(rows.groupby(["session", "direction"], observed=True, sort=False)["step"].mean())
    np.testing.assert_allclose(fitted["estimate"].sort_values(), mean.sort_values(), rtol=1e-6)


def test_a_sinusoid_along_the_traverse_beside_scipy(campaign, read_table, lab):
    cuts = [{"joint": 1, "from_deg": low + 40.0, "to_deg": low} for low in range(-120, 120, 40)]
    table = campaign(("2012-03-05",), tuple(cuts), directions=("+",), replicates=1)
    rng = np.random.default_rng(3)

    def steps(g, swing, ends):
        return np.array([quad(lambda q: 1.0 / (g * (1.0 + swing * np.sin(q))), *end)[0] for end in ends])

    ends = np.radians(table[["from_deg", "to_deg"]].to_numpy(float))
    counts = steps(97e-6, 0.04, ends) * np.exp(0.003 * rng.standard_normal(len(ends)))
    table = table.assign(steps=np.round(counts).astype(int), check_every=1)
    fitted = ssf.fit(read_table(table), laws={1: lab.Eccentric()})

    def residual(values):
        return np.log(table["steps"].to_numpy(float)) - np.log(steps(values[0] * 1e-6, values[1], ends))

    expected = least_squares(residual, [90.0, 0.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x * [1e-6, 1.0]
    np.testing.assert_allclose(fitted.joints[1].values[0], expected, rtol=1e-6)


@pytest.mark.slow
def test_every_other_verb_takes_the_law(log, lab):
    laws = {3: lab.GUIDE}
    guide = log.select(log.rows["joint"] == 3)
    own, published = (ssf.diagnose(guide, laws=chosen, gain=False) for chosen in (laws, None))
    assert (own.verdict, own.p_value) == (published.verdict, pytest.approx(published.p_value, abs=1e-3))
    assert own.extended_law().joints[3].law is lab.GUIDE
    comparison = ssf.compare_strategies(guide, laws=laws)
    assert {"constant step", "closed form", "least squares, D-optimal"} <= set(comparison.errors["strategy"])
    assert "claim" not in str(comparison)
    page = ssf.report(guide, laws=laws, sections=(), comparison=comparison).html
    assert "What the thesis says is left out for joint 3" in page
    assert "What the thesis claims" not in page
    assert "share lost" in page


@pytest.mark.nightly
def test_the_sessions_share_a_distribution_under_ones_own_law(log, lab):
    options = {"seed": 1, "target_ess": 200, "progress": False}
    guide = log.select(log.rows["joint"] == 3)
    own = ssf.fit(guide, "bayes", laws={3: lab.GUIDE}, **options).result
    published = ssf.fit(guide, "bayes", **options).result
    np.testing.assert_allclose(parameters(own, OWN)[:, 0], parameters(published, THESIS)[:, 0], rtol=1e-3)


def test_laws_are_for_a_machine_s_joints(log, lab):
    with pytest.raises(ssf.InputError, match=r"no such joint.*one of 1, 2, 3"):
        ssf.fit(log, laws={4: lab.GUIDE})
    with pytest.raises(ssf.InputError, match="'guide' is of joint 3, but is given for joint 1"):
        ssf.laws.choose_laws(log.rows.assign(joint=1), log.machine, {1: lab.GUIDE})
    with pytest.raises(ssf.InputError, match="is no StepLaw but str"):
        ssf.fit(log, laws={3: "guide"})


def bad_laws(guide):
    class StartsBelowZero(guide):
        def start_values(self, mean_step):
            return -super().start_values(mean_step)

    class NoNumber(guide):
        def scales(self, mean_step):
            return np.nan * super().scales(mean_step)

    class Raises(guide):
        def gamma(self, state, values):
            return 1 / 0

    class Unused(guide):
        parameters = (*guide.parameters[:2], Parameter("spare", "nm", "nothing"))

        def gamma(self, state, values):
            return super().gamma(state, values * [1, 1, 0])

        def gamma_slopes(self, state, values):
            return super().gamma_slopes(state, values * [1, 1, 0]) * [1, 1, 0]

    class WrongSlope(guide):
        def gamma_slopes(self, state, values):
            return super().gamma_slopes(state, values) * [1, -1, 1]

    class UnknownColumn(guide):
        columns = ("q2", "thetta", "psi")

    class TooFew(guide):
        def gamma_slopes(self, state, values):
            return super().gamma_slopes(state, values)[..., :2]

    class Twice(guide):
        parameters = (*guide.parameters[:2], guide.parameters[0])

    class Empty(guide):
        parameters = ()

    return {
        StartsBelowZero: r"start values \(free = -.*no step size above 0 in 48 traverses of 48",
        NoNumber: "scales gives .*nan.* finite number",
        Raises: r"ZeroDivisionError: division by zero \(test_own_laws.py, line \d+\)",
        Unused: "spare changes no count; use it",
        WrongSlope: "derivative by recoil is not that of its step size",
        UnknownColumn: "no column thetta; did you mean theta",
        TooFew: r"derivatives have shape \(48, 2\), not \(48, 3\)",
        Twice: "two of its parameters are called free",
        Empty: "no parameters",
    }


@pytest.mark.parametrize("number", range(9))
def test_a_bad_law_is_refused_with_one_message(number, log, lab):
    law, message = list(bad_laws(lab.Guide).items())[number]
    with pytest.raises(ssf.InputError, match=message) as error:
        ssf.fit(log, laws={3: law()})
    assert len(error.value.problems) == 1


def test_a_parameter_that_this_log_cannot_show_is_no_fault_of_the_law(log, lab):
    level = log.select(log.rows["q2"] < -1.5)
    result = ssf.fit(level, laws={3: lab.GUIDE})
    flags = [flag.message for flag in result.flags if flag.flag == "not_identified"]
    assert any("no count depends on recoil" in message for message in flags)


def test_what_cannot_be_told_apart_is_named_as_a_combination(log, lab):
    result = ssf.fit(log, laws={3: lab.Doubled()})
    message = next(flag.message for flag in result.flags if flag.flag == "not_identified")
    assert "free and more cannot be known one by one" in message
    falls, rises = (float(part.split()[0]) for part in message.split(" by ")[-2:])
    assert sorted([falls, rises])[1] / sorted([falls, rises])[0] == pytest.approx(2.0, rel=0.01)
    assert "rises by" in message
    assert "falls by" in message


def test_a_function_makes_the_law_of_its_joint_and_rows(log, lab):
    def make(joint, rows, machine):
        assert (joint, len(rows), machine) == (3, len(log.usable), log.machine)
        return lab.GUIDE

    assert ssf.fit(log, laws={3: make}).joints[3].law is lab.GUIDE


@pytest.mark.slow
def test_a_saved_result_comes_back_with_its_law_given_again(log, lab, tmp_path):
    causes = [cause for cause in ssf.causes.library() if cause.name == "drift"]
    result = ssf.fit(log, laws={3: lab.GUIDE}, causes=causes)
    result.save(tmp_path / "result.json")
    back = ssf.load_result(tmp_path / "result.json", laws={3: lab.Guide()})
    pd.testing.assert_frame_equal(back.si.parameters, result.si.parameters)
    pd.testing.assert_frame_equal(back.si.predict(log.usable), result.si.predict(log.usable))
    for laws in (None, {}, {3: Prismatic()}, {3: lab.Doubled()}):
        with pytest.raises(ssf.InputError, match=r"laboratory:Guide.*no code is run.*--law laboratory:Guide"):
            ssf.load_result(tmp_path / "result.json", laws=laws)


def test_a_law_that_changed_since_is_refused(log, lab, tmp_path, monkeypatch):
    ssf.fit(log, laws={3: lab.GUIDE}).save(tmp_path / "result.json")
    monkeypatch.setattr(lab.Guide, "parameters", (*lab.Guide.parameters[:2], Parameter("w", "nm", "")))
    with pytest.raises(ssf.InputError, match="has changed since"):
        ssf.load_result(tmp_path / "result.json", laws={3: lab.GUIDE})


def test_nothing_that_a_file_names_is_imported(log, lab, tmp_path, monkeypatch):
    (tmp_path / "stranger.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    monkeypatch.syspath_prepend(tmp_path)
    ssf.fit(log, laws={3: lab.GUIDE}).save(tmp_path / "result.json")
    text = (tmp_path / "result.json").read_text("utf-8").replace("laboratory:", "stranger:")
    content = json.loads(text)
    content.pop("checksum")
    (tmp_path / "result.json").write_text(json.dumps(content))
    with pytest.raises(ssf.InputError, match="stranger:Guide"):
        ssf.load_result(tmp_path / "result.json", laws={3: lab.GUIDE})
    assert not (tmp_path / "ran").exists()


def test_a_law_that_nothing_could_find_again_is_not_saved(log, lab, tmp_path):
    class Local(lab.Guide):
        pass

    result = ssf.fit(log, laws={3: Local()})
    with pytest.raises(ssf.InputError, match=r"cannot be saved.*Move it into a file"):
        result.save(tmp_path / "result.json")
    assert list(tmp_path.iterdir()) == []


def install(monkeypatch, **offered):
    def entry_points(group):
        assert group == "stickslip_fit.laws"
        return [SimpleNamespace(name=name, value=f"lab:{name}", load=load) for name, load in offered.items()]

    monkeypatch.setattr(registry, "entry_points", entry_points)


def test_an_installed_law_is_found_by_name_and_loads_with_a_result(
    log, lab, tmp_path, monkeypatch, path, run
):
    install(monkeypatch, guide=lambda: lab.Guide, both=lambda: lab.EVERY_JOINT)
    assert type(installed_laws()["guide"]) is lab.Guide
    status, printed, _ = run("fit", path, "--law", "guide", "--json", tmp_path / "result.json")
    assert status == 0
    assert "recoil" in printed
    assert ssf.load_result(tmp_path / "result.json").joints[3].law.name == "guide"


def missing():
    raise ModuleNotFoundError("No module named 'lab'")


def ending():
    raise SystemExit(3)


@pytest.mark.parametrize("load", [missing, ending, lambda: 5, lambda: dict])
def test_a_broken_installed_law_is_named_and_left_out(load, lab, monkeypatch):
    install(monkeypatch, broken=load, guide=lambda: lab.GUIDE)
    with pytest.warns(UserWarning, match="the law lab:broken of an installed package is left out"):
        assert list(installed_laws()) == ["guide"]


@pytest.mark.slow
def test_the_command_line_takes_a_law(path, log, lab, tmp_path, run, refused):
    saved = tmp_path / "result.json"
    status, printed, _ = run("fit", path, "--law", "laboratory:GUIDE", "--json", saved)
    assert status == 0
    assert "recoil" in printed
    expected = ssf.fit(log, laws={3: lab.GUIDE})
    back = ssf.load_result(saved, laws={3: lab.GUIDE})
    np.testing.assert_array_equal(back.joints[3].values, expected.joints[3].values)
    for name in ("laboratory:Guide", "3=laboratory:EVERY_JOINT", "laboratory:EVERY_JOINT"):
        assert run("calibrate", path, "--law", name)[0] == 0
    move = ("plan-move", saved, "--at", "0,-90,6", "--joints", "0,-90,7")
    complaint = refused(*move)
    assert "--law laboratory:Guide" in complaint
    # Joints 1 and 2 were not driven in this log.
    assert run(*move, "--law", "laboratory:GUIDE")[2] != complaint


def test_every_law_that_cannot_be_found_is_listed(path, lab, tmp_path, run):
    (tmp_path / "ends.py").write_text("raise SystemExit(3)\n")
    sys.path.append(str(tmp_path))
    names = ("nowhere:X", "unheard-of", "laboratory:NUMBER", "laboratory:missing", "2=laboratory:GUIDE")
    names = (*names, "ends:X")
    status, printed, complaint = run("fit", path, *(word for name in names for word in ("--law", name)))
    sys.path.remove(str(tmp_path))
    assert (status, printed) == (2, "")
    messages = (
        *("No module named", "no law that is known", "no law but int", "has no 'missing'"),
        *("of joint 3, not of", "SystemExit"),
    )
    for name, message in zip(names, messages, strict=True):
        assert any(name in line and message in line for line in complaint.splitlines())


@pytest.mark.slow
def test_what_cannot_be_saved_is_refused_before_the_fit(path, lab, monkeypatch, tmp_path, run, refused):
    class Local(lab.Guide):
        pass

    monkeypatch.setattr(lab, "NUMBER", Local())
    saved = tmp_path / "r.json"
    assert run("fit", path, "--law", "laboratory:NUMBER", "--json", saved)[0] == 0  # the variable holds it
    monkeypatch.setattr(lab, "NUMBER", lambda joint, rows, machine: Local())
    monkeypatch.setattr(ssf.estimation.least_squares, "iterate_weights", lambda *_: pytest.fail("fitted"))
    saved.unlink()
    assert "cannot be saved" in refused("fit", path, "--law", "laboratory:NUMBER", "--json", saved)
    assert "give its file as --causes-from" in refused("fit", path, "--law", saved)
    assert not saved.exists()


@pytest.mark.slow
def test_a_bound_is_of_the_law_in_hand(path, lab, run, refused):
    status, printed, _ = run("fit", path, "--law", "laboratory:GUIDE", "--bound", "weight=0:300")
    assert status == 0
    assert "held back by its bound at 300" in printed
    assert "free, recoil, weight" in refused("fit", path, "--law", "laboratory:GUIDE", "--bound", "b=0:1")


FORMULA = """
[joint.3]
formula = "gamma ~ (free - weight*load) * (1 - share*abs(cos(q2)))"
units = { free = "nm", weight = "nm", share = "1" }
start = { share = 0.2 }

[[cause]]
name = "slow"
formula = "* (1 + A*session_seconds/3600)"
parameters = "A in %"

[roles]
"""


@pytest.mark.slow
def test_a_file_of_formulas_gives_laws_and_causes(path, log, tmp_path, run, refused):
    (tmp_path / "law.toml").write_text(FORMULA)
    options = ("--law", tmp_path / "law.toml", "--cause", "slow")
    status, printed, complaint = run("fit", path, *options, "--json", tmp_path / "result.json")
    assert (status, complaint) == (0, "")
    assert "slow.A" in printed
    back = ssf.load_result(tmp_path / "result.json")  # text, so that nothing has to be given again
    table = back.si.parameters
    assert list(table["name"].unique()) == ["free", "weight", "share", "slow.A"]
    content = ssf.read_law_file(tmp_path / "law.toml")
    fitted = ssf.fit(log, laws=content.laws, causes=content.causes)
    pd.testing.assert_frame_equal(back.si.predict(log.usable), fitted.si.predict(log.usable))
    plain = ssf.fit(log, laws=content.laws)
    np.testing.assert_allclose(
        parameters(plain, ("free", "share", "weight")), parameters(ssf.fit(log), THESIS), rtol=1e-6
    )
    assert "would overwrite" in refused("fit", path, *options, "--json", tmp_path / "law.toml")


def test_a_function_in_a_saved_result_is_not_imported(log, lab, tmp_path):
    law = ssf.Law(lab.slope, units={"free": "nm", "weight": "nm"})
    result = ssf.fit(log, laws={3: law})
    result.save(tmp_path / "result.json")
    with pytest.raises(ssf.InputError, match=r"laboratory:slope.*no code is run"):
        ssf.load_result(tmp_path / "result.json")
    back = ssf.load_result(tmp_path / "result.json", laws={3: law})
    pd.testing.assert_frame_equal(back.si.predict(log.usable), result.si.predict(log.usable))


def test_an_amplitude_starts_where_no_traverse_stalls(campaign, read_table):
    table = campaign(("2012-03-05",), ({"joint": 1}, {"joint": 1, "from_deg": 60.0, "to_deg": -20.0}))
    result = ssf.fit(read_table(table), laws={1: ssf.Law("gamma ~ g*(1 + A*sin(q))")})
    assert np.isfinite(result.joints[1].values).all()
    assert not any(flag.flag == "not_converged" for flag in result.flags)
