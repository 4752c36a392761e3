"""Numbers, units and lists as text: estimates with uncertainty, percentages, p-values, configurations.

An estimate has as many decimals as its standard uncertainty justifies (JCGM 100:2008, 7.2.6). Functions
named `format_...` return plain text; functions named `typeset_...` return the text of a page, with
minus signs and no-break spaces.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import floor, isfinite, log10
from typing import TYPE_CHECKING

from stickslip_fit._typing import JointKinds
from stickslip_fit.units import UNITS, Interval, from_si

if TYPE_CHECKING:
    import pandas as pd

MINUS = "\N{MINUS SIGN}"
NO_BREAK_SPACE = "\N{NO-BREAK SPACE}"
MISSING = "–"  # in a table's cell
UNKNOWN_VALUE = "not known"
STEP_DECIMALS = {"nm": 1, "µrad": 2, "%": 2}  # about a tenth of the repeatability of a traverse
MAX_DECIMALS = 6
WHOLE_FROM = 10.0  # from here on, a number without an interval has no decimals
ROUNDING = 1e-9  # of half an interval, so that 0.01 is no less
ANGLE_TOL, SAME_SHARE = 1e-9, 1e-6  # rad; of a joint's full travel

_KEPT_TOGETHER = re.compile(
    r"(?<=\d) (?=(?:nm|mm|µm|µrad|mrad|min|steps|%|°C)(?![\w-]))|(?<=\bp) (?=[=<>] \d)|(?<=\bp [=<>]) (?=\d)"
)
_HYPHEN_MINUS = re.compile(r"(?<= )-(?=\d)")
_DEGREES = re.compile(r"(?<=\d) deg\b")
_BESIDE = {"": "", "1": "", "%/%": " % per %"}


def decimals_for(uncertainty: float) -> int:
    """Decimals that show two significant digits of `uncertainty` below 30, else one (JCGM 100, 7.2.6).

    Examples
    --------
    >>> decimals_for(0.123), decimals_for(0.52), decimals_for(47.0)
    (2, 1, 0)
    """
    if not isfinite(uncertainty) or uncertainty <= 0:
        return 1
    exponent = floor(log10(uncertainty))
    leading = uncertainty / 10.0**exponent
    return max(0, (1 if leading < 3.0 else 0) - exponent)


def format_number(value: float | None, unit: str, decimals: int | None = None) -> str:
    """An SI value in a display unit, which stands elsewhere; `MISSING` where there is none.

    Examples
    --------
    >>> format_number(9.5731e-7, "nm"), format_number(-1.98e-5, "µrad"), format_number(-0.024227, "deg", 2)
    ('957.3', '−19.80', '−1.39')
    """
    if value is None or not isfinite(value):
        return MISSING
    shown = float(from_si(float(value), unit)) if unit in UNITS else float(value)
    return _true_minus(f"{shown:.{STEP_DECIMALS.get(unit, 1) if decimals is None else decimals}f}")


def format_value(value: float | None, unit: str, decimals: int | None = None) -> str:
    """An SI value with its unit.

    Examples
    --------
    >>> format_value(9.573e-7, "nm"), format_value(-0.0314, "%")
    ('957.3 nm', '−3.14 %')
    """
    text = format_number(value, unit, decimals)
    return text if text == MISSING else f"{text}{_beside(unit)}"


def format_uncertain(
    value: float | None, standard_error: float | None, unit: str, *, with_unit: bool = True
) -> str:
    """An SI value with its standard error, in a display unit.

    Examples
    --------
    >>> format_uncertain(9.5731e-7, 1.234e-9, "nm"), format_uncertain(9.5731e-7, None, "nm", with_unit=False)
    ('957.3 ± 1.2 nm', '957.3 ± ?')
    """
    if value is None or not isfinite(value):
        return UNKNOWN_VALUE
    beside = _beside(unit) if with_unit else ""
    if standard_error is None or not isfinite(standard_error):
        return f"{format_number(value, unit, 3 if unit == '1' else 1)} ± ?{beside}"
    error = from_si(float(standard_error), unit) if unit != "°C" else standard_error
    decimals = decimals_for(error)
    return f"{format_number(value, unit, decimals)} ± {error:.{decimals}f}{beside}"


def format_range(low: float, high: float, unit: str, decimals: int | None = None) -> str:
    """Two SI values in a display unit, which stands elsewhere.

    Examples
    --------
    >>> format_range(-1e-9, 2e-9, "nm"), format_range(float("nan"), 2e-9, "nm")
    ('−1.0 to 2.0', '–')
    """
    if not (isfinite(low) and isfinite(high)):
        return MISSING
    return f"{format_number(low, unit, decimals)} to {format_number(high, unit, decimals)}"


def format_estimate(interval: Interval, unit: str, *, signed: bool = False) -> str:
    """An estimate with its unit, down to the first digit of its uncertainty; its size alone unless signed.

    Examples
    --------
    >>> format_estimate(Interval(-0.0378, -0.0394, -0.0363), "%")
    '3.8 %'
    >>> format_estimate(Interval(4506.0, 4185.0, 4827.0), "min")
    '75 min'
    """
    value = interval.estimate if signed else abs(interval.estimate)
    if not isfinite(value):
        return UNKNOWN_VALUE
    return f"{_thousands(format_number(value, unit, _decimals_of(interval, unit)))}{_beside(unit)}"


def format_percent(share: float, *, with_unit: bool = True, signed: bool = False) -> str:
    """A share in per cent, to two or three digits; a plus sign where `signed` and above zero.

    Examples
    --------
    >>> [format_percent(share) for share in (0.00284, -0.0314, 0.1234, 1.58)]
    ['0.28 %', '−3.1 %', '12.3 %', '158 %']
    >>> format_percent(0.0786, signed=True), format_percent(0.0786, with_unit=False)
    ('+7.9 %', '7.9')
    """
    if not isfinite(share):
        return UNKNOWN_VALUE
    percent = 100 * abs(share)
    text = format_number(share, "%", 2 if percent < 0.995 else 1 if percent < 99.5 else 0)
    return f"{'+' if signed and share > 0 else ''}{text}{' %' if with_unit else ''}"


def format_percent_range(low: float, high: float) -> str:
    """Two shares in per cent, without the unit.

    Examples
    --------
    >>> format_percent_range(-0.0012, 0.0314)
    '−0.12 to 3.1'
    """
    if not (isfinite(low) and isfinite(high)):
        return MISSING
    return f"{format_percent(low, with_unit=False)} to {format_percent(high, with_unit=False)}"


def format_p_value(value: float, *, relation: bool = False) -> str:
    """A p-value, in a sentence with its relation to p.

    Examples
    --------
    >>> [format_p_value(value) for value in (0.9996, 0.312, 0.0312, 0.00021, 1e-9)]
    ['1', '0.31', '0.031', '0.0002', '<0.0001']
    >>> format_p_value(0.0312, relation=True), format_p_value(1e-9, relation=True)
    ('= 0.031', '< 0.0001')
    """
    if value < 1e-4:
        return "< 0.0001" if relation else "<0.0001"
    decimals = 0 if value >= 0.995 else 2 if value >= 0.095 else 3 if value >= 0.00095 else 4
    return f"{'= ' if relation else ''}{value:.{decimals}f}"


def format_plain(value: float) -> str:
    """A number with no needless digits.

    Examples
    --------
    >>> format_plain(-90.00000000000001), format_plain(0.5)
    ('−90', '0.5')
    """
    return f"{round(value, 3) + 0.0:g}".replace("-", MINUS)


def format_angle(value: float) -> str:
    """An angle in degrees."""
    return f"{format_plain(from_si(value, 'deg'))}°"


def format_length(value: float) -> str:
    """A length in mm."""
    return f"{format_plain(from_si(value, 'mm'))} mm"


def format_coordinate(name: str, value: float, machine: JointKinds) -> str:
    """One coordinate of a configuration.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> [format_coordinate(name, 0.012, load_machine()) for name in ("q3", "theta")]
    ['q3 = 12 mm', 'theta = 0.688°']
    """
    return f"{name} = {format_position(value, _joint_of(name), machine)}"


def format_configuration(row: pd.Series, machine: JointKinds) -> str:
    """The configuration of a traverse, and its ends if it does not cover the joint's full travel.

    `row` has joint, q1 to qn, theta, psi, start and stop, SI; what is not known is left out, and on the
    published arm q1 = 0.
    """
    joint = int(row["joint"])
    names = [*(f"q{other}" for other in machine.joints if other != joint), "theta", "psi"]
    if machine.has_published_geometry and abs(row["q1"]) <= ANGLE_TOL:
        names.remove("q1")
    known = [name for name in names if isfinite(row[name])]
    parts = [f"{name} {format_position(row[name], _joint_of(name), machine)}" for name in known]
    span = machine.span(joint)
    if abs(abs(row["stop"] - row["start"]) - span) > SAME_SHARE * span:
        parts.append(" to ".join(format_position(row[end], joint, machine) for end in ("start", "stop")))
    return ", ".join(parts)


def _joint_of(name: str) -> int | None:
    """The joint whose position a column has; None for the base's orientation."""
    return int(name[1:]) if name.startswith("q") else None


