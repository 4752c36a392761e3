"""Questions about what differs within sessions: over all of them, and in each by itself."""

from __future__ import annotations

import pandas as pd

from stickslip_fit.anova.comparison import compare
from stickslip_fit.anova.question import READINGS, Question, Refusal

MOST_SESSIONS = 12  # beyond these, only the question over all sessions; one can still be named


def within_sessions(
    analysis: str, factor: str, rows: pd.DataFrame, direction: str | None, configuration: str
) -> list[Question | Refusal]:
    """Ask over all sessions, sessions being blocks, and in each of them.

    Over sessions, levels are compared by the means of their cells, against how differently they differ from
    session to session: what holds for these sessions and not only in one of them. In a session, against
    its readings' scatter.

    The F test over sessions is exact where cells have equal numbers of readings. Where these differ sixfold
    and levels differ alike in all sessions, it rejects 3.6 to 5.7 times in 100 in place of 5.

    Parameters
    ----------
    analysis, factor : str
        Name of the question, and of what differs.
    rows : DataFrame
        Readings of one joint at one configuration, with a column level.
    direction : str or None
    configuration : str
    """
    joint = int(rows["joint"].iloc[0])
    levels = rows.groupby("session", sort=False)["level"].nunique()
    paired = [session for session, count in levels.items() if count > 1]
    if not paired:
        reason = f"no session has readings of more than one {factor} here"
        return [Refusal(analysis, joint, direction, None, configuration, reason)]
    asked: list[Question | Refusal] = []
    if len(levels) > 1:
        mine = rows[rows["session"].isin(paired)]
        over = Question(analysis, joint, direction, None, configuration, factor, f"session x {factor}", mine)
        asked.append(_answerable(over, len(paired)))
    if len(paired) <= MOST_SESSIONS:
        asked += [
            _in_session(
                Question(
                    analysis, joint, direction, session, configuration, factor, READINGS,
                    rows[rows["session"] == session],
                )
            )
            for session in paired
        ]  # fmt: skip
    return asked


def _answerable(over: Question, sessions: int) -> Question | Refusal:
    if sessions < 2:
        return _refuse(
            over, f"one session only has more than one {over.factor}: repeat it in another session"
        )
    units = over.units
    comparison = compare(units["level"], units["block"])
    if not comparison.connected:
        return _refuse(over, f"some levels of {over.factor} were never read in one session with the others")
    if comparison.freedom[1] < 1:
        return _refuse(over, f"too few sessions have the same levels of {over.factor}")
    return over


def _in_session(question: Question) -> Question | Refusal:
    if len(question.readings) == question.readings["level"].nunique():
        reason = f"one reading of each {question.factor} says nothing of scatter: repeat one in this session"
        return _refuse(question, reason)
    return question


def _refuse(question: Question, reason: str) -> Refusal:
    return Refusal(
        question.analysis,
        question.joint,
        question.direction,
        question.session,
        question.configuration,
        reason,
    )
