"""The page of a drive: who is answered, how long what is held holds, and what is shown."""

import json
import socket
import threading
import time
from contextlib import closing, suppress
from http.client import HTTPConnection
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from stickslip_fit._json import to_plain
from stickslip_fit.drive.page import (
    HOMING_VALID_SECONDS,
    VALID_SECONDS,
    DrivePage,
    HeldInput,
    PageMessage,
    describe_drive,
    serve_drive_page,
)
from stickslip_fit.drive.page_server import MAX_CLIENTS, RefusalError
from stickslip_fit.drive.state import DriveState, HomingAdvice
from stickslip_fit.errors import InputError
from stickslip_fit.machine import load_machine
from tests.drive.kinematic_loop import TICK, KinematicLoop

SPEED = 20e-6


class ManualClock:
    """Stands still unless it is put forward."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


class Fingers:
    """What a page sends, by a clock of its own, with a delay of each message."""

    def __init__(self, held: HeldInput, clock: ManualClock) -> None:
        self.held, self.clock = held, clock
        self.number = self.press = 0

    def send(self, *direction: int, press: bool = False, delay: float = 0.002, **more: object) -> PageMessage:
        message = self.prepare(*direction, press=press, **more)
        self.clock.now += delay
        self.held.receive(message)
        return message

    def prepare(self, *direction: int, press: bool = False, **more: object) -> PageMessage:
        self.number += 1
        self.press += press
        content = {
            "client": "a",
            "number": self.number,
            "sent": self.clock.now - 990.0,
            "press": self.press,
            "direction": direction or (0, 0, 0),
            "speed": SPEED,
        }
        return PageMessage.model_validate_json(json.dumps(content | more))


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def held(clock):
    return HeldInput(60e-6, clock)


@pytest.fixture
def fingers(held, clock):
    return Fingers(held, clock)


def moves(wanted):
    return wanted.tip_velocity is not None


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 1, 0), (1, -1, 1)])
def test_what_is_held_is_a_velocity_of_the_speed_chosen(held, fingers, direction):
    assert not moves(held.read(7.0))
    fingers.send(*direction, press=True)
    velocity = held.read(7.0).tip_velocity
    assert np.linalg.norm(velocity) == pytest.approx(SPEED)
    assert np.sign(velocity).tolist() == list(direction)
    assert np.ptp(np.abs(velocity[velocity != 0])) < 1e-18


def test_no_page_is_faster_than_permitted(held, fingers):
    fingers.send(0, 0, -1, press=True, speed=1.0)
    assert held.read(0.0).tip_velocity == pytest.approx([0.0, 0.0, -60e-6])


def test_a_release_stops_at_the_next_read(held, fingers):
    fingers.send(1, 0, 0, press=True)
    assert moves(held.read(0.0))
    fingers.send()
    assert not moves(held.read(0.0))


def test_what_is_held_holds_by_the_loops_clock_from_when_it_was_sent(held, fingers, clock):
    fingers.send(1, 0, 0, press=True, delay=0.0)
    assert held.read(5.0).valid_until == pytest.approx(5.0 + VALID_SECONDS)
    clock.now += 0.06
    assert held.read(5.06).valid_until == pytest.approx(5.0 + VALID_SECONDS)
    fingers.send(1, 0, 0, delay=0.03)  # on its way for 30 ms more than the first one
    assert held.read(5.09).valid_until == pytest.approx(5.06 + VALID_SECONDS)


def test_heartbeats_keep_it_up_and_their_end_ends_it(held, fingers, clock):
    fingers.send(1, 0, 0, press=True)
    for _ in range(40):
        clock.now += 0.05
        fingers.send(1, 0, 0)
        assert moves(held.read(0.0))
    clock.now += VALID_SECONDS - 0.001
    assert moves(held.read(0.0))
    clock.now += 0.002
    assert not moves(held.read(0.0))
    assert "nothing came" in held.broken[1]


@pytest.mark.parametrize("read_between", [True, False])
def test_a_page_that_was_frozen_does_not_go_on_with_what_was_held(held, fingers, clock, read_between):
    fingers.send(1, 0, 0, press=True)
    clock.now += VALID_SECONDS + 0.01
    if read_between:
        held.read(0.0)
    fingers.send(1, 0, 0)
    assert not moves(held.read(0.0))
    assert held.broken[0] == 1
    fingers.send(0, 1, 0)  # still the same press
    assert not moves(held.read(0.0))
    fingers.send()
    fingers.send(0, 1, 0, press=True)
    assert moves(held.read(0.0))
    assert held.broken == (1, "")


def test_a_message_that_was_long_on_its_way_moves_nothing(held, fingers):
    fingers.send(1, 0, 0, press=True)
    fingers.send(1, 0, 0, delay=VALID_SECONDS + 0.05)
    assert not moves(held.read(0.0))


def test_a_message_that_was_overtaken_moves_nothing(held, fingers):
    fingers.send(1, 0, 0, press=True)
    late = fingers.prepare(1, 0, 0)
    fingers.send()
    held.receive(late)
    assert not moves(held.read(0.0))


def test_clocks_that_drift_apart_while_a_computer_sleeps_need_a_new_press_only(held, fingers, clock):
    fingers.send(1, 0, 0, press=True)
    fingers.send()
    fingers.send(1, 0, 0, press=True, sent=-1e6)
    assert moves(held.read(0.0))


def test_stop_needs_a_new_press(held, fingers):
    fingers.send(1, 0, 0, press=True)
    fingers.send(stop=True)
    assert not moves(held.read(0.0))
    fingers.send(1, 0, 0)  # a key that is still held
    assert not moves(held.read(0.0))
    fingers.send(1, 0, 0, press=True)
    assert moves(held.read(0.0))


def test_a_joint_is_sent_home_once(held, fingers):
    """The loop reads on when it is there, and must not go again before the page has heard of it."""
    fingers.send(press=True, home=2)
    assert held.wants_home()
    assert held.read(0.0).home == 2
    assert held.wants_home()
    fingers.send(home=2)
    assert held.wants_home()
    assert held.read(0.0).home is None
    assert not held.wants_home()
    fingers.send(home=2)
    assert held.read(0.0).home is None
    assert held.broken == (1, "")
    fingers.send(press=True, home=2)
    assert held.read(0.0).home == 2


@pytest.mark.parametrize("end", ["silence", "stop", "release", "key", "closed"])
def test_a_joint_goes_home_while_the_page_wants_it(clock, end):
    page = DrivePage(load_machine(), clock=clock)
    page.join("a")
    fingers = Fingers(page.held, clock)
    fingers.send(press=True, home=2)
    assert page.read(0.0).home == 2
    for _ in range(20):
        clock.now += 0.05
        fingers.send(home=2)
        assert not page.interrupts(0.0)
    if end == "silence":
        clock.now += HOMING_VALID_SECONDS - 0.01
        assert not page.interrupts(0.0)
        clock.now += 0.02
    elif end == "closed":
        page.leave("a")
    else:
        fingers.send(*((1, 0, 0) if end == "key" else ()), stop=end == "stop")
    assert page.interrupts(0.0)


def test_the_end_is_for_good(held, fingers):
    fingers.send(ends=True)
    fingers.send(1, 0, 0, press=True)
    assert held.read(0.0).ends


@pytest.mark.parametrize(
    "change",
    [
        {"direction": [2, 0, 0]},
        {"direction": [0.5, 0, 0]},
        {"direction": [1, 0]},
        {"speed": -1.0},
        {"speed": float("nan")},
        {"speed": "20"},
        {"sent": float("inf")},
        {"home": 4},
        {"home": True},
        {"number": 0},
        {"more": 1},
    ],
    ids=str,
)
def test_no_other_message_is_understood(change):
    page = DrivePage(load_machine())
    page.join("a")
    page.receive(message())
    with pytest.raises(RefusalError, match="no message"):
        page.receive(message(**{"number": 2} | change))
    with pytest.raises(RefusalError, match="no message"):
        page.receive(b"\xff{")


def state(**changes):
    loop = KinematicLoop(
        DrivePage(load_machine()), DrivePage(load_machine()), load_machine(), [0.4, -1.2, 0.005]
    )
    shown = loop.state("idle", np.zeros(3))
    return DriveState(**{name: getattr(shown, name) for name in shown.__dataclass_fields__} | changes)


def test_what_is_shown_has_units_and_the_digits_that_its_error_deserves():
    machine = load_machine()
    shown = describe_drive(
        state(
            q=np.array([0.5, -1.25, 0.00512]),
            q_error=np.array([2e-5, 1e-4, 3.4e-6]),
            steps=(-1200, 0, 34567),
            limits=("joint 2 is at its soft limit",),
            tip_radius=4.321e-6,
            tolerance=20e-6,
            wanted_velocity=np.array([-20e-6, 0.0, 5e-6]),
            advice=HomingAdvice(2, "-", 12345, 340),
        ),
        machine,
    )
    assert [joint["position"] for joint in shown["joints"]] == [
        "28.6479 deg ± 39 µrad",
        "−71.6197 deg ± 196 µrad",
        "5.1200 mm ± 6.66 µm",
    ]
    assert [joint["steps"] for joint in shown["joints"]] == ["−1,200", "+0", "+34,567"]
    assert shown["limits"] == ["Joint 2 is at its soft limit"]
    assert shown["radius"]["text"] == "4.32\N{NO-BREAK SPACE}µm"
    assert shown["wanted"] == "−20.0, 0.0, 5.0"
    assert shown["advice"] == (
        "Go back to the − stop of joint 2 within 340 steps. It is about 12,345 steps away."
    )
    late = state(advice=HomingAdvice(1, "+", 50, 0))
    assert describe_drive(late, machine)["advice"].startswith(
        "Go back to the + stop of joint 1 now: the toler"
    )


def test_what_is_not_known_is_shown_as_not_known():
    shown = describe_drive(
        state(tip_covariance=np.full((3, 3), np.nan), tip_radius=np.nan, q_error=np.full(3, np.nan)),
        load_machine(),
    )
    content = json.loads(json.dumps(to_plain(shown), allow_nan=False))
    assert content["radius"]["um"] is None
    assert content["views"][0]["ellipse"] is None


@pytest.fixture
def served():
    with serve_drive_page(load_machine(), "<law>.toml") as page:
        yield page


@pytest.fixture(scope="module")
def quiet():
    """One that nothing changes."""
    with serve_drive_page(load_machine(), "law") as page:
        yield page


def request(page, method="GET", name="", *, token=None, headers=None, body=None, host=None, origin=None):
    """Status, headers and body; host None for the page's own, and "" for none at all."""
    parts = urlsplit(page.address)
    with closing(HTTPConnection(parts.hostname, parts.port, timeout=5)) as connection:
        path = parts.path if token is None else f"/{token}/"
        connection.putrequest(method, path + name, skip_host=True)
        if host != "":
            connection.putheader("Host", host or parts.netloc)
        if origin is not None:
            connection.putheader("Origin", origin)
        for header, value in (headers or {}).items():
            connection.putheader(header, value)
        if body is not None:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read() if name != "events" else b""


