"""Does the box answer heater and fan as physics says it must? Names the part at fault when it does not.

Only bounds with wide margins are used (box_bounds.py), in an energy balance that knows the fan's state. Four
questions, each with its own small memory:

- heater on, fan off, and no rise: dead heater, or a fan that runs untold, or a sensor that does not feel it.
  Alarm once EXPECTED_RISE_K would have come at the least: 14 min at full duty from room temperature, 35 min
  if it dies while it heats.
  Nothing is concluded with the fan on, which may carry all heat away (and then nothing can overheat), nor
  while the air is so warm that the weakest heater would not lift it further.
- more heat than was ordered: relay stuck on. With the heater off, a balance over SHORT_S after SETTLE_S
  without switching: 15 to 25 min after the board was told off. Where heater and fan keep switching, a balance
  over LONG_S: within 2 h while little heat is ordered (while much is, the stuck relay gives what is wanted).
- fan on while warm, and it stays warm: fan stuck or blocked, or a relay stuck on. COOLING_S after it went on.
- air colder than the room for COLD_S: one of the two sensors is wrong.

The first, third and fourth need a good room temperature and are silent without one.
A door left open for longer than the time of the first question looks like a dead heater.
"""

from dataclasses import dataclass, field, replace

from edge.safety.box_bounds import PAPER_BOX, BoxBounds
from edge.safety.relay_proof import RelayProof, follow

HEATER_NO_EFFECT = "heater_no_effect"
HEATER_STUCK_ON = "heater_stuck_on"
FAN_NO_EFFECT = "fan_no_effect"
SENSOR_OFFSET = "sensor_offset"

LED_W = 20.0

EXPECTED_RISE_K = 4.0  # of a working heater at the least; an open door of 4 min hides less than that
SEEN_RISE_K = 1.0  # a sensor in a working box shows at least this much of it
SETTLE_S = 300.0  # after switching, heat stored in element and cover moves the air
SHORT_S = 600.0  # an open door that is closed makes warm walls heat the air for 5 min
QUIET_S = SETTLE_S + SHORT_S
LONG_S = 3600.0
COOLING_S = 300.0
COOLED_SHARE = 0.3  # of the excess at the start; without a fan it is about 0.2 in COOLING_S
COLD_K = 4.0  # wet soil cools the air by less
COLD_S = 1800.0
GAP_MAX_S = 150.0  # longer without a look, and longer than so many steps: begin anew
GAP_MAX_STEPS = 2.5


@dataclass(frozen=True, slots=True)
class Observation:
    """The outputs since the last look, and the present readings."""

    dt_s: float
    temp_air: float  # [°C]
    temp_ambient: float | None  # [°C]; None unless good
    heater_duty: float  # as the board drives it, 0..1
    fan_on: bool
    led: float  # 0..1
    fan_share: float = 1.0  # of the time in which the fan was on, where it was
    fan_trusted: bool = True  # False once the fan is known not to work


@dataclass(frozen=True, slots=True)
class Heating:
    """Heater on, fan off."""

    expected_k: float = 0.0  # least rise so far of a working heater
    lowest_c: float = float("inf")


@dataclass(frozen=True, slots=True)
class Balance:
    """Integrals since the begin."""

    begin_c: float
    lowest_c: float
    seconds: float = 0.0
    excess_k_s: float = 0.0  # of air over room
    fan_excess_k_s: float = 0.0  # the same while the fan was on
    ordered_j: float = 0.0  # most that heater and LED can have given


@dataclass(frozen=True, slots=True)
class ThermalMemory:
    """All that is kept from look to look."""

    heat: float = 0.0  # heater duty behind the slowest element's lag
    heating: Heating = Heating()
    off_s: float = 0.0  # heater off for so long
    fan_on: bool = False
    fan_same_s: float = 0.0  # fan unchanged for so long
    excess_k: float = 0.0  # air over room at the last look
    fan_begin_excess_k: float = 0.0  # the same when the fan was last switched
    short: Balance | None = None
    later: Balance | None = None  # the next one, begun half-way: the slow element spoils the first half
    long: Balance | None = None
    cold_s: float = 0.0
    proof: RelayProof = field(default_factory=RelayProof)


