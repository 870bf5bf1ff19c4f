"""Experiments on the virtual board: what is applied, recorded, changed by safety, and left after a kill."""

import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from contexts import context

from edge.__main__ import main
from edge.app.experiment import Experiment, run_experiment
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.config.settings import Settings
from edge.controllers.input_profile import InputProfile
from edge.core.errors import DataError, GreenhouseError
from edge.formats.atomic_file import write_document
from edge.formats.profile_file import Profile, read_profile
from edge.formats.run_file import RecordedRun, read_run
from edge.safety.supervisor import SafetyMemory
from edge.state.codecs import StandingState, encode_standing
from edge.state.store import STANDING, restore
from edge.storage.runs import export_run
from edge.tick.orders import Operation
from training.lab import Lab

pytestmark = pytest.mark.slow

TWELVE_MINUTES = "time_s,heater_duty,fan_on\n0,0.5,0\n180,0,1\n360,1,0\n480,0.25,1\n720,0,0\n"


def profile_file(folder: Path, text: str = TWELVE_MINUTES, name: str = "steps.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def record(folder: Path, profile: Path, *options: str, out: str = "run.csv") -> tuple[int, RecordedRun]:
    code = main(["experiment", str(profile), "--out", str(folder / out), "--virtual", *options])
    return code, read_run(folder / out)


@contextmanager
def lock_step(folder: Path) -> Iterator[SimClock]:
    with Lab(settings_in(folder, config.default()), folder=folder) as lab:
        yield lab.board


def stop_after(clock: SimClock, time_s: float) -> None:
    wait = clock.wait

    def wait_and_stop(*arguments):
        if clock.now() > time_s:
            signal.raise_signal(signal.SIGTERM)
        wait(*arguments)

    clock.wait = wait_and_stop


def stand(settings: Settings, standing: StandingState) -> None:
    write_document(Path(settings.state_file), encode_standing(standing))


def test_the_board_drives_the_profile_row_by_row(tmp_path):
    code, run = record(tmp_path, profile_file(tmp_path), "--role", "train", "--notes", "two pulses")
    assert code == 0
    assert run.columns["time_s"].tolist() == [60.0 * k for k in range(13)]
    assert run.columns["heater_duty"].tolist() == [0.5] * 3 + [0.0] * 3 + [1.0] * 2 + [0.25] * 4 + [0.0]
    assert run.columns["fan_on"].tolist() == [0] * 3 + [1] * 3 + [0] * 2 + [1] * 4 + [0]
    air = run.columns["temp_air_c"]
    assert air.max() > air[0] + 1.0
    assert np.isfinite(run.columns["temp_ambient_c"]).all()
    assert "reference_c" not in run.columns  # nobody followed one
    facts = {key: run.facts[key] for key in ("rig", "role", "profile", "controller", "seed", "notes")}
    assert facts == {
        "rig": "virtual board",
        "role": "train",
        "profile": "steps.csv",
        "controller": "profile",
        "seed": "1",
        "notes": "two pulses; safety changed no command",
    }
    assert run.start_utc is not None


def test_the_same_seed_gives_the_same_file_and_another_seed_another_room(tmp_path):
    profile = profile_file(tmp_path)
    for out, seed in (("a.csv", "7"), ("b.csv", "7"), ("c.csv", "8")):
        record(tmp_path, profile, "--seed", seed, "--minutes", "3", out=out)
    a, b, c = ((tmp_path / name).read_bytes() for name in ("a.csv", "b.csv", "c.csv"))
    assert a == b
    assert a != c


def test_what_safety_changes_stands_in_the_notes_and_the_inputs_are_what_was_driven(tmp_path, capsys):
    too_fine = "time_s,heater_duty,fan_on\n0,0.33,0\n60,0.3,0\n180,0,0\n"
    code, run = record(tmp_path, profile_file(tmp_path, too_fine))
    assert code == 0
    assert run.columns["heater_duty"].tolist() == [0.3, 0.3, 0.3, 0.0]
    assert "safety changed commands: heater.step 1" in run.facts["notes"]
    assert "heater.step 1" in capsys.readouterr().out


def test_a_relay_time_longer_than_the_profiles_pulse_is_told(tmp_path):
    (tmp_path / "edge.yaml").write_text("safety: {fan_min_on_s: 180}\n")
    blink = "time_s,heater_duty,fan_on\n0,0,0\n60,0,1\n120,0,0\n360,0,0\n"
    _, run = record(tmp_path, profile_file(tmp_path, blink), "--config", str(tmp_path / "edge.yaml"))
    assert run.columns["fan_on"].tolist() == [0, 1, 1, 1, 0, 0, 0]
    assert "fan.min_on 2" in run.facts["notes"]


def test_a_profile_with_light_drives_the_lamp_over_the_photoperiod(tmp_path):
    (tmp_path / "edge.yaml").write_text(
        'lighting: {enabled: true, on: "00:00", off: "23:59"}\ntimezone: UTC\n'
    )
    light = "time_s,heater_duty,fan_on,light\n0,0,0,0\n120,0,0,0.4\n240,0,0,0\n"
    _, run = record(tmp_path, profile_file(tmp_path, light), "--config", str(tmp_path / "edge.yaml"))
    assert run.columns["led"].tolist() == [0.0, 0.0, 0.4, 0.4, 0.0]
    assert run.columns["light"][3] > run.columns["light"][1] + 0.2


def test_a_reference_profile_is_followed_by_the_controller_that_was_asked_for(tmp_path):
    reference = profile_file(tmp_path, "time_s,reference_c\n0,24\n600,26\n900,26\n")
    _, run = record(tmp_path, reference, "--controller", "MPC-P")
    assert run.facts["controllers"] == "MPC-P"
    assert run.columns["reference_c"].tolist() == [24.0] * 10 + [26.0] * 6
    assert abs(run.columns["temp_air_c"][10] - 24.0) < 0.7


def test_minutes_end_it_sooner(tmp_path):
    code, run = record(tmp_path, profile_file(tmp_path), "--minutes", "5")
    assert code == 0
    assert run.columns["time_s"][-1] == 300.0


def test_a_lead_in_is_applied_but_is_no_part_of_the_run(tmp_path):
    plain, led_in = profile_file(tmp_path), "# record_from_s: 180\n" + TWELVE_MINUTES
    _, whole = record(tmp_path, plain, out="whole.csv")
    code, run = record(tmp_path, profile_file(tmp_path, led_in, "led_in.csv"))
    assert code == 0
    assert run.columns["time_s"].tolist() == [60.0 * k for k in range(10)]
    for name in set(run.columns) - {"time_s"}:  # the same box, seen from minute 3 on
        np.testing.assert_array_equal(run.columns[name], whole.columns[name][3:])
    assert run.facts["record_from_s"] == "180"
    assert "record_from_s" not in whole.facts
    assert (run.start_utc or 0.0) - (whole.start_utc or 0.0) == 180.0


def test_what_safety_changed_during_the_lead_in_is_no_matter_of_the_run(tmp_path):
    fine_at_first = "# record_from_s: 120\ntime_s,heater_duty,fan_on\n0,0.33,0\n120,0.3,0\n240,0,0\n"
    _, run = record(tmp_path, profile_file(tmp_path, fine_at_first))
    assert run.facts["notes"] == "safety changed no command"


def test_the_history_keeps_the_run_without_its_lead_in_and_the_lead_in_as_ticks(tmp_path):
    database = tmp_path / "history.db"
    record(
        tmp_path,
        profile_file(tmp_path, "# record_from_s: 180\n" + TWELVE_MINUTES),
        "--history",
        str(database),
    )
    assert len(export_run(database, name="steps@4")) == 10
    assert len(export_run(database)) == 13


def test_a_stop_during_the_lead_in_leaves_no_run(tmp_path):
    profile = read_profile(profile_file(tmp_path, "# record_from_s: 600\n" + TWELVE_MINUTES))
    with lock_step(tmp_path) as clock:
        stop_after(clock, 200.0)
        with pytest.raises(GreenhouseError, match=r"steps\.csv: stopped during the lead-in"):
            run_experiment(Experiment(profile), settings_in(tmp_path, config.default()), clock)


def test_another_chamber_is_another_box(tmp_path):
    (tmp_path / "cold.yaml").write_text("room: {temp_c: 15}\n")
    _, run = record(tmp_path, profile_file(tmp_path), "--chamber", str(tmp_path / "cold.yaml"))
    assert run.columns["temp_air_c"][0] < 17.0
    assert run.facts["chamber"] == "cold.yaml"


def test_the_history_keeps_the_run_by_name(tmp_path):
    database = tmp_path / "history.db"
    _, run = record(tmp_path, profile_file(tmp_path), "--history", str(database))
    again = export_run(database, name="steps@1")
    np.testing.assert_array_equal(again.columns["temp_air_c"], run.columns["temp_air_c"])
    assert run.facts["history_id"] == again.facts["history_id"]


def test_a_stop_leaves_a_shorter_run_that_says_so(tmp_path):
    settings = settings_in(tmp_path, config.default())
    profile = read_profile(profile_file(tmp_path))
    with lock_step(tmp_path) as clock:
        stop_after(clock, 200.0)
        run, course = run_experiment(Experiment(profile), settings, clock)
        pins = clock.truth()["pins"]
    assert course.passed_s == 180.0
    assert "stopped after 3 of 12 min" in run.facts["notes"]
    assert len(run) == 4
    assert not pins["heater_relay"]


def test_a_killed_experiment_leaves_its_ticks_in_the_history(tmp_path):
    day = profile_file(tmp_path, "time_s,heater_duty,fan_on\n0,0.2,0\n864000,0,0\n")
    database, out = tmp_path / "history.db", tmp_path / "run.csv"
    command = [sys.executable, "-m", "edge", "experiment", str(day), "--out", str(out), "--virtual"]
    process = subprocess.Popen([*command, "--history", str(database)])
    try:
        give_up = time.monotonic() + 60.0
        while ticks_in(database) < 5 and time.monotonic() < give_up:
            time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    assert not out.exists()
    run = export_run(database)
    assert len(run) >= 5
    assert set(run.columns["heater_duty"].tolist()) == {0.2}


def ticks_in(database: Path) -> int:
    try:
        return sqlite3.connect(database).execute("SELECT count(*) FROM ticks").fetchone()[0]
    except sqlite3.Error:
        return 0


def test_standing_orders_wait_and_stand_again_afterwards(tmp_path):
    settings = settings_in(tmp_path, config.default())
    orders = Operation(controller="rules", reference_c=33.0)
    stand(settings, StandingState(orders, SafetyMemory()))
    profile = read_profile(profile_file(tmp_path))
    with lock_step(tmp_path) as clock:
        run, _ = run_experiment(Experiment(profile), settings, clock)
    assert run.facts["controllers"] == "profile"
    assert restore(STANDING, settings).operation == orders


@pytest.mark.parametrize(
    ("standing", "reason"),
    [
        (StandingState(Operation("MPC", emergency_stop=True), SafetyMemory()), "emergency stop"),
        (StandingState(Operation("MPC"), SafetyMemory(trips=("over_temperature",))), "over_temperature"),
    ],
)
def test_a_rig_that_is_held_off_is_not_experimented_with(tmp_path, standing, reason):
    settings = settings_in(tmp_path, config.default())
    stand(settings, standing)
    with pytest.raises(GreenhouseError, match=reason):
        run_experiment(Experiment(read_profile(profile_file(tmp_path))), settings, NoClock())


class NoClock:
    """Fails when an experiment begins that should have been refused."""

    def now(self) -> float:
        raise AssertionError("began")

    utc = wait = now


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ("time_s,heater_duty,fan_on\n0,0.5,0\n90,0,0\n", "control steps of 60 s"),
        ("time_s,heater_duty,fan_on\n0,0.5,0\n59,0,0\n", "shorter than a step"),
        ("time_s,heater_duty,fan_on\n0,0.5,0\n", "shorter than a step"),
        ("time_s,reference_c\n0,24\n600,39\n", "reference_c: 24..39 leaves"),
        (
            "# record_from_s: 90\ntime_s,heater_duty,fan_on\n0,0.5,0\n180,0,0\n",
            "record_from_s: it must stand",
        ),
        ("# record_from_s: 60\ntime_s,heater_duty,fan_on\n0,0.5,0\n90,0,0\n", "30 s are shorter than a step"),
        ("# record_from_s: 60\ntime_s,reference_c\n0,24\n90,24\n", "30 s are shorter than a step"),
    ],
)
def test_a_profile_that_does_not_fit_is_refused_before_it_begins(tmp_path, rows, reason):
    profile = read_profile(profile_file(tmp_path, rows))
    controller = "MPC" if profile.is_reference else "profile"
    with pytest.raises(DataError, match=reason):
        run_experiment(Experiment(profile, controller), settings_in(tmp_path, config.default()), NoClock())


