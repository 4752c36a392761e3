"""What the answers come to, in sentences, and what a lab should do."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from stickslip_fit._format import (
    capitalize_first,
    format_direction,
    format_p_value,
    format_percent,
    format_step,
    format_step_range,
    join_words,
)
from stickslip_fit.anova.answer import Answer
from stickslip_fit.anova.components import Components
from stickslip_fit.anova.question import Question, Refusal

LEVEL = 0.05
ALL = "over all sessions"
WORTH = 3.0  # times the repeatability: a cost that a lab would want to avoid
FEW = 3  # sessions that a list names


def matters(answer: Answer) -> bool:
    """Whether levels differ at 5 %, everything that was asked taken into account."""
    return answer.p_holm < LEVEL


def verdicts(joint: int, answers: Sequence[Answer]) -> list[str]:
    """What a joint's answers come to, one sentence for each question."""
    mine = [each for each in answers if each.question.joint == joint]
    tellers = {"day": _day, "direction": _direction, "normal-force": _normal_force}
    by_name = {name: [each for each in mine if each.question.analysis == name] for name in tellers}
    return [capitalize_first(tell(by_name[name])) for name, tell in tellers.items() if by_name[name]]


def advice(found: Components, answers: Sequence[Answer]) -> list[str]:
    """Whether to recalibrate each session and to keep parameters for each direction, with the cost of not."""
    mine = [each for each in answers if each.question.joint == found.joint]
    return [_recalibrate(found, mine), *_separate(found, mine)]


def _recalibrate(found: Components, answers: Sequence[Answer]) -> str:
    changes = any(matters(each) for each in answers if each.question.analysis == "day")
    cost, low, high = (
        sqrt(2.0) * value for value in (found.total.deviation, found.total.low, found.total.high)
    )
    price = (
        f"the calibration of another session is off by {format_step(cost, found.joint)} a step "
        f"rms ({format_percent(cost / found.mean)}; 95 %: {format_step_range(low, high, found.joint)}), "
        f"{_times(cost / found.replicate.deviation)} what one reading differs from the next"
    )
    if changes:
        return f"Recalibrate each session: {price}."
    if high > WORTH * found.replicate.deviation:
        return f"Whether to recalibrate each session this log is too small to say: {price}."
    return f"This log gives no reason to recalibrate each session: {price}."


def _separate(found: Components, answers: Sequence[Answer]) -> list[str]:
    if found.direction is None:
        return []
    differs = any(matters(each) for each in answers if each.question.analysis == "direction")
    cost, worth = abs(found.direction) / 2, WORTH * found.replicate.deviation
    share = format_percent(cost / found.mean)
    price = f"one set for both is off by {format_step(cost, found.joint)} a step ({share})"
    if differs:
        return [f"Keep separate parameters for each direction: {price}."]
    if max(map(abs, (found.direction_low or 0.0, found.direction_high or 0.0))) / 2 > worth:
        return [
            f"Whether to keep separate parameters for each direction this log is too small to say: {price}."
        ]
    return [f"This log gives no reason for separate parameters: {price}."]


def _times(ratio: float) -> str:
    return f"{ratio:.2g} times"


def _day(asked: Sequence[Answer]) -> str:
    changed = [each for each in asked if matters(each)]
    same = [each for each in asked if not matters(each)]
    told = []
    if changed:
        sizes = [f"{_size(each)} in direction {_way(each)}" for each in changed]
        told.append(
            f"the step size changes from session to session, by up to {join_words(sizes)} ({_p(changed)})"
        )
    if same:
        ways = join_words([_way(each) for each in same])
        seen = [
            f"{format_step(each.detectable, each.question.joint)} in direction {_way(each)}" for each in same
        ]
        told.append(
            f"no change from session to session shows in direction {ways} ({_p(same)}); one of "
            f"{join_words(seen)} would most likely have shown"
        )
    return "; ".join(told) + "."


