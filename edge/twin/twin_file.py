"""The twin file: YAML that says what the box is, which effects are known, and how well."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import yaml

from edge.core.errors import DataError
from edge.core.plain_text import quote
from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import Rule
from edge.formats.input_file import Source
from edge.formats.reader import read, read_yaml
from edge.twin.effects.effect import EffectParameter
from edge.twin.effects.library import EFFECTS, check_names
from edge.twin.geometry import Geometry, Scale, scale_of
from edge.twin.model import FAN_CONTROLS, BoxTwin, StateNoise
from edge.twin.value import Value, read_value

Place = tuple[str, ...]  # ("effects", "wall_loss", "UA") or ("geometry", "heater_max_w")
FAN_ROLES = ("exhaust", "stirring", "none")  # what the fan does: change the air, mix it, or there is none
NO_FLOW = 1e-9  # share of the flow that a fan which changes no air has
SENSOR = ("quantisation_k", "noise_sd_k", "highest_c")
NUISANCE = ("heater_power_run_sd", "heat_noise_sd_w")
_SAMPLE_S = 60.0
_PAPER = {item.name: float(item.default) for item in fields(Geometry)}  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class TwinFile:
    """The contents of a twin file; a missing key of `geometry` is the paper's.

    day0_utc : where the days begin that an effect counts [s since 1970], None where no effect counts them
    fan_role : of FAN_ROLES; fan_control : of FAN_CONTROLS, as `BoxTwin`
    sensor, nuisance : null or absent where not known; highest_c : that the air may have, for hot boxes
    provenance : where the values come from, any mapping
    answer_s : time constant of the box, for usual values of what is not known; in no file
    """

    geometry: Mapping[str, Value] = field(default_factory=lambda: _geometry({}))
    sample_s: float = _SAMPLE_S
    effects: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    sensor: Mapping[str, float | None] = field(default_factory=dict)
    nuisance: Mapping[str, float | None] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    day0_utc: float | None = None
    fan_role: str = FAN_ROLES[0]
    fan_control: str = FAN_CONTROLS[0]
    answer_s: float | None = None

    def twin(self) -> BoxTwin:
        """Return the twin, with its start for a value that is to be fitted.
        Errors: DataError naming the key
        """
        usual = StateNoise()
        geometry = {name: value.value for name, value in self.geometry.items()}
        if self.fan_role != FAN_ROLES[0]:
            geometry["fan_max_m3_s"] *= NO_FLOW
        return BoxTwin(
            Geometry(**geometry),
            {effect: {name: v.value for name, v in own.items()} for effect, own in self.effects.items()},
            self.sample_s,
            StateNoise(
                usual.sensor_k if (sd := self.sensor.get("noise_sd_k")) is None else sd,
                usual.heat_w if (sd := self.nuisance.get("heat_noise_sd_w")) is None else sd,
                self.sensor.get("quantisation_k") or 0.0,
            ),
            self.day0_utc,
            self.fan_control,
        )

    @property
    def scale(self) -> Scale:
        """Scale of the greenhouse relative to the paper's."""
        return scale_of(self.geometry["heater_max_w"].value, self.sample_s, self.answer_s)

    def usual(self, place: Place) -> EffectParameter:
        """Return an effect's parameter with the start and the range for this greenhouse."""
        return self.scale.usual(EFFECTS[place[1]].parameter(place[2]))

    def possible(self, place: Place) -> EffectParameter:
        """Return an effect's parameter with the range that a twin may have, whatever its answer."""
        scale = replace(self, answer_s=None).scale
        return scale.possible(EFFECTS[place[1]].parameter(place[2]))

    def values(self) -> dict[Place, Value]:
        """Every value by its place, geometry first."""
        found: dict[Place, Value] = {("geometry", name): value for name, value in self.geometry.items()}
        for effect, own in self.effects.items():
            found |= {("effects", effect, name): value for name, value in own.items()}
        return found

    def to_fit(self) -> list[Place]:
        """Places of the values that are still to be fitted."""
        return [place for place, value in self.values().items() if value.fit]

    def with_values(self, changed: Mapping[Place, Value]) -> "TwinFile":
        """Return the file with other values at some places."""
        values = self.values() | dict(changed)
        return replace(
            self,
            geometry={name: values["geometry", name] for name in self.geometry},
            effects={
                effect: {name: values["effects", effect, name] for name in own}
                for effect, own in self.effects.items()
            },
        )


