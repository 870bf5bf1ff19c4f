"""A rig, a broker and real Home Assistants: every entity, every order in both directions, kill -9, pictures.

usage: run.py [VERSION...]   root's; installs at the first run; keeps bench/results/home_assistant.txt
The rig runs in real time with the usual step of a minute, so an order that is shown within 2 s has not waited
for a tick. Its language model is a script that answers at once.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import checks
from home_page import count, keep_port, log_in
from home_run import LIMIT_S, RIG, HomeRun
from server import RealHomeAssistant

from bench.header import header
from tests.support.broker import Broker, wait_for
from tests.support.browser import browser, missing, resize
from tests.support.daemon_process import ROOT, DaemonProcess
from tests.support.virtual_board import virtual_board
from training.llm_stand_in import MODEL
from training.llm_stand_in.server import StandIn

# The oldest that knows `default_entity_id`, the last for Python 3.13, and the newest when this was written.
VERSIONS = ("2025.10.0", "2026.2.3", "2026.11.0")
HERE = Path(__file__).parent
RESULTS = ROOT / "bench" / "results" / "home_assistant.txt"
IMAGES = ROOT / "docs" / "images"
DASHBOARD = ROOT / "deploy" / "home_assistant" / "dashboard.yaml"
SIZES = {"home_assistant_360": (360, 2110), "home_assistant_1440": (1440, 800)}
VIEWS = {"history": ("hui-history-graph-card", 3), "rig": ("hui-tile-card", 18)}  # path -> cards of it
SETTLED_S = 3.0  # a card draws itself after it has been made, and announces no end of that


def take_pictures(run: HomeRun) -> None:
    """Open the dashboard on a telephone and on a desk: no card complains. Save what its first view shows."""
    with browser() as driver:
        log_in(driver, run.home.url, run.home.token)
        keep_port(driver, run.home.url)
        for name, size in SIZES.items():
            resize(driver, size)
            for view, (card, cards) in VIEWS.items():
                driver.get(f"{run.home.url}/green-house/{view}")
                wait_for(lambda card=card, cards=cards: count(driver, card) >= cards, f"{cards} {card}", 60.0)
                time.sleep(SETTLED_S)
                assert not count(driver, "hui-error-card") + count(driver, "hui-warning"), view
            driver.save_screenshot(str(IMAGES / f"{name}.png"))
            kilobytes = (IMAGES / f"{name}.png").stat().st_size / 1000
            run.say(f"dashboard at {size[0]} pixels: every card drawn; {name}.png, {kilobytes:.0f} kB")


def every_check(run: HomeRun) -> None:
    """Run them all, in an order in which none disturbs the next."""
    begin = time.monotonic()
    checks.check_entities(run, "after the start", begin)
    run.say(f"orders, each to be obeyed and shown within {LIMIT_S:g} s, with a control step of 60 s:")
    checks.check_climate(run)
    checks.check_switches(run)
    checks.check_manual(run)
    checks.check_words(run)
    run.say(f"the slowest order was shown after {run.slowest_s:.2f} s")
    take_pictures(run)
    run.daemon.ask("discard", id=run.attribute("sensor.proposal", "id"))
    checks.check_availability(run)
    checks.check_log(run)
    run.say(f"every check has passed, in {time.monotonic() - begin:.0f} s")


def installed(version: str) -> Path:
    """Return the tree with this Home Assistant in it; made now if it is not there."""
    done = subprocess.run(
        ["sh", str(HERE / "install.sh"), version], stdout=subprocess.PIPE, text=True, check=True
    )
    return Path(done.stdout.strip())


@contextmanager
def rig_at_home(tree: Path, folder: Path) -> Iterator[HomeRun]:
    """Start broker, language model, Home Assistant, board and daemon, and surely end them."""
    with ExitStack() as stack:
        broker = stack.enter_context(Broker(folder))
        model = stack.enter_context(StandIn())
        home = stack.enter_context(RealHomeAssistant(tree, DASHBOARD))
        home.connect_to_broker(broker.port)
        board = stack.enter_context(virtual_board(folder, "--real-time"))
        daemon = stack.enter_context(
            DaemonProcess(
                folder,
                broker.port,
                mqtt={"rig": RIG},
                control={"step_s": 60, "model": "", "controller": "MPC-Twin-P"},
                llm={"url": model.url, "model": MODEL},
                bundle={"path": str(folder / "bundles")},
            )
        )
        yield HomeRun(home, daemon, board)


def lines_of(version: str) -> list[str]:
    """Run every check with one version and return what was measured."""
    begin = time.monotonic()
    tree = installed(version)
    first = f"Home Assistant {version} from PyPI, in a Debian of its own"
    first += f", found or installed within {time.monotonic() - begin:.0f} s"
    print(first, flush=True)
    with tempfile.TemporaryDirectory() as name, rig_at_home(tree, Path(name)) as run:
        every_check(run)
        return ["", first, *run.lines]


def main(versions: list[str]) -> None:
    """Run every check with every version; keep the results."""
    if missing():
        sys.exit(f"run.py: apt install {' '.join(missing())}")
    lines = list(header())
    for version in versions:
        lines += lines_of(version)
    RESULTS.write_text("\n".join([*lines, ""]))


if __name__ == "__main__":
    main(sys.argv[1:] or list(VERSIONS))
