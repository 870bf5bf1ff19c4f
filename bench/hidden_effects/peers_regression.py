"""Regression of a declared twin's one-step errors on terms of the residual heat, and its forecast with them.

A peer regresses what the declared twin misses over one step on terms made of the measured columns, and calls
each chosen term by the effect that it would be. The twin is taken at the values that its file gives; a peer
refits nothing of it.

What no such regression can name, whatever is chosen: an effect whose signature is that of another effect's
term (`short_circuit` is `fan_effectiveness`, `radiative_split` is `heater_efficiency`, `sensor_bias` is
`ambient_offset`, `heater_deadtime` is `heater_lag`, `fan_deadtime` is `fan_spinup`), what happens between two
samples (`imperfect_mixing`, `sensor_lag`), what happens at times that no column tells (`door_opening`), and
anything outside the library: a peer never says `unknown`. It gives no alternatives. Hidden bodies
(`soil_mass`, `wall_mass`) are guessed from the air's mean of the last hour, and what is not linear in its
parameter is named without one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.cases import GIVEN_ROWS
from edge.formats.run_file import RecordedRun, resample
from edge.twin.effects.signal import vapour_deficit_kpa
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands, March
from edge.twin.warm_start import PastColumns, at_rest, hold, state_now

Floats = NDArray[np.float64]
_BENDS_ABOVE = 0.6  # duty
SLOW_S = 3600.0  # memory of a body that is guessed
DAY_S = 86400.0
_RUNAWAY_C = (-50.0, 150.0)  # a correction that runs away ends here, without overflow


@dataclass(frozen=True, slots=True)
class TermColumns:
    """Columns at one row or at many; slow_c : the air's mean of the last hour; *_before : a row earlier."""

    temp: Floats
    temp_before: Floats
    slow_c: Floats
    ambient: Floats
    duty: Floats
    duty_before: Floats
    fan: Floats
    fan_before: Floats
    light: Floats
    deficit_kpa: Floats
    day: Floats

    @property
    def excess(self) -> Floats:
        """Air above ambient [K]."""
        return self.temp - self.ambient


@dataclass(frozen=True, slots=True)
class TermParameter:
    """A parameter's value from the term's coefficient `of`, in proportion but for a constant."""

    name: str
    unit: str
    of: Callable[[float, BoxTwin], float]


@dataclass(frozen=True, slots=True)
class PeerTerm:
    """heat : the term [unit]; its coefficient [W per unit] tells the effect's parameter, if there is one."""

    effect: str
    heat: Callable[[TermColumns], Floats]
    parameter: TermParameter | None = None


def _exhaust_w_k(twin: BoxTwin) -> float:
    return twin.geometry.volumetric_heat_j_m3_k * twin.geometry.fan_max_m3_s