@dataclass(frozen=True, slots=True)
class PartFault:
    """A part that does not do what it is told."""

    trip: str
    text: str


def look(
    memory: ThermalMemory, moment: Observation, box: BoxBounds = PAPER_BOX
) -> tuple[ThermalMemory, tuple[PartFault, ...]]:
    """Return the memory after one more step, and the faults found in it."""
    memory = _follow_inputs(memory, moment, box)
    findings = []
    for question in (_heater_works, _heat_is_ordered, _fan_works, _sensors_agree):
        memory, finding = question(memory, moment, box)
        if finding is not None:
            findings.append(finding)
    quiet = not moment.fan_on and min(memory.off_s, memory.fan_same_s) > QUIET_S
    fan = moment.fan_share if moment.fan_on else 0.0
    proof = follow(memory.proof, moment.dt_s, moment.temp_air, moment.heater_duty > 0.0, fan, quiet)
    return replace(memory, proof=proof), tuple(findings)


def shift_readings(memory: ThermalMemory, air_k: float, room_k: float) -> ThermalMemory:
    """Return the memory where calibrations lift air and room from now on [K]: that is not heat.

    Begin balances anew, whose sums are of the readings before. What was known of relay and switches stays.
    """
    return replace(
        memory,
        heating=Heating(),
        short=None,
        later=None,
        long=None,
        excess_k=memory.excess_k + air_k - room_k,
        fan_begin_excess_k=memory.fan_begin_excess_k + air_k - room_k,
        proof=replace(memory.proof, highest_c=memory.proof.highest_c + air_k),
    )


def _follow_inputs(memory: ThermalMemory, moment: Observation, box: BoxBounds) -> ThermalMemory:
    share = moment.dt_s / (box.element_lag_s + moment.dt_s)
    switched = moment.fan_on != memory.fan_on or moment.fan_share < 1.0
    excess = 0.0 if moment.temp_ambient is None else moment.temp_air - moment.temp_ambient
    return replace(
        memory,
        heat=memory.heat + share * (moment.heater_duty - memory.heat),
        off_s=memory.off_s + moment.dt_s if moment.heater_duty == 0.0 else 0.0,
        fan_on=moment.fan_on,
        fan_same_s=moment.dt_s if switched else memory.fan_same_s + moment.dt_s,
        excess_k=excess,
        # The fan was switched at the last look: quick air has lost most of its heat to it by now.
        fan_begin_excess_k=max(excess, memory.excess_k if switched else memory.fan_begin_excess_k),
    )


def _heater_works(
    memory: ThermalMemory, moment: Observation, box: BoxBounds
) -> tuple[ThermalMemory, PartFault | None]:
    """Heater on and no rise."""
    if moment.temp_ambient is None or moment.fan_on or moment.heater_duty == 0.0:
        return replace(memory, heating=Heating()), None
    excess = max(0.0, moment.temp_air - moment.temp_ambient)
    heat_w = box.power_min_w * min(memory.heat, moment.heater_duty) - box.loss_max_w_k * excess
    if heat_w <= 0.0:
        return replace(memory, heating=Heating()), None
    heating = Heating(
        memory.heating.expected_k + heat_w * moment.dt_s / box.capacity_max_j_k,
        min(memory.heating.lowest_c, moment.temp_air),
    )
    if heating.expected_k < EXPECTED_RISE_K:
        return replace(memory, heating=heating), None
    risen = moment.temp_air - heating.lowest_c
    if risen >= SEEN_RISE_K:
        return replace(memory, heating=Heating()), None
    text = (
        f"heater on, air risen {risen:.1f} K where {EXPECTED_RISE_K:g} K was the least: "
        "dead heater, fan stuck on, or the air sensor does not feel it"
    )
    return replace(memory, heating=Heating()), PartFault(HEATER_NO_EFFECT, text)