def own(page):
    return page.address.rpartition("/")[0].rpartition("/")[0]


def message(**changes):
    content = {"client": "a", "number": 1, "sent": 0.0, "press": 1, "direction": [1, 0, 0], "speed": SPEED}
    return json.dumps(content | changes).encode()


JSON = {"Content-Type": "application/json"}


def test_the_page_is_on_the_loopback_address_alone(served):
    parts = urlsplit(served.address)
    assert parts.hostname == "127.0.0.1"
    assert len(parts.path.strip("/")) >= 32
    with pytest.raises(OSError):  # noqa: PT011 (refused, or there is no such address)
        socket.create_connection(("127.0.0.2", parts.port), timeout=1)


def test_the_page_comes_with_a_policy_of_its_own_files_alone(served):
    status, headers, body = request(served)
    assert status == 200
    assert b"&lt;law&gt;.toml" in body
    policy = dict(part.strip().split(" ", 1) for part in headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert {policy[f"{kind}-src"] for kind in ("script", "style", "connect")} == {"'self'"}
    assert policy["frame-ancestors"] == "'none'"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert not [name for name in headers if name.lower().startswith("access-control")]
    assert b"http://" not in body.replace(b"http://www.w3.org/", b"")
    assert b"https://" not in body
    for name, kind in (("drive.js", "javascript"), ("live.js", "javascript"), ("live.css", "css")):
        status, headers, body = request(served, name=name)
        assert (status, kind in headers["Content-Type"]) == (200, True)
        assert b"://" not in body.replace(b"http://www.w3.org/", b"")


@pytest.mark.parametrize("name", ["", "drive.js", "events", "nothing"])
@pytest.mark.parametrize(
    "how",
    [
        {"host": "evil.example"},
        {"host": "localhost"},
        {"host": "127.0.0.1"},
        {"host": ""},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1"},
        {"origin": "http://127.0.0.1:1"},
        {"token": ""},
        {"token": "x" * 32},
        {"token": "%00"},
        {"headers": {"Sec-Fetch-Site": "cross-site"}},
        {"headers": {"Sec-Fetch-Site": "same-site"}},
    ],
    ids=str,
)
def test_strangers_get_403_and_learn_nothing(quiet, name, how):
    status, headers, body = request(quiet, name=name, **how)
    assert status == 403
    assert urlsplit(quiet.address).path.strip("/").encode() not in body
    assert not [header for header in headers if header.lower().startswith("access-control")]


def test_a_host_that_is_named_twice_is_refused(served):
    parts = urlsplit(served.address)
    with socket.create_connection((parts.hostname, parts.port), timeout=5) as raw:
        raw.sendall(f"GET {parts.path} HTTP/1.1\r\nHost: {parts.netloc}\r\nHost: a\r\n\r\n".encode())
        assert raw.recv(100).startswith(b"HTTP/1.1 403")


@pytest.mark.parametrize(
    ("how", "status"),
    [
        ({"origin": None}, 403),
        ({"origin": "http://evil.example"}, 403),
        ({"host": "evil.example"}, 403),
        ({"token": "x" * 32}, 403),
        ({"headers": {"Content-Type": "text/plain"}}, 415),
        ({"headers": {}}, 415),
        ({"name": "drive.js"}, 405),
        ({"body": b" " * 5000}, 413),
        ({"body": None}, 411),
        ({"body": b"{}"}, 400),
        ({}, 409),  # of no page that is open
    ],
    ids=str,
)
def test_only_a_message_of_the_page_moves_anything(served, how, status):
    usual = {"name": "messages", "origin": own(served), "headers": JSON, "body": message()}
    served.join("other")
    assert request(served, "POST", **usual | how)[0] == status
    assert not moves(served.read(0.0))
    served.join("a")
    served.leave("other")
    assert request(served, "POST", **usual)[0] == 204
    assert moves(served.read(0.0))


@pytest.mark.parametrize("method", ["PUT", "DELETE", "OPTIONS", "HEAD", "PATCH", "TRACE"])
def test_no_other_method_is_answered(quiet, method):
    served = quiet
    status, headers, _ = request(served, method, "messages", headers=JSON, origin=own(served), body=message())
    assert status == 405
    assert headers["Allow"] == "GET, POST"
    assert request(served, method, origin="http://evil.example")[0] == 403


class OpenPage:
    """The events of a page."""

    def __init__(self, page: DrivePage) -> None:
        parts = urlsplit(page.address)
        self.connection = HTTPConnection(parts.hostname or "", parts.port, timeout=5)
        self.connection.request("GET", f"{parts.path}events")
        self.socket = self.connection.sock
        self.answer = self.connection.getresponse()
        assert self.answer.headers["Content-Type"].startswith("text/event-stream")

    def event(self) -> dict[str, Any]:
        line, empty = self.answer.readline(), self.answer.readline()
        assert line.startswith(b"data: ")
        assert empty == b"\n"
        return json.loads(line.removeprefix(b"data: "))

    def close(self) -> None:
        """As a browser that has crashed."""
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)
        self.answer.close()
        self.connection.close()


