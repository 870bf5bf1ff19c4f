"""The box's equations as the library states them, written out and integrated by SciPy: to compare with.

Nothing of `edge.twin` is used, so that an error there is not made here as well.
"""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

AIR_J_K, EXHAUST_W_K, HEATER_W = 1.2 * 1005.0 * 0.15, 1.2 * 1005.0 * 68.0 / 3600.0, 100.0
NOTHING = {
    "UA": 0.0, "F_inf": 0.0, "C_w": 1.0, "G_in": 0.0, "G_out": 0.0, "C_s": 1.0, "G_s": 0.0, "kC": 1.0,
    "tau_h": 0.0, "d_h": 0.0, "eta": 1.0, "f_rad": 0.0, "u_sat": 1.0, "sag": 0.0, "epsA": 0.0,
    "eps_f": 1.0, "s_sc": 0.0, "d_f": 0.0, "tau_f": 0.0, "F_mix": 0.0, "tau_s": 0.0, "bias": 0.0,
    "b_amb": 0.0, "P0": 0.0, "P_led": 0.0, "A_sun": 0.0, "k_e": 0.0, "G_door": 0.0, "ua_drift": 0.0,
    "P_fan": 0.0, "G_g": 0.0, "T_g": 0.0, "F_st": 0.0, "G_nc": 0.0, "P_res": 0.0, "G_stir": 0.0,
    "k_el": 0.0, "k_P": 0.0,
}  # fmt: skip
STATES = ("air", "upper", "wall", "soil", "heater", "fan", "sensor")


def late(commands, time_s, dead_s, step_s):
    """The command that acts; off before the first."""
    row = int(np.floor((time_s - dead_s) / step_s))
    return 0.0 if row < 0 else commands[min(row, len(commands) - 1)]


def slopes(state, duty, fan, now, p):
    """dx/dt of STATES.

    now : ambient (as measured), light, solar, rel_humidity, day, door, command (of the heater, not late)
    """
    air, upper, wall, soil, element, speed, sensor = state
    room = now["ambient"] - p["b_amb"]
    supply = min(duty, p["u_sat"])
    wanted_w = p["eta"] * HEATER_W * supply * (1.0 - p["sag"] * supply)
    flow = speed if p["tau_f"] else fan
    freed = 1.0 + p["k_el"] * flow
    power = freed * element if p["tau_h"] else wanted_w
    to_wall = {(0, 0): 0.0, (1, 0): 1.0, (0, 1): 0.0, (1, 1): 0.6}[p["G_in"] > 0.0, p["G_s"] > 0.0]
    to_soil = 1.0 - to_wall if p["G_s"] > 0.0 else 0.0
    ageing = 1.0 + p["ua_drift"] * now["day"]

    def loss(temp):
        leak = 1.2 * 1005.0 * p["F_inf"] * (1.0 - flow)
        radiated = p["epsA"] * 5.670374419e-8 * ((temp + 273.15) ** 4 - (room + 273.15) ** 4)
        excess = abs(temp - room) / 10.0
        rising = 1.2 * 1005.0 * p["F_st"] * excess**0.5 + p["G_nc"] * excess ** (1.0 / 3.0)
        radiated += rising * (temp - room) + p["G_g"] * (temp - p["T_g"])
        radiated += p["G_stir"] * flow * (temp - room)
        return radiated + (ageing * p["UA"] + leak + p["G_door"] * now["door"]) * (temp - room)

    deficit = 0.6108 * np.exp(17.27 * air / (air + 237.3)) * (1.0 - now["rel_humidity"] / 100.0)
    other = (
        p["P_fan"] * flow
        + p["P0"]
        + p["P_led"] * now["light"]
        + p["A_sun"] * now.get("solar", 0.0)
        + p["P_res"] * np.exp(np.log(2.0) * (min(air, 40.0) - 20.0) / 10.0)
        - p["k_P"] * (air - 20.0) * HEATER_W * now["command"]
        - p["k_e"] * (0.4 + 0.6 * now["light"]) * deficit
    )
    exhaust = p["eps_f"] * (1.0 - p["s_sc"]) * flow * EXHAUST_W_K * (air - room)
    heated = (1.0 - p["f_rad"]) * power
    capacity = p["kC"] * AIR_J_K
    d_wall = (p["f_rad"] * to_wall * power - p["G_out"] * ageing * (wall - room)) / p["C_w"]
    d_soil = p["f_rad"] * to_soil * power / p["C_s"]
    if p["F_mix"]:
        swap = 1.2 * 1005.0 * p["F_mix"] * (air - upper)
        half = [
            0.5 * (other - loss(t) - p["G_in"] * (t - wall) - p["G_s"] * (t - soil)) for t in (air, upper)
        ]
        d_air, d_upper = (
            (half[0] - exhaust - swap) * 2.0 / capacity,
            (half[1] + swap + heated) * 2.0 / capacity,
        )
        mean = 0.5 * (air + upper)
    else:
        through = p["G_in"] * (air - wall) + p["G_s"] * (air - soil)
        d_air, d_upper, mean = (heated + other - loss(air) - through - exhaust) / capacity, 0.0, air
    d_wall += p["G_in"] * (mean - wall) / p["C_w"]
    d_soil += p["G_s"] * (mean - soil) / p["C_s"]
    d_element = (wanted_w - freed * element) / p["tau_h"] if p["tau_h"] else 0.0
    d_speed = (fan - speed) / p["tau_f"] if p["tau_f"] else 0.0
    d_sensor = (air - sensor) / p["tau_s"] if p["tau_s"] else d_air
    return np.array([d_air, d_upper, d_wall, d_soil, d_element, d_speed, d_sensor])


def shown(effects, start, duty, fan, columns, step_s=60.0):
    """Return the sensor's reading after each step, from true states `start` by name, commands off before."""
    p = {**NOTHING, **{name: value for own in effects.values() for name, value in own.items()}}
    state = np.array([start.get(name, 0.0) for name in STATES])
    temps = []
    for k in range(len(duty)):
        now = {name: column[k] for name, column in columns.items()} | {"command": duty[k]}
        cuts = sorted({0.0, p["d_h"] % step_s, p["d_f"] % step_s, step_s})
        for begin, end in pairwise(cuts):
            middle = k * step_s + 0.5 * (begin + end)
            acting = late(duty, middle, p["d_h"], step_s), late(fan, middle, p["d_f"], step_s)

            def slope(_, x, acting=acting, now=now):
                return slopes(x, *acting, now, p)

            found = solve_ivp(slope, (0.0, end - begin), state, method="LSODA", rtol=1e-9, atol=1e-9)
            state = found.y[:, -1]
        temps.append(state[-1] + p["bias"])
    return np.array(temps)
