"""Unknown structure: recognised wherever it lies, given a law by a short term or a smooth function."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes import AlongTravel, Temperature, extend
from stickslip_fit.causes.added_steps import AddedSteps
from stickslip_fit.causes.proposed import (
    JointTerm,
    NestedTerm,
    ProposedTerm,
    SmoothTerm,
    TravelTerm,
)
from stickslip_fit.causes.registry import describe, restore
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis.alternatives import attribute_to_causes, build_unstructured_alternatives
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.evidence import STRENGTHS, batch_hypotheses, group_directions
from stickslip_fit.diagnosis.expressions import build_log_dictionary
from stickslip_fit.diagnosis.extension import SelectedCause
from stickslip_fit.diagnosis.finding import Gain
from stickslip_fit.diagnosis.hypotheses import Hypothesis, compute_changes, make_hypothesis
from stickslip_fit.diagnosis.misfit import UNKNOWN, weigh_evidence
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.proposed_term import propose_term
from stickslip_fit.diagnosis.smooth_alternatives import build_smooth_alternatives
from stickslip_fit.diagnosis.withdrawal import find_unsupported, withdraw_causes
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Prismatic
from stickslip_fit.machine import load_machine
from tests.hidden import outside
from tests.hidden.catalogue import EFFECTS
from tests.hidden.effect import Effect, sized
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden


def sine_times_load(campaign, rng):
    """On joint 3 alone, the step size times 1 + A sin(q1) u."""

    def factor(place, size):
        return 1 + size * np.sin(place.angles["q1"]) * place.load if place.joint == 3 else 1.0

    return Effect(0.05, sized("A", "%", 100), factor=factor)


@pytest.fixture(scope="module")
def hidden_logs():
    """A log with an effect that no cause describes, and a replicate of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(EFFECTS, "unknown:test", {"only": sine_times_load})
        return [
            read_hidden(hide("many", ("unknown:test",), 20.0, "gaussian", (), 3, replicate=replicate))
            for replicate in (0, 1)
        ]


@pytest.fixture(scope="module")
def found(hidden_logs):
    """Of joint 3's traverses, to be quick."""
    log = hidden_logs[0]
    return diagnose(log.select(log.rows["joint"] == 3), seed=1, gain=False)


@pytest.fixture(scope="module")
def linearized(hidden_logs):
    """The fit of the published laws to all joints."""
    return problem_from_log(hidden_logs[0])[0].linearize()


@pytest.mark.nightly
def test_a_term_acts_on_the_joint_that_has_the_effect(hidden_logs):
    (finding,) = diagnose(hidden_logs[0], seed=1, gain=False).findings
    assert (finding.term, finding.joints) == ("k * sin(q1) * load, joint 3", (3,))


@pytest.mark.nightly
def test_a_law_says_nothing_of_a_joint_of_which_the_log_shows_nothing():
    """Of joint 1 only traverses at q3 = 0 are left, where a product with q3 is nothing."""
    case = next(one for one in outside.cases((25.0,), 461_000) if one.form == "q3 and sin theta, joint 2")
    log = read_hidden(case.make(0))
    shows = (log.rows["joint"] == 2) | ((log.rows["joint"] == 1) & (log.rows["q3"] == 0.0))
    (finding,) = diagnose(log.select(shows), causes=(), gain=False).findings
    assert {joint for joint, _ in finding.version.on} == {2}


@pytest.fixture(scope="module")
def alternatives(linearized):
    return list(build_unstructured_alternatives(linearized))


def test_a_short_term_is_proposed_and_predicts_a_replicate(found, hidden_logs):
    assert found.verdict == "unknown cause"
    (finding,) = found.findings
    assert finding.term == "k * sin(q1) * load"
    assert finding.joints == (3,)
    law = found.extended_law().joints[3]
    rows = hidden_logs[1].rows
    rows = rows[(rows["joint"] == 3) & (rows["status"] == "ok")].reset_index(drop=True)
    values = law.values[law.group_index(rows)]
    without = values.copy()
    without[:, -1] = 0.0
    response = law.law.response(rows)[0]
    errors = [np.std(response - law.law.predict(rows, one)) for one in (values, without)]
    assert errors[0] < 0.9 * errors[1]
    (size,) = (parameter.size for parameter in finding.parameters)
    assert size.low < law.values[0, -1] < size.high


