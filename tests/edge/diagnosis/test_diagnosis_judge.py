"""edge/diagnosis/judge.py: names and what they must not depend on, from runs to the answer."""

from dataclasses import replace

import numpy as np
import pytest

from edge import DiagnosisResult, Run, Twin, diagnose
from edge.formats.run_file import cut
from edge.twin.model import BoxTwin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest
from tests.support.simulated_runs import BOX, NOISE, Effects, candidates_only, change_run, simulate, twin_file

pytestmark = pytest.mark.slow

ROWS, ROOM_C = 80, 21.0
LAG: Effects = {**BOX, "heater_lag": {"tau_h": 200.0}}
LAGS = {"heater_lag", "sensor_lag"}
POWER_SAID = "the heater's power is open, so that only ratios to it can be known"


def recorded(box: Effects, seed: int, noise_k: float) -> Run:
    """A run in a room as steady as the fan: no log of it tells a slow heater from a slow sensor."""
    run = simulate(box, seed, ROWS, fan=False)
    twin, duty, still = BoxTwin(effects=box), run.columns["heater_duty"], np.zeros(ROWS)
    start = at_rest(twin, ROOM_C, ROOM_C)
    temp = twin.rollout(start, duty[None, :-1], still[None, :-1], ROOM_C)[0]
    noise = noise_k * np.random.default_rng(seed).standard_normal(ROWS)
    columns = {"temp_air_c": np.append(ROOM_C, temp) + noise, "temp_ambient_c": still + ROOM_C, "light": None}
    return Run(run.path.name, change_run(run, **columns))


def diagnosed(file: TwinFile, box: Effects, noise_k: float = NOISE.sensor_k) -> DiagnosisResult:
    with candidates_only(*LAGS, "infiltration", "soil_mass"):
        return diagnose(Twin(file), [recorded(box, seed, noise_k) for seed in (1, 2)])


def open_file(start: float = 1.0, volume: float = 1.0, step_s: float = 60.0, **power: Value) -> TwinFile:
    """A box of which loss and capacity are to be fitted."""
    file = twin_file()
    volume_m3 = Value(volume * file.geometry["volume_m3"].value)
    effects = {name: {key: Value(start * own, fit=True) for key, own in BOX[name].items()} for name in BOX}
    geometry = {**file.geometry, "volume_m3": volume_m3, **power}
    return replace(file, geometry=geometry, sample_s=step_s, effects=effects)


@pytest.fixture(scope="module")
def plain() -> DiagnosisResult:
    return diagnosed(open_file(), LAG)


def names(found: DiagnosisResult) -> dict[str, list[str]]:
    """Names and their alternatives."""
    return {effect["name"]: effect["alternatives"] for effect in found.document["effects"]}


def test_two_lags_that_no_log_tells_apart_are_alternatives_of_each_other(plain: DiagnosisResult) -> None:
    assert plain.verdict == "named"
    [(name, others)] = names(plain).items()
    assert {name, *others} == LAGS
    assert plain.names[name] > 0.9


@pytest.mark.parametrize(
    "file",
    [
        open_file(volume=10.0),
        open_file(start=10.0),
        open_file(step_s=30.0),
        open_file(step_s=120.0),
    ],
    ids=["ten times the volume", "starts ten times as high", "half a step", "two steps"],
)
def test_what_a_file_guesses_changes_no_name(file: TwinFile, plain: DiagnosisResult) -> None:
    found = diagnosed(file, LAG)
    assert (found.verdict, names(found)) == (plain.verdict, names(plain))
    assert lag_s(found) == pytest.approx(lag_s(plain), rel=0.01)
    assert POWER_SAID not in " ".join(found.document["findings"])


def test_a_log_in_several_files_names_the_same() -> None:
    runs = [recorded(LAG, seed, NOISE.sensor_k) for seed in (1, 2)]
    halves = [
        Run(f"{run.name}{begin}", cut(run.content, begin, begin + ROWS // 2))
        for run in runs
        for begin in (0, ROWS // 2)
    ]
    with candidates_only(*LAGS, "infiltration", "soil_mass"):
        found = diagnose(Twin(open_file()), halves)
    classes = [{name, *others} for name, others in names(found).items()]
    assert (found.verdict, classes) == ("named", [LAGS])


def lag_s(found: DiagnosisResult) -> float:
    (effect,) = found.document["effects"]
    (value,) = effect["parameters"].values()
    return value["value"]


@pytest.mark.parametrize("power_w", [25.0, 400.0])
def test_an_open_power_is_a_unit_in_which_all_else_is_told(power_w: float, plain: DiagnosisResult) -> None:
    found = diagnosed(open_file(heater_max_w=Value(power_w, fit=True)), LAG)
    assert (found.verdict, names(found)) == (plain.verdict, names(plain))
    assert POWER_SAID in " ".join(found.document["findings"])
    assert found.twin is not None
    values = found.twin.file.values()
    assert values["effects", "wall_loss", "UA"].value == pytest.approx(4.0 * power_w / 100.0, rel=0.05)


@pytest.mark.parametrize("lag", ["heater_lag", "sensor_lag"])
def test_a_lag_below_half_a_row_is_never_a_name(lag: str) -> None:
    """Though almost without noise it can be seen that something is late."""
    parameter = {"heater_lag": "tau_h", "sensor_lag": "tau_s"}[lag]
    found = diagnosed(twin_file(noise=replace(NOISE, sensor_k=0.01)), {**BOX, lag: {parameter: 15.0}}, 0.01)
    assert not LAGS & set(names(found))
    against = [line for item in found.document["doubtful"] for line in item["against"]]
    assert any("rows of 60 s can't show that" in line for line in against)
