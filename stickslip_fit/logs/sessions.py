"""Sessions: which of them a span of time selects, and which look like one but are two."""

from __future__ import annotations

from collections import defaultdict
from datetime import UTC, date, datetime, timedelta

import numpy as np

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs.identity import Identity
from stickslip_fit.logs.parse import Bools

Moment = str | date | datetime

_EPOCH = datetime(1970, 1, 1)


def choose_sessions(identity: Identity, since: Moment | None, until: Moment | None) -> Bools:
    """Say which rows belong to the sessions whose first traverse falls in [since, until).

    Raises
    ------
    InputError
        If a bound is no date or time, has a zone where the log has none, or no session is left.
    """
    zoned = bool(identity.zoned.any())
    began = np.full(len(identity.labels), np.iinfo(np.int64).max)
    np.minimum.at(began, identity.session, identity.time)
    inside = np.ones(len(began), np.bool_)
    if since is not None:
        inside &= began >= _nanoseconds("since", since, zoned)
    if until is not None:
        inside &= began < _nanoseconds("until", until, zoned)
    if not inside.any():
        first, last = (
            np.datetime_as_string(end.view("M8[ns]"), unit="m") for end in (began.min(), began.max())
        )
        span = " and ".join(
            f"{name} {bound}" for name, bound in (("since", since), ("until", until)) if bound
        )
        raise InputError(f"no session began {span}; the log's sessions began from {first} to {last}")
    return inside[identity.session]


def alike(identity: Identity) -> tuple[str, ...]:
    """Notes on sessions whose labels differ only in spaces or capitals, which may be one session."""
    groups = defaultdict(list)
    for label in identity.labels:
        groups["".join(label.split()).casefold()].append(label)
    return tuple(
        f"sessions {', '.join(map(repr, same))} differ only in spaces or capitals, and count as {len(same)}"
        for same in groups.values()
        if len(same) > 1
    )


def _nanoseconds(name: str, moment: Moment, zoned: bool) -> int:
    try:
        when = datetime.fromisoformat(moment) if isinstance(moment, str) else moment
    except ValueError:
        message = "is no date or time; write it like 2012-03-05 or 2012-03-05T09:41"
        raise InputError(Problem(message, column=name, value=str(moment))) from None
    if not isinstance(when, datetime):
        when = datetime(when.year, when.month, when.day)
    if when.tzinfo is not None:
        if not zoned:
            message = "has a time zone, but the log's times have none; leave it out"
            raise InputError(Problem(message, column=name, value=str(moment)))
        when = when.astimezone(UTC).replace(tzinfo=None)
    return (when - _EPOCH) // timedelta(microseconds=1) * 1000