def test_every_known_cause_has_its_share_and_gains_less_than_the_term(found):
    table = found.explain_unknown()
    assert table["cause"].iloc[0] in found.findings[0].explains
    assert table["share"].is_monotonic_decreasing
    assert ((table["share"] >= 0) & (table["share"] <= 1 + 1e-9)).all()
    finding = found.findings[0]
    assert all(finding.explains[cause] >= share for cause, share in finding.explains_by_equation.items())
    # A cause that explains nothing of the structure gains nothing on held-out traverses.
    assert table["gain"].iloc[-1] < 1e-4
    assert np.isfinite(table[["error", "gain"]]).all(axis=None)


@pytest.mark.slow
def test_a_term_that_does_not_predict_better_leaves_the_law_and_unknown_stays(found):
    (finding,) = found.findings
    worse = Gain(0.004, 0.0041, 0.003, -0.001, 0.001, found.residuals)
    findings = (replace(finding, gain=worse),)
    unsupported = find_unsupported(findings)
    assert unsupported == findings
    selection, left = withdraw_causes(found.selection, findings, unsupported, found.info)
    assert (left[0].cause, left[0].version, left[0].term) == ("unknown", None, "")
    assert selection.law_causes == []


def test_a_law_with_terms_is_saved_and_restored(hidden_logs):
    machine = hidden_logs[0].machine
    smooth = SmoothTerm(("theta", "load"), ((-0.5, 0.5), (-1.0, 1.0)), ((1, 1),), (0.02,), ((3, "+"),))
    term = ProposedTerm((("sin(x)", "q1", 0.0, 1.0), ("x", "load", 0.0, 1.0)), ((3, "+"),))
    assert term.formula == "k * sin(q1) * load, joint 3, + only"
    law = extend(extend(Prismatic(), smooth), term)
    travel = TravelTerm(on=((2, "+"), (3, "+")), sessions=("a", "b"), travel=((2, -2.0, 0.5), (3, 0.0, 0.01)))
    waves = JointTerm(
        ("session_seconds",), ((0.0, 9e3),), on=((2, "+"), (3, "+"), (3, "-")), sessions=("a", "b")
    )
    assert len(waves.parameters) == 4  # of two joints in two sessions
    parts = NestedTerm.of_parts(travel, [(True, "same", (0.1, 0.02)), (False, "opposite", (0.1, 0.02))])
    assert len(parts.parameters) == 12  # of two joints, in two sessions and of opposite sign in directions
    law = extend(law, travel, waves, parts, AddedSteps(("q1",), ((-1.0, 1.0),), on=((3, "-"),)))
    restored = restore(describe(law), machine)
    assert restored.causes == law.causes


def test_a_function_of_an_earlier_version_is_refused(hidden_logs):
    described = describe(extend(Prismatic(), SmoothTerm(("theta",), ((-0.5, 0.5),))))
    described["causes"][0]["name"] = "smooth-term"
    with pytest.raises(InputError, match="earlier version, where it meant something else; diagnose"):
        restore(described, hidden_logs[0].machine)
    described = describe(extend(Prismatic(), AlongTravel()))
    assert restore(described, hidden_logs[0].machine).causes == (AlongTravel(),)
    profile = described["causes"][0]
    profile["shape"] = profile.pop("sds")
    with pytest.raises(InputError, match="'along-travel' of an earlier version"):
        restore(described, hidden_logs[0].machine)


@pytest.mark.slow
def test_directions_that_hypotheses_share_are_evaluated_once_and_right(linearized):
    hypotheses = build_smooth_alternatives(linearized)
    directions = sum(len(group.directions) for group in group_directions(hypotheses))
    assert directions < 0.8 * sum(len(one.prior_share) for one in hypotheses)
    residual = linearized.residual
    evidence = batch_hypotheses(hypotheses, linearized.df).log_evidence(residual[:, None])[:, 0]
    for one, its_evidence in list(zip(hypotheses, evidence, strict=True))[::37]:
        signal = STRENGTHS[:, None] ** 2 * one.prior_share
        explained = (signal / (1 + signal)) @ (one.directions.T @ residual) ** 2 / (residual @ residual)
        log = -0.5 * np.sum(np.log1p(signal), axis=1) - 0.5 * linearized.df * np.log1p(-explained)
        assert its_evidence == pytest.approx(np.log(np.mean(np.exp(log))), abs=1e-6)


