"""Each value that survives a restart as JSON values, and back; `edge/state/store.py` lists them.

A decoder raises an error for anything that its encoder does not write. Orders have their codec in
`edge/tick/orders_json.py`, because the status carries them in the same form.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from edge.core.clock import Moment
from edge.core.controller_names import CONTROLLERS
from edge.core.errors import DataError
from edge.core.messages import Command
from edge.core.plain_text import quote
from edge.drift import noise, where
from edge.drift.evidence import Evidence
from edge.drift.monitor import DriftMemory
from edge.forecasts.skill import ErrorPair, SkillState, Width
from edge.formats.cross_check import Rule
from edge.formats.reader import read
from edge.safety.memory import DAY_S, HEAT_BUCKET_S, AirDoubt, Dose, SafetyMemory, book_heat
from edge.safety.relay_proof import RelayProof
from edge.safety.thermal_supervision import ThermalMemory
from edge.tick import orders_json
from edge.tick.orders import Operation

Floats = NDArray[np.float64]
Count = Annotated[int, Rule(low=0)]
Size = Annotated[float, Rule(low=0.0)]
Above0 = Annotated[float, Rule(above=0.0)]
MaybeNumbers = tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class SafetyDocument:
    """Latched trips, and each dose of water: when, and how long."""

    trips: tuple[str, ...]
    doses: tuple[tuple[float, Size], ...]


@dataclass(frozen=True, slots=True)
class StandingState:
    """Standing orders, and what safety has latched."""

    operation: Operation
    memory: SafetyMemory
    broken: str = ""  # why the state file could not be understood
    at: Moment = field(default_factory=lambda: Moment("", 0.0, 0.0))  # of the save


def encode_standing(state: StandingState) -> dict[str, Any]:
    """Return orders under "operation", safety's memory under "safety"."""
    return {"operation": orders_json.to_dict(state.operation), "safety": encode_safety(state.memory)}


@dataclass(frozen=True, slots=True)
class StandingDocument:
    """The file, part by part."""

    operation: Mapping[str, Any]
    safety: Mapping[str, Any]


def decode_standing(values: Mapping[str, Any]) -> StandingState:
    """Invert `encode_standing`. Errors: DataError"""
    found = read(StandingDocument, values)
    operation = orders_json.from_dict(found.operation)
    if operation.controller not in CONTROLLERS:
        raise DataError(f"operation.controller: unknown controller {quote(operation.controller)}")
    return StandingState(operation, decode_safety(found.safety))


def encode_safety(memory: SafetyMemory) -> dict[str, Any]:
    """Return latched trips and the water of the last day; the rest of the memory may be lost."""
    return {"trips": list(memory.trips), "doses": [[dose.utc, dose.length_s] for dose in memory.doses]}


def decode_safety(values: Mapping[str, Any]) -> SafetyMemory:
    """Invert `encode_safety`. Errors: DataError on what it never wrote"""
    found = read(SafetyDocument, values, key="safety")
    doses = tuple(Dose(None, utc, length_s) for utc, length_s in found.doses)
    return SafetyMemory(trips=found.trips, doses=doses)


@dataclass(frozen=True, slots=True)
class Limits:
    """Use of limits so far, and how long the configured reference runs; times in seconds before `at`.

    doses : age, utc, length; proof : of the relay, times since the last one, with heat, with the fan
    releases_s : how far `releases_until_s` lies ahead; air_doubt : age, words, what the air had [°C]
    """

    at: Moment
    doses: tuple[tuple[Size, float, Size], ...]
    heat: tuple[tuple[Size, Size], ...]
    fan_switches: tuple[Size, ...]
    proof: tuple[Size, Size, Size]
    releases_s: Annotated[float, Rule(low=0.0, high=DAY_S)]
    reference_start: tuple[str, Size] | None
    air_doubt: tuple[Size, str, float] | None = None


def encode_limits(state: StandingState) -> dict[str, Any]:
    """Return `Limits`; `at` is of the save."""
    memory, at, start = state.memory, state.at, state.operation.reference_start
    proof, doubt = memory.thermal.proof, memory.air_doubt
    return {
        "at": asdict(at),
        "doses": [[max(0.0, d.age_s(at.time_s, at.utc)), d.utc, d.length_s] for d in memory.doses],
        "heat": [[at.time_s - begin_s, wh] for begin_s, wh in memory.heat],
        "fan_switches": [max(0.0, at.time_s - switched_s) for switched_s in memory.fan_switches],
        "proof": [proof.since_s, proof.heated_s, proof.fanned_s],
        "releases_s": max(0.0, memory.releases_until_s - at.time_s),
        "reference_start": start and [start[0], at.time_s - start[1]],
        "air_doubt": doubt and [max(0.0, at.time_s - doubt.since_s), doubt.words, doubt.before_c],
    }