def format_position(value: float, joint: int | None, machine: JointKinds) -> str:
    """A joint's position, or without a joint an angle of the base, with its unit."""
    slides = joint is not None and machine.is_prismatic(joint)
    return format_length(value) if slides else format_angle(value)


def format_time(moment: pd.Timestamp) -> str:
    """A moment; empty where it is not known."""
    return "" if moment != moment else f"{moment:%Y-%m-%d %H:%M:%S}"


def position_unit(joint: int, machine: JointKinds) -> str:
    """Display unit of a joint's position."""
    return "mm" if machine.is_prismatic(joint) else "deg"


def coordinate_unit(name: str, machine: JointKinds) -> str:
    """Display unit of a column q1 to qn, theta or psi."""
    joint = _joint_of(name)
    return "deg" if joint is None else position_unit(joint, machine)


def step_unit(joint: int, machine: JointKinds) -> str:
    """Display unit of a joint's step size."""
    return "nm" if machine.is_prismatic(joint) else "µrad"


def format_step_range(low: float, high: float, unit: str) -> str:
    """An interval of step sizes with its unit."""
    return f"{format_range(low, high, unit)} {unit}"


def joint_name(joint: int, machine: JointKinds) -> str:
    """A joint with what kind it is.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> joint_name(3, load_machine())
    'joint 3 (prismatic)'
    """
    return f"joint {joint} ({machine.describe_joint(joint)})"


