"""An independent simulator of the library's effects: the equations by name, integrated by Runge and Kutta.

It shares no code with `edge.twin`, so that an error there is not made here as well. All columns of a batch
(runs, and variants of the same runs) are integrated at once. Commands that come late and a fan that spins up
are exact means over each part of a step; the rest is RK4 in parts short against the fastest body.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bench.hidden_effects.inputs import Bend, ColumnInputs, Floats, OutsideConditions

HEAT_J_M3_K = 1.2 * 1005.0  # of air
AIR_J_K = HEAT_J_M3_K * 0.15
EXHAUST_W_K = HEAT_J_M3_K * 68.0 / 3600.0
HEATER_W = 100.0
SIGMA, KELVIN = 5.670374419e-8, 273.15
STATES = ("air", "upper", "wall", "soil", "heater", "sensor")
CURVE_AT_K = 8.0  # T - T_amb at which a loss that bends has its stated value
LONGEST_PART_S, SHARE_OF_FASTEST = 6.0, 0.6
LONGEST_LATE_PART_S = 2.5  # where commands arrive within a part
NEUTRAL = {
    "UA": 0.0, "F_inf": 0.0, "C_w": 1.0, "G_in": 0.0, "G_out": 0.0, "C_s": 1.0, "G_s": 0.0, "kC": 1.0,
    "tau_h": 0.0, "d_h": 0.0, "eta": 1.0, "f_rad": 0.0, "u_sat": 1.0, "sag": 0.0, "epsA": 0.0,
    "eps_f": 1.0, "s_sc": 0.0, "d_f": 0.0, "tau_f": 0.0, "F_mix": 0.0, "tau_s": 0.0, "bias": 0.0,
    "b_amb": 0.0, "P0": 0.0, "P_led": 0.0, "k_e": 0.0, "G_door": 0.0, "ua_drift": 0.0,
    "ua_curve": 0.0,  # undeclared: the walls' conductance grows by this share per 10 K
}  # fmt: skip


def simulate(
    parameters: Mapping[str, Floats], inputs: ColumnInputs, step_s: float = 60.0, bend: Bend | None = None
) -> tuple[Floats, Floats]:
    """Return the sensor's reading at each row, and all states there.

    parameters : [B] each, by the names of NEUTRAL, which stands for those that are not given
    Returns : [N + 1, B] [°C] and [N + 1, len(STATES), B]; all begins at the room's temperature, all off
    Errors : KeyError for a name that NEUTRAL lacks: an effect hidden nowhere would be sought in vain
    """
    if unknown := set(parameters) - set(NEUTRAL):
        raise KeyError(f"NEUTRAL has no {', '.join(sorted(unknown))}")
    columns = inputs.duty.shape[1]
    p = {name: np.broadcast_to(parameters.get(name, usual), columns) for name, usual in NEUTRAL.items()}
    p = {name: np.asarray(values, dtype=np.float64) for name, values in p.items()}
    parts = int(np.ceil(step_s / _part_s(p)))
    return _March(p, inputs, step_s, parts, bend or Bend()).run()


def _part_s(p: Mapping[str, Floats]) -> float:
    """Longest part that is short against the fastest body [s]."""
    flow = EXHAUST_W_K * p["eps_f"] * (1.0 - p["s_sc"]) + 2.0 * HEAT_J_M3_K * p["F_mix"]
    out = flow + p["UA"] + p["G_in"] + p["G_s"] + HEAT_J_M3_K * p["F_inf"] + 6.5 * p["epsA"] + p["G_door"]
    times = [p["kC"] * AIR_J_K / np.where(p["F_mix"] > 0.0, 2.0, 1.0) / out]
    times += [np.where(p[name] > 0.0, p[name], np.inf) for name in ("tau_s", "tau_h")]
    late = (p["d_h"] > 0.0).any() or (p["d_f"] > 0.0).any()
    longest_s = LONGEST_LATE_PART_S if late else LONGEST_PART_S
    return min(longest_s, SHARE_OF_FASTEST * float(np.min(times)))


class _StepInputs(NamedTuple):
    """The constants over a part of a step, each [B]."""

    k: int
    duty: Floats  # commands that act
    speed: Floats
    room: Floats
    wanted_w: Floats  # of the element
    flow_w_k: Floats  # heat that the exhaust takes
    ageing: Floats  # factor on the walls
    heat_w: Floats  # into the air


class _March:
    """One simulation."""

    def __init__(
        self, p: dict[str, Floats], inputs: ColumnInputs, step_s: float, parts: int, bend: Bend
    ) -> None:
        self.p, self.inputs, self.bend = p, inputs, bend
        self.step_s, self.parts, self.part_s = step_s, parts, step_s / parts
        self.has = {name: bool((values != NEUTRAL[name]).any()) for name, values in p.items()}
        self.two_zones, self.lagged, self.slow_sensor = (p[key] > 0.0 for key in ("F_mix", "tau_h", "tau_s"))
        wall, soil = p["G_in"] > 0.0, p["G_s"] > 0.0
        self.to_wall = p["f_rad"] * np.where(wall & soil, 0.6, np.where(wall, 1.0, 0.0))
        self.to_soil = p["f_rad"] * np.where(wall & soil, 0.4, np.where(soil, 1.0, 0.0))
        self.capacity = p["kC"] * AIR_J_K
        self.exhaust = EXHAUST_W_K * p["eps_f"] * (1.0 - p["s_sc"])
        self.per_heater_s = self.lagged / np.where(self.lagged, p["tau_h"], 1.0)
        self.per_sensor_s = self.slow_sensor / np.where(self.slow_sensor, p["tau_s"], 1.0)
        self.duty = self._late(inputs.duty, p["d_h"])
        self.speed = self._spun_up(self._late(inputs.fan, p["d_f"]))
        self.fan_hours = np.cumsum(self.speed.mean(axis=1), axis=0) * step_s / 3600.0
        self.rooms = inputs.ambient - p["b_amb"]

    def run(self) -> tuple[Floats, Floats]:
        steps, rooms = len(self.inputs.duty), self.rooms
        states = np.zeros((len(STATES), rooms.shape[1]))
        states[[0, 1, 2, 3, 5]] = rooms[0]
        kept, readings = [states], [self._reading(0, 0, states)]
        for k in range(steps):
            for j in range(self.parts):
                room = rooms[k] + (j + 0.5) / self.parts * (rooms[k + 1] - rooms[k])
                states = self._part(self._acting(k, j, room, states[0]), states)
            kept.append(states)
            readings.append(self._reading(k, self.parts - 1, states))
        return np.array(readings), np.array(kept)

    def _acting(self, k: int, j: int, room: Floats, air: Floats) -> _StepInputs:
        p, inputs, bend = self.p, self.inputs, self.bend
        duty, speed = self.duty[k, j], self.speed[k, j]
        supply = np.minimum(duty, p["u_sat"])
        wanted_w = p["eta"] * HEATER_W * inputs.power[k] * supply * (1.0 - p["sag"] * supply)
        flow = self.exhaust * speed
        if bend.power:
            wanted_w = wanted_w * bend.power(self._now(k, duty, speed, air, room))
        if bend.flow:
            flow = flow * bend.flow(self._now(k, duty, speed, air, room))
        ageing = np.maximum(1.0 + p["ua_drift"] * inputs.day[k], 0.0)
        heat_w = p["P0"] + p["P_led"] * inputs.light[k] + inputs.heat_w[k]
        return _StepInputs(k, duty, speed, room, wanted_w, flow, ageing, heat_w)

    def _part(self, acting: _StepInputs, states: Floats) -> Floats:
        """RK4 over one part; an element and a sensor without lag follow at once."""
        h, states = self.part_s, states.copy()
        states[4] = np.where(self.lagged, states[4], acting.wanted_w)
        one = self._slopes(acting, states)
        two = self._slopes(acting, states + 0.5 * h * one)
        three = self._slopes(acting, states + 0.5 * h * two)
        four = self._slopes(acting, states + h * three)
        after = states + (h / 6.0) * (one + 2.0 * (two + three) + four)
        after[5] = np.where(self.slow_sensor, after[5], after[0])
        return after

    def _slopes(self, acting: _StepInputs, x: Floats) -> Floats:
        """dx/dt of STATES."""
        p, room = self.p, acting.room
        air, upper, wall, soil, element, sensor = x
        heat_w = acting.heat_w + self._heat_by_air(acting, air)
        heater_w = (1.0 - p["f_rad"]) * element
        exhaust = acting.flow_w_k * (air - room)
        lost = self._heat_loss(acting, air, wall, soil)
        out = np.zeros_like(x)
        out[0] = heater_w + heat_w - lost - exhaust
        # With two zones the heater is below and the sensor above; a box without has both in one.
        mean = air
        if self.has["F_mix"]:
            two = self.two_zones
            mean = np.where(two, 0.5 * (air + upper), air)
            swap = HEAT_J_M3_K * p["F_mix"] * (air - upper)
            lost_above = self._heat_loss(acting, upper, wall, soil)
            out[0] = np.where(two, heat_w - lost - 2.0 * (exhaust + swap), out[0])
            out[1] = np.where(two, heat_w - lost_above + 2.0 * (swap + heater_w), 0.0) / self.capacity
        out[0] /= self.capacity
        beyond = wall - room
        outwards = p["G_out"] * acting.ageing * self._curve(beyond) * beyond
        out[2] = (p["G_in"] * (mean - wall) + self.to_wall * element - outwards) / p["C_w"]
        out[3] = (p["G_s"] * (mean - soil) + self.to_soil * element) / p["C_s"]
        out[4] = (acting.wanted_w - element) * self.per_heater_s
        out[5] = (air - sensor) * self.per_sensor_s
        return out

    def _heat_by_air(self, acting: _StepInputs, air: Floats) -> Floats | float:
        """Heat into the air that its temperature has a part in [W]."""
        k, p = acting.k, self.p
        heat_w: Floats | float = 0.0
        if self.has["k_e"]:
            open_share = 0.4 + 0.6 * self.inputs.light[k]
            heat_w = -p["k_e"] * open_share * _deficit_kpa(air, self.inputs.rel_humidity[k])
        if self.bend.heat_w:
            heat_w = heat_w + self.bend.heat_w(self._now(k, acting.duty, acting.speed, air, acting.room))
        return heat_w

    def _heat_loss(self, acting: _StepInputs, temp: Floats, wall: Floats, soil: Floats) -> Floats:
        """Heat to bodies and the room, were all the air at this temperature [W]."""
        p, excess = self.p, temp - acting.room
        straight = p["UA"] * acting.ageing * self._curve(excess)
        if self.has["F_inf"]:
            straight = straight + HEAT_J_M3_K * p["F_inf"] * (1.0 - acting.speed)
        if self.has["G_door"]:
            straight = straight + p["G_door"] * self.inputs.door[acting.k]
        lost = straight * excess + p["G_in"] * (temp - wall) + p["G_s"] * (temp - soil)
        if self.has["epsA"]:
            lost = lost + p["epsA"] * SIGMA * ((temp + KELVIN) ** 4 - (acting.room + KELVIN) ** 4)
        return lost

    def _curve(self, excess: Floats) -> Floats | float:
        if not self.has["ua_curve"]:
            return 1.0
        return 1.0 + self.p["ua_curve"] * (excess - CURVE_AT_K) / 10.0

    def _now(self, k: int, duty: Floats, fan: Floats, air: Floats, room: Floats) -> OutsideConditions:
        i = self.inputs
        columns = (i.light[k], i.rel_humidity[k], i.hour[k], i.day[k], i.chance[k], self.fan_hours[k])
        return OutsideConditions(air, room, duty, fan, *columns)

    def _reading(self, k: int, j: int, states: Floats) -> Floats:
        shown = states[5] + self.p["bias"]
        if self.bend.reading:
            now = self._now(k, self.duty[k, j], self.speed[k, j], states[0], self.rooms[k])
            shown = shown + self.bend.reading(now)
        return np.asarray(shown)

    def _late(self, commands: Floats, dead_s: Floats) -> Floats:
        """Mean command that acts in each part, [N, parts, B]; off before the first row."""
        area = np.concatenate([np.zeros((1, commands.shape[1])), np.cumsum(commands, axis=0)]) * self.step_s
        edges = self.step_s * np.arange(len(area))
        times = self.part_s * np.arange(len(commands) * self.parts + 1)
        passed = np.stack(
            [np.interp(times - dead, edges, column) for dead, column in zip(dead_s, area.T, strict=True)],
            axis=1,
        )
        return (np.diff(passed, axis=0) / self.part_s).reshape(len(commands), self.parts, -1)

    def _spun_up(self, wanted: Floats) -> Floats:
        """Mean speed in each part, [N, parts, B], from rest."""
        tau = self.p["tau_f"]
        if not (tau > 0.0).any():
            return wanted
        safe = np.where(tau > 0.0, tau, 1.0)
        left = np.where(tau > 0.0, np.exp(-self.part_s / safe), 0.0)
        mean = np.where(tau > 0.0, (1.0 - left) * safe / self.part_s, 0.0)
        speeds, now = np.empty_like(wanted), np.zeros_like(tau)
        for k in range(len(wanted)):
            for j in range(self.parts):
                off = now - wanted[k, j]
                speeds[k, j] = wanted[k, j] + off * mean
                now = wanted[k, j] + off * left
        return speeds


def _deficit_kpa(air: Floats, rel_humidity: Floats) -> Floats:
    """Tetens' saturation pressure less the vapour's [kPa]."""
    return 0.6108 * np.exp(17.27 * air / (air + 237.3)) * (1.0 - rel_humidity / 100.0)
