"""Journals with valid checksums and numbers whose events no capture writes."""

import copy
import json
import random
from zlib import crc32

import pytest

from stickslip_fit.capture.campaign import journal_path
from stickslip_fit.capture.journal import JournalReplay, read_journal
from stickslip_fit.capture.operator import OperatorChoice, OperatorReply
from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from tests.capture.played import MACHINE, SHORT, Capture, Player, plan_of

REPEAT, QUIT = OperatorReply(OperatorChoice.REPEAT), OperatorReply(OperatorChoice.QUIT)
WARM = OperatorReply(conditions={"temperature": 295.0, "covariate:pressure_hPa": 1013.0})
VALUES = (
    *(None, True, -1, 0, 1, 4, 5, 10**30, 0.5, float("nan"), "", "+", "ok", "x" * 99),
    *([], [1], {}, {"a": {}}),
)


class Absent(Player):
    """Ends the capture as it begins."""

    def begin_session(self, label):
        return QUIT


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """A capture that was ended after a few readings, and its events, with few of the commands."""
    folder = tmp_path_factory.mktemp("captured")
    capture = Capture(folder, plan_of(folder, SHORT))
    skip = OperatorReply(OperatorChoice.SKIP, "a door slammed")
    capture.answer(REPEAT, WARM, skip, OperatorReply(note="fine"), QUIT)
    capture.run()
    events = []
    read_journal(journal_path(capture.log), events.append)
    names = [event["event"] for event in events]
    followed = [name == after == "commanded" for name, after in zip(names, [*names[1:], ""], strict=True)]
    return capture, [event for event, more in zip(events, followed, strict=True) if not more]


def write_journal(path, events):
    """Write events with the numbers and checksums that they would have."""
    checksum, content = 0, b""
    for number, event in enumerate(events):
        numbered = {"number": number} | event | {"number": number} if isinstance(event, dict) else event
        text = json.dumps(numbered).encode()
        checksum = crc32(text, checksum)
        content += b"%08x %s\n" % (checksum, text)
    path.write_bytes(content)


def resume(capture, events, player=Absent):
    """Go on with a journal of these events, and end at once; its rows."""
    write_journal(journal_path(capture.log), events)
    again = Capture(capture.folder, capture.plan)
    again.player = player(again.joints)
    again.run(again=True)
    return again.rows


def test_what_a_capture_wrote_goes_on(captured):
    capture, events = captured
    names = {event["event"] for event in events}
    assert names >= {
        *("begun", "conditions", "drive", "commanded", "ended", "excluded", "noted", "skipped", "writing"),
    }
    assert resume(capture, events)["status"].eq("ok").sum() == 3


def first(events, name):
    return next(event for event in events if event["event"] == name)


def drop_key(events):
    del first(events, "ended")["status"]


def repeat_reading(events):
    place = next(
        place for place, event in enumerate(events) if event["event"] == "drive" and event["planned"] == 1
    )
    for event in events[place : place + 5]:
        if event["event"] == "drive":
            event["planned"] = 0


