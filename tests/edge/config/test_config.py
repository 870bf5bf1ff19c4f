"""edge/config: settings, the example file and secrets."""

import dataclasses
import math
import os
import re
from datetime import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import loading as config
from edge.config.example import changed_keys, changes, document
from edge.config.secrets import SIZE_MAX, Secret, read_secret, secret_path
from edge.config.settings import SafetySettings, Settings
from edge.core import hard_limits
from edge.core.errors import ConfigError
from edge.formats.cross_check import Section

EXAMPLE = Path(__file__).parents[3] / "deploy" / "edge.example.yaml"


def refusal(source: str) -> str:
    with pytest.raises(ConfigError) as caught:
        config.parse(source)
    return str(caught.value)


def leaves(section: Section, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], dataclasses.Field]]:
    found = []
    for item in dataclasses.fields(section):
        value = getattr(section, item.name)
        found += (
            leaves(value, (*path, item.name)) if isinstance(value, Section) else [((*path, item.name), item)]
        )
    return found


LEAVES = leaves(Settings())
NUMBERS = [
    (path, item) for path, item in LEAVES if item.type in (float, int) and not item.metadata["rule"].choices
]


def nested(path: tuple[str, ...], value: str) -> str:
    return "{" + ": {".join(path) + f": {value}" + "}" * len(path)


def test_an_empty_file_gives_the_defaults():
    assert config.parse("") == config.default()


def test_the_example_file_is_what_the_settings_say():
    assert EXAMPLE.read_text() == document(Settings())


def test_the_example_file_holds_the_defaults():
    assert config.load(EXAMPLE) == config.default()


@pytest.mark.parametrize(
    ("path", "item"), LEAVES, ids=lambda value: ".".join(value) if isinstance(value, tuple) else ""
)
def test_every_key_says_what_it_is(path, item):
    rule = item.metadata["rule"]
    assert rule.doc
    if item.type is float:
        assert rule.unit and math.isfinite(rule.low) and math.isfinite(rule.high)


def test_a_misspelt_key_is_refused_with_the_nearest_known_one():
    assert refusal("board: {baudrte: 9600}") == (
        "edge.yaml: board: unknown key 'baudrte'; did you mean 'baudrate'?"
    )


HARD_LIMITS = {  # smallest and largest value as plain numbers: who changes a limit changes this table
    "safety.temp_air_max_c": (None, 60.0),
    "safety.temp_trip_c": (None, 65.0),
    "safety.reading_age_max_s": (None, 60.0),
    "safety.heater_rise_per_s": (None, 1.0),
    "safety.valve_pulse_max_s": (None, 10.0),
    "safety.valve_day_max_s": (None, 600.0),
    "watering.pulse_s": (None, 10.0),
    "watering.daily_max_s": (None, 600.0),
    "control.step_s": (1.0, 600.0),
    "reference.reference_c": (5.0, 45.0),
    "reference.min_c": (5.0, 45.0),
    "reference.max_c": (5.0, 45.0),
    "calibration.temp_air.offset": (-5.0, 5.0),
    "calibration.temp_air.gain": (0.9, 1.1),
}


OUT_OF_RANGE = re.compile("(above the hard limit|below the smallest allowed,|beyond the hard limits?) ")


@pytest.mark.parametrize("key", HARD_LIMITS)
def test_a_hard_limit_is_in_its_range_and_a_thousandth_beyond_is_not(key):
    path = tuple(key.split("."))
    for limit, step in zip(HARD_LIMITS[key], (-1e-3, 1e-3), strict=True):
        if limit is not None:
            assert OUT_OF_RANGE.search(refusal(nested(path, repr(limit + step))))
            try:
                config.parse(nested(path, repr(limit)))
            except ConfigError as error:  # another key may forbid the limit
                assert not OUT_OF_RANGE.search(str(error))


@pytest.mark.parametrize(
    ("path", "item"), NUMBERS, ids=lambda value: ".".join(value) if isinstance(value, tuple) else ""
)
def test_every_number_is_held_to_its_range(path, item):
    rule = item.metadata["rule"]
    step = 1 if item.type is int else max(abs(rule.high), abs(rule.low)) * 1e-6
    place = f"edge.yaml: {'.'.join(path)}: "
    for outside in (rule.low - step, rule.high + step):
        assert refusal(nested(path, repr(outside))).startswith(place)


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_no_value_widens_a_hard_limit(value):
    try:
        safety = dataclasses.replace(SafetySettings(), temp_air_max_c=value)
    except ConfigError:
        return
    assert safety.temp_air_max_c <= hard_limits.TEMP_AIR_MAX_C


