"""Grey boxes by separable least squares over free runs: where a diagnosis begins.

A grey box is linear in its states: the air, perhaps a second body, a heater and a sensor that lag. Only its
rates [1/s] and its dead time are searched; the gains of heat and sun, the hidden starts of each run and the
room where nobody measured it follow from them by linear least squares with weak priors (variable projection,
Golub & Pereyra 1973, SIAM J. Numer. Anal. 10). All values are ratios that a log can tell: no volume and no
power is needed before they are turned into W/K and J/K.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.grey_run import GreyRun

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Terms = frozenset[str]

# The rates of each term. A second body exchanges heat with the air: a `wall` loses some to the room as well,
# `soil` does not, and a `mantle` stands between heater and air.
RATES = {
    "heater_lag": ("heater",),
    "dead_time": ("dead_s",),
    "wall": ("air_body", "body_air", "body_room"),
    "soil": ("air_body", "body_air"),
    "mantle": ("air_body", "body_air"),
    "sensor_lag": ("sensor",),
    "fan": ("fan",),
}
BODIES = frozenset({"wall", "soil", "mantle"})
# Time constants from what no row can tell from none to what no run can tell from standing still.
FASTEST_STEPS, SLOWEST_RUNS = 0.02, 50.0
FAST = frozenset({"heater", "sensor"})  # of two lags in a row no log of one room tells which is the box
FAST_AT, SLOW_AT = 0.6, 0.4  # between the slowest and the fastest
RATE_SD = 6.0  # of a rate's logarithm about the middle: only what no row tells is held by it
START_SD_K, ROOM_SD_K, BODY_SD_K = 0.5, 10.0, 10.0
USUAL_ROOM_C = 24.0  # at most, where no one measured it and the run does not begin at rest
AT_REST_SD_K = 1.0
ROUGHLY, FINELY = 8, 60  # evaluations of the Jacobian
FOLLOWED = 2  # starts that are followed to their ends


@dataclass(frozen=True, slots=True, eq=False)
class _GreyNetwork:
    """da/dt = matrix a + heat u + gain x + room T_room. a : air, then what the terms add"""

    states: tuple[str, ...]
    matrix: Floats
    heat: Floats
    gain: Floats
    room: Floats

    @property
    def shown(self) -> int:
        """The state that is measured."""
        return self.states.index("sensor") if "sensor" in self.states else 0


def _network(terms: Terms, rates: Mapping[str, float], fan: float) -> _GreyNetwork:
    states = ["air"]
    states += ["body"] if terms & BODIES else []
    states += ["heater"] if "heater_lag" in terms else []
    states += ["sensor"] if "sensor_lag" in terms else []
    at = {name: i for i, name in enumerate(states)}
    matrix, heat, room = np.zeros((len(at), len(at))), np.zeros(len(at)), np.zeros(len(at))
    loss, warmed = rates["loss"] + fan * rates.get("fan", 0.0), 0
    matrix[0, 0], room[0] = -loss, loss
    if "body" in at:
        body, to_air, from_air = at["body"], rates["air_body"], rates["body_air"]
        matrix[0, 0] -= to_air
        matrix[0, body], matrix[body, 0], matrix[body, body] = to_air, from_air, -from_air
        if "wall" in terms:
            matrix[body, body] -= rates["body_room"]
            room[body] = rates["body_room"]
        warmed = body if "mantle" in terms else 0
    if "heater" in at:
        matrix[at["heater"], at["heater"]], matrix[warmed, at["heater"]] = -rates["heater"], 1.0
        heat[at["heater"]] = rates["heater"]
    else:
        heat[warmed] = 1.0
    if "sensor" in at:
        matrix[at["sensor"], 0], matrix[at["sensor"], at["sensor"]] = rates["sensor"], -rates["sensor"]
    gain = np.eye(len(at))[0]
    # Two equal rates in a chain have no eigenvectors of their own.
    matrix -= np.diag(1e-9 * np.abs(np.diag(matrix)) * np.arange(len(at)))
    return _GreyNetwork(tuple(states), matrix, heat, gain, room)


@dataclass(frozen=True, slots=True, eq=False)
class _Responses:
    """Columns of what the sensor shows: of each gain [N, *], of the room [N], of each start [N, *]"""

    gains: Floats
    room: Floats
    starts: Floats


def _responses(terms: Terms, rates: Mapping[str, float], run: GreyRun, step_s: float) -> _Responses:
    rows, duty = np.arange(len(run.temp)), run.duty
    if "dead_s" in rates:
        duty = np.interp(rows - rates["dead_s"] / step_s, rows, duty, left=duty[0])
    inputs = [duty, *run.others]
    if run.others:  # where the sun heats, something heats at night too
        inputs.append(np.ones(len(rows)))
    inputs.append(np.ones(len(rows)) if run.room is None else run.room)
    fan = np.zeros(len(rows)) if run.fan is None or "fan" not in terms else np.round(run.fan, 2)
    networks = {float(level): _network(terms, rates, float(level)) for level in np.unique(fan)}
    shown = _steady(networks[0.0], inputs, step_s) if {*networks} == {0.0} else None
    if shown is None:
        shown = _step_through(networks, fan, inputs, step_s)
    count = len(inputs)
    return _Responses(shown[:, : count - 1], shown[:, count - 1], shown[:, count:])


def _directions(network: _GreyNetwork, count: int) -> list[Floats]:
    return [network.heat, *[network.gain] * (count - 2), network.room]


def _steady(network: _GreyNetwork, inputs: Sequence[Floats], step_s: float) -> Floats | None:
    """Responses of a network that never changes, by its eigenmodes; None where it has none that are real."""
    from scipy.signal import lfilter  # scipy.signal takes a while to load

    values, vectors = np.linalg.eig(network.matrix)
    if np.iscomplexobj(values):
        return None
    inverse, decay = np.linalg.inv(vectors), np.exp(values * step_s)
    still = np.abs(values * step_s) < 1e-9
    integral = np.where(still, step_s, np.expm1(values * step_s) / np.where(still, 1.0, values))
    rows, shown = len(inputs[0]), vectors[network.shown]
    columns = []
    for direction, column in zip(_directions(network, len(inputs)), inputs, strict=True):
        weights = shown * integral * (inverse @ direction)
        modes = zip(weights, decay, strict=True)
        columns.append(sum(lfilter([0.0, w], [1.0, -d], column) for w, d in modes))
    powers = decay[None, :] ** np.arange(rows)[:, None]
    return np.column_stack([*columns, powers @ (shown[:, None] * inverse)])


def _step_through(
    networks: Mapping[float, _GreyNetwork], fan: Floats, inputs: Sequence[Floats], step_s: float
) -> Floats:
    """Responses of a network that the fan changes, step by step."""
    from scipy.linalg import expm

    count, size = len(inputs), len(networks[float(fan[0])].states)
    pushed, decays = np.zeros((len(fan), size, count + size)), {}
    for level, network in networks.items():
        both = np.block([[network.matrix, np.eye(size)], [np.zeros((size, 2 * size))]])
        whole = expm(both * step_s)
        decays[level], rows = whole[:size, :size], fan == level
        for i, direction in enumerate(_directions(network, count)):
            pushed[rows, :, i] = inputs[i][rows, None] * (whole[:size, size:] @ direction)
    state, place = np.concatenate([np.zeros((size, count)), np.eye(size)], axis=1), network.shown
    shown = np.empty((len(fan), count + size))
    for k, level in enumerate(fan):
        shown[k] = state[place]
        state = decays[float(level)] @ state + pushed[k]
    return shown


@dataclass(frozen=True, slots=True, eq=False)
class GreyBox:
    """A grey box with its values.

    rates : [1/s], `dead_s` [s]; gains : of full heat [K/s], of each other column, of what is constant
    starts : of each run it was fitted to: air, hidden states, and the room where it was not measured
    errors : of each run [N], NaN where not measured
    """

    terms: Terms
    rates: Mapping[str, float]
    gains: Floats
    starts: tuple[Floats, ...]
    errors: tuple[Floats, ...]
    step_s: float
    noise_k: float

    @property
    def rmse_k(self) -> float:
        """Error of free runs over what it was fitted to [K]."""
        return rms(np.concatenate(self.errors))

    def free_run(self, run: GreyRun, start: Floats) -> Floats:
        """Return what the sensor would show, [N] [°C]."""
        found = _responses(self.terms, self.rates, run, self.step_s)
        return _add_up(found, run, self.gains, start)

    def start_of(self, run: GreyRun) -> Floats:
        """Return the start of a run that no fit saw: in balance with its first readings."""
        rooms = [start[-1] for start in self.starts]
        room_c = float(np.mean(rooms)) if run.room is None and not run.at_rest else _room_of(run)
        return _balance(self.terms, self.rates, run, room_c)[0]


def _room_of(run: GreyRun) -> float:
    if run.room is not None:
        return float(run.room[0])
    return run.first_c if run.at_rest else min(run.first_c - START_SD_K, USUAL_ROOM_C)


def _balance(terms: Terms, rates: Mapping[str, float], run: GreyRun, room_c: float) -> tuple[Floats, Floats]:
    """Return start and sds of a run in balance with its first readings: states, then the room if open."""
    network, first_c = _network(terms, rates, 0.0 if run.fan is None else float(run.fan[0])), run.first_c
    body_c, lost = first_c, rates["loss"] * (first_c - room_c)
    if "mantle" in terms:
        body_c += lost / rates["air_body"]
    elif "wall" in terms:
        parts = np.array([rates["body_air"], rates["body_room"]])
        body_c = float(parts @ [first_c, room_c] / parts.sum())
    mean = {"air": first_c, "sensor": first_c, "body": body_c, "heater": lost}
    wide = AT_REST_SD_K if run.at_rest else BODY_SD_K
    # In K/s: as much as would hold all that the air moves by.
    heated = rates["loss"] * (START_SD_K + float(np.nanmax(run.temp) - np.nanmin(run.temp)))
    sd = {"air": START_SD_K, "sensor": START_SD_K, "body": wide, "heater": heated}
    means, sds = ([table[name] for name in network.states] for table in (mean, sd))
    if run.room is None:
        means.append(room_c)
        sds.append(AT_REST_SD_K if run.at_rest else ROOM_SD_K)
    return np.array(means), np.array(sds)


def _add_up(found: _Responses, run: GreyRun, gains: Floats, start: Floats) -> Floats:
    states = found.starts.shape[1]
    room = found.room if run.room is not None else start[-1] * found.room
    return np.asarray(found.gains @ gains + found.starts @ start[:states] + room)


def rms(errors: Floats) -> float:
    """Return the root of the mean square of what is known."""
    known = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


class _RateSearch:
    """One structure over some runs: residuals of what is linear at its best, as a function of the rates."""

    def __init__(self, terms: Terms, runs: Sequence[GreyRun], step_s: float, noise_k: float) -> None:
        self.terms, self.runs, self.step_s, self.noise_k = terms, runs, step_s, noise_k
        self.names = rate_names(terms)
        longest_s = max(len(run.temp) for run in runs) * step_s
        fastest, slowest = 1.0 / (FASTEST_STEPS * step_s), 1.0 / (SLOWEST_RUNS * longest_s)
        dead_s = np.array([FASTEST_STEPS * step_s, max(min(longest_s / 6.0, 60.0 * step_s), step_s)])
        bounds = [dead_s if name == "dead_s" else np.array([slowest, fastest]) for name in self.names]
        self.low, self.high = np.log(np.array(bounds)).T
        share = np.array([FAST_AT if name in FAST else SLOW_AT for name in self.names])
        self._middle = self.low + share * (self.high - self.low)

    def solve(self, rates: Mapping[str, float]) -> tuple[Floats, Floats, list[Floats]]:
        """Return residuals with those of the priors [K], gains, starts."""
        parts, rests = [], []
        for run in self.runs:
            found = _responses(self.terms, rates, run, self.step_s)
            seen = np.isfinite(run.temp)
            mean, sd = _balance(self.terms, rates, run, _room_of(run))
            own = found.starts if run.room is not None else np.column_stack([found.starts, found.room])
            measured = run.temp - (found.room if run.room is not None else 0.0)
            weights, count = self.noise_k / sd, own.shape[1]
            prior = np.column_stack([np.diag(weights), np.zeros((count, found.gains.shape[1]))])
            matrix = np.concatenate([np.column_stack([own, found.gains])[seen], prior])
            wanted = np.concatenate([measured[seen], weights * mean])
            triangle_q, triangle = np.linalg.qr(matrix)
            parts.append((matrix, wanted, triangle, triangle_q.T @ wanted, count))
            rests.append((triangle[count:, count:], (triangle_q.T @ wanted)[count:]))
        shared, wanted = (np.concatenate(column) for column in zip(*rests, strict=True))
        size = np.linalg.norm(shared, axis=0) + 1e-300
        gains = np.linalg.lstsq(shared / size, wanted, rcond=1e-10)[0] / size
        residuals, starts = [], []
        for matrix, wanted, triangle, turned, count in parts:
            left = turned[:count] - triangle[:count, count:] @ gains
            starts.append(np.linalg.lstsq(triangle[:count, :count], left, rcond=1e-12)[0])
            residuals.append(matrix @ np.concatenate([starts[-1], gains]) - wanted)
        return np.concatenate(residuals), np.asarray(gains), starts

    def residuals(self, x: Floats) -> Floats:
        """Return what is left, in standard deviations of a reading. x : logarithms of the rates"""
        left = self.solve(dict(zip(self.names, np.exp(x), strict=True)))[0] / self.noise_k
        return np.concatenate(
            [np.clip(np.nan_to_num(left, nan=1e6), -1e6, 1e6), (x - self._middle) / RATE_SD]
        )

    def descend(self, x: Floats, steps: int) -> tuple[float, Floats]:
        """Return the cost and place of a minimum near a start."""
        from scipy.optimize import least_squares  # loads for half a second

        begun = np.clip(x, self.low + 1e-3, self.high - 1e-3)
        try:
            found = least_squares(
                self.residuals, begun, bounds=(self.low, self.high), max_nfev=steps, ftol=1e-6, xtol=1e-5
            )
        except np.linalg.LinAlgError:
            return float("inf"), begun
        return float(found.cost), np.asarray(found.x)

    def box(self, x: Floats) -> GreyBox:
        """Return the grey box at a place."""
        rates = dict(zip(self.names, map(float, np.exp(x)), strict=True))
        _, gains, starts = self.solve(rates)
        errors = []
        for run, start in zip(self.runs, starts, strict=True):
            found = _responses(self.terms, rates, run, self.step_s)
            errors.append(run.temp - _add_up(found, run, gains, start))
        return GreyBox(self.terms, rates, gains, tuple(starts), tuple(errors), self.step_s, self.noise_k)


def rate_names(terms: Terms) -> list[str]:
    """Return the names of all that is searched."""
    return ["loss", *(name for term, names in RATES.items() if term in terms for name in names)]


def fit(
    terms: Terms, runs: Sequence[GreyRun], step_s: float, noise_k: float, near: GreyBox | None = None
) -> GreyBox:
    """Fit a structure from several starts. near : one with all of its terms but one, fitted"""
    problem = _RateSearch(terms, runs, step_s, noise_k)
    starts = [np.log([rates[name] for name in problem.names]) for rates in _starts(problem, near)]
    rough = sorted((problem.descend(x, ROUGHLY) for x in starts), key=lambda item: item[0])
    ends = [problem.descend(x, FINELY) for _, x in rough[:FOLLOWED]]
    return problem.box(min(ends, key=lambda item: item[0])[1])


def _starts(problem: _RateSearch, near: GreyBox | None) -> Iterator[dict[str, float]]:
    step_s, longest_s = problem.step_s, max(len(run.temp) for run in problem.runs) * problem.step_s
    if near is None:
        if problem.terms:
            near = fit(frozenset(), problem.runs, step_s, problem.noise_k)
        else:
            yield from ({"loss": times / longest_s} for times in (1.0, 4.0, 15.0, 60.0))
            return
    scale, fast = max(near.rates["loss"], 3.0 / longest_s), 1.0 / (3.0 * step_s)
    # The last of each is none of the effect: no structure fits worse than one that it contains.
    none, tiny = 1.0 / (1.1 * FASTEST_STEPS * step_s), 1.1 / (SLOWEST_RUNS * longest_s)
    soil = ((scale, 0.3 * scale), (3 * scale, 0.3 * scale), (10 * scale, scale), (0.3 * scale, 0.05 * scale))
    grid: dict[str, tuple[tuple[float, ...], ...]] = {
        "heater_lag": ((3 * scale,), (10 * scale,), (fast,), (none,)),
        "dead_time": ((2 * step_s,), (6 * step_s,), (1.02 * FASTEST_STEPS * step_s,)),
        "sensor_lag": ((5 * scale,), (fast,), (none,)),
        "fan": ((0.3 * scale,), (3 * scale,), (tiny,)),
        "soil": (*soil, (tiny, scale)),
        "wall": (*((a, b, 0.3 * b) for a, b in soil), (tiny, scale, tiny)),
        "mantle": ((scale, 3 * scale), (3 * scale, 10 * scale), (0.5 * scale, 30 * scale), (none, none)),
    }
    for term in RATES:
        if term in problem.terms - near.terms:
            for values in grid[term]:
                known = dict(near.rates) | dict(zip(RATES[term], values, strict=True))
                yield {name: known.get(name, scale) for name in problem.names}
