"""Options and arguments shared by the commands, and their parsing."""

from __future__ import annotations

import math
import os
import re
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stickslip_fit._io import find_write_fault
from stickslip_fit.cli._files import INPUT, Output
from stickslip_fit.errors import ALPHA_LIMITS, InputError, InputIssue, suggest

if TYPE_CHECKING:
    from stickslip_fit._typing import Array
    from stickslip_fit.bayes import Posterior
    from stickslip_fit.estimation import Result
    from stickslip_fit.laws import StepLaw
    from stickslip_fit.logs import Log
    from stickslip_fit.logs.plan import Plan
    from stickslip_fit.machine import Machine
    from stickslip_fit.moves import CalibratedArm, DriveCommand
    from stickslip_fit.simulation import LawValues


def parse_path(text: str) -> Path:
    """A path; InputError for an empty one, which would be the current folder."""
    if not text:
        raise InputError("a file was named by an empty text, perhaps a variable that is not set; name a file")
    return Path(text)


def parse_table_law(text: str) -> Path | str:
    """The path of a law file, or a formula as it is: what has a ~, or = in its place, and is no file."""
    is_formula = re.search(r"[~=]", text) and not text.startswith("~/") and not text.endswith(".toml")
    return text if is_formula and not os.path.exists(text) else parse_path(text)


LogPath = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        parser=parse_path,
        help="Campaign log: CSV, Excel or Parquet files, or a folder of them.",
    ),
    INPUT,
]
MachinePath = Annotated[
    Path | None, typer.Option("--machine", help="Machine file (TOML); the nominal MM3A without it."), INPUT
]
Since = Annotated[str | None, typer.Option(help="Only sessions that began at or after this date.")]
Until = Annotated[str | None, typer.Option(help="Only sessions that began before this date.")]
Sheet = Annotated[
    str | None, typer.Option(metavar="NAME", help="Sheet of an Excel workbook; the first one without it.")
]
Json = Annotated[Path | None, typer.Option("--json", help="Also save the result here."), Output()]
Alpha = Annotated[float, typer.Option(min=ALPHA_LIMITS[0], max=ALPHA_LIMITS[1], help="False-alarm rate.")]
Seed = Annotated[int, typer.Option(min=0, help="Of the bootstrap.")]
ReportPath = Annotated[
    Path | None, typer.Option("--report", help="Also show it as one HTML page here, with figures."), Output()
]
ExtendedLawPath = Annotated[
    Path | None,
    typer.Option("--save-law", help="Also save the law here (JSON), extended by the causes found."),
    Output(),
]
Force = Annotated[bool, typer.Option("--force", help="Replace files that exist already.")]
Chart = Annotated[
    Path | None,
    typer.Option("--chart", help="Also draw the control chart here: .png, .svg or .pdf."),
    Output(),
]
PlanPath = Annotated[Path, typer.Argument(metavar="PLAN", help="Plan of a campaign (TOML)."), INPUT]
Calibration = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG|RESULT",
        parser=parse_path,
        help="A campaign log to fit, or a result saved with `fit --json`.",
    ),
    INPUT,
]
Session = Annotated[str | None, typer.Option(help="Whose calibration to use; the latest without it.")]
Theta = Annotated[float, typer.Option(help="Base turned about x, degrees.")]
Psi = Annotated[float, typer.Option(help="Base turned about y, degrees.")]
At = Annotated[str, typer.Option("--at", metavar="Q1,Q2,Q3", help="Where the joints stand: deg,deg,mm.")]
Condition = Annotated[
    list[str] | None,
    typer.Option(
        "--condition",
        metavar="NAME=VALUE",
        help="Condition for a law with causes, e.g. session_min=30 or temperature_C=23; repeatable.",
    ),
]
LawNames = Annotated[
    list[Path] | None,
    typer.Option(
        "--law",
        metavar="[JOINT=]LAW",
        parser=parse_path,
        help="physical, or a law of your own: FILE.toml of formulas, MODULE:NAME of Python, or an installed "
        "one's name; of one joint with JOINT= before it, e.g. 2=mylab:ELBOW; repeatable.",
    ),
    INPUT,
]
CauseNames = Annotated[
    list[str] | None,
    typer.Option(
        "--cause", metavar="NAME", help="Fit this cause with the laws, e.g. thermal-warm-up; repeatable."
    ),
]
CausesFrom = Annotated[
    Path | None,
    typer.Option(
        "--causes-from",
        metavar="RESULT",
        help="Take the causes of this saved result as known, with its uncertainties.",
    ),
    INPUT,
]