def format_direction(direction: str | None) -> str:
    """A direction's sign, typeset."""
    return MINUS if direction == "-" else direction or ""


def pluralize(count: int, noun: str) -> str:
    """A number of things.

    Examples
    --------
    >>> pluralize(1, "traverse"), pluralize(12300, "traverse")
    ('1 traverse', '12,300 traverses')
    """
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def join_words(items: Sequence[str], last: str = "and") -> str:
    """Items in a sentence.

    Examples
    --------
    >>> join_words(["a", "b", "c"], "or")
    'a, b or c'
    """
    return f"{', '.join(items[:-1])} {last} {items[-1]}" if len(items) > 1 else "".join(items)


def capitalize_first(text: str) -> str:
    """A text as a sentence begins; what follows stays as it is."""
    return text[:1].upper() + text[1:]


def typeset_text(text: str) -> str:
    """A sentence for any output: degree signs and true minus signs.

    Examples
    --------
    >>> typeset_text("theta -90 deg, q3 12 mm")
    'theta −90°, q3 12 mm'
    """
    return _DEGREES.sub("°", _HYPHEN_MINUS.sub(MINUS, text))


def keep_units(text: str) -> str:
    """A sentence whose lines never break between a number and its unit, nor within a p-value.

    Examples
    --------
    >>> keep_units("a map is 3 mm wide, p = 0.4").count(NO_BREAK_SPACE)
    3
    """
    return _KEPT_TOGETHER.sub(NO_BREAK_SPACE, text)


LONG_TIMES = {"years": 2.0, "days": 3.0, "h": 2.0}  # from how many on each is used


def choose_time_unit(value: float, unit: str) -> tuple[str, float]:
    """The unit in which a time is read most easily, and how many of the given unit it is.

    Only seconds are changed: any other unit was chosen by somebody.

    Examples
    --------
    >>> choose_time_unit(90.0, "s"), choose_time_unit(86_430.0, "s"), choose_time_unit(1e6, "min")
    (('s', 1.0), ('h', 3600.0), ('min', 1.0))
    """
    if unit == "s":
        for name, least in LONG_TIMES.items():
            seconds = float(UNITS[name].numerator)
            if abs(value) >= least * seconds:
                return name, seconds
    return unit, 1.0


def format_duration(value: float, unit: str, digits: int = 3) -> str:
    """A time in the unit in which it is read most easily.

    Examples
    --------
    >>> format_duration(86_430.0, "s"), format_duration(1.55e7, "s"), format_duration(5.0, "rows")
    ('24.0 h', '179 days', '5.00 rows')
    """
    name, size = choose_time_unit(value, unit)
    return f"{format_significant(value / size, digits)} {name}"


