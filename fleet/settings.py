"""Every setting of a fleet: default, unit, range and meaning; `fleet.yaml` holds them."""

from dataclasses import dataclass, field
from pathlib import Path

from edge.config.loading import all_problems
from edge.config.settings import MqttSettings
from edge.formats.address import host_problem, url_problem
from edge.formats.cross_check import Section, items, number, text, whole
from edge.formats.reader import read_yaml


@dataclass(frozen=True, slots=True)
class DatabaseSettings(Section):
    """Rigs, events, bundles, twins, jobs and people."""

    url: str = text(
        "sqlite:////var/lib/greenhouse-fleet/fleet.db",
        "SQLAlchemy's URL: sqlite:////PATH, or postgresql+psycopg://USER@HOST/NAME",
        pattern=r"(sqlite|postgresql\+psycopg)://.*",
    )
    password_file: str = text("", "file of PostgreSQL's password; a bare name is a systemd credential")


@dataclass(frozen=True, slots=True)
class NumbersSettings(Section):
    """Every number of every tick."""

    url: str = text(
        "http://127.0.0.1:8428",
        "VictoriaMetrics: one node, and no proxy between",
        form=url_problem,
    )
    retention_days: float = number(
        3650.0,
        "older ticks are refused; at most -retentionPeriod of VictoriaMetrics",
        "days",
        1.0,
        36500.0,
    )


@dataclass(frozen=True, slots=True)
class IngestSettings(Section):
    """`greenhouse fleet ingest`: from the broker to the numbers and the database."""

    rigs_max: int = whole(100_000, "rigs that are taken in; messages of more are refused", 1, 10_000_000)
    batch_s: float = number(5.0, "messages of so long are stored together", "s", 0.1, 60.0)
    window: int = whole(
        4096, "messages that wait for their acknowledgement; the broker holds the others", 20, 65535
    )
    gap_wait_s: float = number(10.0, "a gap this old is asked for", "s", 1.0, 3600.0)


@dataclass(frozen=True, slots=True)
class FleetPageSettings(Section):
    """The fleet's page and API: `greenhouse fleet serve`."""

    host: str = text("127.0.0.1", "address to listen at; caddy asks here", form=host_problem)
    port: int = whole(8432, "TCP port", 1, 65535)
    names: tuple[str, ...] = items(
        "names by which browsers reach it; its address and this machine's name do",
        "fleet.example.org",
        host_problem,
    )
    alert_token_file: str = text(
        "", "file of the word by which vmalert shows who it is; empty: no alarm is taken"
    )


@dataclass(frozen=True, slots=True)
class AlarmRuleSettings(Section):
    """When vmalert raises an alarm; `greenhouse fleet up` writes its rules."""

    silent_s: float = number(600.0, "a rig without a tick for so long is silent", "s", 60.0, 86400.0)
    air_max_c: float = number(
        41.0, "air above it is an alarm; a rig's own safety turns its heater off at 40", "degC", 10.0, 80.0
    )


@dataclass(frozen=True, slots=True)
class RolloutSettings(Section):
    """Bundles in waves. Rigs need `bundle.source` of their own settings to be `address`."""

    address: str = text(
        "", "where rigs fetch bundles: /bundles of `greenhouse fleet serve`", form=url_problem
    )
    trusted_keys: str = text("/etc/greenhouse/keys", "folder of public keys (*.pub) whose bundles may spread")
    margin: float = number(0.1, "share of the control cost by which a bundle may be dearer", "1", 0.0, 0.25)
    error: float = number(
        0.05, "probability at most that a rollout is stopped without such harm", "1", 1e-6, 0.5
    )
    wave_h: float = number(
        120.0, "a wave that is shown neither worse nor safe by then waits for a person", "h", 24.0, 2000.0
    )


@dataclass(frozen=True, slots=True)
class FleetSettings(Section):
    """All of `fleet.yaml`. mqtt : `rig` is the client id"""

    database: DatabaseSettings = field(default_factory=DatabaseSettings)
    numbers: NumbersSettings = field(default_factory=NumbersSettings)
    ingest: IngestSettings = field(default_factory=IngestSettings)
    alarms: AlarmRuleSettings = field(default_factory=AlarmRuleSettings)
    page: FleetPageSettings = field(default_factory=FleetPageSettings)
    rollout: RolloutSettings = field(default_factory=RolloutSettings)
    mqtt: MqttSettings = field(default_factory=lambda: MqttSettings(rig="fleet"))


def load(path: Path) -> FleetSettings:
    """Load settings from a YAML file. Errors: ConfigError, a line for each wrong key"""
    with all_problems(path):
        return read_yaml(FleetSettings, path)