@dataclass(frozen=True)
class LogSource:
    """A campaign log, as commands name it."""

    log: LogPath
    machine: MachinePath = None
    since: Since = None
    until: Until = None
    sheet: Sheet = None

    def read(self) -> Log:
        """The log."""
        return load_log(self.log, self.machine, self.since, self.until, self.sheet)

    def command(self, name: str, *options: str, law: list[Path] | None = None) -> str:
        """Another command on the same log and laws, read in the same way, to be copied."""
        given = {"machine": self.machine, "since": self.since, "until": self.until, "sheet": self.sheet}
        same = [text for option, value in given.items() if value for text in (f"--{option}", str(value))]
        same += [text for one in law or () for text in ("--law", str(one))]
        return shlex.join(["stickslip-fit", name, *map(str, self.log), *same, *options])


@dataclass(frozen=True)
class ArmSource:
    """One session's calibration, and how the base stands, in degrees."""

    calibration: Calibration
    session: Session = None
    theta: Theta = 0.0
    psi: Psi = 0.0
    condition: Condition = None
    law: LawNames = None
    machine: MachinePath = None
    sheet: Sheet = None

    def load(self) -> CalibratedArm:
        """The arm in use."""
        from stickslip_fit.moves import calibrated_arm
        from stickslip_fit.moves.arm import check_conditions, parse_conditions
        from stickslip_fit.units import to_si

        result = load_or_fit_result(self.calibration, self.machine, self.law, self.sheet)
        values = parse_conditions(self.condition or (), result, "--condition")
        check_conditions(result, values, "--condition")
        return calibrated_arm(result, self.session, to_si(self.theta, "deg"), to_si(self.psi, "deg"), values)


class Method(StrEnum):
    """Estimation method."""

    closed_form = "closed-form"
    least_squares = "least-squares"
    bayes = "bayes"


class Dialect(StrEnum):
    """Dialect of the controller."""

    new = "new"
    old = "old"
    anc300 = "anc300"


Port = Annotated[str | None, typer.Option(help="Serial port of the controller; VISA resource of an ANC300.")]
DialectOption = Annotated[Dialect, typer.Option(help="Dialect of the controller.")]
Device = Annotated[str | None, typer.Option(help="Microphone: its name, a part of it, or its number.")]
Page = Annotated[bool, typer.Option("--page", help="Also show it on a page, for a browser on this computer.")]
PagePort = Annotated[
    int, typer.Option(min=0, max=65535, help="Of that page; 0 takes any that is free.", show_default=False)
]
Ratio = Annotated[float, typer.Option(help="Emulated: signal-to-noise ratio of the stop, dB.")]


def check_chart(path: Path | None) -> None:
    """Refuse a kind of picture that cannot be drawn, before any work; raises InputError."""
    if path is not None:
        from stickslip_fit.plotting._style import check_suffix

        check_suffix(path)


def reject_options(options: Mapping[str, object], where: str) -> None:
    """Refuse options that have no meaning where they are given; raises InputError."""
    for option, value in options.items():
        if value:
            raise InputError(f"{option} means nothing {where}; leave it out")


def require_option[Value](value: Value | None, option: str) -> Value:
    """The value of an option that is needed; raises InputError without one."""
    if value is None:
        raise InputError(f"give {option}")
    return value


_DRIVE_PATTERN = re.compile(r"([123])([+-])([1-9]\d{0,11})")
_BOUND_PATTERN = re.compile(r"([^=]+)=([^:]*):([^:]*)")
_REPEATABILITY_PATTERN = re.compile(r"(?:([1-9]\d?)([+-])=)?(\d{1,6}(?:\.\d{1,12})?|\.\d{1,12})")


def command_line() -> str:
    """The command as it was typed, without the path of the program, which may be run as a module, too."""
    name = Path(sys.argv[0]).name
    return shlex.join(["stickslip-fit" if name == "__main__.py" else name, *sys.argv[1:]])


