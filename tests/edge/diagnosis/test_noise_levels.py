"""edge/diagnosis/noise_levels.py: noise that the file does not declare is found with the twin."""

import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from edge.diagnosis.fitting import fit
from edge.diagnosis.innovations import NoiseLevels
from edge.diagnosis.noise_levels import (
    HEAT_RANGE,
    RANGES,
    SENSOR_RANGE_K,
    USUAL_HEAT,
    USUAL_HEAT_LOG_SD,
    find_levels,
    first_levels,
    level_prior,
    unexplained_heat,
)
from edge.diagnosis.trial import FittedTwin, Trial
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import TwinFile
from tests.support.simulated_runs import BOX, NOISE, change_run, simulate, twin_file

LOUD = NoiseLevels(sensor_k=0.3, room_k=0.05, heat_w=3.0, heat_tau_s=600.0, power_share=0.01)
HEATER_W = 100.0  # of a twin file that does not say
SEEDS = range(1, 7)


def runs_with(noise: NoiseLevels) -> RunBatch:
    return batch_runs([simulate(BOX, seed, 120, noise) for seed in SEEDS], 60.0)


def undeclared() -> TwinFile:
    return replace(twin_file(), sensor={"quantisation_k": 0.0, "noise_sd_k": None}, nuisance={})


def found_levels(file: TwinFile, runs: RunBatch) -> tuple[FittedTwin, NoiseLevels]:
    [plain] = fit([Trial(file, first_levels(file, runs))], runs, 1)
    [better] = find_levels([plain], file, runs)
    return plain, better.levels


def test_what_the_file_declares_is_taken_with_the_readings_rounding() -> None:
    # 0.1 K steps are spread evenly over 0.1 K: a standard deviation of 0.1 / sqrt(12).
    file = replace(twin_file(), sensor={"quantisation_k": 0.1, "noise_sd_k": 0.2})
    first = first_levels(file, runs_with(NOISE))
    assert first.sensor_k == pytest.approx(math.hypot(0.2, 0.1 / math.sqrt(12.0)))
    assert first.heat_w == NOISE.heat_w
    assert first.power_share == NOISE.power_share


def test_noise_of_a_reading_is_first_told_by_how_it_curls() -> None:
    first = first_levels(undeclared(), runs_with(LOUD))
    assert first.sensor_k == pytest.approx(0.3, rel=0.25)
    assert first.room_k == pytest.approx(0.05, rel=0.25)


@pytest.mark.parametrize("sensor_k", [None, 0.0])
def test_a_reading_without_noise_still_has_its_rounding(sensor_k: float | None) -> None:
    runs = runs_with(NOISE)
    flat = replace(runs, temp=np.full_like(runs.temp, 21.0))
    file = replace(twin_file(), sensor={"quantisation_k": 0.5, "noise_sd_k": sensor_k})
    assert first_levels(file, flat).sensor_k == pytest.approx(0.5 / math.sqrt(12.0))
    sharp = replace(file, sensor={"quantisation_k": None, "noise_sd_k": sensor_k})
    assert first_levels(sharp, flat).sensor_k == SENSOR_RANGE_K[0]


def test_a_run_without_a_still_row_gives_finite_levels() -> None:
    runs = [simulate(BOX, 1, 60)]
    busy = change_run(runs[0], heater_duty=np.arange(60) % 2.0)
    holes = change_run(runs[0], temp_air_c=np.where(np.arange(60) % 3, np.nan, runs[0].columns["temp_air_c"]))
    for run in (busy, holes):
        levels = first_levels(undeclared(), batch_runs([run], 60.0))
        assert all(math.isfinite(level) and level > 0.0 for level in astuple(levels))


def likelihood(levels: NoiseLevels, file: TwinFile, runs: RunBatch) -> float:
    [found] = fit([Trial(file, levels)], runs, 1)
    return found.log_likelihood + level_prior(levels, file)