def _heat_is_ordered(
    memory: ThermalMemory, moment: Observation, box: BoxBounds
) -> tuple[ThermalMemory, PartFault | None]:
    """More heat than was ordered."""
    settled = memory.off_s >= SETTLE_S and memory.fan_same_s >= SETTLE_S
    short = _continue(memory.short, moment, box) if settled else None
    later = None
    if short is not None and short.seconds >= SHORT_S / 2.0:
        later = _continue(memory.later, moment, box)
    long: Balance | None = _continue(memory.long, moment, box)
    heat_w = 0.0
    if short is not None and short.seconds >= SHORT_S:
        heat_w = max(heat_w, unordered_w(short, moment.temp_air, box) - box.other_heat_w)
        short, later = later, None
    if long is not None and long.seconds >= LONG_S:
        heat_w = max(heat_w, unordered_w(long, moment.temp_air, box) - box.other_heat_long_w)
        long = None
    memory = replace(memory, short=short, later=later, long=long)
    if heat_w <= 0.0:
        return memory, None
    text = f"{heat_w:.0f} W or more come in that nobody ordered: heater relay stuck on (or a fan without air)"
    return memory, PartFault(HEATER_STUCK_ON, text)


def _continue(balance: Balance | None, moment: Observation, box: BoxBounds) -> Balance:
    if balance is None:
        return Balance(moment.temp_air, moment.temp_air)
    lowest = min(balance.lowest_c, moment.temp_air)
    room = lowest if moment.temp_ambient is None else moment.temp_ambient
    excess = (moment.temp_air - room) * moment.dt_s
    # In a part of a step it may have taken next to no heat.
    fanned = moment.fan_on and moment.fan_share == 1.0 and moment.fan_trusted
    ordered_w = box.power_max_w * moment.heater_duty + LED_W * moment.led
    return Balance(
        balance.begin_c,
        lowest,
        balance.seconds + moment.dt_s,
        balance.excess_k_s + excess,
        balance.fan_excess_k_s + (excess if fanned else 0.0),
        balance.ordered_j + ordered_w * moment.dt_s,
    )


def unordered_w(balance: Balance, temp_air: float, box: BoxBounds = PAPER_BOX) -> float:
    """Heat that came in beside what was ordered, at the least: stored, lost through cover and fan [W]."""
    change = temp_air - balance.begin_c
    stored_j = (box.capacity_min_j_k if change > 0.0 else box.capacity_max_j_k) * change
    lost_j = box.loss_min_w_k * balance.excess_k_s + box.fan_min_w_k * balance.fan_excess_k_s
    return (stored_j + lost_j - balance.ordered_j) / balance.seconds


def _fan_works(
    memory: ThermalMemory, moment: Observation, box: BoxBounds
) -> tuple[ThermalMemory, PartFault | None]:
    """Fan on and no cooling while warm."""
    if not box.fan_cools or moment.temp_ambient is None or not moment.fan_on or memory.fan_same_s < COOLING_S:
        return memory, None
    excess = moment.temp_air - moment.temp_ambient
    heated = box.power_max_w * max(memory.heat, moment.heater_duty) / (box.fan_weak_w_k + box.loss_min_w_k)
    if excess <= max((1.0 - COOLED_SHARE) * memory.fan_begin_excess_k, heated + box.other_heat_k):
        return memory, None
    text = (
        f"fan on for {memory.fan_same_s:.0f} s, air still {excess:.1f} K above the room: "
        "fan stuck or blocked, or heater relay stuck on"
    )
    return memory, PartFault(FAN_NO_EFFECT, text)


def _sensors_agree(
    memory: ThermalMemory, moment: Observation, box: BoxBounds
) -> tuple[ThermalMemory, PartFault | None]:
    """Air colder than the room: nothing in the box cools."""
    cold = moment.temp_ambient is not None and moment.temp_air < moment.temp_ambient - COLD_K
    memory = replace(memory, cold_s=memory.cold_s + moment.dt_s if cold else 0.0)
    if memory.cold_s < COLD_S:
        return memory, None
    text = f"air {moment.temp_air:.1f} °C, colder than the room for {COLD_S / 60:.0f} min: a sensor is off"
    return memory, PartFault(SENSOR_OFFSET, text)
