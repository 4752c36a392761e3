"""The picture of the arm against trigonometry done here, and its ellipse against drawn errors."""

from itertools import product
from math import cos, degrees, hypot, pi, radians, sin

import numpy as np
import pytest

from stickslip_fit.drive.picture import MARKS, draw_arm, round_down, view_arm
from stickslip_fit.drive.state import DriveState
from stickslip_fit.errors import InputError
from stickslip_fit.machine import load_machine
from stickslip_fit.moves.error_ellipsoid import error_ellipse

A1, L2 = 0.0125, 0.0375  # of the nominal machine
COVARIANCE = np.array([[9.0, 2.0, 0.0], [2.0, 4.0, -1.0], [0.0, -1.0, 1.0]]) * 1e-12
CORNERS = list(product((-120.0, -45.0, 0.0, 77.0, 120.0), (-210.0, -90.0, 0.0, 17.0, 30.0), (0.0, 12.0)))


@pytest.fixture(scope="module")
def machine():
    return load_machine()


def tip_of(q):
    """Radius, height, and the tip in the base's frame, m; the thesis's forward kinematics by hand."""
    length = L2 + q[2]
    radius, height = A1 - length * sin(q[1]), length * cos(q[1])
    return radius, height, (radius * cos(q[0]), radius * sin(q[0]), height)


def state_at(q1, q2, q3, covariance=COVARIANCE):
    q = (radians(q1), radians(q2), q3 / 1000)
    zero = np.zeros(3)
    return DriveState(
        *(0.0, "idle", np.array(q), zero, np.array(tip_of(q)[2]), covariance),
        *(1e-6, 1e-5, zero, zero, (0, 0, 0)),
    )


def find(lines, letter, columns):
    """Columns and rows of a letter within some columns."""
    return [
        (column, row)
        for row, line in enumerate(lines)
        for column in columns
        if column < len(line) and line[column] == letter
    ]


def expected_cell(width, height, spans, centre, point):
    """By hand: the middle of the extent is in the middle, and all of it has room; in characters."""
    dots = min((2 * width - 1) / spans[0], (4 * height - 1) / spans[1])
    right, up = (dots * (a - b) for a, b in zip(point, centre, strict=True))
    return ((2 * width - 1) / 2 + right) / 2, ((4 * height - 1) / 2 - up) / 4


@pytest.mark.parametrize("q", CORNERS, ids=str)
def test_the_tip_is_in_the_character_that_its_kinematics_say(machine, q):
    state = state_at(*q)
    lines = draw_arm(state, machine, 80, 16)
    radius, height, (x, y, _) = tip_of(state.q)
    longest, shortest = A1 + L2 + 0.012, A1 - (L2 + 0.012) * 0.5  # outward, and back over the base at q2 = 30
    rows = 16 - 3  # without titles, bars and legend
    above = expected_cell(26, rows, (1.5 * longest, 2 * longest), (longest / 4, 0.0), (x, y))
    plane = expected_cell(
        26, rows, (longest - shortest, 2 * 0.0495), ((longest + shortest) / 2, 0.0), (radius, height)
    )
    for first, cell in ((0, above), (41, plane)):
        ((column, row),) = find(lines[1:14], MARKS["tip"], range(first, first + 26))
        # A character has 2 x 4 dots, and a point the nearest one.
        assert -0.251 <= cell[0] - (column - first) <= 0.751
        assert -0.126 <= cell[1] - row <= 0.876


@pytest.mark.parametrize(("width", "height"), [(80, 15), (120, 30), (44, 12), (80, 7)])
def test_every_configuration_has_a_picture_that_keeps_its_size(machine, width, height):
    sides = 2 if width >= 76 else 1
    for q in CORNERS:
        lines = draw_arm(state_at(*q), machine, width, height)
        assert len(lines) == height
        assert max(map(len, lines)) <= width
        assert sum(line.count(MARKS["tip"]) for line in lines[:-1]) == 2 * sides  # the arm's, the ellipse's
        assert sum(line.count("mm") for line in lines) == sum(line.count("µm") for line in lines) == sides


@pytest.mark.parametrize(("width", "height"), [(30, 20), (80, 6), (1, 1), (0, 0)])
def test_without_room_there_is_no_picture(machine, width, height):
    assert draw_arm(state_at(0, -90, 0), machine, width, height) == []


