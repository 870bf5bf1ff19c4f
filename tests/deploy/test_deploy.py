"""Installation on a rig: unit, device rule, scripts; as far as a machine without systemd can tell."""

import contextlib
import hashlib
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from unit_calls import call_groups, resolved

from edge.__main__ import parser_for
from edge.app.daemon import REQUESTS_VARIABLE
from edge.app.nightly_diagnosis import REQUEST
from edge.config import loading as config
from edge.config.settings import Settings
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT, DaemonProcess, run_command
from tests.support.virtual_board import virtual_board

DEPLOY = ROOT / "deploy"
UNIT = DEPLOY / "greenhouse.service"
DIAGNOSIS = DEPLOY / "greenhouse-diagnosis.service"
PATH_UNIT = DEPLOY / "greenhouse-diagnosis.path"
EVIDENCE = DEPLOY / "greenhouse-evidence.service"
TIMER = DEPLOY / "greenhouse-evidence.timer"
PAGE = DEPLOY / "greenhouse-page.service"
UNITS = (UNIT, DIAGNOSIS, PATH_UNIT, EVIDENCE, TIMER, PAGE)
EXPOSURE_MAX = {UNIT: 2.0, DIAGNOSIS: 1.0, EVIDENCE: 1.0, PAGE: 2.0}
NOBODY = 65534
# Asked for and done without: sqlite gives files that root makes to their owner, OpenBLAS places memory.
DISPENSABLE_CALLS = {"fchown", "mbind"}


def needs(program: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


def values(key: str, unit: Path = UNIT) -> list[str]:
    """Values of one key of a unit, in order."""
    return re.findall(rf"^{key}=(.*)$", unit.read_text(), re.MULTILINE)


# the unit


@needs("systemd-analyze")
@pytest.mark.parametrize("unit", EXPOSURE_MAX)
def test_the_unit_is_hardened(unit: Path) -> None:
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    score = re.search(rf"Overall exposure level for {re.escape(unit.name)}: ([0-9.]+)", out)
    assert score is not None, out
    assert float(score[1]) <= EXPOSURE_MAX[unit]


@needs("systemd-analyze")
def test_systemd_has_nothing_to_say_against_the_units(tmp_path: Path) -> None:
    for unit in UNITS:
        text = re.sub(r"/opt/greenhouse/venv/bin/\w+", shutil.which("true") or "", unit.read_text())
        (tmp_path / unit.name).write_text(text)
    for unit in UNITS:
        done = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", str(tmp_path / unit.name)],
            capture_output=True,
            text=True,
            env={**os.environ, "SYSTEMD_UNIT_PATH": f"{tmp_path}:"},
        )
        assert (done.returncode, done.stderr) == (0, "")


def test_the_unit_starts_the_daemon() -> None:
    assert values("ExecStart") == [
        "/opt/greenhouse/venv/bin/greenhouse run --config /etc/greenhouse/edge.yaml"
    ]


def test_the_diagnosis_has_a_memory_limit_of_its_own_and_ends_with_the_daemon() -> None:
    assert values("MemoryMax", DIAGNOSIS) == ["320M"]
    assert values("OOMScoreAdjust", DIAGNOSIS) == ["1000"]
    assert values("BindsTo", DIAGNOSIS) == [UNIT.name]
    assert PATH_UNIT.stem == DIAGNOSIS.stem


def test_the_evidence_unit_seals_with_the_rigs_configuration() -> None:
    program, *words = values("ExecStart", EVIDENCE)[0].split()
    assert program == "/opt/greenhouse/venv/bin/greenhouse"
    arguments = parser_for("evidence").parse_args(words)
    assert (arguments.action, arguments.config) == ("extend", Path("/etc/greenhouse/edge.yaml"))
    assert TIMER.stem == EVIDENCE.stem
    assert values("OnCalendar", TIMER) == ["*-*-* 00:20:00 UTC"]


