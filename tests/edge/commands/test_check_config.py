"""edge/commands/check_config.py: everything that would not work, each with its key."""

import os
import socket
import stat
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.commands.check_config import problems
from edge.config import loading as config

MQTT = "mqtt: {{enabled: true, username: rig, tls: true, "
ERRORS = {
    "history.path: /: is a folder": "history: {{path: /}}",
    "history.path: {folder}/text: is not an SQLite database": "history: {{path: {folder}/text}}",
    "history.path: {folder}/fifo: is not a regular file": "history: {{path: {folder}/fifo}}",
    "history.path: {folder}/text/x/h.db: {folder}/text is not": "history: {{path: {folder}/text/x/h.db}}",
    "control_socket.path: /etc/passwd: exists and is not a socket": "control_socket: {{path: /etc/passwd}}",
    "is too long for a Unix socket": "control_socket: {{path: {folder}/" + "s" * 100 + "}}",
    "the folder {folder}/none is missing": "control_socket: {{path: {folder}/none/control.sock}}",
    "control_socket.path: is empty": 'control_socket: {{path: ""}}',
    "{folder}/one: is state_file too": "state_file: {folder}/one\nhistory: {{path: {folder}/one}}",
    "board.port: {folder}/text: is not a serial port": "board: {{port: {folder}/text}}",
    "state_file: {folder}/text": "state_file: {folder}/text",
    "mqtt.password_file: /none/password: No such file": MQTT + "password_file: /none/password}}",
    "mqtt.password_file: {folder}/open: mode 0644 lets others in": MQTT + "password_file: {folder}/open}}",
    "mqtt.ca: /none/ca.pem: No such file": MQTT + "ca: /none/ca.pem}}",
    "mqtt.ca: {folder}/text: ": MQTT + "ca: {folder}/text}}",
    "mqtt.client_key: /none/key: No such file": MQTT + "client_cert: {folder}/text, client_key: /none/key}}",
    "llm.key_file: /none/key: No such file": "llm: {{url: http://localhost, model: m, key_file: /none/key}}",
    "llm.ca: /none/ca.pem: No such file": "llm: {{url: https://localhost, model: m, ca: /none/ca.pem}}",
    "alarms.ntfy.token_file: /none/k: No such": "alarms: {{ntfy: {{url: http://x/t, token_file: /none/k}}}}",
    "alarms.mail.ca: /none/ca.pem: No such file": "alarms: {{mail: {{ca: /none/ca.pem}}}}",
    "bundle.path: {folder}/text: is not a folder": "bundle: {{path: {folder}/text}}",
    "bundle.trusted_keys: {folder}/text: is not a folder": "bundle: {{trusted_keys: {folder}/text}}",
    "bundle.signing_key: /none/key: No such file": "bundle: {{signing_key: /none/key}}",
    "drift.reports: {folder}/text: is not a folder": "drift: {{diagnose: always, reports: {folder}/text}}",
    "box.twin: /none/twin.yaml: cannot be read": "box: {{twin: /none/twin.yaml}}",
    "box.twin: {folder}/text: ": "box: {{twin: {folder}/text}}",
    "box.heater_w: 40 W, but": "box: {{heater_w: 40, twin: edge/models/default_bundle/twin.yaml}}",
    "external.socket: {folder}/text: exists and is not a socket": "external: {{socket: {folder}/text}}",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "text").write_text("neither JSON nor PEM nor SQLite")
    (tmp_path / "text").chmod(0o600)
    (tmp_path / "open").write_text("secret")
    (tmp_path / "open").chmod(0o644)
    os.mkfifo(tmp_path / "fifo")
    return tmp_path


