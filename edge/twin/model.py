"""The twin: geometry, base balance and named effects, stepped exactly for inputs constant over each step.

With no effects it is the paper's PBM (eq. pbm): dT/dt = H/(rho V C_p) - F (T - T_amb)/V.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edge.core.errors import DataError
from edge.twin.discretisation import Transition, discretise
from edge.twin.effects.library import Effects, build, day_counter, needs
from edge.twin.geometry import Geometry
from edge.twin.network import AIR, LinearSystem, Network
from edge.twin.rollout import Commands, March, has_shares, rollout
from edge.twin.signals import Conditions, Signals, columns_of

DAY_S = 86400.0
FAN_CONTROLS = ("relay", "speed")
Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class StateNoise:
    """The noise with which the twin's state is estimated; it does not enter a prediction from a known state.

    sensor_k : sd of one measured temperature [K]; step_k : of its readings, 0 where it is not known
    heat_w : sd of the heat into the air that the twin does not know, constant over a step [W]
    """

    sensor_k: float = 0.1
    heat_w: float = 5.0
    step_k: float = 0.0


@dataclass(frozen=True, eq=False)
class BoxTwin:
    """Physics of the box at one step length; immutable, so what depends on the fan alone is computed once.

    effects : parameters by effect, as in `edge.twin.effects.library.EFFECTS`
    step_s : length of a step [s]
    fitted_s : step by which the ranges of its values go, None for step_s
    day0_utc : where the days begin that an effect counts [s since 1970], None where no effect counts them
    fan_control : of FAN_CONTROLS, what a fan of 0 to 1 is. With a relay it is the share of the step, from its
        beginning, for which the fan is on; else the speed that it has throughout, as share of the full flow
    Errors : DataError naming the key, `effects.wall_loss.UA: ...`
    """

    geometry: Geometry = field(default_factory=Geometry)
    effects: Effects = field(default_factory=dict)
    step_s: float = 60.0
    noise: StateNoise = field(default_factory=StateNoise)
    day0_utc: float | None = None
    fan_control: str = FAN_CONTROLS[0]
    fitted_s: float | None = None
    system: LinearSystem = field(init=False)
    signals: Signals = field(init=False)

    def __post_init__(self) -> None:
        if not (self.step_s > 0.0 and np.isfinite(self.step_s)):
            raise DataError(f"sample_s: {self.step_s:g} is not a finite number above 0")
        network = self.network()
        system = network.system()
        object.__setattr__(self, "system", system)  # frozen for all but its own making
        object.__setattr__(self, "signals", network.signals)

    def network(self) -> Network:
        """Return its bodies and paths, anew."""
        return build(self.geometry, self.effects, self.fitted_s or self.step_s)

    def in_steps(self, step_s: float) -> "BoxTwin":
        """Return the twin in other steps, whose ranges its values need not keep to."""
        return replace(self, step_s=step_s, fitted_s=self.fitted_s or self.step_s)

    @cached_property
    def off_on(self) -> Transition:
        """The step with the fan off and on, K = 2; a search makes many twins that never need it."""
        return discretise(self.system, np.array([0.0, 1.0]), self.step_s)

    @property
    def states(self) -> tuple[str, ...]:
        """Names, the air first."""
        return self.system.states

    @cached_property
    def sha256(self) -> str:
        """Hash of all that a prediction depends on; not of where it comes from."""
        content: dict[str, object] = {
            "geometry": asdict(self.geometry),
            "effects": {name: dict(values) for name, values in self.effects.items()},
            "sample_s": self.step_s,
            "noise": {"sensor_k": self.noise.sensor_k, "heat_w": self.noise.heat_w},
        }
        if self.day0_utc is not None:
            content["day0_utc"] = self.day0_utc
        if not self.has_relay:
            content["fan_control"] = self.fan_control
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), default=float)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def needs(self) -> dict[str, str]:
        """Columns beside the room's that a prediction needs, and the effect that needs each."""
        return needs(self.effects)

    @property
    def has_relay(self) -> bool:
        """True if the fan is either off or on, never between."""
        return self.fan_control == FAN_CONTROLS[0]

    def changes_within(self, fan: Floats) -> bool:
        """Return True if the fan stops within a step, so that the step is one of parts: see `march`."""
        return self.has_relay and has_shares(fan)

    def transitions(self, fan: Floats) -> tuple[Transition, Indices]:
        """Return steps for the fan speeds that occur, and the index of each element of `fan` among them.

        fan : that it does not change within a step, see `changes_within`
        """
        if ((fan == 0.0) | (fan == 1.0)).all():
            return self.off_on, fan.astype(np.intp)
        speeds, index = np.unique(fan, return_inverse=True)
        return discretise(self.system, speeds, self.step_s), index.reshape(fan.shape)

    def step(
        self, temp: ArrayLike, ambient: ArrayLike, duty: ArrayLike, fan: ArrayLike, source: ArrayLike = 0.0
    ) -> Floats:
        """Air temperature one step later, for a twin whose only state it is; scalars or arrays of one shape.

        temp, ambient : [°C]; duty, fan : 0..1
        source : corrective source term r of CoSTA (paper, eq. method-hybrid-model), added to dT/dt [K/s]
        Errors : DataError for a twin with hidden states, which one temperature doesn't tell: see `advance`,
            and for one that needs more columns
        """
        if len(self.states) > 1:
            raise DataError(f"twin: {', '.join(self.states[1:])} can't be known from a temperature alone")
        return self.advance(np.asarray(temp, dtype=np.float64)[..., None], ambient, duty, fan, source)[..., 0]

    def advance(
        self, state: Floats, ambient: ArrayLike, duty: ArrayLike, fan: ArrayLike, source: ArrayLike = 0.0
    ) -> Floats:
        """Return the state one step later, if the commands before were the same.

        state : [..., n], in the order of `states`; the others : scalars or of the shape [...], as in `step`
        Returns : [..., n]
        Errors : DataError for a twin that needs more columns
        """
        inputs = (np.shape(item) for item in (ambient, duty, fan, source))
        shape = np.broadcast_shapes(state.shape[:-1], *inputs)
        fans = np.broadcast_to(np.asarray(fan, dtype=np.float64), shape)
        if not self.signals.plain or self.changes_within(fans):
            flat = [np.broadcast_to(item, shape).reshape(-1, 1) for item in (duty, fan, ambient, source)]
            before = Commands(np.asarray(flat[0], dtype=np.float64), np.asarray(flat[1], dtype=np.float64))
            rows = np.broadcast_to(state, (*shape, state.shape[-1])).reshape(-1, state.shape[-1])
            march = self.march(before, flat[2], flat[3], before=before)
            return march.step(0, rows).reshape(*shape, -1)
        transition, index = self.transitions(fans)
        driven = _input_effect(transition, index, ambient, duty, source)
        driven += np.einsum("...ij,...j->...i", transition.state[index], state)
        return driven

    def steps(self, ambient: Floats, duty: Floats, fan: Floats) -> tuple[Floats, Floats]:
        """Matrices [N, n, n], and what the inputs [N] add [N, n], of N steps of a twin that is `plain`."""
        if self.changes_within(fan):
            (whole,) = self.march(Commands(duty[None], fan[None]), ambient).parts
            return whole.matrix[:, 0], whole.driven[:, 0]
        transition, index = self.transitions(fan)
        return transition.state[index], _input_effect(transition, index, ambient, duty, 0.0)

    def rollout(
        self,
        start: Floats,
        duty: Floats,
        fan: Floats,
        ambient: ArrayLike,
        source: ArrayLike = 0.0,
        offset: Floats | None = None,
        conditions: Conditions | None = None,
        before: Commands | None = None,
    ) -> Floats:
        """Air temperature after each of N steps.

        start : [n] or [B, n]; duty, fan : [B, N]; ambient, source : scalar, [N] or [B, N]
        offset : [N], added to the air temperature after each step, and carried on from there [K]
        conditions : further columns [N] or [B, N], those of `needs` at least
        before : commands up to the start, [P] or [B, P], which dead times and a fan that spins up remember;
            both off where none are known
        Returns : [B, N] [°C]
        Errors : DataError naming a column that is missing
        """
        # Where one matrix per fan speed is exact, the inputs of all steps are added up before the loop.
        states = np.broadcast_to(start, (fan.shape[0], len(self.states)))
        if not self.signals.steady or self.changes_within(fan):
            march = self.march(Commands(duty, fan), ambient, source, conditions, before)
            return march.rollout(states, offset)
        if not self.signals.plain:
            columns = columns_of(self.needs, conditions)
            measured = np.asarray(ambient, dtype=np.float64)
            seen = {**columns, "fan_on": fan}
            heat_w = self.signals.heat_w(np.zeros(()), measured, seen, by_temp=False)
            source = np.asarray(source) + heat_w / self.system.air_capacity_j_k
            duty, ambient = self.signals.duty(duty), self.signals.room(measured)
        in_time = np.ascontiguousarray(fan.T)
        transition, index = self.transitions(in_time)
        driven = _input_effect(transition, index, _in_time(ambient), _in_time(duty), _in_time(source))
        if offset is not None:
            for i in {0, self.states.index(AIR)}:  # a sensor and what it shows
                driven[:, :, i] += offset[:, None]
        if len(self.states) == 1:
            return _one_state(states[:, 0], transition.state[:, 0, 0][index], driven[:, :, 0])
        return rollout(transition.state, index, states, driven).T

    def march(
        self,
        commands: Commands,
        ambient: ArrayLike,
        source: ArrayLike = 0.0,
        conditions: Conditions | None = None,
        before: Commands | None = None,
        step_s: float | None = None,
    ) -> March:
        """Return the N steps of a rollout, to be made one by one; the arguments as in `rollout`.

        step_s : of these steps and of those before [s], None for the twin's own
        Errors : DataError naming a column that is missing, or `day0_utc`
        """
        columns = {**columns_of(self.needs, conditions), "heater_duty": commands.duty}
        if self.signals.ageing_per_day != 0.0:
            if self.day0_utc is None:
                counter = day_counter(self.effects)
                raise DataError(f"day0_utc: missing, the twin's {counter} counts days from it")
            columns["day"] = self.signals.days((columns["utc"] - self.day0_utc) / DAY_S)
        return March.of(
            self.system,
            self.signals,
            self.step_s if step_s is None else step_s,
            commands,
            ambient,
            source,
            columns,
            before,
            self.has_relay,
        )


def _input_effect(
    transition: Transition, index: Indices, ambient: ArrayLike, duty: ArrayLike, source: ArrayLike
) -> Floats:
    """Return the effect of the inputs over the step, shape of `index` + [n]."""
    gains = transition.drive
    total: Floats = gains[index, :, 0] * np.asarray(duty)[..., None]
    total += gains[index, :, 1] * np.asarray(ambient)[..., None]
    if np.any(source):
        total += gains[index, :, 2] * np.asarray(source)[..., None]
    return total


def _in_time(values: ArrayLike) -> Floats:
    """[B, N] or [N] or scalar as something that goes with [N, B]."""
    array = np.asarray(values, dtype=np.float64)
    return array[:, None] if array.ndim == 1 else array.T


def _one_state(start: Floats, decay: Floats, driven: Floats) -> Floats:
    """start : [B]; decay, driven : [N, B]. Returns : [B, N]"""
    temps = np.empty_like(decay)
    temp = start
    for k in range(len(decay)):
        np.multiply(decay[k], temp, out=temps[k])
        temps[k] += driven[k]
        temp = temps[k]
    return temps.T
