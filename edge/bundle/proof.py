"""A bundle's models run first in a process of their own: a graph may loop for ever, or take all memory.

The process checks the bundle itself, so that what it proves is what the signature covers.
"""

import json
import os
import resource
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from edge.core.errors import DataError
from edge.core.plain_text import plain
from edge.core.processes import environment


@dataclass(frozen=True, slots=True)
class ProofLimits:
    """Limits for proving a bundle; the packaged one takes 1 s and 80 MB."""

    cpu_s: int = 60  # a single-board computer needs a tenth of it
    wall_s: float = 180.0  # beside a daemon that works
    memory: int = 300 << 20  # beside the daemon within the unit's MemoryMax= [bytes]


LIMITS = ProofLimits()


@dataclass(frozen=True, slots=True)
class Prover:
    """Proves bundles of this rig: trusted `keys` (a folder), control steps of `step_s` [s]."""

    keys: Path
    step_s: float
    limits: ProofLimits = LIMITS

    def __call__(self, folder: Path) -> None:
        """Load the bundle in `folder` with all of its models. Errors: DataError with what is wrong"""
        task = {"folder": str(folder.absolute()), "keys": str(self.keys.absolute()), "step_s": self.step_s}
        command = [
            sys.executable,
            "-m",
            "edge.bundle.proof",
            json.dumps({**task, "limits": asdict(self.limits)}),
        ]
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                env=environment(),
                timeout=self.limits.wall_s,
            )
        except subprocess.TimeoutExpired:
            raise DataError(f"its models are not proved after {self.limits.wall_s:g} s") from None
        except OSError as error:
            raise DataError(f"its models cannot be proved: {error.strerror}") from error
        if done.returncode:
            raise DataError(self._reason(done))

    def _reason(self, done: "subprocess.CompletedProcess[bytes]") -> str:
        if done.returncode == REFUSED:
            return plain(done.stdout.decode(errors="replace"), 400)
        said = plain(done.stderr.decode(errors="replace")[-200:])
        ended = f"signal {-done.returncode}" if done.returncode < 0 else f"exit code {done.returncode}"
        return (
            f"its models end the process that proves them ({ended}), which may compute for "
            f"{self.limits.cpu_s} s and take {self.limits.memory >> 20} MB{f': {said}' if said else ''}"
        )


REFUSED = 3  # exit code: the reason is on stdout


def main(task: str) -> int:
    """Prove what the JSON object `task` names, within its limits."""
    values = json.loads(task)
    limits = ProofLimits(**values["limits"])
    resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s))
    resource.setrlimit(resource.RLIMIT_DATA, (limits.memory, limits.memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):  # not where root acts as the store's owner
        Path("/proc/self/oom_score_adj").write_text("1000")  # where memory runs short this process ends first
    from edge.bundle.predictors import loader
    from edge.bundle.store import BundleStore  # after the limits

    folder = Path(values["folder"])
    try:
        BundleStore(folder.parent, Path(values["keys"]), loader(values["step_s"])).load_folder(folder)
    except DataError as error:
        print(error)
        return REFUSED
    except MemoryError:
        print(f"its models need more than {limits.memory >> 20} MB")
        return REFUSED
    return 0


if __name__ == "__main__":
    os._exit(main(sys.argv[1]))  # no exit handlers: a library's may wait
