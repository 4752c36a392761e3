"""Files are written completely or not at all, whoever is killed meanwhile."""

import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from random import Random

import pytest

import stickslip_fit as ssf
from stickslip_fit._io import find_write_fault, identify_file, write_atomically
from stickslip_fit.errors import InputError
from stickslip_fit.reporting.page import Report

ROOT = Path(__file__).parents[1]
POSIX = pytest.mark.skipif(os.name != "posix", reason="of POSIX systems")
WRITER = """
import sys
sys.path.insert(0, {root!r})
from stickslip_fit._io import write_atomically
print("begun", flush=True)
for number in range(10**9):
    write_atomically("target", b"%09d" % number * 200_000)
"""


@POSIX
def test_a_symbolic_link_is_followed_and_not_replaced(tmp_path):
    real, link, dangling = tmp_path / "real", tmp_path / "link", tmp_path / "dangling"
    real.write_text("old")
    link.symlink_to(real)
    dangling.symlink_to("elsewhere")
    write_atomically(link, "new")
    write_atomically(dangling, "new")
    assert (link.is_symlink(), dangling.is_symlink()) == (True, True)
    assert (real.read_text(), (tmp_path / "elsewhere").read_text()) == ("new", "new")
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    with pytest.raises(InputError, match="symbolic links"):
        write_atomically(circle, "new")
    assert circle.is_symlink()


@POSIX
def test_a_hard_link_keeps_what_it_had(tmp_path):
    (tmp_path / "one").write_text("old")
    os.link(tmp_path / "one", tmp_path / "other")
    write_atomically(tmp_path / "one", "new")
    assert ((tmp_path / "one").read_text(), (tmp_path / "other").read_text()) == ("new", "old")


@POSIX
def test_permissions_stay(tmp_path):
    path = tmp_path / "private"
    path.write_text("")
    path.chmod(0o640)
    write_atomically(path, "new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


@POSIX
@pytest.mark.skipif(os.name == "posix" and os.geteuid() == 0, reason="root may write to all files")
def test_a_read_only_file_is_not_replaced(tmp_path):
    path = tmp_path / "kept"
    path.write_text("old")
    path.chmod(0o440)
    assert find_write_fault(path) is not None
    with pytest.raises(InputError, match="read-only"):
        write_atomically(path, "new")
    assert path.read_text() == "old"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_devices_are_written_to_and_a_full_one_says_so(tmp_path):
    device = os.stat("/dev/null")
    write_atomically("/dev/null", "gone")
    assert os.stat("/dev/null") == device
    with pytest.raises(InputError, match=r"No space left on device.*make room"):
        write_atomically("/dev/full", "x" * 100_000)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="cannot be written"):
        write_atomically(tmp_path / "pipe", "nobody reads this")


def test_stray_bytes_of_a_file_name_are_no_obstacle(tmp_path):
    write_atomically(tmp_path / "out.json", '"caf\udce9.csv"')
    assert (tmp_path / "out.json").read_text("utf-8") == '"caf\\udce9.csv"'


def test_new_files_that_some_systems_take_for_one_are_one(tmp_path):
    assert identify_file(tmp_path / "Ergebnis.json") == identify_file(tmp_path / "ergebnis.JSON")
    assert identify_file(tmp_path / "fa\u00e7ade") == identify_file(tmp_path / "fac\u0327ade")
    assert identify_file(tmp_path / "one") != identify_file(tmp_path / "other")


@POSIX
def test_stale_temporary_files_go_and_those_of_a_living_writer_stay(tmp_path):
    import fcntl

    stale, alive, foreign = (
        tmp_path / f".stickslip-fit-{name}.tmp" for name in ("stale123", "alive123", "no")
    )
    for path in (stale, alive, foreign):
        path.write_text("half")
    with alive.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        write_atomically(tmp_path / "target", "whole")
        assert [path.exists() for path in (stale, alive, foreign)] == [False, True, True]
    write_atomically(tmp_path / "target", "whole")
    assert not alive.exists()


def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch):
    (tmp_path / "target").write_text("old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InputError, match="make room"):
        write_atomically(tmp_path / "target", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["target"]
    assert (tmp_path / "target").read_text() == "old"


@POSIX
@pytest.mark.parametrize("kills", [2, pytest.param(200, marks=pytest.mark.nightly)])
def test_a_killed_writer_leaves_a_whole_file_and_no_temporary_one_after_the_next(kills, tmp_path):
    rng, left = Random(1), 0
    for _ in range(kills):
        program = [sys.executable, "-c", WRITER.format(root=str(ROOT))]
        with subprocess.Popen(program, cwd=tmp_path, stdout=subprocess.PIPE) as writer:
            writer.stdout.readline()
            time.sleep(rng.uniform(0.001, 0.05))
            writer.send_signal(signal.SIGKILL)
        if (tmp_path / "target").exists():
            content = (tmp_path / "target").read_bytes()
            assert content == content[:9] * 200_000
        left += len(list(tmp_path.glob(".*.tmp")))
        write_atomically(tmp_path / "target", b"000000000" * 200_000)
        assert [path.name for path in tmp_path.iterdir()] == ["target"]
    assert left or kills < 100


@pytest.mark.slow
def test_saving_never_replaces_the_log(campaign, tmp_path):
    path = tmp_path / "log.csv"
    campaign(("2012-03-05",)).to_csv(path, index=False)
    measured = path.read_bytes()
    log = ssf.read_log(path)
    fit = ssf.calibrate(log)
    page = Report("of the log", "<html></html>", log.files)
    (tmp_path / "alias.csv").symlink_to(path)
    for target in (path, tmp_path / "alias.csv"):
        for save in (fit.save, log.to_csv, page.save):
            with pytest.raises(InputError, match="is a log that this was computed from"):
                save(target)
    assert path.read_bytes() == measured
    fit.save(tmp_path / "fit.json")
    with pytest.raises(InputError, match="is a log"):
        ssf.load_result(tmp_path / "fit.json").save(path)
