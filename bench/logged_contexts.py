"""Contexts as a controller sees them in closed loop on the virtual board, for benchmarks of planners."""

import tempfile
from dataclasses import replace
from pathlib import Path

from bench.closed_loop_day import CHAMBER_YAML, DAY_YAML
from edge.app import controllers as registry
from edge.app.daemon import Daemon
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import settings_in, virtual_rig
from edge.config import loading as config
from edge.core.controller import Context, Controller
from edge.core.messages import Decision
from edge.core.predictor import Predictor


class Logger:
    """A controller that keeps what it is asked."""

    def __init__(self, inner: Controller) -> None:
        self.name = inner.name
        self.contexts: list[Context] = []
        self._inner = inner

    def decide(self, context: Context) -> Decision:
        """As the inner one."""
        self.contexts.append(context)
        return self._inner.decide(context)

    def reset(self) -> None:
        """As the inner one."""
        self._inner.reset()


def logged_contexts(controller: str, model: Predictor, seed: int, hours: float) -> list[Context]:
    """One per tick from midnight on: the day of `bench.closed_loop_day`, the daemon in lock-step."""
    with tempfile.TemporaryDirectory(prefix="logged-contexts-") as temporary:
        folder = Path(temporary)
        (folder / "chamber.yaml").write_text(CHAMBER_YAML)
        settings = settings_in(folder, config.parse(DAY_YAML, "logged_contexts"))
        settings = replace(settings, control=replace(settings.control, controller=controller))
        logger = Logger(registry.make(controller, registry.ControllerParts(settings.control, model)))
        with virtual_rig(folder, seed, ("--chamber", str(folder / "chamber.yaml"))) as rig:
            clock = SimClock(rig.control)
            try:
                end_s = clock.now() + 3600.0 * hours
                with Daemon(settings, clock, stop_at_s=end_s, more_controllers=(logger,)) as daemon:
                    daemon.run()
            finally:
                clock.close()
    return logger.contexts
