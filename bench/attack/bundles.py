"""Hostile bundles: python -m bench.attack.bundles --seed S --count N. Each is refused, or runs in shadow.

Damaged archives, unsigned and signed contents that nobody here would make, graphs that loop for ever or take
all memory. Whatever comes, the active bundle stays the one that it was, byte for byte, and nothing hangs.
"""

import hashlib
import io
import json
import random
import shutil
import signal
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from onnx import TensorProto, helper

from bench.attack.part import TrialResult, main_of
from edge.bundle.archive import open_archive
from edge.bundle.manifest import MANIFEST, SIGNATURE
from edge.bundle.predictors import loader
from edge.bundle.proof import ProofLimits, Prover
from edge.bundle.roles import activate
from edge.bundle.sign import ManifestFacts, build_bundle, generate_key, sign_folder
from edge.bundle.store import PACKAGED_FOLDER, BundleStore
from edge.core.errors import DataError, RequestError
from edge.models import policy_contract as contract
from edge.models.onnx_policy import INPUT, OUTPUT
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES

ACTIVE = "1.0"
LIMITS = ProofLimits(cpu_s=4, wall_s=20.0)
HANG_S = 30  # per bundle; the prover's limit is the longest that may be waited for
Files = dict[str, bytes]
JSON_VALUES: tuple[object, ...] = (
    None,
    True,
    -1,
    1e308,
    10**400,
    "",
    "\ud800",
    "../x",
    [],
    {},
    [[]] * 9,
    "x" * 99_999,
    float("nan"),
)


def loop_graph(trips: int, size: int) -> bytes:
    """Return a policy whose graph loops `trips` times over an array of `size` numbers."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go_in"], ["go"]),
            helper.make_node("Sin", ["state_in"], ["state"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("trip", TensorProto.INT64, []),
            helper.make_tensor_value_info("go_in", TensorProto.BOOL, []),
            helper.make_tensor_value_info("state_in", TensorProto.FLOAT, None),
        ],
        [
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("state", TensorProto.FLOAT, None),
        ],
    )
    nodes = [
        helper.make_node("ReduceSum", [INPUT], ["sum"], keepdims=0),
        helper.make_node("Expand", ["sum", "size"], ["big"]),
        helper.make_node("Loop", ["trips", "yes", "big"], ["looped"], body=body),
        helper.make_node("ReduceMean", ["looped"], ["mean"], keepdims=0),
        helper.make_node("MatMul", [INPUT, "weights"], ["linear"]),
        helper.make_node("Add", ["linear", "mean"], [OUTPUT]),
    ]
    graph = helper.make_graph(
        nodes,
        "evil",
        [helper.make_tensor_value_info(INPUT, TensorProto.FLOAT, ["B", len(FEATURES)])],
        [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, ["B", ACTIONS])],
        [
            helper.make_tensor("trips", TensorProto.INT64, [], [trips]),
            helper.make_tensor("yes", TensorProto.BOOL, [], [True]),
            helper.make_tensor("size", TensorProto.INT64, [1], [size]),
            helper.make_tensor(
                "weights", TensorProto.FLOAT, [len(FEATURES), ACTIONS], [0.0] * len(FEATURES) * ACTIONS
            ),
        ],
    )
    # All else is as it should be: only the time that it takes may be what refuses it.
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)
    facts: dict[str, Any] = {
        "variant": "RL-Off", "sample_s": 60.0, "model": "ham", "model_sha256": "0" * 64,
        "data_sha256": "0" * 64, "command": "none", "seed": 0, "settings": {}, "metrics": {}, "software": {},
    }  # fmt: skip
    observations = np.eye(len(FEATURES))[:3]
    document = contract.document_of(observations, np.zeros((3, ACTIONS)), facts)
    model.metadata_props.add(key=contract.KEY, value=json.dumps(document))
    return bytes(model.SerializeToString())


ENDLESS = loop_graph(2**62, 1)
GREEDY = loop_graph(1, 2**31)


class BundleRig:
    """A store with an active bundle, and the key that the rig trusts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.trusted = folder / "trusted"
        self.trusted.mkdir()
        self.key, self.other_key = folder / "key.pem", folder / "other.pem"
        shutil.move(generate_key(self.key), self.trusted)
        generate_key(self.other_key)
        self.store = BundleStore(
            folder / "store", self.trusted, loader(60.0), prove=Prover(self.trusted, 60.0, LIMITS)
        )
        self.models = folder / "models"
        self.models.mkdir()
        for name in ("arx.json", "twin.yaml", "intervals.json", "report.json", "lstm.onnx", "rl-off.onnx"):
            shutil.copyfile(PACKAGED_FOLDER / name, self.models / name)
        self.build(folder / "active.zip", ACTIVE)
        with open_archive(folder / "active.zip") as archive:
            self.store.install(archive)
        self.store.change(lambda roles: activate(roles, None))
        self.before = self.state()

    def build(self, out: Path, version: str, key: Path | None = None) -> bytes:
        """Build a sound archive."""
        facts = ManifestFacts(version=version, created_utc="2026-07-01T12:00:00Z", data_sha256="d" * 64)
        build_bundle(self.models, out, facts, key or self.key)
        return out.read_bytes()

    def sign_bundle(self, files: Mapping[str, bytes], manifest: Callable[[dict[str, Any]], None]) -> Files:
        """Files with a signed manifest that says of them what `manifest` makes of the true one."""
        document = json.loads(files[MANIFEST])
        own = {name: content for name, content in files.items() if name not in (MANIFEST, SIGNATURE)}
        document["files"] = {
            name: {"sha256": hashlib.sha256(content).hexdigest(), "size": len(content)}
            for name, content in own.items()
        }
        manifest(document)
        content = json.dumps(document).encode()
        key: Any = load_pem_private_key(self.key.read_bytes(), None)
        return {**own, MANIFEST: content, SIGNATURE: key.sign(content)}

    def state(self) -> tuple[str, str]:
        """Return the active bundle, and a digest of all of its bytes."""
        digest = hashlib.sha256()
        for path in sorted((self.folder / "store" / ACTIVE).iterdir()):
            digest.update(path.name.encode() + path.read_bytes())
        return self.store.roles().active, digest.hexdigest()


