"""edge/diagnosis/innovations.py: the filter against a covariance that is written out, and whiteness."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from edge.diagnosis.innovations import FilterInput, NoiseLevels, gains, log_likelihoods, whiten
from edge.twin.linearise import linearise
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import spread
from tests.support.simulated_runs import BOX, NOISE, STEP_S, Floats, coloured_noise

SLOW = BoxTwin(
    effects={
        "extra_capacity": {"kC": 8.0},
        "wall_mass": {"C_w": 5000.0, "G_in": 10.0, "G_out": 8.0},
        "heater_lag": {"tau_h": 120.0},
        "sensor_lag": {"tau_s": 45.0},
        "fan_effectiveness": {"eps_f": 0.8},
    }
)
ROWS = 14
LEVELS = NoiseLevels(sensor_k=0.15, room_k=0.3, heat_w=3.0, heat_tau_s=400.0, power_share=0.1)


def recording(rows: int = ROWS, runs: int = 2, seed: int = 5) -> RunBatch:
    draw = np.random.default_rng(seed)
    duty = np.repeat(draw.choice([0.2, 0.5, 1.0], (runs, rows // 7 + 1)), 7, axis=1)[:, :rows]
    fan = np.repeat((draw.random((runs, rows // 5 + 1)) < 0.4).astype(float), 5, axis=1)[:, :rows]
    ambient = 21.0 + np.cumsum(0.05 * draw.standard_normal((runs, rows)), axis=1)
    return RunBatch(np.full((runs, rows + 1), 22.0), duty, fan, ambient)


def dense_covariance(twin: BoxTwin, runs: RunBatch, run: int, levels: NoiseLevels) -> Floats:
    """Return the covariance of one run's temperatures [N, N], from rollouts of each source of noise."""
    rows, size = runs.duty.shape[1], len(twin.states)
    duty, fan, ambient = (column[run : run + 1] for column in (runs.duty, runs.fan, runs.ambient))
    rest = np.full(size, 20.0)
    plain = twin.rollout(rest, duty, fan, ambient)[0]

    def by(start: Floats = rest, room: object = 0.0, heat_w: object = 0.0, power: float = 1.0) -> Floats:
        source = np.asarray(heat_w) / twin.system.air_capacity_j_k
        return twin.rollout(start, power * duty, fan, ambient + np.asarray(room), source)[0] - plain

    unit = np.eye(rows)
    by_heat = np.stack([by(heat_w=row) for row in unit], axis=1)
    by_room = np.stack([by(room=row) for row in unit], axis=1)
    by_start = np.stack([by(start=rest + row) for row in np.eye(size)], axis=1)
    by_power = by(power=2.0)
    apart_s = STEP_S * np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    heat = levels.heat_w**2 * np.exp(-apart_s / levels.heat_tau_s)
    return (
        by_heat @ heat @ by_heat.T
        + levels.room_k**2 * by_room @ by_room.T
        + by_start @ np.diag(spread(twin) ** 2) @ by_start.T
        + levels.power_share**2 * np.outer(by_power, by_power)
        + levels.sensor_k**2 * np.eye(rows)
    )


def log_density(twin: BoxTwin, runs: RunBatch, levels: NoiseLevels, errors: Floats) -> Floats:
    """By the filter, of each run; `errors` [B, N], NaN where nothing was measured."""
    seen = np.isfinite(errors)
    filters = gains([FilterInput(linearise(twin, runs), levels, spread(twin), STEP_S)], seen)
    white = whiten(filters, np.array([0]), np.nan_to_num(errors)[None])[0]
    spreads = np.where(seen, np.log(filters.sd[:, 0].T), 0.0).sum(axis=1)
    return -0.5 * (white**2).sum(axis=1) - spreads - 0.5 * np.log(2.0 * np.pi) * seen.sum(axis=1)


def expected_density(twin: BoxTwin, runs: RunBatch, levels: NoiseLevels, errors: Floats) -> list[float]:
    found = []
    for run, row in enumerate(errors):
        seen = np.isfinite(row)
        covariance = dense_covariance(twin, runs, run, levels)[np.ix_(seen, seen)]
        found.append(float(multivariate_normal.logpdf(row[seen], cov=covariance)))
    return found