SIGNIFICANT_DIGITS = 3
POWERS_SHOWN = range(-3, 6)  # of ten, of numbers that are written without one
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_significant(value: float, digits: int = SIGNIFICANT_DIGITS) -> str:
    """A number of any size to some significant digits, in whatever unit it is.

    Examples
    --------
    >>> [format_significant(value) for value in (0.012345, -12.3456, 12345.6, 3.2e-9)]
    ['0.0123', '−12.3', '12,346', '3.20×10⁻⁹']
    """
    if not isfinite(value):
        return UNKNOWN_VALUE
    power = _power_of(value)
    return _with_decimals(value, digits - 1 - power, power)


def format_measured(interval: Interval, unit: str = "", least: float = 0.0) -> str:
    """An estimate in a unit that is not converted, down to the second digit of its uncertainty.

    That counts as no smaller than `least`, also in `format_measured_range`.

    Examples
    --------
    >>> format_measured(Interval(-0.51234, -0.55, -0.47), "N s/m"), format_measured(Interval(2.0, 1.0, 3.0))
    ('−0.512 N s/m', '2.0')
    >>> format_measured(Interval(0.0021, 0.0, 0.9))  # a size is never shown as 0
    '0.002'
    """
    power, decimals = _common_scale(interval, least)
    if not isfinite(interval.estimate):
        return UNKNOWN_VALUE
    return f"{_with_decimals(interval.estimate, decimals, power)}{_beside(unit)}"


def format_measured_range(interval: Interval, least: float = 0.0) -> str:
    """An interval to as many digits as `format_measured` shows of its estimate; `MISSING` where unknown.

    Examples
    --------
    >>> format_measured_range(Interval(-0.51234, -0.55, -0.47))
    '−0.550 to −0.470'
    >>> format_measured_range(Interval(3e-9, 2e-9, 4e-9))
    '2.0×10⁻⁹ to 4.0×10⁻⁹'
    """
    if not (isfinite(interval.low) and isfinite(interval.high)):
        return MISSING
    power, decimals = _common_scale(interval, least)
    return " to ".join(_with_decimals(end, decimals, power) for end in (interval.low, interval.high))


def format_share(share: Interval) -> str:
    """A share in per cent with its interval.

    Examples
    --------
    >>> format_share(Interval(0.031, 0.0267, 0.0354))
    '3.10 % (2.67 to 3.54 %)'
    """
    shown = share.times(100.0)
    return f"{format_measured(shown, '%')} ({format_measured_range(shown)} %)"


def _common_scale(interval: Interval, least_half: float = 0.0) -> tuple[int, int]:
    """Power of ten and decimals for an estimate and both ends of its interval."""
    known = [abs(x) for x in (interval.estimate, interval.low, interval.high) if isfinite(x)]
    power = _power_of(max(known, default=0.0))
    half = max(abs(interval.high - interval.low) / 2, least_half)
    if not isfinite(half) or half <= 0:
        return power, SIGNIFICANT_DIGITS - 1 - power
    is_size = isfinite(interval.estimate) and interval.low >= 0
    least = -_power_of(interval.estimate) if is_size else 0
    return power, max(1 - floor(log10(half * (1.0 + ROUNDING))), least)


def _power_of(value: float) -> int:
    return floor(log10(abs(value))) if value else 0


def _with_decimals(value: float, decimals: int, power: int) -> str:
    """A number to this many decimals; as a multiple of a power of ten where that is not in `POWERS_SHOWN`."""
    if power in POWERS_SHOWN:
        return _thousands(_true_minus(f"{value:.{max(decimals, 0)}f}"))
    shown = f"{value / 10.0**power:.{min(max(decimals + power, 0), 9)}f}"
    return f"{_true_minus(shown)}×10{str(power).translate(_SUPERSCRIPTS)}"


def _decimals_of(interval: Interval, unit: str) -> int:
    values = interval.estimate, interval.low, interval.high
    estimate, low, high = (float(from_si(x, unit)) if unit in UNITS else x for x in values)
    half = abs(high - low) / 2
    if not isfinite(half) or half <= 0:
        return 0 if abs(estimate) >= WHOLE_FROM else 2
    return min(max(0, -floor(log10(half))), MAX_DECIMALS)


def _thousands(text: str) -> str:
    """Commas between thousands."""
    whole, point, rest = text.partition(".")
    sign, digits = (whole[:1], whole[1:]) if whole.startswith(MINUS) else ("", whole)
    return f"{sign}{int(digits):,}{point}{rest}"


def _beside(unit: str) -> str:
    return _BESIDE.get(unit, f" {unit}")


def _true_minus(text: str) -> str:
    """A true minus sign, and none before a zero."""
    if text.startswith("-"):
        return text[1:] if float(text) == 0 else MINUS + text[1:]
    return text
