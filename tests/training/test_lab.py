"""training/lab.py: one rig in simulated time, whichever way its board runs."""

import os
import signal

import numpy as np
import pytest

from edge.config import loading as config
from training.lab import Lab

SETTINGS = config.parse(
    "{timezone: UTC, control: {controller: rules}, drift: {enabled: false}, reference: {reference_c: 25}}",
    "test",
)


def test_the_board_in_this_process_gives_the_run_of_the_one_behind_a_line():
    runs = []
    for board in ("here", "process"):
        with Lab(SETTINGS, board=board, seed=3, chamber={"room": {"start_hour": 3}}, with_truth=True) as lab:
            lab.run(minutes=15)
        runs.append(lab)
    near, far = (lab.columns() for lab in runs)
    assert len(near["time_s"]) == 15
    for name in near.keys() - {"solve_ms"}:
        np.testing.assert_array_equal(near[name], far[name], err_msg=name)
    assert [one.changes for one in runs[0].history] == [one.changes for one in runs[1].history]


def test_a_second_run_is_a_restart_of_the_daemon_on_the_same_board_and_files():
    with Lab(SETTINGS, board="here") as lab:
        lab.run(ticks=2)
        first_end_s = lab.board.now()
        lab.run(minutes=3)
        assert (lab.folder / "history.db").exists()
    assert [record.seq for record in lab.history] == [1, 2, 3, 4, 5]
    assert lab.history[2].time_s > first_end_s
    assert not lab.folder.exists()


def test_an_open_end_keeps_no_history_and_stop_ends_it():
    seen = []
    with Lab(SETTINGS, board="here", on_tick=lambda record: seen.append(record) or lab.stop()) as lab:
        lab.run()
    assert (len(seen), lab.history) == (1, [])


def test_a_signal_before_the_limit_is_not_a_short_run():
    def interrupt(record):
        os.kill(os.getpid(), signal.SIGTERM)

    with Lab(SETTINGS, board="here", on_tick=interrupt) as lab, pytest.raises(KeyboardInterrupt):
        lab.run(minutes=5)
    assert len(lab.history) == 1
