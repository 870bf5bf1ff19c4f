"""`greenhouse demo`: the daemon against a virtual board, live. No broker, no root, no board needed."""

import argparse
import tempfile
from pathlib import Path

from edge import config
from edge.daemon import Daemon
from edge.display import make_display
from edge.outlet import standard_output
from edge.settings import Settings
from edge.sim_clock import SimClock
from edge.virtual_rig import settings_in, virtual_rig

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
    parser.add_argument("--speed", type=float, default=120.0, help="simulated seconds a second, 0: no brake")
    parser.add_argument(
        "--minutes", type=float, default=None, help="simulated minutes, then it ends by itself"
    )
    parser.add_argument("--controller", default="MPC-Twin-P", help="usual: MPC-Twin-P")
    parser.add_argument("--llm-url", default="", help="OpenAI-compatible endpoint, for the controllers LLM-*")
    parser.add_argument("--llm-model", default="", help="the model's name there")
    parser.add_argument("--seed", type=int, default=1, help="of the virtual board")
    parser.add_argument(
        "--out", type=Path, default=None, help="folder that keeps the history; else none is kept"
    )


def run(arguments: argparse.Namespace) -> int:
    """Until Ctrl-C, or the end of --minutes."""
    with tempfile.TemporaryDirectory(prefix="greenhouse-demo-") as temporary:
        folder = arguments.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        settings = config.parse(DEMO_YAML.format_map(vars(arguments)), "demo")
        with virtual_rig(folder, arguments.seed) as rig:
            _run(arguments, settings_in(folder, settings), rig.control)
    return 0


def _run(arguments: argparse.Namespace, settings: Settings, control: Path) -> None:
    stop_at_s = float("inf") if arguments.minutes is None else 60.0 * arguments.minutes
    clock = SimClock(control, speed=arguments.speed or None)
    with standard_output() as out:
        display = make_display(out)
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