def load_log(
    paths: list[Path],
    machine: Path | None,
    since: str | None = None,
    until: str | None = None,
    sheet: str | None = None,
) -> Log:
    """Read the log that the paths name."""
    from stickslip_fit.logs import read_log
    from stickslip_fit.machine import load_machine

    return read_log(paths, machine=load_machine(machine), since=since, until=until, sheet=sheet)


_LAW_PATTERN = re.compile(r"(?:(\d{1,3})=)?(.+)", re.DOTALL)


def load_laws(names: list[Path] | None, joints: Iterable[int]) -> dict[int, Any]:
    """Laws of one's own by joint, as `choose_laws` takes them; a formula or function is for all `joints`.

    Raises
    ------
    InputError
        With every law that cannot be found, imported or used.
    """
    from stickslip_fit.laws.registry import laws_by_joint

    laws: dict[int, Any] = {}
    issues = []
    for name in map(str, names or ()):
        match = _LAW_PATTERN.fullmatch(name)
        assert match is not None  # no option is empty, see `parse_path`
        wanted = (int(match[1]),) if match[1] else tuple(joints)
        try:
            own = laws_by_joint(_find_law(match[2]), wanted)
            if match[1] and wanted[0] not in own:
                raise InputError(f"is of joint {', '.join(map(str, own))}, not of joint {match[1]}")
            if twice := laws.keys() & own.keys():
                raise InputError(f"is a second law of joint {', '.join(map(str, sorted(twice)))}; give one")
        except InputError as error:
            issues.append(InputIssue(str(error), column="--law", value=name))
        else:
            laws |= {joint: own[joint] for joint in wanted if joint in own} if match[1] else own
    if issues:
        raise InputError(issues)
    return laws


def _find_law(name: str) -> Any:
    from stickslip_fit.laws.registry import check_kind, installed_laws

    if is_law_file(name):
        from stickslip_fit.causes.law_file import read_law_file

        content = read_law_file(name)
        return content.laws or content.law
    module, colon, variable = name.partition(":")
    if not colon:
        installed = installed_laws()
        if name in installed:
            return installed[name]
        if name == "physical":
            from stickslip_fit.estimation import physical_law

            return physical_law
        known = (
            f"; installed packages offer {', '.join(installed)}{suggest(name, installed)}"
            if installed
            else ""
        )
        if name.endswith(".json"):
            raise InputError(
                "is a saved result; give its file as --causes-from, or where RESULT is asked for"
            )
        raise InputError(
            f"is no law that is known; give physical, MODULE:NAME, or a FILE.toml of formulas{known}"
        )
    if (here := os.getcwd()) not in sys.path:
        sys.path.insert(0, here)  # as Python itself has it for a script: a file of one's own beside the log
    try:
        found = import_module(module)
    # Whatever the user's module raises, even where it ends the program, is told in one message.
    except (Exception, SystemExit) as error:
        raise InputError(f"cannot be imported: {type(error).__name__}: {error}") from None
    if variable not in vars(found):
        raise InputError(f"the module {module} ({found.__file__}) has no {variable!r}")
    return check_kind(vars(found)[variable])


def is_law_file(name: str) -> bool:
    """Whether a law is named by a file of formulas."""
    return name.endswith(".toml")


def load_causes(names: list[Path] | None) -> tuple[Any, ...]:
    """Causes in the files of formulas among the laws that are named; raises InputError for a faulty file."""
    from stickslip_fit.causes.law_file import read_law_file

    matches = [_LAW_PATTERN.fullmatch(str(name)) for name in names or ()]
    files = dict.fromkeys(match[2] for match in matches if match is not None and is_law_file(match[2]))
    return tuple(cause for file in files for cause in read_law_file(file).causes)


def check_savable(log: Log, laws: Mapping[int, Any], path: Path | None) -> None:
    """Refuse a law that cannot be saved before anything is fitted, where `path` is to be written."""
    if path is not None and laws:
        from stickslip_fit.laws import choose_laws, describe_law

        for law in choose_laws(log.usable, log.machine, laws).values():
            describe_law(law)


MAX_JOINTS = 9  # for which a saved result is given laws without joints