@pytest.mark.parametrize(
    "name",
    [
        "q1, opposite",
        "psi, - only",
        "pause, joint 1",
        "theta, each joint and direction",
        "product of theta and load, joint 3",
        "period of",
        "q2, joint 3, in each session",
        "position, joint 2, in each session, each direction",
        "position, joint 2, in each session, in part",
        "position, each joint, in each session",
        "position, each joint, in each session, each direction",
    ],
)
def test_an_alternative_has_the_effects_of_the_law_that_it_becomes(linearized, alternatives, name):
    """At the sizes that its prior says: the law's effects have the covariance of the hypothesis."""
    one = next(one for one in alternatives if one.cause.startswith(f"unknown:{name}"))
    assert isinstance(one, Hypothesis)
    changes = compute_changes(
        linearized, one.version, np.diag([each.prior_sd for each in one.version.parameters])
    )
    effects = linearized.project(linearized.whiten(changes))
    assert np.sqrt(np.sum(effects**2)) == pytest.approx(one.length, rel=0.05)
    covariance = one.length**2 * (one.directions * one.prior_share) @ one.directions.T
    difference = np.linalg.norm(effects @ effects.T - covariance)
    # Averages along a traverse are not weighted by the step size, which gravity changes along joint 2's.
    allowed = 0.2 if name.startswith("position") else 0.1
    assert difference < allowed * np.linalg.norm(covariance)


@pytest.mark.slow
def test_nothing_unknown_has_nothing_to_explain():
    answer = diagnose(read_hidden(hide("session", (), None, "gaussian", (), 2)), gain=False)
    assert answer.verdict == "nothing wrong"
    assert answer.explain_unknown().empty


@pytest.mark.slow
def test_every_coordinate_and_column_has_an_alternative_and_a_recorded_one_none_of_its_causes(linearized):
    rows = linearized.rows
    hypotheses = build_smooth_alternatives(linearized)
    names = {one.cause.removeprefix("unknown:") for one in hypotheses}
    columns = ["temperature", "humidity", *(name for name in rows if name.startswith("covariate:"))]
    history = ["session_seconds", "steps_before", "before_load", "before_direction", "before_joint", "pause"]
    angles = ["q1", "q2", "q3", "theta", "psi"]
    for name in (*angles, *columns, *history, "before_length", "product of q1 and load"):
        assert f"{name}, opposite" in names
    # Any function of the temperature, the same for all joints, is the cause temperature.
    temperature = Temperature(mean=294.0)
    attributed = attribute_to_causes(hypotheses, [temperature], ())
    assert {one.cause for one in attributed if getattr(one.version, "of", "") == "temperature"} == {
        "temperature"
    }
    left_out = {one.cause for one in attribute_to_causes(hypotheses, [temperature], ["temperature"])}
    assert not {"temperature", "unknown:temperature"} & left_out
    assert {"unknown:theta", "unknown:temperature, opposite"} <= left_out
    assert all(one.version is not None for one in hypotheses)


@pytest.mark.slow
def test_rows_weigh_as_the_noise_that_was_found(tmp_path):
    """A tenth of the configurations is five times as noisy, and two counts are 30 % off."""
    hidden = hide("thesis", (), 0.0, "configurations", (), 5)
    counts = hidden.campaign.counts[hidden.campaign.plan.joint == 3]
    log = read_hidden(hidden)
    log = log.select(log.rows["joint"] == 3)
    wrong = log.rows.index[[40, 100]]
    log.rows.loc[wrong, "steps"] = (1.3 * log.rows.loc[wrong, "steps"]).astype(int)
    found = ssf.diagnose(log, seed=1, gain=False)
    assert [finding.cause for finding in found.findings] == ["end-stop-misfire"]
    law, selection = found.extended_law(), found.selection
    law.save(tmp_path / "law.json")
    assert ssf.load_result(tmp_path / "law.json").method == "weighted-least-squares"
    steps = law.predict(log.usable)["steps"].to_numpy()
    # The noise, and with it every weight, is that of the law whose gain is measured.
    kept = np.delete(np.arange(len(steps)), selection.outliers)
    fitted = selection.problem.responses - selection.fit.residual
    assert np.log(steps[kept]) == pytest.approx(fitted, abs=1e-6)
    plain = ssf.fit(log.exclude(wrong)).predict(log.usable)["steps"].to_numpy()
    errors = [np.sqrt(np.mean(np.log(one / counts) ** 2)) for one in (steps, plain)]
    assert errors[0] < 0.7 * errors[1]