def _direction(asked: Sequence[Answer]) -> str:
    over = [each for each in asked if each.question.session is None]
    within = [each for each in asked if each.question.session is not None]
    differing = [each for each in within if matters(each)]
    if over and matters(over[0]):
        return f"the two directions differ by {_size(over[0])}, taken over all sessions ({_p(over)})."
    if differing:
        each_of = f"{len(differing)} of {len(within)} sessions" if len(within) > 1 else "the session"
        sizes = sorted(each.effect.difference for each in differing)
        joint = asked[0].question.joint
        spread = (
            format_step(sizes[0], joint) if len(sizes) == 1 else format_step_range(sizes[0], sizes[-1], joint)
        )
        unsure = "; from so few, or so different, sessions it cannot be said of others" if over else ""
        return f"the two directions differ in {each_of}, by {spread} ({_p(differing)}){unsure}."
    least = min(asked, key=lambda each: each.detectable)
    return (
        f"no difference between the directions shows ({_p(asked)}); one of "
        f"{format_step(least.detectable, least.question.joint)} would most likely have shown."
    )


def _normal_force(asked: Sequence[Answer]) -> str:
    over = [each for each in asked if each.question.session is None] or list(asked)
    differing = [each for each in over if matters(each)]
    if not differing:
        least = max(over, key=lambda each: each.detectable)
        return (
            f"turning the base about the joint's axis changes nothing that shows ({_p(over)}); a change of "
            f"{format_step(least.detectable, least.question.joint)} would most likely have shown."
        )
    sizes = [
        f"{_size(each)} in direction {_way(each)} (between {' and '.join(each.furthest)})"
        for each in differing
    ]
    told = f"{join_words(sizes)} ({_p(differing)})"
    if _may_drift(differing):
        return (
            f"between orientations of the base about the joint's axis the step size differs, by {told}; but "
            "readings drift, or may, within their session, which alone could do that."
        )
    return f"turning the base about the joint's axis changes the step size, by {told}."


def _may_drift(answers: Sequence[Answer]) -> bool:
    """Whether readings drift, or levels were read one after another: then the hour could be what matters."""
    by_time = {"levels in turn", "drift within a session"}
    return any(
        each.name in by_time and each.verdict == "doubtful" for one in answers for each in one.premises
    )


def _way(answer: Answer) -> str:
    return format_direction(str(answer.question.direction))


def _size(answer: Answer) -> str:
    return (
        f"{format_step(answer.effect.difference, answer.question.joint)} ({format_percent(answer.relative)})"
    )


def _p(answers: Sequence[Answer]) -> str:
    """The least convincing adjusted p-value of effects, the most convincing one where none shows."""
    values = [each.p_holm for each in answers]
    shown = max(values) if all(value < LEVEL for value in values) else min(values)
    return f"adjusted p {format_p_value(shown, relation=True)}"


def doubts(answers: Sequence[Answer]) -> list[str]:
    """Premises that fail, then those that nothing can be told of, each once, with the questions concerned."""
    told: dict[str, dict[str, list[Question]]] = {"doubtful": {}, "cannot tell": {}}
    fine: dict[str, None] = {}
    for each in answers:
        for premise in each.premises:
            if premise.verdict == "holds":
                fine[premise.name] = None
            else:
                told[premise.verdict].setdefault(premise.message, []).append(each.question)
    lines = [
        f"{capitalize_first(message)} ({named(asked)})."
        for by_message in told.values()
        for message, asked in by_message.items()
    ]
    return [*lines, f"All other checks of {join_words(list(fine))} pass."] if fine else lines


def reasons(refused: Sequence[Refusal]) -> list[str]:
    """Why questions cannot be answered, each reason once."""
    told: dict[str, list[Refusal]] = {}
    for each in refused:
        told.setdefault(each.reason, []).append(each)
    return [f"{capitalize_first(named(asked))}: {reason}." for reason, asked in told.items()]


def named(asked: Sequence[Question | Refusal]) -> str:
    """Questions in few words, the sessions of one kind together."""
    sessions: dict[str, list[str]] = {}
    for each in asked:
        parts = [
            f"joint {each.joint}",
            each.analysis,
            *([format_direction(each.direction)] if each.direction else []),
        ]
        sessions.setdefault(" ".join(parts), []).append(each.session or ALL)
    return join_words([f"{name}{_sessions(which)}" for name, which in sessions.items()])


def _sessions(which: Sequence[str]) -> str:
    if set(which) == {ALL}:
        return ""
    few = [*which[:FEW], f"{len(which) - FEW} more"] if len(which) > FEW + 1 else which
    return f" [{', '.join(few)}]"