def _keep(document: dict[str, Any]) -> None:
    """Leave the manifest as it is."""


def unpack(archive: bytes) -> Files:
    """Return the files of a zip archive by name."""
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def pack(files: Mapping[str, bytes] | list[tuple[str, bytes]]) -> bytes:
    """Return a zip archive; a list may name one file twice, as no honest archive does."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items() if isinstance(files, Mapping) else files:
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def flip_bytes(content: bytes, chance: random.Random, share: float = 0.0) -> bytes:
    """Exchange some bytes, at least one."""
    changed = bytearray(content)
    for _ in range(1 + int(share * len(changed) * chance.random())):
        changed[chance.randrange(len(changed))] = chance.randrange(256)
    return bytes(changed)


def evil_json(content: bytes, chance: random.Random) -> bytes:
    """One value of a document exchanged, or the document for one that no reader expects."""
    if chance.random() < 0.2:
        return chance.choice(
            [b"[" * 100_000, b'{"a":' * 100_000, b"\xff\xfe", b"", b"9" * 5000, b'{"format": 1e999}']
        )
    document = json.loads(content)
    place: Any = document
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = chance.choice(keys)
        inner = place[key]
        if isinstance(inner, dict | list) and inner and chance.random() < 0.7:
            place = inner
        else:
            place[key] = chance.choice(JSON_VALUES)
            return json.dumps(document).encode()


def evil_yaml(chance: random.Random) -> bytes:
    """Draw a YAML text that costs a careless reader memory, depth or time."""
    return chance.choice(
        [
            b"a: &a [1, 1]\nb: &b [*a, *a]\nsample_s: [*b, *b]\n",
            b"sample_s: " + b"[" * 5000,
            b"sample_s: " + b"9" * 400 + b"\n",
            b"sample_s: " + b"x" * 200_000 + b"\n",
            b"effects: {wall_loss: {UA: 1e308}}\n",
            b"sample_s: 1e-300\n",
            b"geometry: {volume_m3: .nan}\n",
            b"!!python/object/apply:os.system [id]\n",
            b"\xff\xff",
        ]
    )


def evil_archive(rig: BundleRig, chance: random.Random, version: str) -> tuple[str, bytes]:
    """Return the kind of damage, and the archive."""
    archive = rig.build(rig.folder / "sound.zip", version)
    files = unpack(archive)
    kind = chance.choice(KINDS)
    return kind, MAKE[kind](rig, chance, archive, files)


def _names(rig: BundleRig, chance: random.Random, archive: bytes, files: Files) -> bytes:
    name = chance.choice(
        ["../roles.json", "/etc/passwd", "a/b", ".hidden", "x" * 300, "arx.json", "\u202e", "roles.json"]
    )
    return pack([*files.items(), (name, b"x")])


def _onnx(rig: BundleRig, chance: random.Random, archive: bytes, files: Files) -> bytes:
    name = chance.choice(["lstm.onnx", "rl-off.onnx"])
    return pack(rig.sign_bundle({**files, name: flip_bytes(files[name], chance, 0.001)}, _keep))


def _graph(graph: bytes) -> "Make":
    def make(rig: BundleRig, chance: random.Random, archive: bytes, files: Files) -> bytes:
        return pack(rig.sign_bundle({**files, "rl-off.onnx": graph}, _keep))

    return make


def _other_key(rig: BundleRig, chance: random.Random, archive: bytes, files: Files) -> bytes:
    folder = rig.folder / "foreign"
    shutil.copytree(rig.models, folder)
    sign_folder(folder, ManifestFacts("9.0", "2026-07-01T12:00:00Z", "d" * 64), rig.other_key)
    content = {path.name: path.read_bytes() for path in folder.iterdir()}
    shutil.rmtree(folder)
    return pack(content)


def _older(rig: BundleRig, chance: random.Random, archive: bytes, files: Files) -> bytes:
    older = chance.choice(["0.1", "0.9.9", "alpha", "0", "00.99-rc1"])
    return pack(rig.sign_bundle(files, lambda document: document.update(version=older)))


def _manifest(rig: BundleRig, chance: random.Random, archive: bytes, files: Files) -> bytes:
    def change(document: dict[str, Any]) -> None:
        changed = evil_json(json.dumps(document).encode(), chance)
        with suppress(ValueError, RecursionError):
            found = json.loads(changed)
            if isinstance(found, dict):
                document.clear()
                document.update(found)

    return pack(rig.sign_bundle(files, change))


Make = Callable[[BundleRig, random.Random, bytes, Files], bytes]
MAKE: dict[str, Make] = {
    "flipped bytes": lambda rig, chance, archive, files: flip_bytes(archive, chance, 0.01),
    "cut": lambda rig, chance, archive, files: archive[: chance.randrange(len(archive))],
    "noise": lambda rig, chance, archive, files: chance.randbytes(chance.randrange(100_000)),
    "names": _names,
    "bomb": lambda rig, chance, archive, files: pack({f"a{n}": bytes(15 << 20) for n in range(3)}),
    "many files": lambda rig, chance, archive, files: pack({f"a{n}": b"" for n in range(2000)}),
    "unsigned manifest": lambda rig, chance, archive, files: pack(
        {**files, MANIFEST: evil_json(files[MANIFEST], chance)}
    ),
    "unsigned file": lambda rig, chance, archive, files: pack(
        {**files, "arx.json": evil_json(files["arx.json"], chance)}
    ),
    "other key": _other_key,
    "older": _older,
    "signed manifest": _manifest,
    "signed arx": lambda rig, chance, archive, files: pack(
        rig.sign_bundle({**files, "arx.json": evil_json(files["arx.json"], chance)}, _keep)
    ),
    "signed intervals": lambda rig, chance, archive, files: pack(
        rig.sign_bundle({**files, "intervals.json": evil_json(files["intervals.json"], chance)}, _keep)
    ),
    "signed twin": lambda rig, chance, archive, files: pack(
        rig.sign_bundle({**files, "twin.yaml": evil_yaml(chance)}, _keep)
    ),
    "signed onnx": _onnx,
    "endless graph": _graph(ENDLESS),
    "greedy graph": _graph(GREEDY),
}  # fmt: skip
SLOW = ("endless graph", "greedy graph", "signed onnx", "bomb")
KINDS = [kind for kind in MAKE for _ in range(1 if kind in SLOW else 3)]


class Hang(BaseException):
    """An attempt took longer than HANG_S; no `except Exception` on the way may swallow it."""


@contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Raise Hang in the main thread after so long."""

    def ring(number: int, frame: object) -> None:
        raise Hang(f"no end after {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def attempt(rig: BundleRig, seed: int) -> tuple[str, str, str]:
    """Install the bundle of this seed. Returns : its kind, the outcome, the violation ("" without one)"""
    kind, archive = evil_archive(rig, random.Random(seed), f"2.{seed}")
    try:
        with time_limit(HANG_S):
            rig.store.install(io.BytesIO(archive))
        outcome = "in shadow"
    except (DataError, RequestError) as error:
        outcome = "refused"
        if not str(error).strip() or "\n" in str(error):
            return kind, outcome, f"its reason is not a line: {str(error)[:200]!r}"
    except (Exception, Hang) as error:
        return kind, "failed", f"{type(error).__name__}: {str(error)[:200]}"
    if rig.state() != rig.before:
        return kind, outcome, "the active bundle has changed"
    return kind, outcome, ""


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """One bundle of each seed into one store; afterwards the active bundle still loads."""
    with tempfile.TemporaryDirectory(prefix="gh-") as folder:
        rig = BundleRig(Path(folder))
        for number in range(seed, seed + count):
            kind, outcome, violation = attempt(rig, number)
            yield TrialResult(f"{kind}, seed {number}: {outcome}", 1, [violation] if violation else [])
        rig.store.load(ACTIVE)


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 200, "bundles", __doc__))