@pytest.mark.slow
def test_the_size_of_a_single_outlying_count_is_known_within_its_noise():
    """And no better: the interval of one value is not that of values among each other."""
    log = read_hidden(hide("thesis", (), 0.0, "gaussian", (), 5))
    log = log.select(log.rows["joint"] == 3)
    row = log.rows.index[68]
    log.rows.loc[row, "steps"] = round(np.exp(0.15) * log.rows.loc[row, "steps"])
    found = ssf.diagnose(log, seed=1, gain=False)
    (finding,) = found.findings
    size = finding.parameters[1].size
    assert size.low < 0.15 < size.high
    assert size.low < size.estimate < size.high
    assert 1.9 < (size.high - size.low) / 2 / found.repeatability < 4.0


def law_for(linearized, alternatives, column, expressions, strength=25.0):
    """The law proposed for a change of the log counts, shape (n,), in noise, and the error of its fit.

    The error is what is wrong of the whitened change, as a share of its square.
    """
    rng = np.random.default_rng(2)
    change = linearized.project(linearized.whiten(column))
    change *= strength / np.linalg.norm(change)
    noise = linearized.project(rng.standard_normal(len(change)))
    misfit = weigh_evidence(replace(linearized, residual=change + noise), alternatives)
    unknown = SelectedCause(UNKNOWN, None, np.zeros(0), form_cause_set(misfit, UNKNOWN), misfit, 0.0)
    version = propose_term(linearized, [unknown], expressions, rng)[0].version
    sizes = np.diag([min(one.prior_sd, 1.0) for one in version.parameters])
    effects = linearized.project(linearized.whiten(compute_changes(linearized, version, sizes)))
    values = np.linalg.solve(effects.T @ effects + np.eye(len(sizes)), effects.T @ misfit.residual)
    return version, np.sum((effects @ values - change) ** 2) / strength**2


@pytest.mark.parametrize(
    "surface",
    [lambda theta, time: (theta - 0.5) * (4.0 * np.abs(time - 0.5) - 1.0), lambda theta, time: theta * time],
    ids=["falls with the one, rises and falls with the other", "has a mean over each"],
)
def test_a_function_of_two_carriers_has_more_than_their_lowest_functions(linearized, alternatives, surface):
    carriers = ("theta", "session_seconds")
    products = [one for one in alternatives if getattr(one.version, "carriers", ()) == carriers]
    rows = linearized.rows
    theta, time = ((rows[name] - rows[name].min()) / np.ptp(rows[name]) for name in carriers)
    version, error = law_for(linearized, products, surface(theta, time).to_numpy(), lambda fit: None)
    assert version.carriers == carriers
    assert error < 0.05


@pytest.mark.slow
def test_a_short_term_may_follow_the_traverse_before(linearized, alternatives):
    """As a share of the joint's travel, or of a pause the logarithm; unknown of a first traverse."""
    gap, pause = (linearized.rows[name].to_numpy(float) for name in ("before_gap", "pause"))
    expressions = partial(build_log_dictionary, machine=load_machine())
    for name, values in (("before gap", gap), ("log(1 + pause / s)", np.log1p(pause))):
        centred = np.nan_to_num(values - np.nanmean(values))
        version, error = law_for(linearized, alternatives, centred, expressions)
        assert version.formula.startswith(f"k * (({name} - ")
        assert error < 0.02


@pytest.fixture(scope="module")
def by_direction(tmp_path_factory):
    """A slide's step size follows sin(psi), by -6 % in one direction, +2 % in the other; noise of 0.3 %."""
    folder, rng = tmp_path_factory.mktemp("slide"), np.random.default_rng(11)
    lines = ["session,joint,direction,steps,check_every,q1_mm,from_mm,to_mm,theta_deg,psi_deg"]
    for k in range(240):
        way, psi = "+-"[k % 2], rng.choice([-90, -45, 0, 30, 60, 90])
        factor = 1 + np.sin(np.radians(psi)) * (-0.06 if way == "+" else 0.02)
        steps = 1e4 / factor * np.exp(0.003 * rng.standard_normal())
        ends = "0,10" if way == "+" else "10,0"
        lines.append(f"d{k // 80},1,{way},{steps:.0f},1,,{ends},0,{psi}")
    (folder / "log.csv").write_text("\n".join(lines), "utf-8")
    (folder / "m.toml").write_text('name = "s"\n[[joint]]\nkind = "prismatic"\nrange_mm = [0, 10]\n', "utf-8")
    return ssf.read_log(folder / "log.csv", machine=load_machine(folder / "m.toml"))


