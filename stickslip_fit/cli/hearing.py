"""The ear by itself: `capture tune` before a session, `capture listen` to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit.cli.rig_options import Device, Dialect, DialectOption, Port, Ratio, given, refuse
from stickslip_fit.files import check_folder

if TYPE_CHECKING:
    from stickslip_fit.capture.tuning import Tuning

CheckEvery = Annotated[int, typer.Option(min=1, help="Steps between two checks, as in the plan.")]
StepPeriod = Annotated[float, typer.Option(min=0.1, help="Of the controller, ms.")]


def tune(
    output: Annotated[Path, typer.Option("-o", "--output", help="Tuning to write, for `--tuning`.")],
    port: Port = None,
    dialect: DialectOption = Dialect.new,
    device: Device = None,
    joint: Annotated[int, typer.Option(min=1, max=3, help="Which joint to listen to.")] = 3,
    check_every: CheckEvery = 5,
    step_period: StepPeriod = 10.0,
    moving: Annotated[Path | None, typer.Option(help="A recording of the moving joint, not a rig.")] = None,
    at_stop: Annotated[Path | None, typer.Option(help="With --moving: one of it at its stop.")] = None,
    emulate: Annotated[bool, typer.Option("--emulate", help="Try it without hardware.")] = False,
    snr: Ratio = 12.0,
    chart: Annotated[
        Path | None, typer.Option(help="Also draw both spectra here: .png, .svg or .pdf.")
    ] = None,
) -> None:
    """Listen to a joint moving and at its stop; say where the stop is heard best, and how well."""
    from stickslip_fit.cli.planning import refuse_outputs

    check_folder(output)
    refuse_outputs(None, chart)

    from stickslip_fit.capture.tuning import save_tuning
    from stickslip_fit.cli import capturing
    from stickslip_fit.units import to_si

    period = to_si(step_period, "ms")
    at_rig = {"--port": port, "--device": device}
    if emulate:
        refuse(at_rig | {"--moving": moving, "--at-stop": at_stop}, "at an emulated rig")
        found = capturing.tune_at_nothing(check_every, period, snr)
    elif moving or at_stop:
        refuse(at_rig, "beside recordings")
        found = _tuned_by(given(moving, "--moving"), given(at_stop, "--at-stop"), check_every * period)
    else:
        at = given(port, "--port; or recordings, with --moving and --at-stop; or try it with --emulate")
        found = capturing.tune_at_rig(
            capturing.Connection(at, dialect.value, device), joint, check_every, period
        )
    save_tuning(found, output)
    print(f"{found.conclusion}\n\nsaved to {output}")
    if chart is not None:
        from stickslip_fit.report.chart import write_figure
        from stickslip_fit.report.figures.spectrum import plot_spectrum

        write_figure(plot_spectrum(found), chart, "spectrum")
        print(f"chart written to {chart}")


def listen(
    recording: Annotated[Path, typer.Argument(help="WAV file of one traverse.", show_default=False)],
    tuning: Annotated[Path, typer.Option(help="What `capture tune` wrote.")],
    check_every: CheckEvery = 5,
    step_period: StepPeriod = 10.0,
) -> None:
    """Say where in a recording the ear hears the stop."""
    from stickslip_fit.capture.detector import Detector
    from stickslip_fit.capture.tuning import load_tuning
    from stickslip_fit.capture.wav import read_wav
    from stickslip_fit.units import to_si

    sound = read_wav(recording)
    detector = Detector(sound, load_tuning(tuning))
    seconds = check_every * to_si(step_period, "ms")
    detector.begin()
    checks = int(len(sound.values) / sound.rate / seconds)
    for check in range(1, checks + 1):
        heard = detector.check(seconds)
        at = f"at {check * seconds:.2f} s (check {check:,} of {checks:,})"
        if heard.at_stop:
            steps = (check - heard.checks_late) * check_every
            print(f"the stop is heard {at}, {heard.level:+.1f} dB; that makes a count of {steps:,} steps")
            return
        if heard.fault:
            print(f"broken off {at}: {heard.fault}")
            return
    print(f"no stop is heard in {checks * seconds:.1f} s ({checks:,} checks)")


def _tuned_by(moving: Path, at_stop: Path, seconds: float) -> Tuning:
    from stickslip_fit.capture.tune import tune as tuned
    from stickslip_fit.capture.wav import read_wav
    from stickslip_fit.errors import InputError, Problem

    freely, pushing = read_wav(moving), read_wav(at_stop)
    if freely.rate != pushing.rate:
        message = (
            f"has {pushing.rate:,} samples per second and {moving} has {freely.rate:,}; record both alike"
        )
        raise InputError(Problem(message, str(at_stop)))
    return tuned(freely.values, pushing.values, freely.rate, seconds)