@pytest.mark.parametrize(
    "levels",
    [
        LEVELS,
        replace(LEVELS, power_share=0.0, room_k=0.0),
        replace(LEVELS, heat_w=0.0),
        replace(LEVELS, sensor_k=0.01, heat_tau_s=5000.0),
    ],
    ids=["all", "heat alone", "no heat", "slow heat"],
)
@pytest.mark.parametrize("twin", [BoxTwin(effects=BOX), SLOW], ids=["one state", "four states"])
def test_the_likelihood_is_that_of_a_gaussian_written_out(twin: BoxTwin, levels: NoiseLevels) -> None:
    runs = recording()
    errors = np.random.default_rng(1).normal(0.0, 0.5, (2, ROWS))
    found = log_density(twin, runs, levels, errors)
    assert found == pytest.approx(expected_density(twin, runs, levels, errors), rel=1e-7)


@pytest.mark.parametrize("missing", [[0], [ROWS - 1], [3, 4, 5], [*range(0, ROWS, 2)], [*range(1, ROWS)]])
def test_rows_without_a_temperature_say_nothing(missing: list[int]) -> None:
    runs = recording()
    errors = np.random.default_rng(2).normal(0.0, 0.5, (2, ROWS))
    errors[0, missing] = np.nan
    found = log_density(SLOW, runs, LEVELS, errors)
    assert found == pytest.approx(expected_density(SLOW, runs, LEVELS, errors), rel=1e-7)


def test_a_run_that_is_padded_is_worth_what_it_is_alone() -> None:
    runs = recording(rows=20)
    errors = np.random.default_rng(3).normal(0.0, 0.5, (2, 20))
    errors[1, ROWS:] = np.nan  # as `batch_runs` pads the shorter one
    both = log_density(SLOW, runs, LEVELS, errors)
    short = replace(
        runs,
        temp=runs.temp[1:, : ROWS + 1],
        **{name: getattr(runs, name)[1:, :ROWS] for name in ("duty", "fan", "ambient")},
    )
    assert both[1] == pytest.approx(log_density(SLOW, short, LEVELS, errors[1:, :ROWS])[0])


def test_twins_filtered_side_by_side_come_out_as_alone() -> None:
    runs = recording()
    seen = np.ones((2, ROWS), dtype=bool)
    seen[1, 5] = False
    other = BoxTwin(effects=BOX)
    filtered = [
        FilterInput(linearise(SLOW, runs), LEVELS, spread(SLOW), STEP_S),
        FilterInput(linearise(other, runs), NOISE, spread(other), STEP_S),
    ]
    errors = np.random.default_rng(4).normal(0.0, 0.5, (3, 2, ROWS))
    owner = np.array([1, 0, 1])
    together = whiten(gains(filtered, seen), owner, errors)
    assert together.shape == (3, 2, ROWS)
    assert (together[:, 1, 5] == 0.0).all()
    for i, own in enumerate(owner):
        alone = whiten(gains([filtered[own]], seen), np.array([0]), errors[i : i + 1])
        assert together[i] == pytest.approx(alone[0], abs=1e-12)


def test_a_likelihood_is_that_of_the_whitened_errors() -> None:
    runs = recording()
    seen = np.ones((2, ROWS), dtype=bool)
    seen[1, 5] = seen[0, -1] = False
    other = BoxTwin(effects=BOX)
    filtered = [
        FilterInput(linearise(SLOW, runs), LEVELS, spread(SLOW), STEP_S),
        FilterInput(linearise(other, runs), NOISE, spread(other), STEP_S),
    ]
    errors = np.random.default_rng(4).normal(0.0, 0.5, (2, 2, ROWS))
    found, filters = log_likelihoods(filtered, seen, errors), gains(filtered, seen)
    white = whiten(filters, np.array([0, 1]), errors)
    spreads = np.where(seen.T[:, None], np.log(filters.sd), 0.0).sum(axis=(0, 2))
    assert found == pytest.approx(-0.5 * (white**2).sum(axis=(1, 2)) - spreads, rel=1e-12)


