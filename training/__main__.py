"""`greenhouse-train`: fit the models on the recorded runs and forecast the test runs with them."""

import argparse
import itertools
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge.config.settings import LlmSettings
from edge.core.errors import GreenhouseError
from edge.core.sweep import add_arguments, sweep
from training.rl import command as rl

if TYPE_CHECKING:  # importing torch takes a second, `--help` need not wait
    from training.models.study import Regime, TrainingJob

OUT = Path("out/training")
LOGS = Path("out/tensorboard")
RESULTS = Path("training/results")
TRAINED = RESULTS / "trained"
POLICIES = RESULTS / "policies"
IMAGES = Path("docs/images")
SEEDS = (0, 1, 2, 3, 4)
REGIMES = ("interpolation", "extrapolation")
COMMANDS = {
    "linear": "the ARX models: the paper's, and the one with the room temperature",
    "pbm": "the physics models: the paper's, and the twin with fitted effects",
    "lstm": "the LSTMs: the paper's, and the one that predicts increments",
    "ham": "the hybrids: the paper's (CoSTA), and the one over the fitted twin, guarded",
    "all": "all of these, with every seed, in both regimes",
}


def main(words: Sequence[str] | None = None) -> int:
    """Entry point. Expected errors end in one line and exit code 2."""
    arguments = _parser().parse_args(words)
    try:
        return int(arguments.run(arguments))
    except GreenhouseError as error:
        print(f"greenhouse-train {arguments.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="greenhouse-train", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, help_text in COMMANDS.items():
        sub = commands.add_parser(name, help=help_text, description=help_text)
        sub.add_argument("--regime", choices=REGIMES, help="one; usual: both")
        sub.add_argument(
            "--seeds", type=int, nargs="+", default=SEEDS, help="of the networks (usual: 0 to 4)"
        )
        sub.add_argument("--out", type=Path, default=OUT, help=f"models and records (usual: {OUT})")
        sub.add_argument("--logs", type=Path, default=LOGS, help=f"TensorBoard logs (usual: {LOGS})")
        if name in ("pbm", "ham"):
            sub.add_argument(
                "--twin", type=Path, help="instead: this twin file by itself, or the guarded hybrid over it"
            )
        # One after the other unless asked for: a training measures its own time and memory.
        add_arguments(sub, workers=0)
        sub.set_defaults(run=_train, twin=None)
    _add_bundle(commands)
    _add_evaluate(commands.add_parser("evaluate", help=_evaluate.__doc__, description=_evaluate.__doc__))
    _add_compare(commands.add_parser("compare", help=_compare.__doc__, description=_compare.__doc__))
    _add_paper_case(
        commands.add_parser("paper-case", help=_paper_case.__doc__, description=_paper_case.__doc__)
    )
    rl.add_commands(commands)
    return parser


def _add_bundle(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    key = commands.add_parser("key", help="a new key pair that signs bundles", description=_key.__doc__)
    key.add_argument("file", type=Path, help="private key to make; the public one ends in .pub")
    key.set_defaults(run=_key)
    bundle = commands.add_parser(
        "bundle", help="a signed bundle of what was trained", description=_bundle.__doc__
    )
    bundle.add_argument("version", help="of the bundle, e.g. 2.0")
    bundle.add_argument("--out", type=Path, default=OUT, help=f"where the trainings are (usual: {OUT})")
    bundle.add_argument("--key", type=Path, help="private key that signs")
    bundle.add_argument(
        "--hybrid", default="ham_guarded", help="ham_given: the one over a given twin (usual: ham_guarded)"
    )
    bundle.add_argument("--network", default="lstm", help="the training in the LSTM's place (usual: lstm)")
    bundle.add_argument(
        "--policies", type=Path, default=POLICIES, help=f"where the policies are (usual: {POLICIES})"
    )
    bundle.add_argument(
        "--packaged-models",
        action="store_true",
        help="the models and intervals of the bundle that ships with the software, as they are",
    )
    where = bundle.add_mutually_exclusive_group(required=True)
    where.add_argument("--file", type=Path, help="archive to write, for `greenhouse bundle install`")
    where.add_argument("--default", action="store_true", help="the bundle that ships with the software")
    bundle.set_defaults(run=_bundle)


def _add_evaluate(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--trained", type=Path, default=TRAINED, help=f"what `all` has left (usual: {TRAINED})")
    sub.add_argument("--results", type=Path, default=RESULTS, help=f"figures, report (usual: {RESULTS})")
    sub.add_argument("--images", type=Path, default=IMAGES, help=f"pictures (usual: {IMAGES})")
    sub.add_argument("--check", action="store_true", help="compare with what is there and change nothing")
    sub.add_argument(
        "--tolerance", type=float, help="of --check (usual: 0 on the machine that made the figures)"
    )
    sub.set_defaults(run=_evaluate)


def _add_compare(sub: argparse.ArgumentParser) -> None:
    runs, results = OUT.parent / "control", RESULTS / "control"
    sub.add_argument("--controllers", nargs="+", metavar="NAME", help="only these (usual: all)")
    sub.add_argument("--references", nargs="+", default=["reference_1", "reference_2"], metavar="NAME")
    sub.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5], help="of the virtual board")
    sub.add_argument("--runs", type=Path, default=runs, help=f"runs done before and now (usual: {runs})")
    sub.add_argument("--results", type=Path, default=results, help=f"figures (usual: {results})")
    sub.add_argument("--images", type=Path, default=IMAGES, help=f"pictures (usual: {IMAGES})")
    add_arguments(sub)
    sub.add_argument(
        "--llm-url", default="", help="endpoint of the LLM controllers (usual: the scripted stand-in)"
    )
    sub.add_argument("--llm-model", default="stand-in", help="its model (usual: the scripted stand-in)")
    usual = LlmSettings()
    for name in ("exchanges", "answer_tokens"):
        words, value = f"--llm-{name.replace('_', '-')}", getattr(usual, name)
        sub.add_argument(words, type=int, default=value, help=f"as llm.{name} (usual: {value})")
    sub.add_argument(
        "--kept",
        action="store_true",
        help="run nothing, take what is kept; with --beside-kept the tables are made anew from the figures",
    )
    sub.add_argument(
        "--beside-kept",
        action="store_true",
        help="beside the other runs' figures as they are kept (and do again what the pictures show)",
    )
    # Changes nothing, so that a reader can ask whether the kept figures still hold.
    sub.add_argument("--check", action="store_true", help="compare with the kept figures, change nothing")
    sub.add_argument(
        "--tolerance",
        type=float,
        default=0.005,
        help="of --check, as a share of each figure (usual: 0.005); one machine and one version give 0",
    )
    sub.set_defaults(run=_compare)


def _add_paper_case(sub: argparse.ArgumentParser) -> None:
    case = RESULTS / "paper_case"
    sub.add_argument("--results", type=Path, default=case, help=f"twins, figures, picture (usual: {case})")
    evaluation = RESULTS / "evaluation.json"
    sub.add_argument(
        "--evaluation", type=Path, default=evaluation, help=f"the other models' figures (usual: {evaluation})"
    )
    networks = OUT.parent / "paper_case"
    sub.add_argument("--out", type=Path, default=networks, help=f"trained networks (usual: {networks})")
    sub.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="of the networks (usual: 0 to 4)")
    sub.add_argument(
        "--kept-twins", action="store_true", help="diagnose nothing, take the twins that are there"
    )
    sub.add_argument(
        "--check",
        action="store_true",
        help="the same, compare with the figures that are there, change nothing",
    )
    sub.set_defaults(run=_paper_case)


