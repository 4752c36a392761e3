"""Stage files: a stage in TOML, checked key by key."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from pathlib import Path
from typing import Annotated, Self

from annotated_types import Interval
from pydantic import model_validator

from stickslip_fit._toml import Give, Misfit, Quantity, Text, TomlTable, read_toml
from stickslip_fit.errors import InputError
from stickslip_fit.step.drift import StageDrift
from stickslip_fit.step.hysteresis import Hysteresis, MaxwellCapacitor, PrandtlIshlinskii
from stickslip_fit.step.motion import WaveformName
from stickslip_fit.step.ode import Foot, RecoilBase
from stickslip_fit.step.stage import GRAVITY, Contact, ContactName, Drive, Stage

MAX_TABLE = 2000  # points
Mass = Annotated[float, Quantity(("g", "kg"), (1e-9, 1e3))]
Time = Annotated[float, Quantity(("ms", "s"), (0.0, 10.0))]
RampTime = Annotated[float | None, Quantity(("ms", "s"), (1e-9, 10.0))]
OtherMass = Annotated[float | None, Quantity(("g", "kg"), (1e-9, 1e3))]
PerKelvin = Annotated[float, Quantity(("%/K",), (-0.2, 0.2))]
DampingRatio = Annotated[float, Quantity(("1",), (0.0, 5.0))]


class SliderTable(TomlTable):
    """What moves, with all that it carries, and what acts on it along the motion."""

    mass: Mass
    gravity: Annotated[float, Quantity(("1",), (-1.0, 1.0))] = 0.0
    """Share of the weight against the motion: 1 straight up, 0 level, -1 straight down."""
    force: Annotated[float, Quantity(("mN", "N"), (-1e3, 1e3))] = 0.0
    """Another force against the motion."""


class ContactTable(TomlTable):
    """Friction between slider and foot; which keys matter depends on the model."""

    model: ContactName = "coulomb"
    """`"coulomb"` is exact and instant; the others have bristles and need a stiffness."""
    friction_coefficient: Annotated[float, Quantity(("1",), (1e-6, 10.0))]
    """Kinetic."""
    preload: Annotated[float, Quantity(("N", "mN"), (1e-9, 1e6))]
    """Normal force."""
    static_ratio: Annotated[float, Quantity(("1",), (1.0, 10.0))] = 1.0
    """Static over kinetic friction; `"dahl"` and `"maxwell-slip"` have none."""
    stiffness: Annotated[float | None, Quantity(("N/µm",), (1.0, 1e12))] = None
    """Of all bristles, sigma0."""
    damping: Annotated[float, Quantity(("N s/m",), (0.0, 1e6))] = 0.0
    """Of the bristles, sigma1."""
    viscosity: Annotated[float, Quantity(("N s/m",), (0.0, 1e6))] = 0.0
    """sigma2."""
    stribeck_speed: Annotated[float, Quantity(("mm/s",), (1e-9, 1e3))] = 1e-3
    """At which static friction has mostly given way to kinetic."""
    exponent: Annotated[float, Quantity(("1",), (0.5, 5.0))] = 1.0
    """Of `"dahl"`."""
    elastic_share: Annotated[float, Quantity(("%",), (0.01, 0.999))] = 0.5
    """Of `"elastoplastic"`: up to this share of the deflection in steady sliding nothing slips."""
    elements: Annotated[int, Interval(ge=1, le=50)] = 8
    """Of `"maxwell-slip"`."""


class DriveTable(TomlTable):
    """The voltage, by the name of a waveform or as a table."""

    voltage: Annotated[float, Quantity(("V",), (1e-6, 1e5))]
    """Peak to peak."""
    gain: Annotated[float, Quantity(("nm/V",), (1e-15, 1e-3))]
    """Travel of the foot per volt; with hysteresis, of a large change of voltage."""
    waveform: WaveformName = "ramp"
    """Forward at constant speed, at constant acceleration from rest, or rest to rest."""
    ramp_time: RampTime = None
    """Forward."""
    flyback_time: Time = 0.0
    """Back; bristles need one unless the foot has a resonance."""
    rest_time: Time = 0.0
    """Before the next step."""
    times: Annotated[
        list[float] | None, Quantity(("ms", "s"), (0.0, 10.0), "give a list of times from 0 on")
    ] = None
    """Of a table, in place of waveform, ramp_time, flyback_time and rest_time."""
    shares: Annotated[list[float] | None, Give("give a list of numbers, one for each time")] = None
    """Of the voltage, at the table's times; the last is the first."""