@pytest.mark.parametrize(("message", "text"), ERRORS.items())
def test_what_would_not_work_is_an_error_with_its_key(
    folder: Path, message: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text += "" if "box: " in text else "\nbox: {{heater_w: 100}}\n"
    (folder / "edge.yaml").write_text(text.format(folder=folder))
    assert main(["check-config", str(folder / "edge.yaml")]) == 2
    told = capsys.readouterr()
    errors = [line for line in told.err.splitlines() if line.startswith("greenhouse check-config: ")]
    assert len(errors) == 1 and message.format(folder=folder) in errors[0]
    assert "is good" not in told.out


def test_all_that_is_wrong_on_the_machine_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "edge.yaml").write_text(
        "history: {path: /}\ncontrol_socket: {path: /etc/passwd}\ncontrol: {model: /none/arx.json}\n"
        "mqtt: {enabled: true, tls: true, username: rig, ca: /none/ca, password_file: /none/password}\n"
    )
    assert main(["check-config", str(folder / "edge.yaml")]) == 2
    told = capsys.readouterr().err
    for part in ("history.path", "control_socket.path", "/none/arx.json", "mqtt.ca", "mqtt.password_file"):
        assert told.count(part) == 1


def test_all_wrong_keys_and_values_are_said_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "edge.yaml").write_text(
        "board: {baudrite: 9600}\ncontrol: {horizon: 900, step_s: soon, fallback: PID}\nmqtt: 3\n"
    )
    assert main(["check-config", str(tmp_path / "edge.yaml")]) == 2
    told = capsys.readouterr().err.splitlines()
    parts = ("'baudrite'", "control.horizon: 900", "control.step_s", "control.fallback", "mqtt: must hold")
    assert len(told) == len(parts)
    assert all(any(part in line for line in told) for part in parts)


def test_a_path_with_a_nul_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "edge.yaml").write_text('board: {port: "/dev/a\\0b"}\n')
    assert main(["check-config", str(tmp_path / "edge.yaml")]) == 2
    assert "board.port: '/dev/a\\x00b'" in capsys.readouterr().err


def test_a_board_that_is_not_plugged_in_is_a_warning_that_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "edge.yaml").write_text("board: {port: /dev/no-board}\n")
    assert main(["check-config", str(tmp_path / "edge.yaml")]) == 0
    told = capsys.readouterr()
    assert f"warning: {tmp_path / 'edge.yaml'}: board.port: /dev/no-board: is not there" in told.err
    assert "is good" in told.out


def test_a_credential_of_the_service_is_a_warning_outside_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    settings = config.parse("mqtt: {enabled: true, username: rig, password_file: mqtt_password}")
    told = [each for each in problems(settings) if "mqtt" in each.text]
    assert [each.is_error for each in told] == [False]
    assert "mqtt.password_file: 'mqtt_password' is a systemd credential" in told[0].text


def test_a_rig_with_all_that_it_names_has_no_problem(tmp_path: Path) -> None:
    (tmp_path / "password").write_text("secret")
    (tmp_path / "password").chmod(stat.S_IRUSR)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "control.sock"))  # of the daemon that runs meanwhile
        settings = config.parse(
            f"""
board: {{port: /dev/null}}
box: {{heater_w: 100}}
state_file: {tmp_path}/state.json
history: {{path: {tmp_path}/new/history.db}}
control_socket: {{path: {tmp_path}/control.sock}}
bundle: {{path: {tmp_path}/bundles, trusted_keys: {tmp_path}}}
mqtt: {{enabled: true, username: rig, password_file: {tmp_path}/password, tls: true}}
"""
        )
        assert list(problems(settings)) == []


@pytest.mark.parametrize(
    ("text", "left", "is_error"),
    [
        ("", (), False),
        ("", ("state.json",), True),  # an upgrade: this rig heated before
        ("", ("state.json", "limits.json"), False),  # it did not: an upgrade changes nothing
        ("box: {heater_w: 100}\n", ("state.json",), None),
        ("safety: {heater_max_duty: 0}\n", ("state.json",), None),
    ],
)
def test_a_heater_of_unknown_power_is_named_before_the_rig_starts(
    tmp_path: Path, text: str, left: tuple[str, ...], is_error: bool | None
) -> None:
    for name in left:
        (tmp_path / name).write_text("{}")
    found = problems(config.parse(f"state_file: {tmp_path}/state.json\n{text}"))
    assert [one.is_error for one in found if one.text.startswith("box.heater_w: ")] == (
        [] if is_error is None else [is_error]
    )