def _paper_case(arguments: argparse.Namespace) -> int:
    """the bare physics model told what it lacks, and the hybrid over it before and after"""
    from training.evaluate.paper_case import run

    return run(arguments)


def _compare(arguments: argparse.Namespace) -> int:
    """the comparison of all controllers in closed loop on the virtual rig"""
    from training.control.compare import run

    return run(arguments)


def _evaluate(arguments: argparse.Namespace) -> int:
    """the comparison of all models: tables, pictures and the report"""
    from training.evaluate.evaluation import run

    return run(arguments)


def _key(arguments: argparse.Namespace) -> int:
    """The public half goes into a rig's folder of trusted keys; the private half stays with you."""
    from edge.bundle.sign import generate_key

    print(f"{arguments.file} signs; {generate_key(arguments.file)} goes to the rig's /etc/greenhouse/keys")
    return 0


def _bundle(arguments: argparse.Namespace) -> int:
    """Export, calibrate on fresh runs of the virtual board (made once, a quarter of an hour), sign."""
    from training.evaluate import coverage
    from training.export import pack

    folder = Path("out/bundle")
    if arguments.packaged_models:
        pack.gather_packaged(folder)
    else:
        pack.gather(arguments.out, folder, arguments.hybrid, arguments.network)
        coverage.main([str(folder)])
    pack.add_policies(arguments.policies, folder)
    if arguments.default:
        pack.pack_default(folder, arguments.version, arguments.key or pack.KEY)
        print(f"{pack.PACKAGED.name}: version {arguments.version}, signed")
    else:
        if arguments.key is None:
            raise GreenhouseError("--key: an archive needs a key that signs it: `greenhouse-train key FILE`")
        pack.pack_file(folder, arguments.version, arguments.file, arguments.key)
        print(f"{arguments.file}: version {arguments.version}, signed")
    return 0