def test_the_lease_and_the_longest_maintenance_are_those_of_the_manual():
    assert hard_limits.LEASE_S == 10.0
    assert hard_limits.MAINTENANCE_MAX_MIN / 60.0 == 24.0


def test_settings_made_in_code_are_held_to_the_same_limits():
    with pytest.raises(ConfigError, match="above the hard limit"):
        SafetySettings(temp_air_max_c=61.0)


@pytest.mark.parametrize("source", ["a: [", "\t- x", "a: b: c", "*x", "!!python/object:os.system {}"])
def test_what_is_no_yaml_is_refused_with_its_line(source):
    assert "line 1" in refusal(source)


def test_an_empty_section_keeps_its_defaults():
    assert config.parse("board:\nsafety: ~\n") == config.default()


def test_on_and_off_are_keys_and_times_need_no_quotes():
    lighting = config.parse("lighting: {on: 06:00, off: 22:00}").lighting
    assert (lighting.on, lighting.off) == (time(6), time(22))


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("safety: {temp_trip_c: 40}", "safety.temp_trip_c: must be above temp_air_max_c, 40"),
        ("safety: {temp_air_max_c: 37}", "reference.max_c: must be below safety.temp_air_max_c, 37"),
        ("reference: {min_c: 30, max_c: 30}", "reference.min_c: must be below max_c, 30"),
        ("reference: {reference_c: 39}", "reference.reference_c: 39 is outside min_c..max_c, 15..38"),
        ("reference: {kind: daily}", "reference.daily: is empty but kind is daily"),
        ("reference: {kind: csv}", "reference.csv: is empty but kind is csv"),
        ("reference: {kind: ramp, ramp: {to_c: 10}}", "reference.ramp.to_c: 10 is outside min_c..max_c"),
        ("reference: {steps: [{at_s: 9}, {at_s: 9}]}", "reference.steps: at_s must rise"),
        ("reference: {daily: [{at: 06:00}, {at: 06:00}]}", "reference.daily: times must rise"),
        ("reference: {daily: [{at: 06:00}, {at: 05:59}]}", "reference.daily: times must rise"),
        ("reference: {daily: [{at: 06:00, reference_c: 14}]}", "daily[0].reference_c: 14 is outside"),
        ("lighting: {on: 22:00}", "lighting.off: is the same time as on"),
        ("mqtt: {ca: x}", "mqtt.tls: must be true"),
        ("mqtt: {client_cert: x}", "mqtt.tls: must be true"),
        ("mqtt: {tls: true, client_cert: x}", "mqtt.client_key: client_cert and client_key go together"),
        ("mqtt: {client_key: x}", "mqtt.client_key: client_cert and client_key go together"),
        ("mqtt: {password_file: x}", "mqtt.username: is empty"),
        *(
            (f"{section}: {{host: '{value}'}}", f"{section}.host: {value!r} is not a host name or an IP")
            for section in ("mqtt", "page")
            for value in ("mqtt://broker:1883", "broker:1883", "10.0.0.300")
        ),
        ("mqtt: {host: ''}", "mqtt.host: '' does not match"),
        ("page: {names: [ok.example.org, 'https://x.org']}", "page.names: 'https://x.org' is not"),
        ("alarms: {mail: {host: 'smtp://mail.lan'}}", "alarms.mail.host: 'smtp://mail.lan' is not a host"),
        ("alarms: {page_url: 'http://a@b:c/'}", "alarms.page_url: is not https://HOST/PATH"),
        ("bundle: {source: 'http://a@b:c/'}", "bundle.source: is not https://HOST/PATH"),
        ("llm: {model: m, url: 'http://a@b:c/'}", "llm.url: is not https://HOST/PATH"),
        ("llm: {model: m, url: 'http://b/v1?c=d'}", "llm.url: has a part behind a question mark"),
        ("{bundle: {path: ''}, control: {controller: RL-Off}}", "controller: RL-Off needs bundle.path"),
        ("alarms: {ntfy: {url: 'https://u:pw@ntfy.sh/t'}}", "alarms.ntfy.url: is not https://HOST/PATH"),
        ("alarms: {webhook: {url: 'ftp://x/t'}}", "alarms.webhook.url: is not https://HOST/PATH"),
        ("alarms: {life_sign: {url: 'https://x/', url_file: /x}}", "alarms.life_sign.url_file: url is given"),
        ("alarms: {mail: {host: mail.lan, to: [a@b.org]}}", "alarms.mail.sender: is empty"),
        ("alarms: {mail: {host: mail.lan, sender: a@b.org}}", "alarms.mail.to: is empty"),
        ("alarms: {mail: {host: m, sender: a@b.org, to: ['a b@c']}}", "alarms.mail.to[0]: is not an address"),
        (
            "alarms: {mail: {host: m, sender: a@b.org, to: [a@b.org], username: a}}",
            "alarms.mail.password_file: username and password_file go together",
        ),
        (
            "alarms: {mail: {host: m, sender: a@b.c, to: [a@b.c], username: a, password_file: p, tls: none}}",
            "alarms.mail.tls: a password is sent over an encrypted line alone",
        ),
        ("mqtt: {rig: 'a/b'}", "mqtt.rig: 'a/b' does not match"),
        ("mqtt: {topic_prefix: ''}", "mqtt.topic_prefix: '' does not match"),
        ("history: {retention_days: 5}", "history.downsample_after_days: is more than retention_days, 5"),
        ("watering: {pulse_s: 5.1}", "watering.pulse_s: is more than safety.valve_pulse_max_s, 5"),
        ("calibration: {temp_air: {offset: -5.1}}", "temp_air.offset: -5.1 is beyond the hard limit"),
        ("calibration: {temp_air: {gain: 1.2}}", "calibration.temp_air.gain: 1.2 is beyond the hard limit"),
        ("control: {controller: mpc}", "control.controller: 'mpc' is none of rules, PID, MPC"),
        ("board: {baudrate: 12345}", "board.baudrate: 12345 is none of"),
        ("timezone: Mars/Base", "timezone: 'Mars/Base' is neither"),
        ("timezone: ../etc", "timezone: '../etc' is neither"),
    ],
)  # fmt: skip
def test_values_that_contradict_each_other_are_refused(source, message):
    assert message in refusal(source)


