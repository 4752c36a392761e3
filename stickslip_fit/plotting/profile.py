"""Figures of the step size along a joint's travel: of a fit with its traverses, and of a finding."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stickslip_fit._format import (
    capitalize_first,
    coordinate_unit,
    format_direction,
    format_percent,
    join_words,
    joint_name,
    position_unit,
)
from stickslip_fit.diagnosis.finding import Finding, TravelProfile
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.travel_profile import format_extremes
from stickslip_fit.errors import shorten
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.profile import Profile, compute_profiles, has_profile
from stickslip_fit.machine import Machine
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    INK,
    MARKERS,
    LineStyle,
    direction_entries,
    make_figure,
    make_legend_entry,
    report_style,
    set_angle_ticks,
)
from stickslip_fit.plotting._svg import Picture, make_picture
from stickslip_fit.plotting.sides import find_key
from stickslip_fit.units import Z_95, from_si

MAX_PANELS, PANELS_ACROSS = 8, 4
ROOM = 1.6  # times the largest change: a scale, beyond which bands are cut


def profile_pictures(rows: pd.DataFrame, fit: Result) -> list[Picture]:
    """The profile of one joint; nothing where it was not driven over several stretches.

    Parameters
    ----------
    rows : DataFrame
        See `collect_traverses`, by `fit`.
    """
    profiles = compute_profiles(rows, fit)
    if not profiles:
        return []
    joint = int(rows["joint"].iloc[0])
    fitted = has_profile(fit.joints[joint])
    title = f"Step size along the travel, {joint_name(joint, fit.machine)}"
    caption = _write_caption(profiles, joint, fit.machine, fitted=fitted)
    figure = draw_profiles(profiles, joint, fit.machine, fitted=fitted)
    return [make_picture(f"profile-{joint}", title, caption, figure)]


def _write_caption(profiles: Sequence[Profile], joint: int, machine: Machine, *, fitted: bool) -> str:
    directions = join_words(
        [_describe_profile(each, joint, machine, fitted=fitted) for each in profiles], "and"
    )
    points = "Points: traverses binned by their middle, relative to the law without causes in position"
    if fitted:
        return (
            f"Along the travel the law's step size varies by {directions}. {points}; bars: one standard "
            "error. Lines: the profile in the extended law; a traverse averages over its own stretch."
        )
    return (
        f"The law has no cause in position; along the travel bins differ by {directions}, noise included. "
        f"{points}; bars: one standard error. Traverses of half of the travel or more are left out."
    )


def _describe_profile(profile: Profile, joint: int, machine: Machine, *, fitted: bool) -> str:
    """Rms over the travel and where the extremes are."""
    values, places = (profile.fitted, profile.position) if fitted else (profile.mean, profile.middle)
    rms = format_percent(float(np.sqrt(np.mean((values - values.mean()) ** 2))))
    unit, extremes = coordinate_unit(f"q{joint}", machine), []
    decimals, beside = (0, "°") if unit == "deg" else (1, f" {unit}")
    for k in (int(np.argmax(values)), int(np.argmin(values))):
        where = f"{from_si(float(places[k]), unit):.{decimals}f}{beside}"
        extremes.append(f"{format_percent(float(values[k]), signed=True)} at {where}")
    return f"{rms} rms in direction {format_direction(profile.direction)} ({', '.join(extremes)})"


def draw_profiles(profiles: Sequence[Profile], joint: int, machine: Machine, *, fitted: bool) -> Figure:
    """Both directions in one panel."""
    unit = coordinate_unit(f"q{joint}", machine)
    with report_style():
        signs = [profile.direction for profile in profiles]
        legend = direction_entries(marker="o", label="traverses, direction {}", signs=signs)
        if fitted:
            legend.append(make_legend_entry("profile in the extended law", INK, line="-"))
        figure, axes = make_figure([2.1], 1, legend, top=0.12, bottom=0.45)
        axis = axes[0, 0]
        axis.axhline(0.0, color=INK, lw=0.6)
        for marker, profile in zip(MARKERS, profiles, strict=False):
            colour = DIRECTION_COLOURS[profile.direction]
            x, y, bars = from_si(profile.middle, unit), 100 * profile.mean, 100 * profile.error
            axis.errorbar(x, y, yerr=bars, ls="", marker=marker, color=colour, elinewidth=0.8)
            if fitted:
                axis.plot(from_si(profile.position, unit), 100 * profile.fitted, color=colour)
        low, high = (
            from_si(end(each.position[k] for each in profiles), unit) for end, k in ((min, 0), (max, -1))
        )
        if unit == "deg":
            set_angle_ticks(axis, low, high, 10)
        axis.set_xlabel(f"q{joint} ({'°' if unit == 'deg' else unit})")
        axis.set_ylabel("step size, relative (%)")
    return figure


def travel_picture(finding: Finding, machine: Machine) -> Picture:
    """What a finding makes of the step size along the travel, with its errors; `Finding.travel` has some."""
    kinds = {(one.joint, one.session): one.rms for one in finding.travel}
    largest = sorted(kinds, key=lambda kind: -kinds[kind])[:MAX_PANELS]
    shown = [one for one in finding.travel if (one.joint, one.session) in largest]
    what = "the extended law" if finding.cause == UNKNOWN else finding.cause
    caption = (
        "How much larger a step is than on average along the travel that traverses covered; bands: 95 % of "
        f"what it may be. {capitalize_first(_describe_largest(shown, machine))}."
    )
    if len(largest) < len(kinds):
        caption += f" The {MAX_PANELS} of {len(kinds)} profiles that vary most."
    title = f"The step size along the travel, by {what}"
    return make_picture(find_key("travel", finding), title, caption, draw_travel(shown, machine))


def _describe_largest(profiles: Sequence[TravelProfile], machine: Machine) -> str:
    """Where the profile that varies most has its extremes."""
    most = max(profiles, key=lambda one: one.rms)
    names = [joint_name(most.joint, machine)]
    names += [f"session {most.session}"] if most.session else []
    names += [f"direction {format_direction(most.direction)}"] if most.direction else []
    smallest, largest = format_extremes(most, machine)
    of_several = " (the profile that varies most)" if len(profiles) > 1 else ""
    return f"{', '.join(names)}{of_several}: smallest at {smallest}, largest at {largest}"


def draw_travel(profiles: Sequence[TravelProfile], machine: Machine) -> Figure:
    """A panel for each joint and session."""
    kinds = list(dict.fromkeys((one.joint, one.session) for one in profiles))
    across = min(len(kinds), PANELS_ACROSS)
    down = -(-len(kinds) // across)
    styles: dict[str, tuple[str, str, LineStyle]] = {
        "": ("both directions", INK, "-"),
        "+": (f"direction {format_direction('+')}", DIRECTION_COLOURS["+"], "-"),
        "-": (f"direction {format_direction('-')}", DIRECTION_COLOURS["-"], "--"),
    }
    with report_style():
        shown = [style for sign, style in styles.items() if any(one.direction == sign for one in profiles)]
        legend = [make_legend_entry(label, colour, line=line) for label, colour, line in shown]
        figure, axes = make_figure(
            [1.9 if down == 1 else 1.3] * down,
            across,
            legend,
            top=0.3,
            bottom=0.45,
            down=0.62,
            share_x="none",
            share_y="all",
        )
        for axis, (joint, session) in zip(axes.flat, kinds, strict=False):
            unit = position_unit(joint, machine)
            axis.axhline(0.0, color=INK, lw=0.6)
            for one in profiles:
                if (one.joint, one.session) == (joint, session):
                    x, y, band = from_si(one.position, unit), 100 * one.change, 100 * Z_95 * one.error
                    _, colour, line = styles[one.direction]
                    axis.fill_between(x, y - band, y + band, color=colour, alpha=0.2, lw=0)
                    axis.plot(x, y, color=colour, ls=line)
            if unit == "deg":
                low, high = axis.get_xlim()
                set_angle_ticks(axis, low, high, 10 if across == 1 else 5)
            axis.set_xlabel(f"q{joint} ({'°' if unit == 'deg' else unit})")
            axis.set_title(shorten(session, 18) if session else joint_name(joint, machine), loc="left")
        limit = ROOM * max(100 * float(np.abs(one.change).max()) for one in profiles)
        low, high = axes[0, 0].get_ylim()
        axes[0, 0].set_ylim(max(low, -limit), min(high, limit))
        for axis in axes.flat[len(kinds) :]:
            axis.set_visible(False)
        for axis in axes[:, 0]:
            axis.set_ylabel("step size, relative (%)")
    return figure