def test_a_term_has_a_size_for_each_direction_where_one_does_not_suffice(by_direction):
    diagnosis = diagnose(by_direction, gain=False)
    (finding,) = diagnosis.findings
    assert finding.term == "k * sin(psi), k by direction"
    sizes = {one.direction: one.size for one in finding.parameters}
    assert sizes["+"].low < -0.06 < sizes["+"].high
    assert sizes["-"].low < 0.02 < sizes["-"].high
    assert "k (+) = −6.0" in diagnosis.summary().headline[0]
    law = diagnosis.extended_law().joints[1].law
    assert restore(describe(law), by_direction.machine).causes == law.causes


@pytest.mark.slow
def test_what_pairs_of_places_explain_is_that_of_least_squares(hidden_logs):
    """Also beside a cause whose parameter the directions share, which makes their effects dependent."""
    problem = problem_from_log(hidden_logs[0])[0]
    plain = problem.linearize()
    both = np.random.default_rng(3).standard_normal((len(problem), 2))
    for linearized in (plain, plain.absorb(plain.project(plain.whiten(both)))):
        dictionary = build_log_dictionary(linearized, hidden_logs[0].machine)
        residual = linearized.residual
        explained = dictionary.explained(residual[:, None])[..., 0]
        for place, (one, other) in enumerate(dictionary.pairs, dictionary.n_single):
            best = int(np.argmax(explained[place]))
            sets = np.zeros((len(residual), 2))
            for column, which in enumerate((one, other)):
                for rows, by in zip(dictionary.groups, dictionary.combine[which], strict=True):
                    sets[rows, column] = by * dictionary.columns[rows, best]
            effects = linearized.project(sets)
            values, *_ = np.linalg.lstsq(effects, residual, rcond=None)
            fitted = effects @ values
            assert explained[place, best] == pytest.approx(fitted @ fitted, rel=1e-6)
            np.testing.assert_allclose(dictionary.coefficients(place, best, residual), values, rtol=1e-5)


@pytest.mark.slow
def test_no_alternative_explains_more_than_there_is_where_much_is_absorbed():
    """Part by part, what joints and directions lose to what is absorbed would count several times."""
    plain = problem_from_log(read_hidden(hide("session", seed=4)))[0].linearize()
    rng = np.random.default_rng(1)
    absorbed = plain.absorb(rng.standard_normal((len(plain), 120)))
    noise = absorbed.project(rng.standard_normal((len(plain), 20)))
    squares = np.sum(noise**2, axis=0)
    for one in build_smooth_alternatives(absorbed):
        explained = [np.sum(one.coefficients(own) ** 2) for own in noise.T]
        assert np.all(explained < 1.05 * squares), one.cause


def test_an_expression_is_looked_for_anew_where_the_test_has_it_already(linearized, alternatives):
    """As in a fold, whose rows may show none: what is left then is a smooth function."""
    term = ProposedTerm((("sin(x)", "theta", 0.0, 1.0, "deg"),))
    effect = linearized.project(linearized.whiten(compute_changes(linearized, term, np.array([[0.01]]))))
    change = 25.0 * effect[:, 0] / np.linalg.norm(effect)
    misfit = weigh_evidence(replace(linearized, residual=change), alternatives)
    misfit = misfit.with_likeliest(make_hypothesis(f"{UNKNOWN}:theta", term, None, effect))
    assert misfit.best_hypothesis(UNKNOWN).version is term
    unknown = SelectedCause(UNKNOWN, None, np.zeros(0), form_cause_set(misfit, UNKNOWN), misfit, 0.0)
    (proposed,) = propose_term(linearized, [unknown], lambda fit: None, np.random.default_rng(2))
    assert isinstance(proposed.version, SmoothTerm)