class HysteresisTable(TomlTable):
    """The piezo's hysteresis, by play operators or by elements; without this table travel follows voltage."""

    weights: Annotated[list[float] | None, Quantity(("%", "1"), (0.0, 1.0), "give a list of numbers; {}")] = (
        None
    )
    """Of play operators (Prandtl-Ishlinskii): share of a large travel that each carries."""
    thresholds: Annotated[list[float] | None, Quantity(("V",), (0.0, 1e5), "give a list of numbers; {}")] = (
        None
    )
    """Of play operators: half the change of voltage after which each joins."""
    stiffnesses: Annotated[list[float] | None, Quantity(("1",), (0.0, 1e6), "give a list of numbers; {}")] = (
        None
    )
    """Of elasto-slide elements (Maxwell): over that of the spring beside them, 1/gain."""
    break_voltages: Annotated[
        list[float] | None, Quantity(("V",), (0.0, 1e5), "give a list of numbers; {}")
    ] = None
    """Of elasto-slide elements: at which each slides."""

    def make_hysteresis(self) -> Hysteresis | None:
        """The model, if the table has one; InputError for values that make none."""
        plays, elements = (self.weights, self.thresholds), (self.stiffnesses, self.break_voltages)
        given = [pair for pair in (plays, elements) if pair != (None, None)]
        if not given:
            return None
        if len(given) == 2 or None in given[0]:
            raise InputError("give weights and thresholds, or stiffnesses and break_voltages")
        make = PrandtlIshlinskii if given[0] is plays else MaxwellCapacitor
        return make(*(tuple(values or ()) for values in given[0]))


class FootTable(TomlTable):
    """The foot as a mass on the piezo; without this table it follows the waveform."""

    mass: OtherMass = None
    resonance: Annotated[float | None, Quantity(("kHz", "Hz"), (1.0, 1e8))] = None
    """Of foot and piezo; without it the foot follows the waveform, and its mass only recoils."""
    damping_ratio: DampingRatio = 0.02


class BaseTable(TomlTable):
    """A base that recoils; without this table it stands."""

    mass: OtherMass = None
    resonance: Annotated[float, Quantity(("Hz", "kHz"), (0.0, 1e8))] = 0.0
    """On its mount; 0 if nothing holds it."""
    damping_ratio: DampingRatio = 0.02


class DriftTable(TomlTable):
    """What heat and wear do; without this table nothing."""

    warm_up: Annotated[float, Quantity(("K",), (-500.0, 500.0))] = 0.0
    """Temperature rise of a stage that is stepped all the time."""
    warm_up_time: Annotated[float, Quantity(("min", "s", "h"), (1.0, 1e6))] = 600.0
    """Time constant."""
    friction: PerKelvin = 0.0
    """Change of the friction coefficient."""
    preload: PerKelvin = 0.0
    """Change of the preload."""
    gain: PerKelvin = 0.0
    """Change of the travel per volt."""
    wear_length: Annotated[float | None, Quantity(("m",), (1e-6, 1e9))] = None
    """Sliding distance over which wear takes the preload to 1/e."""
    run_in: Annotated[float, Quantity(("%",), (-0.9, 10.0))] = 0.0
    """Excess of the friction coefficient of new surfaces."""
    run_in_length: Annotated[float, Quantity(("m",), (1e-6, 1e9))] = 1.0
    """Sliding distance over which it falls to 1/e."""