def _train(arguments: argparse.Namespace) -> int:
    from training.models.registry import FAMILIES, GIVEN
    from training.models.study import SCENARIOS
    from training.models.summary import records, table

    known = FAMILIES if arguments.twin is None else GIVEN
    families = known if arguments.command == "all" else {arguments.command: known[arguments.command]}
    regimes = [regime for regime in SCENARIOS if arguments.regime in (None, regime)]
    options = "" if arguments.twin is None else f" --twin {arguments.twin.name}"
    sweep(
        partial(_study, arguments.twin, arguments.out, arguments.logs),
        list(_jobs(families, regimes, arguments.seeds, options)),
        arguments.workers,
        arguments.dask,
        lambda done, job, record: print(_line(record), flush=True),
    )
    names = [name for family in families.values() for name in family]
    print("\n".join(table(records(arguments.out), names).text()))
    return 0


def _study(twin: Path | None, out: Path, logs: Path, job: "TrainingJob") -> dict[str, Any]:
    from edge.twin.twin_file import read_twin_file
    from training.models.registry import MODELS, over
    from training.models.study import study

    models = MODELS if twin is None else over(read_twin_file(twin))
    return study(job, models[job.name], out, logs)


def _jobs(
    families: Mapping[str, Sequence[str]], regimes: Sequence["Regime"], seeds: Sequence[int], options: str
) -> Iterator["TrainingJob"]:
    from training.models.registry import SEEDED
    from training.models.study import TrainingJob

    for family, names in families.items():
        for name, regime in itertools.product(names, regimes):
            for seed in seeds if name in SEEDED else (0,):
                command = f"greenhouse-train {family} --regime {regime} --seeds {seed}{options}"
                yield TrainingJob(name, regime, seed, command)


def _line(record: Mapping[str, Any]) -> str:
    maes = "  ".join(f"{one['free_run']['mae_k']:6.3f}" for one in record["scenarios"].values())
    what = f"{record['model']:15s} {record['regime']:14s} seed {record['seed']}"
    return f"{what}  MAE {maes} K  {record['wall_s']:6.1f} s  {record['peak_rss_mib']:5.0f} MiB"


if __name__ == "__main__":
    sys.exit(main())
