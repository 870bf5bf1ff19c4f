"""`greenhouse-train rl` and `rl-online`: their arguments, and what they print."""

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
    """Both of them."""
    _add_offline(commands.add_parser("rl", help=_offline.__doc__, description=_offline.__doc__))
    _add_online(commands.add_parser("rl-online", help=_online.__doc__, description=_online.__doc__))


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
