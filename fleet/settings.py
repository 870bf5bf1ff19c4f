"""Every setting of a fleet: default, unit, range and meaning; `fleet.yaml` holds them."""

from dataclasses import dataclass, field
from pathlib import Path

from edge.config.loading import all_problems
from edge.config.settings import URL, MqttSettings
from edge.formats.cross_check import Section, text
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

    url: str = text("http://127.0.0.1:8428", "VictoriaMetrics, or vmauth in front of a cluster", pattern=URL)


@dataclass(frozen=True, slots=True)
class FleetSettings(Section):
    """All of `fleet.yaml`. mqtt : `rig` is the client id"""

    database: DatabaseSettings = field(default_factory=DatabaseSettings)
    numbers: NumbersSettings = field(default_factory=NumbersSettings)
    mqtt: MqttSettings = field(default_factory=lambda: MqttSettings(rig="fleet"))


def load(path: Path) -> FleetSettings:
    """Load settings from a YAML file. Errors: ConfigError, a line for each wrong key"""
    with all_problems(path):
        return read_yaml(FleetSettings, path)