def test_a_reading_long_after_a_start_that_is_forgotten_counts_in_full() -> None:
    runs = recording(rows=1500, runs=1)
    fast = BoxTwin(effects=BOX | {"extra_capacity": {"kC": 1.0}})
    levels = replace(LEVELS, room_k=0.0, heat_w=0.0, power_share=0.0)
    seen = np.ones((1, 1500), dtype=bool)
    filters = gains([FilterInput(linearise(fast, runs), levels, spread(fast), STEP_S)], seen)
    assert filters.rows[-1, 0, 0, 0, -1] == 0.0  # nothing is left to learn, to the last bit
    white = whiten(filters, np.array([0]), np.ones((1, 1, 1500)))
    assert white[0, 0, -1] == pytest.approx(1.0 / levels.sensor_k)


def test_where_nothing_is_measured_the_filter_still_expects_something() -> None:
    runs = recording()
    seen = np.ones((2, ROWS), dtype=bool)
    seen[:, 6:] = False
    filters = gains([FilterInput(linearise(SLOW, runs), LEVELS, spread(SLOW), STEP_S)], seen)
    errors = np.random.default_rng(6).normal(0.0, 0.5, (1, 2, ROWS))
    everywhere = whiten(filters, np.array([0]), errors, everywhere=True)
    plain = whiten(filters, np.array([0]), errors)
    assert everywhere[..., :6] == pytest.approx(plain[..., :6])
    assert (plain[..., 6:] == 0.0).all()
    expected = errors - everywhere * filters.sd[:, 0].T  # of the error, from the rows before
    covariance = dense_covariance(SLOW, runs, 0, LEVELS)
    told = covariance[6:, :6] @ np.linalg.solve(covariance[:6, :6], errors[0, 0, :6])
    assert expected[0, 0, 6:] == pytest.approx(told, abs=1e-9)


def drawn(twin: BoxTwin, runs: RunBatch) -> Floats:
    """Draw measured minus free run, from the middle of the start, by the model [B, N]."""
    draw, shape = np.random.default_rng(7), runs.duty.shape
    heat_w = np.stack([coloured_noise(draw, shape[1], LEVELS) for _ in range(shape[0])])
    power = runs.duty * (1.0 + LEVELS.power_share * draw.standard_normal((shape[0], 1)))
    room = runs.ambient + LEVELS.room_k * draw.standard_normal(shape)
    rest = np.full(len(twin.states), 20.0)
    start = rest + spread(twin) * draw.standard_normal((shape[0], len(rest)))
    true = twin.rollout(start, power, runs.fan, room, heat_w / twin.system.air_capacity_j_k)
    measured = true + LEVELS.sensor_k * draw.standard_normal(shape)
    return measured - twin.rollout(rest, runs.duty, runs.fan, runs.ambient)


def innovations(twin: BoxTwin, runs: RunBatch, levels: NoiseLevels) -> Floats:
    errors = drawn(twin, runs)
    filters = gains([FilterInput(linearise(twin, runs), levels, spread(twin), STEP_S)], np.isfinite(errors))
    return whiten(filters, np.array([0]), errors[None])[0]


def square_bounds(count: int) -> tuple[float, float]:
    """Return bounds of a sum of squares of white noise: of 1000 seeds one falls outside."""
    low, high = chi2.ppf([0.0005, 0.9995], count)
    return float(low), float(high)


@pytest.mark.parametrize("twin", [BoxTwin(effects=BOX), SLOW], ids=["one state", "four states"])
def test_innovations_of_what_the_model_says_are_white_and_of_unit_size(twin: BoxTwin) -> None:
    white = innovations(twin, recording(rows=120, runs=16), LEVELS)
    low, high = square_bounds(white.size)
    assert low < (white**2).sum() < high
    assert abs(white.mean()) < 3.3 / np.sqrt(white.size)
    for lag in (1, 2, 5, 10):
        correlation = (white[:, lag:] * white[:, :-lag]).sum() / white.size
        assert abs(correlation) < 3.3 / np.sqrt(white.size)


@pytest.mark.parametrize(
    "wrong",
    [{"heat_w": 1.5}, {"sensor_k": 0.07}, {"power_share": 0.02}, {"room_k": 0.0}, {"heat_tau_s": 4000.0}],
    ids=lambda wrong: next(iter(wrong)),
)
def test_a_noise_level_that_is_too_low_or_too_slow_shows_in_the_innovations(wrong: dict[str, float]) -> None:
    white = innovations(SLOW, recording(rows=120, runs=16), replace(LEVELS, **wrong))
    assert (white**2).sum() > square_bounds(white.size)[1]
