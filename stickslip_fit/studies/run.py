"""run_study: from a StudyPlan to a SimulationStudy. Start reading here.

Order: `plan`, `simulation`, `calibration`, `execution`, `study`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pandas as pd

from stickslip_fit._io import progress_bar
from stickslip_fit.errors import InputError
from stickslip_fit.studies.calibration import StudyDesign, design_study
from stickslip_fit.studies.execution import Backend, Chunk, Cores, ResultStore, current_code_version
from stickslip_fit.studies.plan import StudyPlan
from stickslip_fit.studies.simulation import CAMPAIGN_SPACING
from stickslip_fit.studies.study import SimulationStudy

CHUNK_CAMPAIGNS = 100  # campaigns; seconds of work
MAX_ROWS = 200_000  # of all of them; hundreds of megabytes
MAX_CLOCK_TIME = timedelta(days=365 * 250)  # so long can a clock run on which they stand one after the other


def run_study(
    plan: StudyPlan,
    folder: str | Path | None = None,
    backend: Backend = Cores(),  # noqa: B008 - frozen, and without state
    *,
    progress: bool = False,
    command: str = "",
) -> SimulationStudy:
    """Simulate every campaign, let every strategy calibrate it, and sum up.

    A campaign depends on the study's seed, its scenario's name and its number alone: the numbers are the same
    on any backend, and whatever was finished before.

    Parameters
    ----------
    plan : StudyPlan
    folder : path, optional
        Keeps campaigns, up to a hundred at a time, as they are finished; the same study in the same folder,
        were it with more campaigns or scenarios, only works on what is missing.
    backend : Backend, optional
    progress : bool, optional
        Show it, where there is a terminal.
    command : str, optional
        Kept in the study's provenance.

    Raises
    ------
    InputError
        If two strategies or scenarios have one name, the plan suits none, a joint comes to a halt, the folder
        cannot be written to, or the backend fails.
    """
    _check_names("strategies", [strategy.name for strategy in plan.strategies])
    _check_names("scenarios", [scenario.name for scenario in plan.scenarios])
    common = design_study(plan)
    chunks = make_chunks(plan, common)
    if folder is None:
        found = dict(_run_chunks(chunks, backend, progress, 0))
    else:
        found = dict(
            _load_or_run(chunks, ResultStore(Path(folder), current_code_version()), backend, progress)
        )
    return SimulationStudy(
        plan, common, pd.concat([found[k] for k in range(len(chunks))], ignore_index=True), command
    )


def make_chunks(plan: StudyPlan, common: StudyDesign) -> list[Chunk]:
    """The pieces of a study, scenario by scenario."""
    sessions = plan.plan.sessions
    lasts = sessions[-1].begins - sessions[0].begins + CAMPAIGN_SPACING
    rows = len(sessions) * plan.plan.traverses_per_session
    size = max(1, min(CHUNK_CAMPAIGNS, MAX_ROWS // rows, MAX_CLOCK_TIME // lasts))
    return [
        Chunk(plan, common, scenario, first, min(first + size, plan.campaigns))
        for scenario in plan.scenarios
        for first in range(0, plan.campaigns, size)
    ]


def _load_or_run(
    chunks: Sequence[Chunk], store: ResultStore, backend: Backend, progress: bool
) -> Iterator[tuple[int, pd.DataFrame]]:
    """Each chunk's place and table; what was not there is worked on and kept first."""
    missing = [k for k, chunk in enumerate(chunks) if not store.has(chunk)]
    done = sum(map(len, chunks)) - sum(len(chunks[k]) for k in missing)
    for place, table in _run_chunks([chunks[k] for k in missing], backend, progress, done):
        store.write(chunks[missing[place]], table)
    for k, chunk in enumerate(chunks):
        yield k, store.read(chunk)


def _run_chunks(
    chunks: Sequence[Chunk], backend: Backend, progress: bool, done: int
) -> Iterator[tuple[int, pd.DataFrame]]:
    total = done + sum(map(len, chunks))
    shown = progress_bar(progress, total=total, initial=done, unit=" campaigns")
    with shown, closing(backend.run(chunks)) as results:
        for place, table in results:
            shown.update(len(chunks[place]))
            yield place, table


def _check_names(what: str, names: list[str]) -> None:
    if not names or len(set(names)) < len(names):
        raise InputError(f"{what} need names that differ, and there must be one; these are {names}")
