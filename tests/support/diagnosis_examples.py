"""Made-up diagnoses as a report gets them: a box of one node, in which something acts that its twin lacks."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.report.story import Story, Trace

Floats = NDArray[np.float64]

STEP_S = 60.0
HEATER_W, UA_W_K, FAN_W_K, AIR_J_K = 100.0, 5.0, 16.0, 900.0
NOISE_K = 0.08
Power = Callable[[Floats], Floats]


def lagged(duty: Floats, tau_s: float = 420.0) -> Floats:
    """Power of a heater that warms up first [W]."""
    power, now = np.empty(len(duty)), 0.0
    for row, wanted in enumerate(HEATER_W * duty):
        now += (1.0 - np.exp(-STEP_S / tau_s)) * (wanted - now)
        power[row] = now
    return power


def prompt(duty: Floats) -> Floats:
    """Power of a heater that heats at once [W]."""
    return HEATER_W * duty


def sagging(duty: Floats) -> Floats:
    """Power that falls with the square of the duty [W]."""
    return HEATER_W * duty - 22.0 * duty**2


def run_through(
    power: Floats, fan: Floats, ambient: Floats, start_c: float, fan_share: float = 1.0
) -> Floats:
    """Air temperature of a node that loses heat through its walls and by the fan [°C]."""
    temp, now = np.empty(len(power)), start_c
    for row in range(len(power)):
        temp[row] = now
        loss = UA_W_K + fan_share * FAN_W_K * fan[row]
        rest = ambient[row] + power[row] / loss
        now = rest + (now - rest) * np.exp(-STEP_S * loss / AIR_J_K)
    return temp


def trace(
    name: str, role: str, truth: Power, twin: Power, after: Power, seed: int, fan_share: float = 1.0
) -> Trace:
    """Two and a half hours: duty in steps, the fan now and then, a room that wanders."""
    random = np.random.default_rng(seed)
    rows = 150
    time_s = STEP_S * np.arange(rows)
    duty = np.repeat(random.choice([0.0, 0.2, 0.4, 0.6, 0.8], rows // 15), 15)
    fan = np.repeat(random.choice([0.0, 0.0, 1.0], rows // 10), 10)
    ambient = 21.0 + 0.8 * np.sin(2.0 * np.pi * time_s / 7000.0 + seed)
    real = run_through(truth(duty), fan, ambient, 21.0, fan_share)
    measured = np.round(real + NOISE_K * random.standard_normal(rows), 1)
    before = run_through(twin(duty), fan, ambient, 21.0)
    share_after = 1.0 if after is twin else fan_share
    later = run_through(after(duty), fan, ambient, 21.0, share_after)
    white = random.standard_normal(rows)
    missed = 0.35 * (measured - before) / NOISE_K + white
    inputs = {"heater_duty": duty, "fan_on": fan, "temp_ambient": ambient}
    return Trace(name, role, time_s, measured, before, later, white if truth is twin else missed, inputs)


def rmse(residual: Floats | None) -> float:
    """Root mean square of what is known [K]."""
    assert residual is not None
    return float(np.sqrt(np.nanmean(residual**2)))


def errors(traces: list[Trace], when: str) -> dict[str, Any] | None:
    """A side of the gap."""
    if not traces:
        return None
    found = {one.name: one.residual(when) for one in traces}

    def both(residual: Floats) -> dict[str, float]:
        return {"rmse_k": rmse(residual), "mae_k": float(np.nanmean(np.abs(residual)))}

    joined = np.concatenate([part for part in found.values() if part is not None])
    return {**both(joined), "per_run": {name: both(part) for name, part in found.items() if part is not None}}


def common(traces: list[Trace]) -> dict[str, Any]:
    """Return the keys that every diagnosis has."""
    train, test = ([one for one in traces if one.role == role] for role in ("train", "test"))
    floor = float(np.hypot(NOISE_K, 0.1 / np.sqrt(12.0)))
    sides = {when: {"train": errors(train, when), "test": errors(test, when)} for when in ("before", "after")}
    return {
        "gap": {**sides, "noise_floor": {"train": floor, "test": floor if test else None}},
        "predictions": {
            one.name: {
                "before": one.before.tolist(),
                "after": one.after.tolist(),
            }
            for one in test
            if one.before is not None and one.after is not None
        },
        "seconds": 6.4,
        "data_sha256": "9f2c4b8e" * 8,
        "software": "greenhouse-twin 0.1.0",
        "command": "greenhouse twin diagnose train_01.csv train_02.csv train_03.csv --test test_01.csv "
        "--twin twin.yaml --out report",
        "twin_before": "twin_before.yaml",
    }


def regime(where: str, share: float, heat_w: float | None, se: float | None) -> dict[str, Any]:
    """A row of the regimes."""
    return {"where": where, "share_of_squared_error": share, "heat_w": heat_w, "heat_w_se": se}


def named_story(test: bool = True) -> Story:
    """Heater lag, then a fan that gives less than it should, which may be a short circuit as well."""
    names = [("train_01.csv", "train"), ("train_02.csv", "train"), ("train_03.csv", "train")]
    names += [("test_01.csv", "test")] if test else []
    traces = [
        trace(name, role, lagged, prompt, lagged, seed, fan_share=0.7)
        for seed, (name, role) in enumerate(names)
    ]
    known = common(traces)
    gap = known["gap"]
    first, last = (
        [(gap[when][role] or {}).get("rmse_k", 0.0) for role in ("train", "test")]
        for when in ("before", "after")
    )
    steps = [
        ((), *first),
        (("heater_lag",), *(0.5 * error for error in first)),
        (("heater_lag", "fan_effectiveness"), *last),
    ]
    document = {
        "verdict": "named",
        "effects": [
            {
                "name": "heater_lag",
                "alternatives": [],
                "log_odds": 812.4,
                "probability": 0.947,
                "parameters": {"tau_h": {"value": 418.2, "low": 402.5, "high": 434.9, "unit": "s"}},
                "equation": "The element warms up before it heats: tau_h dP/dt = H - P.",
                "without": "negative for minutes after the heater goes on, positive for as long after",
            },
            {
                "name": "fan_effectiveness",
                "alternatives": ["short_circuit"],
                "alternative_log_odds": {"short_circuit": -0.02},
                "log_odds": 96.7,
                "probability": 0.9,
                "parameters": {"eps_f": {"value": 0.703, "low": 0.681, "high": 0.724, "unit": ""}},
                "equation": "Share of the rated flow that changes air, against the filters: F -> eps_f F.",
                "without": "positive with the fan on, in proportion to T - T_amb",
            },
        ],
        "depends_on": [],
        "regimes": [
            regime("within 15 min of a change of the duty", 0.58, -14.2, 0.9),
            regime("the fan is on and T - T_amb > 6 K", 0.27, 38.1, 3.1),
            regime("the heater is on", 0.11, -2.3, 0.4),
            regime("hour 14 to 15", 0.004, None, None),
        ],
        **known,
        "next_experiment": {
            "profile": "next_experiment.csv",
            "why": "A pseudo-random fan sequence of 2 to 6 minutes at a duty of 0.6 separates the two best.",
            "separates": ["fan_effectiveness", "short_circuit"],
            "duration_s": 5400.0,
            "expected_log_odds": 0.4,
            "largest_temp_air_c": 38.2,
        },
        "waterfall": [
            {"effects": list(effects), "train_rmse_k": train, "test_rmse_k": held_out if test else None}
            for effects, train, held_out in steps
        ],
        "formula": None,
        "findings": [
            "58 % of the squared error lies within 15 min of a change of the duty; there the model gains"
            " 14.2 ± 0.9 W too much",
            "27 % of the squared error lies where the fan is on and T - T_amb > 6 K; there the model gains"
            " 38 ± 3 W too little",
        ],
        "events": [
            {"run": "train_02.csv", "from_s": 4200.0, "to_s": 4380.0, "kind": "door", "heat_w": -61.0}
        ],
        "twin_after": "twin.yaml",
        "doubtful": [
            {"name": "soil_mass", "against": ["C_s would store 17 times the heat of the box full of water"]}
        ],
        "provisional": [],
        "left_out": {
            "given_k": 2.4,
            "after_k": 0.11,
            "simple_k": {"one mass": 0.61, "heater lag": 0.14, "two masses": 0.58, "ARX 2": 0.09},
            "test_k": {"one mass": 0.72, "heater lag": 0.2, "two masses": 0.6, "ARX 2": None},
        },
        "against_adopting": [],
    }  # fmt: skip
    return Story(document, tuple(traces))


def nothing_story() -> Story:
    """A twin that has all; its test run told no later temperatures."""
    traces = [trace(f"train_0{n}.csv", "train", prompt, prompt, prompt, n) for n in (1, 2)]
    forecast = trace("test_01.csv", "test", prompt, prompt, prompt, 9)
    measured = np.where(np.arange(150) < 2, forecast.measured, np.nan)
    untold = replace(forecast, measured=measured, innovations=None)
    document = {
        "verdict": "nothing_missing",
        "effects": [],
        "depends_on": [],
        "regimes": [regime("the fan is on", 0.31, 0.2, 0.3)],
        **common(traces),
        "next_experiment": None,
        "twin_after": None,
    }
    return Story(document, (*traces, untold))


def unknown_story() -> Story:
    """Power that falls with the square of the duty, which the library is taken not to know."""
    names = [("train_01.csv", "train"), ("train_02.csv", "train"), ("test_01.csv", "test")]
    traces = [trace(name, role, sagging, prompt, prompt, n + 4) for n, (name, role) in enumerate(names)]
    formula: Mapping[str, Any] = {
        "text": "Q = a u^2",
        "parameters": {"a": {"value": -21.6, "low": -23.1, "high": -20.2, "unit": "W"}},
    }
    document = {
        "verdict": "unknown",
        "effects": [],
        "depends_on": ["heater_duty", "temp_air"],
        "regimes": [
            regime("the duty is above 0.5", 0.83, -11.0, 0.6),
            regime("the heater is off", 0.02, 0.1, 0.4),
        ],
        **common(traces),
        "next_experiment": {
            "profile": "next_experiment.csv",
            "why": "A staircase of five duty levels shows how the heat depends on the duty.",
            "separates": [],
            "duration_s": 10800.0,
            "expected_log_odds": None,
        },
        "formula": formula,
        "twin_after": None,
    }
    return Story(document, tuple(traces))


STORIES: Mapping[str, Callable[[], Story]] = {
    "named": named_story,
    "nothing_missing": nothing_story,
    "unknown": unknown_story,
}