@pytest.mark.parametrize("noise", [NOISE, LOUD], ids=["quiet", "loud"])
def test_noise_that_nobody_declared_is_found(noise: NoiseLevels) -> None:
    file, runs = undeclared(), runs_with(noise)
    _, levels = found_levels(file, runs)
    assert levels.sensor_k == pytest.approx(noise.sensor_k, rel=0.2)
    assert 0.6 < levels.heat_w / noise.heat_w < 1.6  # as sure as some fifty times 600 s can make it
    # A quiet heat's length is hardly told, so by likelihood: not below the truth but for the search's steps.
    assert likelihood(levels, file, runs) > likelihood(noise, file, runs) - 1.0


def test_noise_that_was_declared_is_not_sought() -> None:
    file = twin_file()  # too quiet by far for these runs
    _, levels = found_levels(file, runs_with(LOUD))
    assert (levels.sensor_k, levels.heat_w, levels.power_share) == (
        *(NOISE.sensor_k, NOISE.heat_w, NOISE.power_share),
    )


def test_levels_that_were_sought_are_likelier_and_inside_their_ranges() -> None:
    file, runs = undeclared(), runs_with(LOUD)
    plain, levels = found_levels(file, runs)
    assert likelihood(levels, file, runs) > likelihood(plain.trial.levels, file, runs) + 10.0
    for name, (low, high) in RANGES.items():
        assert low <= getattr(levels, name) <= high


def test_several_trials_get_the_levels_they_get_alone() -> None:
    file, quiet, loud = undeclared(), runs_with(NOISE), runs_with(LOUD)
    both = fit([Trial(file, LOUD), Trial(file, replace(LOUD, heat_w=0.1))], quiet, 1)
    together = [trial.levels for trial in find_levels(both, file, quiet)]
    alone = [find_levels([item], file, quiet)[0].levels for item in both]
    assert together[0].heat_w == pytest.approx(alone[0].heat_w, rel=0.3)
    assert together[1].heat_w == pytest.approx(alone[1].heat_w, rel=0.3)
    assert found_levels(file, loud)[1].heat_w > 2.0 * max(levels.heat_w for levels in together)


def test_a_heat_that_is_usual_is_likelier_before_anything_is_seen() -> None:
    def prior(heat_w: float, file: TwinFile) -> float:
        return level_prior(replace(NOISE, heat_w=heat_w), file)

    off_by_one_sd = USUAL_HEAT * HEATER_W * math.exp(USUAL_HEAT_LOG_SD)
    assert prior(USUAL_HEAT * HEATER_W, undeclared()) == 0.0
    assert prior(off_by_one_sd, undeclared()) == pytest.approx(-0.5)
    assert prior(off_by_one_sd, twin_file()) == 0.0  # declared: there is nothing to believe


@pytest.mark.parametrize("file", [twin_file(), undeclared()], ids=["declared", "undeclared"])
def test_more_heat_than_the_file_or_a_usual_box_has_is_told(file: TwinFile) -> None:
    for heat_w, told in ((NOISE.heat_w, False), (15.0, True)):
        runs = runs_with(replace(NOISE, heat_w=heat_w))
        [found] = fit([Trial(file, replace(NOISE, heat_w=max(heat_w, HEAT_RANGE[0] * HEATER_W)))], runs, 1)
        assert unexplained_heat(found, file, runs) is told


@pytest.mark.parametrize("factor", [2.0, 10.0])
def test_more_and_less_heat_than_usual_are_equally_unlikely(factor):
    usual = USUAL_HEAT * HEATER_W
    heats_w = usual, usual * factor, usual / factor
    prior = [level_prior(replace(LOUD, heat_w=heat_w), undeclared()) for heat_w in heats_w]
    assert prior[0] == 0.0
    expected = -0.5 * (math.log(factor) / USUAL_HEAT_LOG_SD) ** 2
    assert prior[1:] == [pytest.approx(expected)] * 2
