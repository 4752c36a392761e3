"""``python -m stickslip_fit.capture.emulator LAW``: an emulated rig as a process for other programs."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from functools import partial

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import DIALECTS, emulate_rig, serve_rig
from stickslip_fit.capture.protocols import STEP_PERIOD, RealClock
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Noise
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values


def main() -> None:
    """Serve until the standard input ends, or Ctrl-C."""
    options = _parser().parse_args()
    try:
        machine = load_machine(options.machine)
        laws = read_law_values(options.law, machine)
    except InputError as error:
        sys.exit(str(error))
    spread = {
        (joint, direction): options.repeatability_pct / 100 for joint in laws.laws for direction in "+-"
    }
    truth = HiddenLaws(laws, machine, Noise(spread), options.seed)
    rig = emulate_rig(truth, options.dialect, RealClock(), options.step_period_ms / 1000)
    microphone = rig.microphone(Acoustics(options.snr_db, period=rig.emulated_controller.period))
    with suppress(KeyboardInterrupt):
        serve_rig(rig, microphone, sys.stdin.fileno(), partial(print, flush=True))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m stickslip_fit.capture.emulator",
        description="An emulated rig behind a pseudo-terminal. It prints the terminal's "
        'name, and takes orders such as {"set": {"theta": 0.5}} (SI), one a line.',
    )
    parser.add_argument("law", help="law file (TOML) by which the joints step, with or without causes")
    parser.add_argument("--machine", help="machine file (TOML); the nominal MM3A without it")
    parser.add_argument("--dialect", choices=list(DIALECTS), default="new")
    parser.add_argument("--repeatability-pct", type=float, default=0.27, help="repeatability of the counts")
    parser.add_argument("--step-period-ms", type=float, default=1000 * STEP_PERIOD)
    parser.add_argument("--snr-db", type=float, default=12.0, help="of the stop's sound")
    parser.add_argument("--seed", type=int, default=0)
    return parser


if __name__ == "__main__":
    main()