class StageFile(TomlTable):
    """A stage."""

    name: Text = ""
    """Shown above the answer; the file's name if left out."""
    slider: SliderTable
    contact: ContactTable
    drive: DriveTable
    hysteresis: HysteresisTable
    foot: FootTable
    base: BaseTable
    drift: DriftTable

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        self.refuse(*self._misfits())
        return self

    def _misfits(self) -> Iterator[Misfit]:
        contact, foot, base = self.contact, self.foot, self.base
        friction = contact.friction_coefficient * contact.preload
        held = abs(self.load()) * self.slider.mass
        if held >= friction:
            advice = f"friction of {friction:.3g} N does not hold the load of {held:.3g} N; raise it"
            yield advice, ("contact", "friction_coefficient")
        bristles = contact.model != "coulomb"
        if bristles and contact.stiffness is None:
            yield "give the bristles' stiffness in N/µm", ("contact", "model")
        elif bristles:
            try:
                self.make_contact().bristles()
            except InputError as error:
                yield str(error), ("contact", "stiffness_N_per_um")
        for name in ("resonance", "damping_ratio"):
            if foot.mass is None and name in foot.fields_in_file():
                yield "give the foot's mass with it", ("foot", self._key(foot, name))
        if base.mass is None and base.fields_in_file():
            yield ("give the base's mass with it", ("base", self._key(base, base.fields_in_file()[0])))
        if base.mass is not None and foot.mass is None:
            yield (
                "a base recoils from the foot's mass too; give it under [foot]",
                ("base", self._key(base, "mass")),
            )
        if not bristles and (foot.resonance is not None or base.mass is not None):
            yield "choose a model with bristles for a foot with a resonance, or a base", ("contact", "model")
        try:
            self.hysteresis.make_hysteresis()
        except InputError as error:
            yield str(error), ("hysteresis", next(iter(self.hysteresis._written)))
            return
        yield from self._drive_misfits(bristles and foot.resonance is None)

    def _drive_misfits(self, needs_flyback: bool) -> Iterator[Misfit]:
        drive = self.drive
        if drive.times is not None and drive.shares is not None:
            others = {"waveform", "ramp_time", "flyback_time", "rest_time"}.intersection(
                drive.fields_in_file()
            )
            for name in sorted(others):
                yield "the table of times and shares says it; leave it out", ("drive", self._key(drive, name))
            if len(drive.times) > MAX_TABLE:
                yield f"give at most {MAX_TABLE:,} times", ("drive", self._key(drive, "times"))
        elif drive.times is not None or drive.shares is not None:
            name = "times" if drive.times is not None else "shares"
            yield "give both times and shares", ("drive", self._key(drive, name))
            return
        elif drive.ramp_time is None:
            yield "give a ramp time, or a table of times and shares", ("drive", self._key(drive, "voltage"))
            return
        elif needs_flyback and drive.flyback_time == 0:
            place = ("drive", self._key(drive, "ramp_time"))
            yield "bristles cannot follow a jump: give a flyback_time too, or the foot a resonance", place
        try:
            self.make_drive().motion()
        except InputError as error:
            yield str(error), ("drive", self._key(drive, "times" if drive.times is not None else "ramp_time"))

    @staticmethod
    def _key(table: TomlTable, name: str) -> str:
        """The key that gives a field, as it is in the file."""
        keys = table.fields_by_key()
        return next((key for key in table._written if keys[key][0] == name), name)

    def load(self) -> float:
        """Deceleration of the slider by the load, m/s^2."""
        return GRAVITY * self.slider.gravity + self.slider.force / self.slider.mass

    def make_contact(self) -> Contact:
        """The contact."""
        values = {name: getattr(self.contact, name) for name in ContactTable.model_fields}
        return Contact(**{**values, "stiffness": self.contact.stiffness or 0.0})

    def make_drift(self) -> StageDrift | None:
        """What use does, if anything."""
        own = self.drift
        if not own.fields_in_file():
            return None
        heat = (own.warm_up, own.warm_up_time, own.friction, own.preload, own.gain)
        return StageDrift(*heat, own.wear_length or inf, own.run_in, own.run_in_length)

    def make_drive(self) -> Drive:
        """The drive."""
        own = self.drive
        table = (tuple(own.times), tuple(own.shares)) if own.times and own.shares else None
        times = (own.ramp_time or 0.0, own.flyback_time, own.rest_time)
        hysteresis = self.hysteresis.make_hysteresis()
        return Drive(own.voltage, own.gain, *times, own.waveform, table, hysteresis)


def read_stage(path: str | Path) -> Stage:
    """Read a stage file.

    Parameters
    ----------
    path : path
        A TOML file with the keys of `StageFile`.

    Raises
    ------
    InputError
        With every fault: file, line, key, value, and what to write.
    """
    read = read_toml(path, StageFile, "stage file")
    foot, base = read.foot, read.base
    return Stage(
        name=read.name or Path(path).stem,
        mass=read.slider.mass,
        contact=read.make_contact(),
        drive=read.make_drive(),
        load=read.load(),
        foot=None if foot.mass is None else Foot(foot.mass, foot.resonance or inf, foot.damping_ratio),
        base=None if base.mass is None else RecoilBase(base.mass, base.resonance, base.damping_ratio),
        drift=read.make_drift(),
    )