def stream(page):
    return closing(OpenPage(page))


def wait_until(condition, seconds=2.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.001)


def post(page, **changes):
    body = message(**changes)
    return request(page, "POST", "messages", origin=own(page), headers=JSON, body=body)[0]


def test_the_first_page_controls_and_the_second_sees_and_can_stop(served):
    with stream(served) as first, stream(served) as second:
        one, other = first.event(), second.event()
        assert (one["controls"], other["controls"]) == (True, False)
        served.show(state(message="all is well"))
        for each in (first, second):
            wait_until(lambda each=each: each.event().get("drive", {}).get("message") == "All is well")
        assert post(served, client=other["client"]) == 409
        assert not moves(served.read(0.0))
        assert post(served, client=one["client"]) == 204
        assert moves(served.read(0.0))
        assert post(served, client=other["client"], direction=[0, 0, 0], stop=True) == 204
        assert not moves(served.read(0.0))
        assert post(served, client=one["client"], number=2) == 204  # still held
        assert not moves(served.read(0.0))


def test_a_page_that_is_closed_stops_at_once_and_the_next_one_controls(served):
    with stream(served) as first, stream(served) as second:
        one, other = first.event(), second.event()
        assert post(served, client=one["client"]) == 204
        assert moves(served.read(0.0))
        began = time.monotonic()
        first.socket.shutdown(socket.SHUT_WR)  # it would still take what is written
        wait_until(lambda: not moves(served.read(0.0)))
        assert time.monotonic() - began < VALID_SECONDS / 2
        wait_until(lambda: second.event()["controls"])
        assert not moves(served.read(0.0))
        assert post(served, client=one["client"], number=2) == 409
        assert post(served, client=other["client"]) == 204
        assert moves(served.read(0.0))


