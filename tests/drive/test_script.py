"""Scripts of velocities."""

import numpy as np
import pytest

from stickslip_fit.drive.script import ScriptDevice, read_script
from stickslip_fit.errors import InputError

HEAD = "time_s,vx_um_s,vy_um_s,vz_um_s"


def script(tmp_path, text):
    path = tmp_path / "path.csv"
    path.write_text(text, encoding="utf-8")
    return read_script(path)


def test_each_velocity_holds_until_the_next(tmp_path):
    device = ScriptDevice(script(tmp_path, f"{HEAD}\n0,20,0,0\n1,0,-5,2.5\n2,0,0,0\n3,0,0,0\n"))
    seen = {}
    for number in range(400):
        wanted = device.read(5.0 + 0.01 * number)
        if wanted.ends:
            break
        seen[number] = None if wanted.tip_velocity is None else tuple(wanted.tip_velocity * 1e6)
        assert wanted.tip_velocity is None or wanted.valid_until < 5.07 + 0.01 * number
    assert number == 300
    changes = [number for number in seen if number == 0 or seen[number] != seen[number - 1]]
    assert changes == [0, 100, 200]
    assert [seen[number] for number in changes] == [
        pytest.approx((20, 0, 0)),
        pytest.approx((0, -5, 2.5)),
        None,
    ]


def test_a_script_waits_for_whom_it_drives(tmp_path):
    device = ScriptDevice(script(tmp_path, f"{HEAD}\n0,20,0,0\n1,0,0,0\n"))
    device.read(0.0)
    assert not device.read(100.0).ends
    assert device.read(100.01).tip_velocity is not None


def test_going_home_is_asked_for_once(tmp_path):
    device = ScriptDevice(script(tmp_path, f"{HEAD},home\n0,20,0,0,\n0.5,0,0,0,3\n0.6,0,0,0,2\n"))
    homes = []
    for number in range(100):
        wanted = device.read(0.01 * number)
        homes += [wanted.home] if wanted.home else []
        if wanted.ends:
            break
    assert homes == [3, 2]
    assert wanted.ends


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "begins with the columns time_s,vx_um_s"),
        ("time_s,vx_um_s\n0,1\n", "begins with the columns"),
        (f"{HEAD}\n0,1,1,1\n", "fewer than two lines"),
        (f"{HEAD}\n0,1,1,1\n1,fast,1,1\n", r"line 3, column vx_um_s, value 'fast': give a number"),
        (f"{HEAD}\n0,1,1,1\n1,inf,1,1\n", r"line 3, column vx_um_s, value 'inf'"),
        (f"{HEAD}\n0,1,1,1\n0,1,1,1\n", r"line 3, column time_s, value '0': times increase"),
        (f"{HEAD}\n-1,1,1,1\n0,1,1,1\n", r"line 2, column time_s"),
        (f"{HEAD}\n0,1,1\n1,1,1,1\n", "line 2: has 3 cells, not 4"),
        (f"{HEAD},home\n0,1,1,1,4\n1,1,1,1,\n", r"column home, value '4': give a joint"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path, text, found):
    with pytest.raises(InputError, match=found):
        script(tmp_path, text)


def test_all_faults_are_told_at_once(tmp_path):
    with pytest.raises(InputError) as raised:
        script(tmp_path, f"{HEAD}\n0,a,1,1\n1,1,b,1\n0.5,1,1,1\n")
    assert len(str(raised.value).splitlines()) >= 3


def test_a_missing_or_binary_file(tmp_path):
    with pytest.raises(InputError, match=r"cannot be read .*; name an existing script"):
        read_script(tmp_path / "none.csv")
    (tmp_path / "bad.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no CSV file"):
        read_script(tmp_path / "bad.csv")
    assert np.isfinite(script(tmp_path, f"\ufeff{HEAD}\n0, 1, 1, 1\n\n1,1,1,1\n").velocities).all()
