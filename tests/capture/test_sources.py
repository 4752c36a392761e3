"""A microphone that is not there, one that is played by hand, and files."""

import builtins
import sys
from threading import Timer
from types import SimpleNamespace

import numpy as np
import pytest

from stickslip_fit.capture import audio as microphone
from stickslip_fit.capture.audio import Microphone, read_wav
from stickslip_fit.errors import InputError
from tests.capture.hearing import write_wav

RATE = 1000


class Stream:
    """Stands in for sounddevice's stream; the test pushes the blocks."""

    time = 0.0

    def __init__(self, rate, **settings):
        self.rate, self.callback = rate, settings["callback"]
        self.heard = 0

    def start(self):
        """Nothing to start."""

    def close(self):
        self.closed = True

    def push(self, values, overflow=False, adc=True):
        began = self.heard / self.rate
        self.heard += len(values)
        times = SimpleNamespace(inputBufferAdcTime=began if adc else 0.0, currentTime=self.heard / self.rate)
        block = np.asarray(values, np.float32)[:, None]
        self.callback(block, len(values), times, SimpleNamespace(input_overflow=overflow))


@pytest.fixture
def stream(monkeypatch):
    module = SimpleNamespace(InputStream=Stream, PortAudioError=RuntimeError)
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    return Microphone(rate=RATE)


@pytest.mark.parametrize("adc", [True, False])
def test_a_microphone_gives_the_seconds_up_to_now(stream, adc):
    for block in np.arange(200).reshape(10, 20):
        stream._stream.push(block, adc=adc)
    stream._stream.time = 0.15
    heard = stream.read(0.05)
    assert heard.values.tolist() == list(range(100, 150))
    assert not heard.overflowed


def test_a_microphone_waits_for_what_is_still_on_its_way(stream):
    stream._stream.push(np.arange(100))
    stream._stream.time = 0.12
    late = Timer(0.05, stream._stream.push, [np.arange(100, 140)])
    late.start()
    assert stream.read(0.05).values.tolist() == list(range(70, 120))
    late.join()


def test_a_microphone_that_is_gone_gives_nothing(stream, monkeypatch):
    monkeypatch.setattr(microphone, "READ_TIMEOUT", 0.02)
    stream._stream.push(np.arange(100))
    stream._stream.time = 0.2
    assert len(stream.read(0.05).values) == 0


def test_an_overflow_is_told_once_and_old_sound_is_dropped(stream):
    stream._stream.push(np.zeros(RATE), overflow=True)
    for _ in range(9):
        stream._stream.push(np.zeros(RATE))
    stream._stream.time = 10.0
    assert [stream.read(0.05).overflowed for _ in range(2)] == [True, False]
    assert sum(map(len, stream._blocks)) <= (microphone.BUFFER_SECONDS + 1) * RATE
    stream.close()
    assert stream._stream.closed


def test_no_device_no_portaudio_and_no_sounddevice_are_told_apart(monkeypatch):
    def refuse(*_, **__):
        raise RuntimeError("Error querying device -1")

    module = SimpleNamespace(InputStream=refuse, PortAudioError=RuntimeError)
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    with pytest.raises(InputError, match=r"no microphone 'USB' can be listened to at 48,000 .*-1"):
        Microphone("USB")
    there = builtins.__import__
    for error, said in ((OSError("PortAudio library not found"), "libportaudio2"), (ImportError(), "pip")):

        def without(name, *rest, error=error):
            if name == "sounddevice":
                raise error
            return there(name, *rest)

        monkeypatch.setattr(builtins, "__import__", without)
        with pytest.raises(InputError, match=said):
            Microphone()
        monkeypatch.setattr(builtins, "__import__", there)


def test_a_wav_file_is_what_was_written_into_it_by_the_standard_library(tmp_path):
    pytest.importorskip("soundfile", reason="soundfile is not installed")
    values = np.random.default_rng(1).uniform(-0.9, 0.9, 4800).astype(np.float32)
    write_wav(tmp_path / "a.wav", values, 48000)
    recording = read_wav(tmp_path / "a.wav")
    assert recording.rate == 48000
    parts = [recording.read(0.04).values for _ in range(3)]
    assert [len(part) for part in parts] == [1920, 1920, 960]
    np.testing.assert_allclose(np.concatenate(parts), values, atol=1e-4)


def test_what_is_no_sound_is_refused(tmp_path):
    pytest.importorskip("soundfile", reason="soundfile is not installed")
    (tmp_path / "a.wav").write_text("hello")
    with pytest.raises(InputError, match=r"a\.wav: is no sound file"):
        read_wav(tmp_path / "a.wav")
    with pytest.raises(InputError, match="there is no such file"):
        read_wav(tmp_path / "b.wav")