def carry_on(state: StandingState, limits: Limits | str, now: Moment, heater_w: float) -> StandingState:
    """Return the state of the process before by the clocks of now; what it did not save counts as used.

    limits : a text where they are not known
    """
    memory, now_s = state.memory, now.time_s
    if isinstance(limits, str):  # an empty dose makes water wait for those that are not known
        doses = (*memory.doses, Dose(now_s, now.utc, 0.0))
        return replace(state, memory=replace(memory, doses=doses), at=now)
    saved_s, start = now_s - limits.at.elapsed_s(now), limits.reference_start
    unsaved_s = min(now_s - saved_s, HEAT_BUCKET_S)
    heat = tuple((saved_s - age_s, wh) for age_s, wh in limits.heat)
    # By earlier software, which has written the state file alone since then.
    older = [dose for dose in memory.doses if dose.utc not in {utc for _, utc, _ in limits.doses}]
    full = SafetyMemory(heat=heat, sent=Command(heater_duty=1.0), time_s=saved_s)
    memory = replace(
        memory,
        heat=book_heat(full, saved_s + unsaved_s, unsaved_s, heater_w).heat,
        doses=(*(Dose(saved_s - age_s, *dose) for age_s, *dose in limits.doses), *older),
        fan_since_s=now_s,  # it went off with the process before, and may have been on unsaved
        fan_switches=(*(saved_s - age_s for age_s in limits.fan_switches), now_s, now_s),
        thermal=ThermalMemory(proof=RelayProof(*(seconds + unsaved_s for seconds in limits.proof))),
        releases_until_s=saved_s + limits.releases_s,
        air_doubt=limits.air_doubt and AirDoubt(saved_s - limits.air_doubt[0], *limits.air_doubt[1:]),
    )
    operation = replace(state.operation, reference_start=start and (start[0], saved_s - start[1]))
    clocks = replace(now, utc=limits.at.utc + now_s - saved_s)
    return replace(state, operation=operation, memory=memory, at=clocks)


def encode_skill(state: SkillState) -> dict[str, Any]:
    """Return a list of lists for each part, keys first."""
    return {
        "pairs": [
            [*key, *pair.versions, pair.scored, pair.mae_k, pair.reference_mae_k]
            for key, pair in state.pairs.items()
        ],
        "widths": [
            [*key, width.version, width.half_width_k, width.scored, width.covered]
            for key, width in state.widths.items()
        ],
    }


@dataclass(frozen=True, slots=True)
class SkillDocument:
    """The file: predictor, horizon, reference, their versions, count, errors; the same of each width."""

    pairs: tuple[tuple[str, int, str, str, str, Count, Size, Size], ...]
    widths: tuple[tuple[str, int, str, Above0, Count, Size], ...]


def decode_skill(values: Mapping[str, Any]) -> SkillState:
    """Invert `encode_skill`. Errors: DataError"""
    found = read(SkillDocument, values)
    pairs = {
        (name, horizon, reference): ErrorPair((version, other), scored, mae_k, reference_mae_k)
        for name, horizon, reference, version, other, scored, mae_k, reference_mae_k in found.pairs
    }
    widths = {
        (name, horizon): Width(version, half, scored, covered)
        for name, horizon, version, half, scored, covered in found.widths
    }
    return SkillState(pairs, widths)


def encode_drift(memory: DriftMemory | None) -> dict[str, Any]:
    """Return JSON values; numbers that JSON has not become null."""
    assert memory is not None  # there is something to save
    values = asdict(memory)
    values["evidence"] = {item.name: _list(getattr(memory.evidence, item.name)) for item in fields(Evidence)}
    values |= {name: _list(getattr(memory, name)) for name in ("sums", "table")}
    return values | {"since_utc": memory.since_utc if memory.disagrees else None}


@dataclass(frozen=True, slots=True)
class EvidenceDocument:
    """Arrays as lists; null is minus infinity, in the first alone."""

    log_sum: MaybeNumbers
    cusum: MaybeNumbers
    since_utc: MaybeNumbers


@dataclass(frozen=True, slots=True)
class DriftDocument:
    """The file."""

    twin_sha256: str
    evidence: EvidenceDocument
    sums: MaybeNumbers
    table: MaybeNumbers
    since_utc: float | None
    agreeing_s: float


def decode_drift(values: Mapping[str, Any]) -> DriftMemory:
    """Invert `encode_drift`. Errors: DataError"""
    found = read(DriftDocument, values)
    fresh = Evidence.none(0.0)
    return DriftMemory(
        found.twin_sha256,
        Evidence(
            _array(found.evidence.log_sum, fresh.log_sum, -math.inf),
            _array(found.evidence.cusum, fresh.cusum),
            _array(found.evidence.since_utc, fresh.since_utc),
        ),
        _array(found.sums, noise.nothing_learnt()),
        _array(found.table, where.empty()),
        math.nan if found.since_utc is None else found.since_utc,
        found.agreeing_s,
    )


def _list(array: Floats) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in array.flat]


def _array(values: MaybeNumbers, like: Floats, instead_of_null: float = math.nan) -> Floats:
    found = np.array([instead_of_null if value is None else value for value in values], dtype=np.float64)
    if found.size != like.size or not (np.isfinite(found) | (found == instead_of_null)).all():
        raise DataError(f"{found.size} numbers, not {like.size}, or null among them")
    return found.reshape(like.shape)