def test_the_bars_say_how_long_things_are(machine):
    """The arm straight out with joint 3 drawn in is 50 mm long, as many characters as the bar says."""
    lines = draw_arm(state_at(0.0, -90.0, 0.0), machine, 120, 34)
    (base,), (tip,) = (find(lines[:-1], MARKS[name], range(47)) for name in ("base", "tip"))
    bar = lines[-2][:47].split("mm")[0].split("┤")
    per_mm = (len(bar[0].strip()) + 1) / float(bar[1])
    assert tip[0] - base[0] == pytest.approx(50 * per_mm, abs=1.6)
    assert tip[1] == base[1]


def test_an_ellipse_is_drawn_as_large_as_its_bar_says(machine):
    """Errors of 3 and 1 µm along x and y: the semi-axes are 2.4477 as long, from 1 - exp(-k^2 / 2) = 0.95."""
    lines = draw_arm(state_at(0.0, -90.0, 0.0, np.diag([9e-12, 1e-12, 1e-12])), machine, 80, 16)
    part = [line.ljust(80)[26:39] for line in lines]
    dots = [
        (2 * column + bit % 2, 4 * row + bit // 2)
        for row, line in enumerate(part[1:-2])
        for column, letter in enumerate(line)
        for bit, value in enumerate((1, 8, 2, 16, 4, 32, 64, 128))
        if 0x2800 < ord(letter) < 0x2900 and (ord(letter) - 0x2800) & value
    ]
    wide, high = (max(values) - min(values) for values in zip(*dots, strict=True))
    bar = part[-2].strip()
    per_um = 2 * len(bar.split("┤")[0] + "┤") / float(bar.split("┤")[1].removesuffix("µm"))
    assert wide == pytest.approx(2 * 2.4477 * 3 * per_um, abs=3)
    assert high == pytest.approx(2 * 2.4477 * 1 * per_um, abs=3)


def test_an_ellipse_holds_95_percent_of_errors():
    rng = np.random.default_rng(5)
    covariance = np.array([[4.0, -1.5], [-1.5, 2.0]]) * 1e-12
    errors = rng.multivariate_normal(np.zeros(2), covariance, 40_000)
    ellipse = error_ellipse(covariance)
    turn = np.array([[cos(ellipse.angle), sin(ellipse.angle)], [-sin(ellipse.angle), cos(ellipse.angle)]])
    along, across = turn @ errors.T
    inside = np.hypot(along / ellipse.longer, across / ellipse.shorter) <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=4 * (0.95 * 0.05 / 40_000) ** 0.5)
    on_it = ellipse.points(7)
    assert np.einsum("ni,ij,nj->n", on_it, np.linalg.inv(covariance), on_it) == pytest.approx(
        5.99146, rel=1e-5
    )


def test_errors_that_are_not_known_have_no_ellipse(machine):
    lines = draw_arm(state_at(0.0, -90.0, 0.0, np.full((3, 3), np.nan)), machine, 80, 15)
    assert sum(line.count("µm") for line in lines) == 0
    assert sum(line.count(MARKS["tip"]) for line in lines[:-1]) == 2
    assert len(draw_arm(state_at(0.0, -90.0, 0.0, np.zeros((3, 3))), machine, 80, 15)) == 15


def test_the_views_are_projections(machine):
    state = state_at(30.0, -60.0, 5.0)
    above, plane = view_arm(state, machine)
    radius, height, (x, y, _) = tip_of(state.q)
    assert above.tip == pytest.approx((x, y), abs=1e-12)
    assert plane.tip == pytest.approx((radius, height), abs=1e-12)
    assert hypot(*np.subtract(plane.far, plane.near)) == pytest.approx(0.012, abs=1e-12)
    assert degrees(np.arctan2(*above.elbow[::-1])) == pytest.approx(30.0)
    outward = np.array([cos(pi / 6), sin(pi / 6), 0.0])
    assert plane.covariance[0, 0] == pytest.approx(outward @ COVARIANCE @ outward, rel=1e-12)
    assert plane.covariance[1, 1] == pytest.approx(1e-12, rel=1e-12)


@pytest.mark.parametrize("value", [1.0, 2.0, 5.0, 1e-6, 2e-6, 5e-5, 1e3])
def test_a_round_number_is_its_own(value):
    assert round_down(value) == pytest.approx(value, rel=1e-12)
    assert round_down(0.999 * value) < value


def test_a_machine_without_lengths_is_refused(machine_of):
    machine = machine_of('[[joint]]\nkind = "prismatic"\nrange_mm = [0, 10]\n')
    with pytest.raises(InputError, match="a picture of the arm"):
        draw_arm(state_at(0, 0, 0), machine, 80, 15)