def load_or_fit_result(
    paths: list[Path], machine: Path | None, law: list[Path] | None = None, sheet: str | None = None
) -> Result:
    """A saved result, or the least-squares fit of a log."""
    from stickslip_fit.estimation import fit_least_squares, load_result

    if len(paths) == 1 and paths[0].suffix == ".json":
        if machine is not None:
            raise InputError("a saved result carries its own machine: leave --machine out, or give the log")
        if sheet is not None:
            raise InputError("a saved result has no sheets: leave --sheet out, or give the log")
        return load_result(paths[0], load_causes(law), laws=load_laws(law, range(1, MAX_JOINTS + 1)))
    log = load_log(paths, machine, sheet=sheet)
    return fit_least_squares(log, laws=load_laws(law, log.joints), command=command_line())


def load_fit(
    paths: list[Path], machine: Path | None, law: list[Path] | None = None, sheet: str | None = None
) -> tuple[Result | Posterior, Result]:
    """What to predict with: draws saved with `fit --tree`, or a result; and always the result."""
    if len(paths) == 1 and paths[0].suffix == ".nc":
        from stickslip_fit.bayes import load_posterior

        if machine is not None:
            raise InputError("saved draws carry their own machine: leave --machine out, or give the log")
        posterior = load_posterior(paths[0], laws=load_laws(law, range(1, MAX_JOINTS + 1)))
        return posterior, posterior.result
    result = load_or_fit_result(paths, machine, law, sheet)
    return result, result


def load_law_values(path: Path, machine: Machine, plan: Plan) -> LawValues:
    """True laws of a simulated plan, from a law file or a saved result for the same machine.

    Sessions that the saved result lacks get the parameters of its latest.
    """
    from stickslip_fit.estimation import load_result
    from stickslip_fit.simulation import LawValues, read_law_values

    if path.suffix != ".json":
        return read_law_values(path, machine)
    result = load_result(path)
    check_same_machine(result, machine, path)
    values: dict[tuple[int, str, str | None], Array] = {}
    planned = {session.label for session in plan.sessions}
    for joint, fit in result.joints.items():
        for (session, direction), known, row in zip(
            fit.groups[["session", "direction"]].itertuples(index=False), fit.known, fit.values, strict=True
        ):
            if known.all():
                values[joint, direction, None] = row
                if session in planned:
                    values[joint, direction, session] = row
    return LawValues({joint: fit.law for joint, fit in result.joints.items()}, values)


def check_same_machine(result: Result, machine: Machine, path: Path) -> None:
    """Refuse a saved result for another machine; raises InputError."""
    if result.machine.sha256 != machine.sha256:
        message = f"was fitted for the machine {result.machine.name!r}; pass that with --machine"
        raise InputError(InputIssue(message, str(path)))


PLAN_SAYS = {
    "session_seconds": "a plan times its traverses itself, from the start of each session on: leave this "
    "out, and change pause_s in its table [timing], or the order of the traverses",
    "step_period": "a plan has its own step period: leave this out, and change step_period_ms in its table "
    "[timing]",
}


def parse_plan_conditions(conditions: list[str] | None, result: Result) -> dict[str, float]:
    """Conditions for the laws of a result that a plan does not give itself."""
    from stickslip_fit.moves.arm import check_conditions, parse_conditions

    each = {text: parse_conditions([text], result, "--condition") for text in conditions or ()}
    known = {name: value for own in each.values() for name, value in own.items()}
    if issues := [
        InputIssue(PLAN_SAYS[name], column="--condition", value=text)
        for text, own in each.items()
        for name in PLAN_SAYS.keys() & own.keys()
    ]:
        raise InputError(issues)
    check_conditions(result, {**known, "session_seconds": math.nan}, "--condition")
    return known


def parse_positions(text: str, option: str) -> Array:
    """Joint positions "Q1,Q2,Q3" in deg, deg and mm."""
    import numpy as np

    from stickslip_fit.units import to_si

    q1, q2, q3 = _parse_three_numbers(text, option, "three numbers Q1,Q2,Q3 in deg,deg,mm, e.g. 0,-90,6")
    return np.array([to_si(q1, "deg"), to_si(q2, "deg"), to_si(q3, "mm")])


def parse_tip_position(text: str, option: str) -> Array:
    """A tip position "X,Y,Z" in mm, base frame."""
    import numpy as np

    from stickslip_fit.units import to_si

    numbers = _parse_three_numbers(text, option, "three numbers X,Y,Z in mm, e.g. 50,0,10")
    return np.array([to_si(value, "mm") for value in numbers])


