"""The same numbers on every backend, and after an interruption; nothing is worked on twice."""

from dataclasses import dataclass, field, replace
from datetime import timedelta

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.strategies import ClosedForm
from stickslip_fit.studies import Cores, Scenario, run_study
from stickslip_fit.studies import study as study_module
from stickslip_fit.studies.execution import ResultStore, current_code_version

ORDER = ["scenario", "campaign", "strategy", "joint", "direction"]


@dataclass
class Watched:
    """One core; keeps count, and is interrupted after so many chunks."""

    most: int = 1000
    worked_on: list[str] = field(default_factory=list)

    def run(self, chunks):
        for place, chunk in enumerate(chunks):
            if len(self.worked_on) == self.most:
                raise KeyboardInterrupt
            self.worked_on.append(str(chunk))
            yield place, chunk.run()


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(study_module, "CHUNK_CAMPAIGNS", 7)


def same(first, second):
    both = [found.campaigns.sort_values(ORDER).reset_index(drop=True) for found in (first, second)]
    pd.testing.assert_frame_equal(*both, check_exact=True)


@pytest.mark.slow
def test_chunks_and_processes_change_nothing(study, monkeypatch):
    plan = study(scatter="uneven", scenarios=(Scenario("a"), Scenario("b")), campaigns=10)
    whole = run_study(plan, backend=Cores(1))
    assert len(whole.campaigns) == 2 * 10 * 3 * 2
    monkeypatch.setattr(study_module, "CHUNK_CAMPAIGNS", 7)
    same(whole, run_study(plan, backend=Cores(2)))


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_an_interrupted_study_goes_on_where_it_was(study, tmp_path):
    plan = study()
    uninterrupted = run_study(plan, backend=Watched())
    with pytest.raises(KeyboardInterrupt):
        run_study(plan, tmp_path, Watched(most=2))
    assert len(list(tmp_path.rglob("*.parquet"))) == 2
    rest = Watched()
    same(uninterrupted, run_study(plan, tmp_path, rest))
    assert rest.worked_on == ["campaigns 14 to 19 of 'nothing hidden'"]
    nothing = Watched()
    same(uninterrupted, run_study(plan, tmp_path, nothing))
    assert nothing.worked_on == []


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_only_what_is_new_is_worked_on(study, tmp_path):
    plan = study(campaigns=14)
    run_study(plan, tmp_path, Watched())
    more = Watched()
    run_study(replace(plan, campaigns=21), tmp_path, more)
    assert more.worked_on == ["campaigns 14 to 20 of 'nothing hidden'"]
    another = Watched()
    run_study(replace(plan, scenarios=(*plan.scenarios, Scenario("b"))), tmp_path, another)
    assert another.worked_on == ["campaigns 0 to 6 of 'b'", "campaigns 7 to 13 of 'b'"]


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize(
    "changed",
    [
        {"seed": 1},
        {"strategies": (ClosedForm(),)},
        pytest.param({"scatter": "t5"}, marks=pytest.mark.nightly),
        pytest.param({"between_sessions": 0.02}, marks=pytest.mark.nightly),
        pytest.param({"repeatability": {(3, way): 0.003 for way in "+-"}}, marks=pytest.mark.nightly),
    ],
)
def test_a_changed_study_does_not_mix(changed, study, tmp_path):
    plan = study(campaigns=7)
    run_study(plan, tmp_path, Watched())
    other = Watched()
    found = run_study(replace(plan, **changed), tmp_path, other)
    assert len(other.worked_on) == 1
    same(found, run_study(replace(plan, **changed), backend=Watched()))


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_a_damaged_chunk_is_named(study, tmp_path):
    plan = study(campaigns=7)
    run_study(plan, tmp_path, Watched())
    chunk = next(tmp_path.rglob("*.parquet"))
    chunk.write_bytes(chunk.read_bytes()[:100])
    with pytest.raises(InputError, match=r"000000-000006.parquet: cannot be read .* delete it"):
        run_study(plan, tmp_path, Watched())


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_no_bit_of_a_chunk_can_flip_unnoticed(study, tmp_path):
    plan = study(campaigns=7)
    run_study(plan, tmp_path, Watched())
    (chunk,) = study_module.make_chunks(plan, None)
    store = ResultStore(tmp_path, current_code_version())
    path, rng = store.path_of(chunk), np.random.default_rng(1)
    raw = path.read_bytes()
    for place in rng.integers(len(raw), size=100):
        damaged = bytearray(raw)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="its hash is another"):
            store.read(chunk)
    path.write_bytes(raw)
    assert set(store.read(chunk)["campaign"]) == set(range(7))
    path.with_suffix(".sha256").unlink()
    with pytest.raises(InputError, match="cannot be read"):
        store.read(chunk)


def test_what_cannot_be_told_apart_is_refused(study):
    with pytest.raises(InputError, match="scenarios need names that differ"):
        run_study(study(scenarios=(Scenario("a"), Scenario("a"))))
    with pytest.raises(InputError, match="strategies need names that differ"):
        run_study(study(strategies=(ClosedForm(), ClosedForm())))


@pytest.mark.slow
def test_large_plans_come_in_smaller_pieces(study, monkeypatch):
    plan = study()
    monkeypatch.setattr(study_module, "MAX_ROWS", 5 * len(plan.plan.rows()))
    assert [chunk.last - chunk.first for chunk in study_module.make_chunks(plan, None)] == [5, 5, 5, 5]
    sessions = plan.plan.sessions
    later = replace(sessions[1], begins=sessions[1].begins + timedelta(days=365 * 30))
    spread = replace(plan, plan=replace(plan.plan, sessions=(sessions[0], later)))
    monkeypatch.setattr(study_module, "MAX_ROWS", 10**9)
    assert max(map(len, study_module.make_chunks(spread, None))) == 8
    assert len(run_study(spread, backend=Cores(1)).campaigns) == 20 * 3 * 2


def test_a_session_that_is_not_over_is_named(study):
    plan = study()
    first, second = plan.plan.sessions
    soon = replace(second, begins=first.begins + timedelta(minutes=20))
    hurried = replace(plan, plan=replace(plan.plan, sessions=(first, soon)))
    with pytest.raises(
        InputError, match=r"session '2012-03-05' takes .* not over when .*'2012-03-06' begins"
    ):
        run_study(hurried, backend=Cores(1))
