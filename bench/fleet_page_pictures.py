"""python -m bench.fleet_page_pictures: the manual's pictures of the fleet's page, over made-up rigs.

A real page and broker, and a database as ingest and the runner of rollouts leave it. Needs chromium,
chromedriver and mosquitto.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver
from sqlalchemy.orm import Session

from bench.page_pictures import IMAGES, SETTLE_S, save
from edge.core.processes import die_with_parent, end_process
from edge.page.access import Role
from fleet.database.base import open_database
from fleet.database.bundles import RolloutRig, RolloutWave
from fleet.database.rigs import FleetRig
from fleet.page.people import EVERY, People
from fleet.rollout.states import RigState, RolloutState, WaveState
from fleet.settings import DatabaseSettings
from tests.support.broker import Broker, Listener, free_port, wait_for
from tests.support.browser import DESK, PHONE, browser
from tests.support.daemon_process import ROOT
from tests.support.held_rollout import DAY_S, add_held_rollout
from tests.support.page_process import Client, cookie_of, listens

NAME, PASSWORD = "Ann", "for pictures alone"
KINDS = {"tent": "north", "case": "south"}  # kind -> group
OF_A_KIND, IN_A_WAVE = 14, 6
STATE: dict[str, Any] = {
    "temp_air_c": 24.1,
    "reference_c": 24.0,
    "mode": "auto",
    "link_up": 1,
}
STATES: Mapping[str, dict[str, Any]] = {
    "tent-03": {"tripped": 1, "trips": "over-temperature", "heater_duty": 0.0},
    "case-11": {"temp_air_c": None, "temp_air_quality": "stale", "heater_duty": 0.0},
    "case-04": {"emergency_stop": 1, "heater_duty": 0.0},
    "tent-08": {"temp_air_c": 21.4, "heater_duty": 1.0},
}
SILENT_S = {"tent-12": 3.2 * 3600.0}
DRIFTS = {
    "case-02": "the twin disagrees since Thu 21:40, mostly while it heats",
}
WORSE = "kind case is dearer by 34%, evidence of harm 148"


def add_rigs(session: Session, utc: float) -> dict[str, str]:
    """Add rigs of every standing and return the kind of each."""
    kinds = {f"{kind}-{number:02}": kind for kind in KINDS for number in range(1, OF_A_KIND + 1)}
    for place, (rig, kind) in enumerate(kinds.items()):
        usual = STATE | {"temp_air_c": 23.9 + place % 4 / 10.0, "heater_duty": (place * 7 % 12) / 20.0}
        row = FleetRig(name=rig, group=KINDS[kind], kind=kind, first_utc=utc - 90 * DAY_S, is_online=True)
        row.state, row.last_utc = usual | STATES.get(rig, {}), utc - SILENT_S.get(rig, 20.0)
        session.add(row)
    session.flush()
    return kinds


def add_rollouts(session: Session, utc: float, kinds: Mapping[str, str]) -> None:
    """Add one that was stopped a month ago, and one whose first wave is held."""
    chosen = [rig for rig in kinds if int(rig[-2:]) % 2 == 0 and int(rig[-2:]) <= 2 * IN_A_WAVE]
    wave_rigs = {rig: kinds[rig] for rig in chosen}
    old = add_held_rollout(session, utc - 30 * DAY_S, wave_rigs, version="2026.10")
    old.state, old.why, old.ended_utc = RolloutState.STOPPED, WORSE, old.began_utc + 0.9 * DAY_S
    wave = session.get_one(RolloutWave, (old.number, 1))
    wave.state, wave.why, wave.ended_utc = WaveState.STOPPED, old.why, old.ended_utc
    wave.kinds = {
        "case": {"blocks": 19, "difference": 0.338, "harm": 148.0, "safety": 1.0},
        "tent": {"blocks": 19, "difference": 0.021, "harm": 1.1, "safety": 2.6},
    }
    for rig in chosen:
        session.get_one(RolloutRig, (old.number, rig)).state = RigState.ROLLED_BACK
    add_held_rollout(session, utc, wave_rigs, version="2026.11", unsure=["tent"])


@contextmanager
def page_of(folder: Path, database: DatabaseSettings) -> Iterator[str]:
    """Serve the page of a database until the end, and yield its address."""
    port, settings = free_port(), folder / "fleet.yaml"
    with Broker(folder, is_verbose=False) as broker, Listener(broker.port) as rigs:
        for rig, words in DRIFTS.items():
            rigs.send(f"greenhouse/{rig}/drift", json.dumps({"state": "disagrees", "text": words}), True)
        mqtt = {"enabled": True, "host": "127.0.0.1", "port": broker.port}
        settings.write_text(
            yaml.safe_dump({"database": {"url": database.url}, "page": {"port": port}, "mqtt": mqtt})
        )
        command = [sys.executable, "-m", "edge", "fleet", "serve", "--settings", str(settings)]
        page = subprocess.Popen(command, cwd=ROOT, preexec_fn=die_with_parent)
        try:
            wait_for(lambda: listens(port) or page.poll() is not None, "the page", 60.0)
            assert page.poll() is None
            yield f"http://127.0.0.1:{port}"
        finally:
            end_process(page, patience_s=15.0)


def take(driver: WebDriver, address: str, part: str, words: str, path: Path) -> None:
    """Write a picture of a part of the page once it shows these words."""
    client = Client(address)
    assert client.post("/api/session", {"name": NAME, "password": PASSWORD}).ok
    driver.get(address)
    cookie = cookie_of(client)
    driver.add_cookie({"name": cookie.name, "value": cookie.value or ""})
    driver.get(f"{address}/#{part}")
    driver.refresh()
    wait_for(lambda: words in driver.find_element(By.TAG_NAME, "body").text, words, 60.0)
    time.sleep(SETTLE_S)
    save(driver, path)


def main() -> int:
    """Fill a database, serve it and take the pictures."""
    parser = argparse.ArgumentParser(prog="python -m bench.fleet_page_pictures", description=__doc__)
    parser.add_argument("--images", type=Path, default=IMAGES, help="folder; default: docs/images")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        database = DatabaseSettings(url=f"sqlite:///{name}/fleet.db")
        engine = open_database(database)
        People(engine).add(NAME, EVERY, Role.ADMIN, PASSWORD)
        with Session(engine) as session, session.begin():
            now = time.time()
            add_rollouts(session, now, add_rigs(session, now))
        with page_of(Path(name), database) as address:
            for size, part, words, file in (
                (DESK, "", "tent-12", "fleet_1440.png"),
                (PHONE, "", "tent-12", "fleet_360.png"),
                (DESK, "bundles", "Wave 1 is held", "fleet_rollout_1440.png"),
            ):
                with browser(size) as driver:
                    take(driver, address, part, words, given.images / file)
        engine.dispose()
    return 0


if __name__ == "__main__":
    sys.exit(main())
