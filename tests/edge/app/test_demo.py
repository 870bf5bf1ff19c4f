"""`greenhouse demo`, as a newcomer runs it: a process, its output, its end."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from edge.__main__ import main
from tests.support.broker import Broker, Listener, needs_mosquitto
from tests.support.daemon_process import ROOT
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow

DEMO = [sys.executable, "-m", "edge", "demo"]
MODULES = os.pathsep.join((str(ROOT), os.environ["PYTHONPATH"]))  # from any folder


def test_ten_minutes_heat_the_box_and_end_with_the_heater_off(tmp_path: Path) -> None:
    command = [*DEMO, "--speed", "0", "--minutes", "10", "--out", str(tmp_path / "kept")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    ticks = [line for line in done.stdout.splitlines() if " tick " in line]
    assert len(ticks) == 10
    assert "heater pin is off" in done.stdout.splitlines()[-1]
    air = [float(line.split(" air ")[1].split()[0]) for line in ticks]
    assert air[-1] > air[0] + 1.0  # the reference is above the room
    assert (tmp_path / "kept" / "history.db").exists()


def test_ctrl_c_stops_it_cleanly_with_the_heater_off(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [*DEMO, "--speed", "600"], stdout=subprocess.PIPE, text=True, start_new_session=True, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": MODULES},
    )  # fmt: skip
    assert process.stdout is not None
    first = process.stdout.readline()
    assert " tick " in first
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)
    rest, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert rest.splitlines()[-1] == "stopped; the board's heater pin is off"
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_controller_is_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--controller", "MPD", "--minutes", "1"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "MPD" in line


def test_a_policy_of_the_packaged_bundle_and_a_language_model_can_be_tried() -> None:
    with StandIn() as server:
        llm = ["--llm-url", server.url, "--llm-model", "stand-in"]
        for name, more in (("RL-Off", []), ("LLM-HAM-Te0", llm)):
            command = [*DEMO, "--controller", name, *more, "--speed", "0", "--minutes", "2"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
            ticks = [line for line in done.stdout.splitlines() if " tick " in line]
            assert name in ticks[-1], done.stderr


@needs_mosquitto
def test_a_demo_publishes_at_the_broker_that_is_named(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "greenhouse/demo/#") as listener:
        command = [*DEMO, "--mqtt", f"localhost:{broker.port}", "--speed", "60", "--minutes", "2"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        assert listener.objects("greenhouse/demo/state")[-1]["temp_air_c"] > 15.0


def test_the_demo_names_the_program_as_it_was_called(tmp_path: Path) -> None:
    program = tmp_path / "greenhouse"
    program.write_text(f"#!{sys.executable}\nfrom edge.__main__ import main\nraise SystemExit(main())\n")
    program.chmod(0o755)
    for path, called in (("/nowhere", str(program)), (str(tmp_path), "greenhouse")):
        done = subprocess.run(
            [str(program), "demo", "--speed", "0", "--minutes", "1"],
            capture_output=True, text=True, timeout=60, check=False,
            env={**os.environ, "PATH": f"{path}:/usr/bin:/bin", "PYTHONPATH": MODULES},
        )  # fmt: skip
        assert done.stderr.startswith(f"in another terminal: {called} status ("), done.stderr


def test_other_commands_speak_to_a_running_demo_by_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", os.environ["TMPDIR"])  # of the demo

    def said(*words: str) -> tuple[str, str]:
        assert main([*words]) == 0
        return capsys.readouterr()

    demo = subprocess.Popen(
        [*DEMO, "--speed", "600"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert demo.stdout is not None and demo.stderr is not None
    assert "in another terminal: greenhouse status" in demo.stderr.readline()
    for _ in range(3):
        demo.stdout.readline()
    try:
        assert said("reference", "26")[0].startswith("Holding 26.0 °C by hand.")
        status, remark = said("status")
        assert "reference" in status and "set by hand to 26.0 °C" in status
        assert "not a real rig" in remark
        ago, _ = said("why", "--at", "1min")  # by the demo's clock, which shows another year
        assert ago.startswith("Tick ")
    finally:
        demo.send_signal(signal.SIGINT)
        demo.communicate(timeout=30)
    said("plot", "--since", "90min", "--out", str(tmp_path / "p.png"))
    assert (tmp_path / "p.png").stat().st_size > 1000
