"""`greenhouse-train rl`, `rl-online`, `rl-gap` and `rl-compare`: their arguments, and what they print."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge.core.errors import DataError
from edge.core.sweep import add_arguments, sweep

if TYPE_CHECKING:  # importing torch takes a second, `--help` need not wait
    from training.rl.study import PolicyJob

    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

POLICIES = Path("training/results/policies")
OFFLINE = ("RL-Off", "RL-Off-P")
ONLINE = ("RL-On-P", "RL-Tr-P")
USUAL = "DQN"  # algorithm
MODELS = ("ham", "lstm", "pbm")
VARIANTS = 32  # of a model whose parameters are drawn
RIG_PATIENCE_S = 3600.0  # without a tick: another controller may decide for a while
VIRTUAL_PATIENCE_S = 60.0  # a daemon in lock-step asks at once, or it has gone


def add_commands(commands: "Commands") -> None:
    """All of them."""
    _add_offline(commands.add_parser("rl", help=_offline.__doc__, description=_offline.__doc__))
    _add_online(commands.add_parser("rl-online", help=_online.__doc__, description=_online.__doc__))
    _add_gap(commands.add_parser("rl-gap", help=_gap.__doc__, description=_gap.__doc__))
    _add_compare(commands.add_parser("rl-compare", help=_compare.__doc__, description=_compare.__doc__))


def _add_offline(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--variant", choices=OFFLINE, nargs="+", default=OFFLINE, help="usual: both")
    sub.add_argument(
        "--model", default="ham", metavar="MODEL", help=f"{', '.join(MODELS)} or a twin file (usual: ham)"
    )
    sub.add_argument("--algorithm", default=USUAL, metavar="NAME", help=f"usual: {USUAL}")
    sub.add_argument("--seed", type=int, nargs="+", default=(0, 1, 2, 3, 4), help="usual: 0 to 4")
    sub.add_argument(
        "--randomise", action="store_true", help="draw the twin's parameters within their intervals"
    )
    sub.add_argument("--steps", type=int, help="of the environment (usual: 100000)")
    sub.add_argument("--out", type=Path, default=POLICIES, help=f"policies, records (usual: {POLICIES})")
    add_arguments(sub, workers=0)
    sub.set_defaults(run=_offline)


def _offline(arguments: argparse.Namespace) -> int:
    """policies learnt in a predictive model, by DQN or another algorithm of 100 000 steps"""
    from dataclasses import replace

    from training.rl.algorithms.registry import algorithm_of
    from training.rl.study import PolicyJob

    settings = algorithm_of(arguments.algorithm).settings
    if arguments.steps is not None:
        settings = replace(settings, steps=arguments.steps)
    jobs = []
    for variant in arguments.variant:
        for seed in arguments.seed:
            words = f"greenhouse-train rl --variant {variant} --model {arguments.model} --seed {seed}"
            words += f" --algorithm {arguments.algorithm}" if arguments.algorithm != USUAL else ""
            words += " --randomise" if arguments.randomise else ""
            words += f" --steps {arguments.steps}" if arguments.steps is not None else ""
            # Many boxes are seen only where asked for: one box is what the paper trains in.
            variants = VARIANTS if arguments.randomise else 1
            job = PolicyJob(variant, arguments.model, seed, words, variants, arguments.algorithm, settings)
            folder = folder_of(
                arguments.out, variant, arguments.model, seed, arguments.randomise, arguments.algorithm
            )
            jobs.append((job, folder))
    sweep(
        _study,
        jobs,
        arguments.workers,
        arguments.dask,
        lambda done, job, record: print(_line(record), flush=True),
    )
    return 0


def _study(place: "tuple[PolicyJob, Path]") -> dict[str, Any]:
    from training.rl.study import study

    return study(*place)


def _add_online(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--variant", choices=ONLINE, required=True)
    sub.add_argument(
        "--from", dest="begin_with", type=Path, metavar="FOLDER", help="training that RL-Tr-P begins with"
    )
    sub.add_argument("--steps", type=int, help="ticks (usual: 1440)")
    sub.add_argument("--seed", type=int, default=0, help="of the learner, and of a virtual board (usual: 0)")
    where = sub.add_mutually_exclusive_group(required=True)
    where.add_argument("--socket", type=Path, help="external.socket of a running daemon")
    where.add_argument("--virtual", action="store_true", help="start one on a virtual board, in lock-step")
    sub.add_argument("--out", type=Path, required=True, metavar="DIR", help="checkpoint, policy, record")
    sub.set_defaults(run=_online)


def _online(arguments: argparse.Namespace) -> int:
    """a policy learnt on the rig, through the daemon; goes on from its checkpoint after a kill"""
    import tempfile
    from dataclasses import replace

    from training.rl.online import OnlineJob, learn_online

    # Late: torch takes seconds, and `--help` needs nothing of it.
    from training.rl.saved_policy import WEIGHTS_FILE
    from training.rl.settings import ONLINE as SETTINGS
    from training.rl.virtual_daemon import virtual_daemon

    variant, begin_with = arguments.variant, arguments.begin_with
    if (begin_with is not None) != (variant == "RL-Tr-P"):
        raise DataError("--from: RL-Tr-P begins with a policy that was trained offline, RL-On-P with none")
    settings = SETTINGS[variant]
    words = f"greenhouse-train rl-online --variant {variant} --seed {arguments.seed}"
    words += f" --from {begin_with}" if begin_with is not None else ""
    if arguments.steps is not None:
        settings = replace(settings, steps=arguments.steps)
        words += f" --steps {arguments.steps}"
    job = OnlineJob(
        variant=variant,
        seed=arguments.seed,
        command=f"{words} {'--virtual' if arguments.virtual else '--socket'}",
        settings=settings,
        begin_with=None if begin_with is None else begin_with / WEIGHTS_FILE,
        where="virtual board" if arguments.virtual else "rig",
        patience_s=VIRTUAL_PATIENCE_S if arguments.virtual else RIG_PATIENCE_S,
    )
    if arguments.virtual:
        with (
            tempfile.TemporaryDirectory(prefix="rl-online-") as folder,
            virtual_daemon(Path(folder), arguments.seed) as socket,
        ):
            record = learn_online(job, socket, arguments.out)
    else:
        record = learn_online(job, arguments.socket, arguments.out)
    metrics = record["metrics"]
    print(
        f"{variant} seed {arguments.seed}: {metrics['steps']} steps, {metrics['used']} of them as proposed, "
        f"{metrics['gaps']} gaps, MAE while learning {metrics['mae_k_while_learning']:.3f} K"
    )
    return 0


def _add_gap(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--variant", choices=OFFLINE, nargs="+", default=("RL-Off",), help="usual: RL-Off")
    sub.add_argument("--seed", type=int, nargs="+", default=(0, 1, 2, 3, 4), help="usual: 0 to 4")
    sub.add_argument("--policies", type=Path, default=POLICIES, help=f"usual: {POLICIES}")
    sub.add_argument("--out", type=Path, help="the table (usual: gap.txt among the policies)")
    sub.set_defaults(run=_gap)


def _gap(arguments: argparse.Namespace) -> int:
    """the same policies in their model and on the virtual rig, with and without randomised parameters"""
    from training.rl.gap import gap_table, hashes
    from training.rl.read_model import read_model

    groups = [
        (
            parameters,
            [folder_of(arguments.policies, variant, "ham", seed, drawn) for seed in arguments.seed],
        )
        for variant in arguments.variant
        for parameters, drawn in (("as fitted", False), ("drawn", True))
    ]
    words = " ".join(map(str, arguments.seed))
    command = f"greenhouse-train rl-gap --variant {' '.join(arguments.variant)} --seed {words}"
    out = arguments.out or arguments.policies / "gap.txt"
    with out.open("w", encoding="utf-8") as kept:
        for lines in (gap_table(groups, read_model("ham"), command), hashes(groups)):
            for line in lines:
                print(line, flush=True)
                print(line, file=kept)
    return 0


def _add_compare(sub: argparse.ArgumentParser) -> None:
    runs, results = Path("out/control"), POLICIES.parent / "control"
    sub.add_argument("--algorithm", nargs="+", metavar="NAME", help="usual: all of training/rl/algorithms")
    sub.add_argument("--seed", type=int, nargs="+", default=(0, 1, 2, 3, 4), help="usual: 0 to 4")
    sub.add_argument("--policies", type=Path, default=POLICIES, help=f"usual: {POLICIES}")
    sub.add_argument("--runs", type=Path, default=runs, help=f"runs done before and now (usual: {runs})")
    sub.add_argument(
        "--results", type=Path, default=results, help=f"figures of all controllers (usual: {results})"
    )
    sub.add_argument("--out", type=Path, help="folder of the table (usual: among the policies)")
    sub.set_defaults(run=_compare)


def _compare(arguments: argparse.Namespace) -> int:
    """policies of each learning algorithm, in fresh episodes and on the virtual rig, in one table"""
    from training.data.datasets import training_runs
    from training.rl.algorithms.registry import ALGORITHMS, algorithm_of
    from training.rl.compare import VARIANT, JudgedPolicy, compare, head, text_of, write
    from training.rl.read_model import REGIME
    from training.rl.study import world_of

    names = arguments.algorithm or list(ALGORITHMS)
    for name in names:
        algorithm_of(name)
    policies = [
        JudgedPolicy(name, folder_of(arguments.policies, VARIANT, "ham", seed, False, name))
        for name in names
        for seed in arguments.seed
    ]
    world = world_of(VARIANT, "ham", training_runs(REGIME))
    found = []
    for one in compare(policies, world, arguments.runs, arguments.results):
        print(f"{one.algorithm} seed {one.seed}: x equal {one.regret:.2f}", flush=True)
        found.append(one)
    words = f"greenhouse-train rl-compare --algorithm {' '.join(names)}"
    lines = head(f"{words} --seed {' '.join(map(str, arguments.seed))}", world)
    write(found, lines, arguments.out or arguments.policies)
    print(text_of(found, lines), end="")
    return 0


def folder_of(
    out: Path, variant: str, model: str, seed: int, randomised: bool, algorithm: str = USUAL
) -> Path:
    """Return the folder of a saved training under `out`."""
    where = f"{Path(model).stem}{'_randomised' if randomised else ''}"
    where += "" if algorithm == USUAL else f"_{algorithm.lower()}"
    return out / variant.lower() / where / f"seed_{seed}"


def _line(record: dict[str, Any]) -> str:
    played = record["metrics"]["validation"]
    return (
        f"{record['variant']:9s} {record['model']:5s} {record['algorithm']:8s} seed {record['seed']}  "
        f"MAE {played['mae_k']:.3f} K  "
        f"reward {played['reward']:.3f}  {record['wall_s']:.1f} s ({record['cpu_s']:.1f} s of CPU)"
    )
