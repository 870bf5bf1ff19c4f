"""Servers of language models from their packages, each in an environment of its own, while they are needed.

No part of `make test`: packages are installed, one of them is compiled.
"""

import os
import site
import subprocess
import time
import urllib.request
import venv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.support.broker import free_port

TRANSFORMERS = "transformers[serving]"
START_S = 300.0
END_S = 30.0


def environment(
    place: Path, packages: Sequence[str], lends_torch: bool = False, build: Mapping[str, str] | None = None
) -> Path:
    """Return the python of an environment with the packages, made at the first call.

    place : its folder; build : environment variables of the installation
    lends_torch : torch comes from the environment that runs this
    """
    python = place / "venv" / "bin" / "python"
    done = place / "venv" / "installed"
    if not done.exists():
        venv.create(place / "venv", with_pip=True)
        if lends_torch:
            (library,) = (place / "venv" / "lib").glob("python3.*/site-packages")
            (library / "lent.pth").write_text("\n".join(site.getsitepackages()) + "\n")
        # Without pip's cache: a wheel that was built with other flags may lie there.
        words = ["-m", "pip", "install", "--quiet", "--no-cache-dir", *packages]
        subprocess.run([python, *words], check=True, env={**os.environ, **(build or {})})
        done.touch()
    return python


def version_of(python: Path, package: str) -> str:
    """Return the version of a package in an environment."""
    code = f"import importlib.metadata as m; print(m.version({package!r}))"
    return subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@contextmanager
def transformers_server(python: Path, model: str, place: Path) -> Iterator[str]:
    """Serve a model's folder in `place` by `transformers serve`; yield the base URL."""
    port = free_port()
    words = [str(python.with_name("transformers")), "serve", model, "--device", "cpu", "--port", str(port)]
    with _running(words, place, f"http://127.0.0.1:{port}/health"):
        yield f"http://127.0.0.1:{port}/v1"


@contextmanager
def llama_server(python: Path, gguf: Path, name: str, place: Path, threads: int) -> Iterator[str]:
    """Serve a GGUF file by llama-cpp-python's server under a name; yield the base URL."""
    port = free_port()
    words = [str(python), "-m", "llama_cpp.server", "--model", str(gguf.resolve()), "--model_alias", name]
    words += ["--port", str(port), "--n_ctx", "4096", "--n_threads", str(threads)]
    with _running(words, place, f"http://127.0.0.1:{port}/v1/models"):
        yield f"http://127.0.0.1:{port}/v1"


@contextmanager
def _running(words: Sequence[str], place: Path, ready: str) -> Iterator[None]:
    log = place / "server.log"
    with log.open("w") as out:
        offline = {**os.environ, "HF_HUB_OFFLINE": "1"}
        process = subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT, env=offline, cwd=place)
    try:
        _wait_until_ready(process, ready, log)
        yield
    finally:
        process.terminate()
        process.wait(END_S)


def _wait_until_ready(process: "subprocess.Popen[bytes]", url: str, log: Path) -> None:
    give_up = time.monotonic() + START_S
    while time.monotonic() < give_up:
        if process.poll() is not None:
            raise SystemExit(f"the server ended, see {log}")
        try:
            with urllib.request.urlopen(url, timeout=5.0):
                return
        except OSError:
            time.sleep(0.5)
    raise SystemExit(f"the server was not ready within {START_S:g} s")