CHANGES = {
    "an unknown event": lambda events: events[3].update(event="danced"),
    "no event": lambda events: events[3].update(event=None),
    "a missing key": drop_key,
    "a key too many": lambda events: first(events, "ended").update(extra=1),
    "text for a number": lambda events: first(events, "commanded").update(steps="5"),
    "true for a number": lambda events: first(events, "commanded").update(steps=True),
    "negative steps": lambda events: first(events, "commanded").update(steps=-5),
    "too many steps": lambda events: first(events, "commanded").update(steps=10**30),
    "a joint that the machine lacks": lambda events: first(events, "drive")["row"].update(joint=4),
    "a column of the log": lambda events: first(events, "drive")["row"].update(steps=5),
    "a time without zone": lambda events: first(events, "drive")["row"].update(time="2012-03-05"),
    "another way than the direction": lambda events: first(events, "drive")["row"].update(stop=-9.0),
    "a place out of range": lambda events: first(events, "drive")["row"].update(q3=9.0),
    "an angle that the log may not hold": lambda events: first(events, "drive")["row"].update(psi=1e30),
    "another session": lambda events: first(events, "drive")["row"].update(session="never"),
    "another purpose": lambda events: first(events, "drive").update(purpose=["home"]),
    "a condition that is none": lambda events: first(events, "conditions").update(values={"steps": 1.0}),
    "a condition that is text": lambda events: first(events, "conditions").update(values={"supply": "80"}),
    "a condition that the log may not hold": lambda events: first(events, "conditions").update(
        values={"supply": 1e30}
    ),
    "the plan's next traverse left out": lambda events: first(events, "skipped").update(planned=9),
    "a reading made twice": repeat_reading,
    "a list": lambda events: events.insert(3, ["commanded", 5]),
    "a number": lambda events: events.insert(3, 7),
    "no beginning": lambda events: events.pop(0),
    "two beginnings": lambda events: events.insert(3, events[0]),
    "a drive that ends twice": lambda events: events.insert(
        events.index(first(events, "ended")), first(events, "ended")
    ),
    "an end with other steps": lambda events: first(events, "ended").update(steps=1),
    "a note on a drive that is not there": lambda events: first(events, "noted").update(drive=999),
    "drives in another order": lambda events: events.append(first(events, "drive")),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_an_event_that_no_capture_writes_is_refused_with_file_and_line(captured, change):
    capture, events = captured
    changed = copy.deepcopy(events)
    change(changed)
    before = capture.log.read_bytes()
    with pytest.raises(
        InputError, match=r"log\.csv\.journal, line \d+: holds an event that no capture writes"
    ):
        resume(capture, changed)
    assert capture.log.read_bytes() == before
    assert journal_path(capture.log).read_bytes().count(b"\n") == len(changed)


def test_json_nested_too_deeply_is_refused(captured):
    path = journal_path(captured[0].log)
    text = b"[" * 200_000
    path.write_bytes(b"%08x %s\n" % (crc32(text), text))
    with pytest.raises(InputError, match=r"line 1: .* it is no JSON"):
        read_journal(path, JournalReplay().apply)


def mutate(events, rng):
    """Drop, double, move or change a few events."""
    changed = copy.deepcopy(events)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        place = rng.randrange(len(changed))
        match rng.randrange(6):
            case 0:
                del changed[place]
            case 1:
                changed.insert(rng.randrange(len(changed)), copy.deepcopy(changed[place]))
            case 2:
                changed.insert(rng.randrange(len(changed)), changed.pop(place))
            case 3:
                changed[place] = rng.choice(VALUES)
            case _ if isinstance(changed[place], dict) and changed[place]:
                table = changed[place]
                nested = [value for value in table.values() if isinstance(value, dict) and value]
                table = rng.choice([table, *nested])
                table[rng.choice([*table, "new"])] = rng.choice(VALUES)
    return changed


@pytest.mark.slow
@pytest.mark.parametrize(("trials", "seed"), [(60, 1), pytest.param(3000, 2, marks=pytest.mark.nightly)])
def test_changed_journals_are_refused_or_read(captured, trials, seed):
    capture, events = captured
    rng, refused = random.Random(seed), 0
    for _ in range(trials):
        changed = mutate(events, rng)
        try:
            rows, said = resume(capture, changed), ""
        except InputError as error:
            rows, said = None, str(error)
        if rows is None:
            refused += 1
            assert "log.csv.journal, line " in said or "begun with another" in said, changed
        else:
            assert rows["steps"].gt(0).all()
        for edited in capture.folder.glob("*.edited-*"):
            edited.unlink()
    assert refused > 0.6 * trials
    resume(capture, events)
    assert len(read_log(capture.log, machine=MACHINE).rows)