Spread = Annotated[float, Rule(low=0.0)]  # standard deviation or step


@dataclass(frozen=True, slots=True)
class TwinDocument:
    """The file, section by section; `read_value` reads the values of geometry and effects."""

    geometry: Mapping[Annotated[str, Rule(choices=tuple(_PAPER))], Any] = field(default_factory=dict)
    fan_role: Annotated[str, Rule(choices=FAN_ROLES)] = FAN_ROLES[0]
    fan_control: Annotated[str, Rule(choices=FAN_CONTROLS)] = FAN_CONTROLS[0]
    sample_s: float = _SAMPLE_S
    day0_utc: str | None = None
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    sensor: Mapping[Annotated[str, Rule(choices=SENSOR)], Spread | None] = field(default_factory=dict)
    nuisance: Mapping[Annotated[str, Rule(choices=NUISANCE)], Spread | None] = field(default_factory=dict)
    provenance: Mapping[Any, Any] = field(default_factory=dict)


def read_twin_file(path: Source) -> TwinFile:
    """Read `path`. Errors: DataError naming the file and the key, also for a file that can't be read."""
    document = read_yaml(TwinDocument, path)
    try:
        file = _twin_file(document)
        file.twin()  # values that no twin can have are refused now
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    return file


def twin_of(document: Mapping[str, Any]) -> TwinFile:
    """Return the twin of a file's content, as `twin_document` makes it. Errors: DataError naming the key"""
    file = _twin_file(read(TwinDocument, document))
    file.twin()
    return file


def write_twin_file(file: TwinFile, path: Path) -> None:
    """Write a file that `read_twin_file` reads back to the same. Errors: OSError."""
    # Flow style for the innermost mappings alone: `UA: {value: 5.1, low: 4.8, high: 5.4}`.
    text = yaml.safe_dump(
        twin_document(file), sort_keys=False, default_flow_style=None, width=110, allow_unicode=True
    )
    write_atomically(path, text)


def twin_document(file: TwinFile) -> dict[str, Any]:
    """Return the file's content: mappings, texts and numbers."""
    return {
        "geometry": {name: value.document() for name, value in file.geometry.items()},
        **({} if file.fan_role == FAN_ROLES[0] else {"fan_role": file.fan_role}),
        **({} if file.fan_control == FAN_CONTROLS[0] else {"fan_control": file.fan_control}),
        "sample_s": file.sample_s,
        **({} if file.day0_utc is None else {"day0_utc": _time_text(file.day0_utc)}),
        "effects": {
            effect: {name: value.document() for name, value in own.items()}
            for effect, own in file.effects.items()
        },
        "sensor": dict(file.sensor),
        "nuisance": dict(file.nuisance),
        "provenance": dict(file.provenance),
    }


def _twin_file(document: TwinDocument) -> TwinFile:
    geometry = _geometry(document.geometry)
    return TwinFile(
        geometry=geometry,
        sample_s=document.sample_s,
        effects=_effects(document.effects, scale_of(geometry["heater_max_w"].value, document.sample_s)),
        sensor=document.sensor,
        nuisance=document.nuisance,
        provenance=document.provenance,
        day0_utc=_time(document.day0_utc),
        fan_role=document.fan_role,
        fan_control=document.fan_control,
    )


def _time(text: str | None) -> float | None:
    """Seconds since 1970 of an ISO 8601 time, UTC where it has no zone."""
    if text is None:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise DataError(f"day0_utc: {quote(text)} is no time like 2026-07-01T12:00:00Z") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _time_text(utc: float) -> str:
    return datetime.fromtimestamp(utc, UTC).isoformat()


def _geometry(given: Mapping[str, Any]) -> dict[str, Value]:
    return {
        name: read_value(f"geometry.{name}", given.get(name, usual), usual) for name, usual in _PAPER.items()
    }


def _effects(document: Mapping[str, Mapping[str, Any]], scale: Scale) -> dict[str, dict[str, Value]]:
    effects = {}
    for name, parameters in document.items():
        check_names(name, parameters)
        effects[name] = {
            item.name: read_value(
                f"effects.{name}.{item.name}", parameters[item.name], scale.usual(item).start
            )
            for item in EFFECTS[name].parameters
        }
    return effects