def test_no_more_pages_than_a_browser_has_connections_for(served):
    with stream(served) as one, stream(served) as two:
        with stream(served) as three:
            assert [each.event()["controls"] for each in (one, two, three)] == [True, False, False]
            assert request(served, name="events")[0] == 503
            assert MAX_CLIENTS == 3
        wait_until(lambda: request(served, name="events")[0] == 200)


def test_pages_are_told_of_the_end():
    with serve_drive_page(load_machine(), "law") as page:
        parts, told = urlsplit(page.address), OpenPage(page)
    assert told.answer.read().endswith(b'"ended":true}\n\n')
    told.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((parts.hostname, parts.port), timeout=1)


def test_a_port_can_be_chosen_and_one_in_use_is_refused(served):
    port = urlsplit(served.address).port
    with pytest.raises(InputError, match=f"port {port}"), serve_drive_page(load_machine(), "law", port=port):
        pass
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    with serve_drive_page(load_machine(), "law", port=port) as page:
        assert urlsplit(page.address).port == port


def test_reading_and_showing_take_no_time(served):
    """A tenth of what a tick may cost, with a page that looks on."""
    shown = state()
    with stream(served) as page:
        page.event()
        began = time.process_time()
        for tick in range(2000):
            served.read(tick * TICK)
            served.show(shown)
        assert (time.process_time() - began) / 2000 < 2e-5
    assert threading.active_count() < 20