def test_a_reference_by_the_clock_is_read():
    source = "reference: {kind: daily, daily: [{at: '06:00', reference_c: 26}, {at: 22:30, reference_c: 20}]}"
    daily = config.parse(source).reference.daily
    assert [(point.at, point.reference_c) for point in daily] == [(time(6), 26.0), (time(22, 30), 20.0)]


def test_errors_of_a_file_name_that_file(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing\.yaml: cannot be read"):
        config.load(tmp_path / "nothing.yaml")
    path = tmp_path / "rig.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"rig\.yaml: cannot be read"):
        config.load(path)
    path.write_text("safety: {temp_air_max_c: 99}")
    with pytest.raises(
        ConfigError, match=r"rig\.yaml: safety\.temp_air_max_c: 99 is above the hard limit 60"
    ):
        config.load(path)


def test_equal_settings_have_one_hash_however_they_are_written():
    assert config.config_hash(config.parse("board: {baudrate: 115200}")) == config.config_hash(
        config.default()
    )


@pytest.mark.parametrize(
    "source", ["board: {port: x}", "lighting: {on: 06:01}", "reference: {steps: [{at_s: 0}]}"]
)
def test_different_settings_have_different_hashes(source):
    assert config.config_hash(config.parse(source)) != config.config_hash(config.default())


@given(st.text(max_size=40))
def test_any_text_is_settings_or_a_refusal(source):
    try:
        assert isinstance(config.parse(source), Settings)
    except ConfigError as error:
        assert str(error).startswith("edge.yaml: ")


def test_the_changes_of_settings_are_read_back_as_these_settings():
    settings = config.parse(
        'board: {port: "/dev/serial/by-id/a \\"b\\""}\n'
        "estimator: {offset_sd_k: 0.000002}\n"
        'reference: {kind: daily, daily: [{at: "06:00", reference_c: 26}, {at: "22:00", reference_c: 20}]}\n'
        'lighting: {enabled: true, on: "07:30"}\n'
        "calibration: {temp_air: {offset: -0.3}}\n"
    )
    text = changes(settings)
    assert config.parse(text) == settings
    assert text.count("\n") == 13  # sections and keys, nothing that is as usual
    assert changes(Settings()) == ""


def test_each_changed_key_is_named_with_both_values():
    settings = config.parse('control: {step_s: 30, controller: rules}\nlighting: {on: "07:30"}\n')
    assert list(changed_keys(settings, Settings())) == [
        ("control.step_s", "60.0", "30.0"),
        ("control.controller", '"auto"', '"rules"'),
        ("lighting.on", '"06:00"', '"07:30"'),
    ]


PLACE = "mqtt.password_file"


@pytest.fixture
def secret_file(tmp_path):
    def write(content: bytes, mode: int = 0o600):
        path = tmp_path / "secret"
        path.write_bytes(content)
        path.chmod(mode)
        return path

    return write


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"hunter2", "hunter2"),
        (b"hunter2\n", "hunter2"),
        (b"hunter2\r\n", "hunter2"),
        (b" two words \n", " two words "),
        (b"line\n\n", "line\n"),
        ("pässword".encode(), "pässword"),
        (b"x" * SIZE_MAX, "x" * SIZE_MAX),
    ],
)
def test_a_secret_is_the_text_without_the_newline_at_its_end(secret_file, content, text):
    assert read_secret(str(secret_file(content)), PLACE).value == text


