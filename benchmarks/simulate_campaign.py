"""Simulating a million traverses against literally stepping them."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from time import perf_counter

from stickslip_fit.logs.plan import Plan, PlannedSession
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import LawValues, read_law_values, simulate, step_through

REFERENCE = Path(__file__).parents[1] / "data" / "reference"
TRAVERSES = 1_000_000
REQUIRED = 1_000


def main() -> None:
    machine = load_machine()
    plan = enlarged(read_plan(REFERENCE / "plan.toml", machine), TRAVERSES)
    truth = read_law_values(REFERENCE / "law.toml", machine)
    began = perf_counter()
    log = simulate(plan, truth, machine)
    simulated = (perf_counter() - began) / len(log)
    stepped = seconds_per_stepped_traverse(plan, truth)
    print(
        f"simulate_campaign: {len(log):,} traverses in {simulated * len(log):.2f} s, "
        f"{simulated * 1e6:.2f} µs each; stepped {stepped * 1e3:.1f} ms each; "
        f"ratio {stepped / simulated:,.0f} (required {REQUIRED:,})"
    )


def enlarged(plan: Plan, traverses: int) -> Plan:
    """The plan with a session every second day until it has so many traverses."""
    first = plan.sessions[0].begins
    days = range(-(-traverses // plan.traverses_per_session))
    sessions = [PlannedSession(f"session {day}", first + timedelta(days=2 * day)) for day in days]
    return replace(plan, sessions=tuple(sessions))


def seconds_per_stepped_traverse(plan: Plan, truth: LawValues) -> float:
    """Each traverse's share of one session, all traverses of a joint stepped side by side as arrays."""
    rows = plan.rows().iloc[: plan.traverses_per_session]
    began = perf_counter()
    for joint, part in rows.groupby("joint"):
        step_through(truth.laws[int(joint)], part, truth.of_rows(part, int(joint))[0])
    return (perf_counter() - began) / len(rows)


if __name__ == "__main__":
    main()