TERMS: tuple[PeerTerm, ...] = (
    PeerTerm("wall_loss", lambda r: r.excess, TermParameter("UA", "W/K", lambda c, t: -c)),
    PeerTerm("infiltration", lambda r: (1.0 - r.fan) * r.excess,
         TermParameter("F_inf", "m³/s", lambda c, t: -c / t.geometry.volumetric_heat_j_m3_k)),
    PeerTerm("fan_effectiveness", lambda r: r.fan * r.excess,
         TermParameter("eps_f", "", lambda c, t: 1.0 - c / _exhaust_w_k(t))),
    PeerTerm("longwave_radiation", lambda r: r.excess**2),
    PeerTerm("heater_efficiency", lambda r: r.duty,
         TermParameter("eta", "", lambda c, t: 1.0 + c / t.geometry.heater_max_w)),
    PeerTerm("heater_sag", lambda r: r.duty**2,
         TermParameter("sag", "", lambda c, t: -c / t.geometry.heater_max_w)),
    PeerTerm("heater_saturation", lambda r: np.maximum(r.duty - _BENDS_ABOVE, 0.0)),
    PeerTerm("heater_lag", lambda r: r.duty - r.duty_before),
    PeerTerm("fan_spinup", lambda r: (r.fan - r.fan_before) * r.excess),
    PeerTerm("extra_capacity", lambda r: r.temp - r.temp_before),
    PeerTerm("soil_mass", lambda r: r.temp - r.slow_c),
    PeerTerm("wall_mass", lambda r: r.slow_c - r.ambient),
    PeerTerm("constant_heat", lambda r: np.ones_like(r.temp), TermParameter("P0", "W", lambda c, t: c)),
    PeerTerm("ambient_offset", lambda r: r.fan),
    PeerTerm("led_gain", lambda r: r.light, TermParameter("P_led", "W", lambda c, t: c)),
    PeerTerm("evapotranspiration", lambda r: (0.4 + 0.6 * r.light) * r.deficit_kpa,
         TermParameter("k_e", "W/kPa", lambda c, t: -c)),
    PeerTerm("ua_drift", lambda r: r.day * r.excess),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class OneStepRegression:
    """One-step misses of M rows. miss : [M] [K]; terms : [M, len(TERMS)]; gain : [M], what 1 W does [K/W]"""

    miss: Floats
    terms: Floats
    gain: Floats


@dataclass(frozen=True, slots=True)
class Columns:
    """A run as arrays of N rows, the room held over its holes; NaN where the air was not measured."""

    temp: Floats
    ambient: Floats
    duty: Floats
    fan: Floats
    light: Floats
    rel_humidity: Floats
    utc: Floats

    @property
    def conditions(self) -> dict[str, Floats]:
        """Columns that effects of a twin read besides heater, fan and ambient."""
        return {"light": self.light, "rel_humidity": self.rel_humidity, "utc": self.utc}

    def rows(self, temp: Floats, before: Floats, slow_c: Floats, day0: float, k: slice | int) -> TermColumns:
        """Rows k as terms see them, with these temperatures."""
        earlier = np.concatenate([[0], np.arange(len(self.duty) - 1)])[k]
        return TermColumns(
            temp, before, slow_c, self.ambient[k], self.duty[k], self.duty[earlier], self.fan[k],
            self.fan[earlier], self.light[k], vapour_deficit_kpa(temp, self.rel_humidity[k]),
            (self.utc[k] - day0) / DAY_S,
        )  # fmt: skip


def columns(run: RecordedRun, step_s: float) -> Columns:
    """Columns that were not recorded are 0; humidity is 50 %."""
    found = resample(run, step_s).columns
    rows = len(found["time_s"])

    def column(name: str, usual: float) -> Floats:
        values = hold(found.get(name, np.full(rows, usual)))
        return np.where(np.isfinite(values), values, usual)

    utc = (run.start_utc or 0.0) + found["time_s"]
    first = found["temp_air_c"][np.isfinite(found["temp_air_c"])]
    room = column("temp_ambient_c", float(first[0]) if len(first) else 20.0)
    return Columns(
        found["temp_air_c"], room, column("heater_duty", 0.0), column("fan_on", 0.0), column("light", 0.0),
        column("rel_humidity_pct", 50.0), utc,
    )  # fmt: skip


def regression(twin: BoxTwin, runs: Sequence[Columns], day0: float) -> OneStepRegression:
    """One-step misses of the twin, its air set to the measurement at every row, its other states carried."""
    parts = [_one_run(twin, run, day0) for run in runs]
    return OneStepRegression(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _one_run(twin: BoxTwin, run: Columns, day0: float) -> tuple[Floats, Floats, Floats]:
    shown, temp = _one_step(twin, run), hold(run.temp)
    usable = np.isfinite(run.temp[1:]) & np.isfinite(run.temp[:-1])
    before = np.concatenate([temp[:1], temp[:-1]])
    rows = run.rows(temp, before, _slow(temp, twin.step_s), day0, slice(None))
    terms = np.stack([term.heat(rows) for term in TERMS], axis=1)[:-1]
    return (run.temp[1:] - shown)[usable], terms[usable], _gain(twin, run.fan[:-1])[usable]


def _slow(temp: Floats, step_s: float) -> Floats:
    left, slow = np.exp(-step_s / SLOW_S), np.empty_like(temp)
    now = temp[0]
    for k, value in enumerate(temp):
        slow[k] = now = left * now + (1.0 - left) * value
    return slow


def _gain(twin: BoxTwin, fan: Floats) -> Floats:
    """Return the effect of 1 W into the air over a step on the next reading [K/W]."""
    off, on = twin.off_on.drive[:, 0, 2] / twin.system.air_capacity_j_k
    return np.asarray(off + fan * (on - off))


def _one_step(twin: BoxTwin, run: Columns) -> Floats:
    """Predict the reading after each row [N - 1]."""
    march = _march(twin, run)
    known = np.flatnonzero(np.isfinite(run.temp))
    states = at_rest(twin, float(run.temp[known[0]]), float(run.ambient[known[0]]))[None]
    shown = np.empty(len(run.temp) - 1)
    for k in range(len(shown)):
        if np.isfinite(run.temp[k]):
            states = states.copy()
            states[:, march.carried] += run.temp[k] - states[0, 0]
        states = march.step(k, states)
        shown[k] = states[0, 0]
    return shown


def forecast(twin: BoxTwin, run: Columns, coefficients: Mapping[str, float], day0: float) -> Floats:
    """Forecast the run from its first known rows, corrected at every step by the chosen terms; [N] [°C].

    coefficients : by effect of TERMS [W per unit of the term]
    """
    known = np.flatnonzero(np.isfinite(run.temp))
    first = int(known[known < GIVEN_ROWS][-1]) if (known < GIVEN_ROWS).any() else int(known[0])
    chosen = [(coefficients[term.effect], term.heat) for term in TERMS if term.effect in coefficients]
    march, gain = _march(twin, run), _gain(twin, run.fan)
    state = _start(twin, run, first)
    shown, states = run.temp.copy(), state[None]
    shown[: first + 1] = hold(run.temp)[: first + 1]
    slow = before = np.asarray(shown[first])
    left = np.exp(-twin.step_s / SLOW_S)
    for k in range(first, len(shown) - 1):
        now = np.asarray(np.clip(shown[k], *_RUNAWAY_C))
        slow = left * slow + (1.0 - left) * now
        row = run.rows(now, before, slow, day0, k)
        heat_w = sum(coefficient * float(heat(row)) for coefficient, heat in chosen)
        states = march.step(k, states).copy()
        states[:, march.carried] += gain[k] * heat_w
        before, shown[k + 1] = now, states[0, 0]
    return np.clip(shown, *_RUNAWAY_C)


def _march(twin: BoxTwin, run: Columns) -> March:
    commands = Commands(run.duty[None], run.fan[None])
    return twin.march(commands, run.ambient[None], conditions={k: v[None] for k, v in run.conditions.items()})


def _start(twin: BoxTwin, run: Columns, first: int) -> Floats:
    rows = slice(0, first + 1)
    conditions = {name: values[rows] for name, values in run.conditions.items()}
    return state_now(
        twin, PastColumns(run.temp[rows], run.ambient[rows], run.duty[rows], run.fan[rows], conditions)
    )


def bic(left: Floats, terms: int) -> float:
    """n log(SSE / n) + p log n of what a regression leaves (Schwarz 1978)."""
    rows = len(left)
    return rows * float(np.log(max(float(left @ left), 1e-300) / rows)) + terms * float(np.log(rows))