def test_the_page_has_a_user_of_its_own_in_the_daemons_group() -> None:
    assert values("ExecStart", PAGE) == [
        "/opt/greenhouse/venv/bin/python -P -m edge.page /etc/greenhouse/edge.yaml"
    ]
    assert values("User", PAGE) != values("User")
    assert values("Group", PAGE) == values("Group")


@needs("strace")
@needs("systemd-analyze")
def test_the_page_can_ask_the_twin_where_its_unit_refuses_what_it_refuses(tmp_path: Path) -> None:
    """Every call that the unit does not allow fails as there, with EPERM."""
    assert values("SystemCallFilter", PAGE) == values("SystemCallFilter")
    groups = call_groups()
    refused = resolved(["@privileged", "@resources"], groups)
    (tmp_path / "edge.yaml").write_text(
        f"bundle: {{path: {tmp_path}}}\ncontrol_socket: {{path: {tmp_path}/x}}\n"
    )
    code = f"""
import asyncio
from edge.page.questions import COMMAND, run_command
words = ("--config", "{tmp_path}/edge.yaml", "--reach=35", "--room=20")
print(asyncio.run(run_command((*COMMAND, *words)))["verdict"])
"""
    inject = ",".join(f"?{name}" for name in sorted(refused))
    output = tmp_path / "strace.txt"
    done = subprocess.run(
        [
            "strace",
            "-ff",  # a file per thread: in one file a call of another may cut a line in two
            "-qq",
            "-o",
            str(output),
            "-e",
            f"inject={inject}:error=EPERM",
            sys.executable,
            "-c",
            code,
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.stdout.startswith("Yes: 35 °C takes "), done.stderr
    trace = "".join(each.read_text() for each in tmp_path.glob(f"{output.name}.*"))
    assert re.search(r"setpriority\(.*EPERM.*INJECTED", trace)
    calls = set(re.findall(r"^([a-z_0-9]+)\(", trace, re.MULTILINE))
    assert calls - allowed_calls() <= {*DISPENSABLE_CALLS, "setpriority"}
    assert re.search(r"(mmap\(.*PROT_WRITE\|PROT_EXEC|mprotect\(.*PROT_EXEC)", trace) is None


def test_the_default_settings_of_the_page_lie_where_its_unit_allows() -> None:
    settings = Settings()
    assert settings.page.folder == f"/var/lib/{values('StateDirectory', PAGE)[0]}"
    assert f"-{settings.stop_folder}" in values("ReadWritePaths", PAGE)
    folders = (DEPLOY / "greenhouse.tmpfiles").read_text()
    assert re.search(rf"^d {settings.stop_folder} +2770 greenhouse +greenhouse$", folders, re.MULTILINE)


def test_daemon_path_unit_and_diagnosis_mean_one_folder() -> None:
    (folder,) = (value for value in values("Environment") if value.startswith(REQUESTS_VARIABLE))
    requests = folder.partition("=")[2]
    assert values("PathExists", PATH_UNIT) == [f"{requests}/{REQUEST}"]
    program, _, arguments = values("ExecStart", DIAGNOSIS)[0].partition(" ")
    assert program == "/opt/greenhouse/venv/bin/python"
    assert arguments == f"-m edge.app.nightly_diagnosis {requests}"
    assert requests.startswith(f"/run/{values('RuntimeDirectory')[0]}/")
    assert f"/run/{values('RuntimeDirectory')[0]}" in values("ReadWritePaths", DIAGNOSIS)[0].split()


def test_the_default_settings_lie_where_the_unit_allows() -> None:
    settings = Settings()
    state, runtime = f"/var/lib/{values('StateDirectory')[0]}/", f"/run/{values('RuntimeDirectory')[0]}/"
    assert settings.history.path.startswith(state)
    assert settings.state_file.startswith(state)
    assert settings.control_socket.path.startswith(runtime)


def test_a_refused_configuration_is_not_tried_again() -> None:
    assert values("RestartPreventExitStatus") == ["2"]  # exit code of a GreenhouseError, edge/__main__.py


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Sequence[str]:
    """System calls of a daemon with MPC and a broker that is not there, from its start to its end."""
    folder = tmp_path_factory.mktemp("trace")
    output = folder / "calls"
    daemon = DaemonProcess(folder, mqtt_port=1)
    with virtual_board(folder, "--real-time"):
        process = subprocess.Popen(
            ["strace", "-f", "-qq", "-o", str(output), *run_command(daemon.config)],
            stdout=subprocess.DEVNULL,
            cwd=ROOT,
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},  # as on a rig, where the program is root's
            start_new_session=True,
        )
        try:
            wait_for(lambda: daemon.seq() >= 3)
            os.killpg(process.pid, signal.SIGTERM)
            assert process.wait(20.0) == 0
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    return output.read_text().splitlines()


@needs("strace")
@needs("systemd-analyze")
def test_the_unit_lets_the_daemon_do_all_that_it_does(trace: Sequence[str]) -> None:
    calls = {match[1] for line in trace if (match := re.match(r"\d+ +([a-z_0-9]+)\(", line))}
    assert "openat" in calls
    assert calls - allowed_calls() <= DISPENSABLE_CALLS


@needs("strace")
def test_the_daemon_uses_no_address_family_that_the_unit_refuses(trace: Sequence[str]) -> None:
    used = {match[1] for line in trace if (match := re.search(r" socket(?:pair)?\((AF_\w+)", line))}
    assert {"AF_UNIX", "AF_INET"} <= used
    assert used <= set(values("RestrictAddressFamilies")[0].split())


@needs("strace")
def test_the_daemon_makes_no_memory_executable(trace: Sequence[str]) -> None:
    """MemoryDenyWriteExecute= refuses to map memory as both, and to make any executable later."""
    assert [line for line in trace if re.search(r" mmap\(.*PROT_WRITE\|PROT_EXEC", line)] == []
    assert [line for line in trace if re.search(r" mprotect\(.*PROT_EXEC", line)] == []


@needs("strace")
def test_of_proc_the_daemon_reads_its_own_folder_and_the_boot_id(trace: Sequence[str]) -> None:
    """ProtectProc=invisible hides other processes; ProtectKernelTunables= leaves the rest readable."""
    opened = {match[1] for line in trace if (match := re.search(r'"(/proc/[^"]*)"', line))}
    assert {path for path in opened if not re.match(r"/proc/(self|thread-self|\d+)/", path)} == {
        "/proc/sys/kernel/random/boot_id"
    }


@needs("strace")
def test_the_daemon_writes_only_where_its_settings_say(
    trace: Sequence[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    written = {
        match[1]
        for line in trace
        if (match := re.search(r'open(?:at)?\(.*"(/[^"]*)", O_(?:WRONLY|RDWR)', line))
    }
    assert any(path.endswith("history.db") for path in written)
    base = str(tmp_path_factory.getbasetemp())
    assert [path for path in written if not path.startswith((base, "/dev/"))] == []


def allowed_calls() -> set[str]:
    """System calls of SystemCallFilter=, groups resolved."""
    groups = call_groups()
    allowed: set[str] = set()
    for line in values("SystemCallFilter"):
        names = resolved(line.removeprefix("~").split(), groups)
        allowed = allowed - names if line.startswith("~") else allowed | names
    return allowed | resolved(["@default"], groups)


# the device rule


def test_the_rule_names_the_port_that_the_default_settings_open() -> None:
    rules = (DEPLOY / "70-greenhouse.rules").read_text()
    link = re.search(r'SYMLINK\+="(\w+)"', rules)
    assert link is not None
    assert f"/dev/{link[1]}" == Settings().board.port
    assert 'ENV{ID_MM_PORT_IGNORE}="1"' in rules


def test_every_line_of_the_rule_is_one() -> None:
    text = (DEPLOY / "70-greenhouse.rules").read_text().replace("\\\n", "")
    term = r'[A-Z]+(\{\w+\})?(==|!=|=|\+=)"[^"]*"'
    for line in filter(None, text.splitlines()):
        if line != "#" and not line.startswith("# "):  # an example behind a bare # must be right too
            assert re.fullmatch(rf"#?{term}(, +{term})*", line), line


# the scripts


@needs("shellcheck")
@pytest.mark.parametrize(
    "script",
    [
        "deploy/install.sh",
        "deploy/install-fleet.sh",
        "deploy/uninstall.sh",
        "tests/install_tools.sh",
        ".ci/run",
    ],
)
def test_the_shell_finds_nothing_wrong(script: str) -> None:
    done = subprocess.run(["shellcheck", str(ROOT / script)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def install(*arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    """install.sh, its virtual environment without packages of its own: those of the tests are lent to it."""
    lent = {
        "PIP_NO_DEPS": "1",
        "PIP_NO_BUILD_ISOLATION": "0",  # pip's word for "use what is there"
        "PYTHONPATH": sysconfig.get_path("purelib"),
        "PYTHON": sys.executable,
    }
    return subprocess.run(
        ["sh", str(DEPLOY / "install.sh"), *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **lent, **environment},
        umask=0o077,  # as a careful root may have it
    )


def contents(root: Path) -> dict[str, str]:
    """Return the files below `root`: mode and digest, or target, by path."""
    found = {}
    for path in sorted(root.rglob("*")):
        if path.suffix == ".pyc":  # no two compilations are alike
            continue
        if path.is_symlink():
            what = str(path.readlink())
        else:
            what = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "folder"
        found[str(path.relative_to(root))] = f"{stat.S_IMODE(path.lstat().st_mode):04o} {what}"
    return found


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    root = tmp_path_factory.mktemp("root")
    done = install("--root", str(root))
    assert done.returncode == 0, done.stderr
    yield root


@pytest.mark.parametrize("script", ["install.sh", "deb/postinst"])
def test_a_first_installation_names_the_rig_by_its_machine(tmp_path: Path, script: str) -> None:
    text = (DEPLOY / script).read_text()
    (code,) = re.findall("-P -c '(.*)'", text)
    edge = tmp_path / "edge.yaml"
    edge.write_text((DEPLOY / {"install.sh": "edge.example.yaml"}.get(script, "deb/edge.yaml")).read_text())
    program = code.replace("/etc/greenhouse/edge.yaml", str(edge))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    (change,) = re.findall(r"^ +(?:run )?((?:sed|echo) .*\$name.*)$", text, re.MULTILINE)
    shell = f"etc={tmp_path}; name={done.stdout.strip()}; {change.replace('/etc/greenhouse', str(tmp_path))}"
    subprocess.run(["sh", "-c", shell], check=True)
    name = config.load(edge).mqtt.rig
    assert name == done.stdout.strip() and re.search("-[0-9a-f]{6}$", name)
    assert config.load(edge).mqtt == replace(config.default().mqtt, rig=name)


def test_install_puts_everything_in_its_place(installed: Path) -> None:
    for unit in UNITS:
        assert (installed / "etc/systemd/system" / unit.name).read_bytes() == unit.read_bytes()
    assert (installed / "etc/udev/rules.d/70-greenhouse.rules").exists()
    assert stat.S_IMODE((installed / "opt/greenhouse/venv/bin/greenhouse").stat().st_mode) == 0o755
    assert config.load(installed / "etc/greenhouse/edge.yaml") == config.default()
    assert stat.S_IMODE((installed / "var/lib/greenhouse/stops").stat().st_mode) == 0o2770
    assert stat.S_IMODE((installed / "var/lib/greenhouse-page").stat().st_mode) == 0o700
    assert stat.S_IMODE((installed / "etc/greenhouse/edge.yaml").stat().st_mode) == 0o640
    assert stat.S_IMODE((installed / "etc/greenhouse/credentials").stat().st_mode) == 0o700
    assert stat.S_IMODE((installed / "etc/greenhouse/page-credentials").stat().st_mode) == 0o700
    assert stat.S_IMODE((installed / "etc/greenhouse/keys").stat().st_mode) == 0o750


def test_a_second_install_keeps_and_checks_the_configuration_and_changes_nothing(installed: Path) -> None:
    edited = installed / "etc/greenhouse/edge.yaml"
    first = edited.read_text()
    edited.write_text("reference: {reference_c: 99}\n")
    before = contents(installed)
    done = install("--root", str(installed))
    assert done.returncode != 0
    assert "reference.reference_c: 99" in done.stderr
    assert contents(installed) == before
    edited.write_text(first)


def test_install_beside_a_fleet_keeps_its_programs_and_uninstall_leaves_them(
    installed: Path, tmp_path: Path
) -> None:
    root = tmp_path / "root"
    shutil.copytree(installed, root, symlinks=True)
    fleet = root / "opt/greenhouse/src/fleet"  # as install-fleet.sh puts it
    assert not fleet.exists()
    fleet.mkdir()
    done = install("--root", str(root))
    assert done.returncode == 0, done.stderr
    assert (fleet / "command.py").exists()
    (installed_fleet,) = root.glob("opt/greenhouse/venv/lib/python*/site-packages/fleet/command.py")
    assert installed_fleet.read_bytes() == (ROOT / "fleet" / "command.py").read_bytes()
    (root / "etc/systemd/system/greenhouse-fleet.target").write_text("")
    refused = subprocess.run(
        ["sh", str(DEPLOY / "uninstall.sh"), "--root", str(root)], capture_output=True, text=True
    )
    assert (refused.returncode, "first greenhouse fleet down" in refused.stderr) == (1, True)
    assert fleet.exists()


def test_a_dry_run_says_what_it_would_do_and_does_nothing(tmp_path: Path) -> None:
    done = install("--dry-run", "--root", str(tmp_path / "root"))
    assert done.returncode == 0, done.stderr
    assert "greenhouse.service" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_install_wants_root() -> None:
    script = (DEPLOY / "install.sh").read_text()
    other = {"user": NOBODY, "group": NOBODY} if os.getuid() == 0 else {}
    done = subprocess.run(["sh", "-s"], input=script, capture_output=True, text=True, cwd="/", **other)
    assert done.returncode == 1
    assert "must be run as root" in done.stderr


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("#!/bin/sh\necho 'Python 3.9.2'\n[ \"$1\" = -V ]\n", "Python 3.9.2, Python 3.11 or newer is needed"),
        ('#!/bin/sh\ncase "$2" in *venv*) exit 1;; esac\n', "apt install python3-venv"),
    ],
)
def test_install_wants_a_python_that_is_fit(tmp_path: Path, program: str, reason: str) -> None:
    python = tmp_path / "python"
    python.write_text(program)
    python.chmod(0o755)
    done = install("--root", str(tmp_path / "root"), PYTHON=str(python))
    assert done.returncode == 1
    assert reason in done.stderr
    assert not (tmp_path / "root").exists()


def test_install_says_which_python_is_missing(tmp_path: Path) -> None:
    done = install("--root", str(tmp_path / "root"), PYTHON="python-of-nowhere")
    assert done.returncode == 1
    assert "python-of-nowhere is missing" in done.stderr


@pytest.mark.parametrize("arguments", [["--force"], ["--root"]])
def test_install_takes_no_argument_that_it_does_not_know(arguments: list[str]) -> None:
    done = install(*arguments)
    assert done.returncode != 0
    assert done.stdout == ""


def test_uninstall_keeps_configuration_and_history(installed: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    shutil.copytree(installed, root, symlinks=True)
    history = root / "var/lib/greenhouse/history.db"
    history.parent.mkdir(parents=True, exist_ok=True)
    history.write_text("rows")
    for _ in range(2):
        done = subprocess.run(
            ["sh", str(DEPLOY / "uninstall.sh"), "--root", str(root)], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    left = {
        path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file() or path.is_symlink()
    }
    assert left == {"etc/greenhouse/edge.yaml", "var/lib/greenhouse/history.db"}