def parse_joint_order(text: str, option: str) -> tuple[int, ...]:
    """Joints in the order in which they move, e.g. "3,1,2"."""
    parts = tuple(part.strip() for part in text.split(","))
    if sorted(parts) != ["1", "2", "3"]:
        raise InputError(InputIssue("give each joint once, e.g. 3,2,1", column=option, value=text))
    return tuple(int(part) for part in parts)


def parse_drive(text: str, option: str) -> DriveCommand:
    """A drive such as "3+5000": joint, direction, steps."""
    from stickslip_fit.moves import DriveCommand

    match = _DRIVE_PATTERN.fullmatch(text.strip())
    if match is None:
        message = "give joint, direction and 1 or more steps, e.g. 3+5000 or 2-1200"
        raise InputError(InputIssue(message, column=option, value=text))
    return DriveCommand(int(match[1]), match[2], int(match[3]))


def parse_bound(text: str, option: str, laws: Iterable[StepLaw]) -> tuple[str, tuple[float, float]]:
    """Bounds such as "c=0:" or "b=0.2:0.4": a parameter's name, lowest and highest value in its unit."""
    from stickslip_fit.causes import ExtendedLaw, library
    from stickslip_fit.laws import Prismatic
    from stickslip_fit.units import to_si

    law_units = {parameter.name: parameter.unit for law in laws for parameter in law.parameters}
    cause_parameters = ExtendedLaw(Prismatic(), library()).cause_parameters
    units = law_units | {parameter.name: parameter.unit for parameter in cause_parameters}
    match = _BOUND_PATTERN.fullmatch(text.strip())
    if match is None or match[1] not in units or not (match[2] or match[3]):
        names = ", ".join([*law_units, "CAUSE.PARAMETER"])
        message = f"give NAME=LOW:HIGH, e.g. b=0.2:0.4 or c=0:; names: {names}"
        raise InputError(InputIssue(message, column=option, value=text))
    try:
        low, high = float(match[2] or "-inf"), float(match[3] or "inf")
    except ValueError:
        raise InputError(InputIssue("give numbers, e.g. b=0.2:0.4", column=option, value=text)) from None
    return match[1], (to_si(low, units[match[1]]), to_si(high, units[match[1]]))


def parse_repeatabilities(
    texts: tuple[str, ...], option: str, joints: Sequence[int]
) -> dict[tuple[int, str], float]:
    """Repeatabilities such as "0.3" (of every joint and direction) or "3+=0.25", in per cent."""
    values: dict[tuple[int, str], float] = {}
    for text in texts:
        match = _REPEATABILITY_PATTERN.fullmatch(text.strip())
        if match is None:
            message = "give per cent, e.g. 0.3, or for one drive 3+=0.3"
            raise InputError(InputIssue(message, column=option, value=text))
        drives = [(joint, direction) for joint in joints for direction in "+-"]
        if match[1]:
            drives = [(int(match[1]), match[2])]
        values |= dict.fromkeys(drives, float(match[3]) / 100)
    return values


def default_output(paths: list[Path]) -> Path:
    """The file in reports/ named after the log."""
    folder = Path("reports")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        message = f"cannot be made here ({error.strerror}); name a file with -o"
        raise InputError(InputIssue(message, str(folder))) from None
    path = folder / f"{paths[0].resolve().stem}.html"
    if fault := find_write_fault(path):
        raise InputError(fault)
    return path


def reference_campaign() -> Path:
    """The simulated campaign of the demo, in a checkout or in an installed package."""
    package = Path(__file__).parents[1]
    for folder in (package / "data", package.parent / "data"):
        path = folder / "reference" / "campaign.csv"
        if path.exists():
            return path
    raise InputError("the reference campaign is not installed; give a log of your own")


def reference_law() -> Path:
    """The true laws of the simulated campaign, used as typical values."""
    return reference_campaign().with_name("law.toml")


def has_browser() -> bool:
    """Whether there is a terminal and a screen that can show a page."""
    screen = (
        sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )
    return bool(screen) and sys.stdout.isatty()


def _parse_three_numbers(text: str, option: str, wanted: str) -> tuple[float, float, float]:
    try:
        first, second, third = (float(part) for part in text.split(","))
        if not all(map(math.isfinite, (first, second, third))):
            raise ValueError
    except ValueError:
        raise InputError(InputIssue(f"give {wanted}", column=option, value=text)) from None
    return first, second, third