def test_a_board_that_is_not_there_is_an_error_not_an_empty_run(tmp_path):
    settings = settings_in(tmp_path, config.default())
    settings = replace(settings, board=replace(settings.board, port=str(tmp_path / "none")))
    profile = read_profile(profile_file(tmp_path))
    with lock_step(tmp_path) as clock, pytest.raises(GreenhouseError, match="none"):
        run_experiment(Experiment(profile), settings, clock)


def test_a_late_tick_still_gets_its_own_row():
    rows = {"time_s": [0.0, 60.0, 120.0], "heater_duty": [0.1, 0.2, 0.3], "fan_on": [0.0, 1.0, 0.0]}
    profile = Profile({key: np.array(values) for key, values in rows.items()}, Path("p.csv"))
    controller = InputProfile(profile)
    at = [100.004, 160.0001, 221.0]  # the first tick was later than the second
    duties = [controller.decide(replace(context(), now_s=now)).command.heater_duty for now in at]
    assert duties == [0.1, 0.2, 0.3]


def paths_of(part: object, place: str = "") -> Iterator[tuple[str, str]]:
    """Settings that are absolute paths, by their keys."""
    for field in fields(part):
        value, key = getattr(part, field.name), f"{place}.{field.name}".lstrip(".")
        if is_dataclass(value):
            yield from paths_of(value, key)
        elif isinstance(value, str) and value.startswith("/"):
            yield key, value


def test_a_virtual_rig_touches_no_file_of_a_real_one(tmp_path: Path) -> None:
    elsewhere = dict(paths_of(settings_in(tmp_path, config.default())))
    assert elsewhere, "no setting is a path"
    assert [key for key, path in elsewhere.items() if not path.startswith(str(tmp_path))] == []
