import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from edge.config.secrets import SIZE_MAX, Secret, read_secret, secret_path
from edge.core.errors import ConfigError

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
