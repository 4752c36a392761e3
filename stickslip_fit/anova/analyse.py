"""Which factors matter in a log: everything asked at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import pandas as pd

from stickslip_fit._summary import Summarized
from stickslip_fit.anova.answer import Answer, answer
from stickslip_fit.anova.components import Components, components
from stickslip_fit.anova.day import day
from stickslip_fit.anova.direction import direction
from stickslip_fit.anova.holm import holm
from stickslip_fit.anova.normal_force import normal_force
from stickslip_fit.anova.question import Choose, Question, Refusal, most_read
from stickslip_fit.anova.readings import readings, selected
from stickslip_fit.anova.record import COLUMNS, record
from stickslip_fit.fit.result import AxesOf
from stickslip_fit.logs import Log


@dataclass(frozen=True, repr=False)
class Anova(Summarized):
    """What a log says of day, direction and normal force.

    Attributes
    ----------
    answers : tuple of Answer
    refusals : tuple of Refusal
        What was asked and cannot be answered, with the reason.
    components : tuple of Components
        Variance components of each joint that has them.
    """

    answers: tuple[Answer, ...]
    refusals: tuple[Refusal, ...]
    components: tuple[Components, ...] = ()

    def plot_factor(self, joint: int, factor: str) -> AxesOf:
        """One joint's readings by ``day``, ``direction`` or ``normal-force``.

        Raises
        ------
        InputError
            If that was not answered.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.factors import plot_factor

        return panels(plot_factor(joint, factor, self.answers))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each question, the refused ones last; see `record.record`."""
        return pd.DataFrame(self.to_json(), columns=list(COLUMNS))

    def to_json(self) -> list[dict[str, object]]:
        """One object for each question, in people's units, null where a field does not apply."""
        return [*map(record, self.answers), *map(record, self.refusals)]


def analyse(
    log: Log, *, joint: int | None = None, session: str | None = None, choose: Choose = most_read
) -> Anova:
    """Ask the thesis's three questions of each joint.

    Parameters
    ----------
    log : Log
    joint : {1, 2, 3}, optional
        Ask of this joint only.
    session : str, optional
        Ask within this session only.
    choose : callable, optional
        Picks the configurations at which they are asked: `question.most_read`, one for each joint, or
        `question.every`.

    Raises
    ------
    InputError
        If the log has no usable traverse of that joint in that session.
    """
    rows = selected(readings(log), joint, session)
    asked = [
        each
        for number, mine in rows.groupby("joint")
        for ask in (day, direction, normal_force)
        for each in ask(mine, log.machine.span(int(number)), choose)
    ]
    found = [components(mine) for _, mine in rows.groupby("joint")]
    return replace(answered(asked), components=tuple(each for each in found if isinstance(each, Components)))


def answered(asked: Sequence[Question | Refusal]) -> Anova:
    """Answer questions, with p-values adjusted for all of them."""
    told = [answer(each) if isinstance(each, Question) else each for each in asked]
    answers = [each for each in told if isinstance(each, Answer)]
    adjusted = holm([each.p_value for each in answers])
    return Anova(
        tuple(replace(each, p_holm=float(p)) for each, p in zip(answers, adjusted, strict=True)),
        tuple(each for each in told if isinstance(each, Refusal)),
    )
