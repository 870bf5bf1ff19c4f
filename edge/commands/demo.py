"""`greenhouse demo`: the daemon against a virtual board, live. No broker, no root, no board needed."""

import argparse
import shutil
import sys
from dataclasses import replace
from pathlib import Path

from edge.app.daemon import Daemon
from edge.app.display import make_display
from edge.app.outlet import standard_output
from edge.app.running_rigs import make_demo_folder
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import settings_in, virtual_rig
from edge.commands.arguments import SEED_MAX, number, whole
from edge.config import loading as config
from edge.config.settings import MqttSettings, Settings
from edge.core.controller_names import CONTROLLERS
from edge.page.child import page_of

RIG = "demo"  # its name over MQTT
DEMO_YAML = """
control: {{controller: {controller}}}
llm: {{url: "{llm_url}", model: "{llm_model}"}}
reference:
  kind: steps
  steps:
    - {{at_s: 0, reference_c: 24}}
    - {{at_s: 1800, reference_c: 28}}
    - {{at_s: 5400, reference_c: 25}}
    - {{at_s: 9000, reference_c: 30}}
    - {{at_s: 12600, reference_c: 23}}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--speed",
        type=number(0.0),
        default=120.0,
        help="simulated seconds per second; 0: unlimited; default: 120",
    )
    parser.add_argument(
        "--minutes",
        type=number(0.0, above=True),
        help="end after so many simulated minutes; default: at Ctrl-C",
    )
    # No choices: the reader of the settings refuses a wrong name, and says which was meant.
    parser.add_argument(
        "--controller",
        default="MPC-Twin-P",
        metavar="NAME",
        help=f"controller: {', '.join(CONTROLLERS)}; LLM-* need --llm-url; default: %(default)s",
    )
    _add_model(parser)
    parser.add_argument(
        "--seed", type=whole(0, SEED_MAX), default=1, help="number that fixes the simulated noise; default: 1"
    )
    parser.add_argument(
        "--out", type=Path, help="folder for the history; default: one that the next demo removes"
    )
    parser.add_argument(
        "--mqtt",
        type=_broker,
        metavar="HOST[:PORT]",
        help=f"publish over MQTT at this broker, as the rig {RIG!r}; default port: {MqttSettings().port}",
    )


def _add_model(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--llm-url",
        default="",
        metavar="URL",
        help="OpenAI-compatible server of a language model, http://host:port/v1, for LLM-* and `ask`",
    )
    parser.add_argument(
        "--llm-model", default="", metavar="NAME", help="name of the language model on that server"
    )


def run(arguments: argparse.Namespace) -> int:
    """Until Ctrl-C, or the end of --minutes."""
    settings = config.parse(DEMO_YAML.format_map(vars(arguments)), "demo")
    folder = make_demo_folder(arguments.out)
    settings = settings_in(folder, settings)
    if arguments.mqtt is not None:
        host, port = arguments.mqtt
        settings = replace(settings, mqtt=replace(settings.mqtt, enabled=True, host=host, port=port, rig=RIG))
    with virtual_rig(folder, arguments.seed) as rig, page_of(settings, folder, RIG) as address:
        _run(arguments, settings, rig.control, address)
    return 0


def _program() -> str:
    """Return how this user calls `greenhouse`: by its path where PATH does not find it."""
    called = Path(sys.argv[0])
    return (
        str(called)
        if called.name == "greenhouse" and shutil.which("greenhouse") != str(called)
        else "greenhouse"
    )


def _broker(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":") if text.count(":") == 1 else (text, "", "")
    if not host or text.count(":") > 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST or HOST:PORT")
    return host, whole(1, 65535)(port) if colon else MqttSettings().port


def _run(arguments: argparse.Namespace, settings: Settings, control: Path, address: str) -> None:
    stop_at_s = float("inf") if arguments.minutes is None else 60.0 * arguments.minutes
    clock = SimClock(control, speed=arguments.speed or None)
    with standard_output() as out:
        hint = f"in another terminal: {_program()} status (or --socket {settings.control_socket.path})"
        print(hint, file=sys.stderr)
        if address:
            print(f"in a browser: {address}", file=sys.stderr)
        display = make_display(out, f"open {address}" if address else hint)
        try:
            with Daemon(
                settings,
                clock,
                after_tick=lambda record: daemon.stop() if out.reader_left else None,
                stop_at_s=stop_at_s,
                more_sinks=(display,),
            ) as daemon:
                daemon.run()
            heater = clock.truth()["pins"]["heater_relay"]
        finally:
            display.close()
            clock.close()
        print(f"stopped; the board's heater pin is {'ON' if heater else 'off'}")
