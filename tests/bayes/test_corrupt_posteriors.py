"""Saved draws that are corrupt, foreign or newer end with one message; those of released versions load."""

import hashlib
import json
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from stickslip_fit.bayes import load_posterior
from stickslip_fit.bayes.posterior import VERSION
from stickslip_fit.errors import InputError
from stickslip_fit.estimation.result import compute_checksum

SAVED = Path(__file__).parent / "saved"
LATEST = SAVED / f"posterior-{VERSION}.nc"


@pytest.fixture
def pair(tmp_path):
    """A copy of the saved draws, with their result beside them."""
    for suffix in (".nc", ".json"):
        shutil.copy(LATEST.with_suffix(suffix), tmp_path / f"fit{suffix}")
    return tmp_path / "fit.nc"


def refused(path):
    with pytest.raises(InputError) as caught:
        load_posterior(path)
    assert len(caught.value.problems) == 1
    return str(caught.value)


def forge(path):
    """Make the result take the draws for its own, whatever was done to them."""
    beside = path.with_suffix(".json")
    content = json.loads(beside.read_text("utf-8"))
    content["draws_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    content["checksum"] = compute_checksum(content)
    beside.write_text(json.dumps(content), encoding="utf-8")


def test_draws_of_every_version_ever_released_load():
    files = {int(re.search(r"(\d+)\.nc$", path.name)[1]): path for path in SAVED.glob("posterior-*.nc")}
    assert sorted(files) == list(range(1, VERSION + 1))
    for path in files.values():
        assert np.isfinite(load_posterior(path).campaign_means()["estimate"]).all()


def test_no_bit_of_the_draws_can_flip_unnoticed(pair):
    rng, raw = np.random.default_rng(1), pair.read_bytes()
    for place in rng.integers(len(raw), size=40):
        damaged = bytearray(raw)
        damaged[place] ^= 1 << int(rng.integers(8))
        pair.write_bytes(damaged)
        assert "is no saved posterior, or damaged" in refused(pair)
    pair.write_bytes(raw[: len(raw) // 2])
    assert "is no saved posterior, or damaged" in refused(pair)


def test_draws_and_result_belong_together(pair):
    beside = pair.with_suffix(".json")
    shutil.copy(SAVED.parents[1] / "estimation" / "saved" / "result-1.json", beside)
    assert "is no saved posterior, or damaged" in refused(pair)
    beside.unlink()
    assert "fit.json: cannot be read (No such file or directory); give a file that `fit --json`" in refused(
        pair
    )
    beside.with_suffix(".nc").unlink()
    assert "fit.nc: cannot be read (No such file or directory); name an existing posterior" in refused(pair)


def set_attribute(name, value):
    def change(file):
        file.attrs[name] = value

    return change


def spoil(file):
    file["joint_3_plus/posterior/mean"][0, 0] = np.nan


def drop(name):
    def change(file):
        del file[name]

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (set_attribute("schema", "stickslip-fit/posterior/2"), "newer version"),
        (set_attribute("priors", "[]" * 9), "no saved posterior"),
        (set_attribute("priors", '[{"joint": 1, "direction": "+"}]'), "no saved posterior"),
        (set_attribute("diagnostics", "3"), "no saved posterior"),
        (lambda file: file.attrs.pop("priors"), "no saved posterior"),
        (drop("joint_3_plus"), "no saved posterior"),
        (drop("joint_3_minus/posterior/spread"), "no saved posterior"),
        (spoil, "the draws of joint 3"),
    ],
)
def test_forged_draws_are_refused(pair, change, reason):
    with h5py.File(pair, "a") as file:
        change(file)
    forge(pair)
    assert reason in refused(pair)


@pytest.mark.parametrize("raw", [b"", b"no netCDF", b"\x89HDF\r\n\x1a\n" + bytes(500)])
def test_what_is_no_hdf5_is_refused_even_if_its_hash_is_right(pair, raw):
    pair.write_bytes(raw)
    forge(pair)
    assert "is no netCDF file" in refused(pair)