@pytest.mark.parametrize("mode", [0o400, 0o600, 0o440, 0o640, 0o700])
def test_a_file_of_owner_and_group_is_taken(secret_file, mode):
    assert read_secret(str(secret_file(b"x", mode)), PLACE).value == "x"


@pytest.mark.parametrize("mode", [0o604, 0o644, 0o602, 0o601, 0o620, 0o660, 0o610, 0o666, 0o777])
def test_a_file_that_lets_others_in_is_refused(secret_file, mode):
    with pytest.raises(ConfigError, match=rf"{PLACE}: .*mode {mode:04o} lets others in"):
        read_secret(str(secret_file(b"x", mode)), PLACE)


@pytest.mark.parametrize(
    ("content", "problem"),
    [(b"", "is empty"), (b"\n", "is empty"), (b"\xff\xfe", "not UTF-8"), (b"x" * (SIZE_MAX + 1), "over")],
)
def test_a_file_that_is_no_secret_is_refused(secret_file, content, problem):
    with pytest.raises(ConfigError, match=problem):
        read_secret(str(secret_file(content)), PLACE)


def test_an_error_never_holds_the_secret(secret_file):
    with pytest.raises(ConfigError) as error:
        read_secret(str(secret_file(b"hunter2\xff")), PLACE)
    told = f"{error.value}{error.value.__cause__}{error.value.__context__ if error.value.__cause__ else ''}"
    assert "hunter2" not in told


def test_a_missing_file_and_a_directory_are_named(tmp_path):
    with pytest.raises(ConfigError, match=rf"{PLACE}: {tmp_path}/none: No such file"):
        read_secret(f"{tmp_path}/none", PLACE)
    with pytest.raises(ConfigError, match="is not a file"):
        read_secret(str(tmp_path), PLACE)


NOBODY = 65534  # a user without rights


@pytest.fixture
def hidden_file():
    """A file that may not be read, in a folder that may; root, who may read all, is nobody for the while."""
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        path = Path(folder) / "secret"
        path.touch(0o000)
        user = os.geteuid()
        os.seteuid(user or NOBODY)
        yield path
        os.seteuid(user)


def test_a_file_that_may_not_be_read_is_refused(hidden_file):
    with pytest.raises(ConfigError, match="Permission denied"):
        read_secret(str(hidden_file), PLACE)


def test_a_bare_name_is_a_systemd_credential(tmp_path, monkeypatch, secret_file):
    secret_file(b"from systemd", 0o440)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert read_secret("secret", PLACE).value == "from systemd"
    assert secret_path("secret", PLACE) == tmp_path / "secret"


@pytest.mark.parametrize("name", ["..", "."])
def test_a_credential_is_a_file_in_that_directory(tmp_path, monkeypatch, name):
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    with pytest.raises(ConfigError, match="is not a file"):
        read_secret(name, PLACE)


@pytest.mark.parametrize("directory", [None, ""])
def test_a_bare_name_outside_systemd_is_an_error_that_says_so(monkeypatch, directory):
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    if directory is not None:
        monkeypatch.setenv("CREDENTIALS_DIRECTORY", directory)
    with pytest.raises(ConfigError, match="outside systemd give a path"):
        read_secret("secret", PLACE)


def test_a_secret_does_not_show_itself():
    secret = Secret("hunter2")
    assert "hunter2" not in f"{secret} {secret!r} {[secret]} {secret:}"
