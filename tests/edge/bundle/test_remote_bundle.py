"""A fleet's orders about bundles: obeyed for one address and trusted signatures alone."""

import hashlib
import io
import ssl
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from bundles import Workshop, make_store
from certificates import make_certificates

from edge.bundle import remote
from edge.bundle.keeper import BundleKeeper
from edge.bundle.manifest import PACKAGED
from edge.bundle.roles import Roles
from edge.bundle.store import BundleStore
from edge.core.clock import RealClock
from edge.core.errors import DataError, RequestError
from edge.core.messages import Event
from tests.support.broker import wait_for


@contextmanager
def serving(files: dict[str, bytes], moved: str = "", papers: Path | None = None) -> Iterator[str]:
    """The address of a server of these files; `moved` is answered for every other path. papers : for https"""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            content = files.get(self.path)
            self.send_response(200 if content is not None else 302 if moved else 404)
            if content is None and moved:
                self.send_header("Location", moved)
            self.end_headers()
            self.wfile.write(content or b"")

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    if papers is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(papers / "broker.crt", papers / "broker.key")
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield f"{'https' if papers else 'http'}://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class OrderedRig:
    """A keeper of bundles that takes orders for an address."""

    def __init__(self, store: BundleStore, source: str) -> None:
        self.store, self.told = store, list[Event]()
        place = remote.BundleSource(source)
        self.keeper = BundleKeeper(store, RealClock(), automatic=False, trial_ticks=10, source=place)

    def close(self) -> None:
        self.keeper.close()

    def order(self, action: str, **keys: Any) -> str:
        """The refusal or the job's error, "" for an order that was carried out."""
        reply = self.keeper.answer({"do": "bundle", "action": action, **keys})
        if not reply["ok"]:
            return str(reply["error"])
        status: dict[str, Any] = {}

        def is_done() -> bool:
            status.update(self.keeper.answer({"action": "status", "job": reply["job"]}))
            return bool(status["job_done"])

        wait_for(is_done, "the job is done")
        self.told += self.keeper.events_pending()
        return str(status["job_error"])


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_signed_bundle_from_the_source_is_activated_once_and_rolled_back_once(workshop: Workshop) -> None:
    archive = workshop.archive("1.0")
    digest = sha256(archive)
    with (
        serving({"/b/1.zip": archive.read_bytes()}) as at,
        closing(OrderedRig(make_store(workshop), f"{at}/b/")) as rig,
    ):
        for _ in range(2):  # an order may come twice
            assert rig.order(remote.INSTALL, url=f"{at}/b/1.zip", sha256=digest) == ""
            assert rig.store.roles() == Roles("1.0", PACKAGED, on_probation=True)
            assert rig.keeper.serving.active is not None and rig.keeper.serving.active.name == "1.0"
        for _ in range(2):
            assert rig.order(remote.ROLL_BACK, version="1.0") == ""
            assert rig.store.roles().active == PACKAGED
    assert [event.key for event in rig.told] == ["bundle.remote-install"] * 2 + ["bundle.remote-rollback"] * 2
    assert rig.told[0].text.startswith(f"sha256 {digest}, asked for; 1.0 is active")
    assert rig.told[2].text.startswith("bundle 1.0, asked for; packaged is active")


def test_the_authority_of_the_source_is_that_of_the_settings(workshop: Workshop, tmp_path: Path) -> None:
    archive, papers = workshop.archive("1.0"), make_certificates(tmp_path / "papers")

    def fetched(authority: str) -> bytes:
        into = io.BytesIO()
        with serving({"/1.zip": archive.read_bytes()}, papers=papers) as at:
            remote.fetch(f"{at}/1.zip", sha256(archive), into, authority)
        return into.getvalue()

    assert fetched(str(papers / "ca.crt")) == archive.read_bytes()
    for authority in ("", str(papers / "stranger.crt")):
        with pytest.raises(DataError, match="CERTIFICATE_VERIFY_FAILED"):
            fetched(authority)
    with pytest.raises(DataError, match=r"bundle\.source_ca: .*nowhere"):
        fetched(str(tmp_path / "nowhere"))


def test_a_bundle_that_no_trusted_key_signed_is_refused(workshop: Workshop, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    foreign = Workshop(tmp_path / "other").archive("1.0")
    with (
        serving({"/1.zip": foreign.read_bytes()}) as at,
        closing(OrderedRig(make_store(workshop), at)) as rig,
    ):
        assert "by none of the" in rig.order(remote.INSTALL, url=f"{at}/1.zip", sha256=sha256(foreign))
        assert (rig.store.versions(), rig.store.roles()) == ([], Roles())
    assert [event.key for event in rig.told] == ["bundle.failed"]
    assert sha256(foreign) in rig.told[0].text  # by which the fleet knows its order


def test_other_bytes_than_ordered_are_refused(workshop: Workshop) -> None:
    archive = workshop.archive("1.0")
    with (
        serving({"/1.zip": archive.read_bytes()}) as at,
        closing(OrderedRig(make_store(workshop), at)) as rig,
    ):
        assert "the order says" in rig.order(remote.INSTALL, url=f"{at}/1.zip", sha256="0" * 64)
        assert rig.store.versions() == []
        assert [path.name for path in rig.store.folder.iterdir()] == []


def test_a_server_that_sends_elsewhere_is_not_followed(workshop: Workshop) -> None:
    archive = workshop.archive("1.0")
    with (
        serving({"/1.zip": archive.read_bytes()}) as elsewhere,
        serving({}, moved=f"{elsewhere}/1.zip") as at,
        closing(OrderedRig(make_store(workshop), at)) as rig,
    ):
        assert "answers 302" in rig.order(remote.INSTALL, url=f"{at}/1.zip", sha256=sha256(archive))
        assert rig.store.versions() == []


def test_a_bundle_whose_models_fail_their_proof_stays_out(workshop: Workshop) -> None:
    def prove(folder: Path) -> None:
        raise DataError("its models loop for ever")

    archive = workshop.archive("1.0")
    with (
        serving({"/1.zip": archive.read_bytes()}) as at,
        closing(OrderedRig(make_store(workshop, prove=prove), at)) as rig,
    ):
        assert "loop for ever" in rig.order(remote.INSTALL, url=f"{at}/1.zip", sha256=sha256(archive))
        assert rig.store.roles() == Roles()


def test_a_server_that_is_away_is_named(workshop: Workshop) -> None:
    with serving({}) as at:
        pass
    with closing(OrderedRig(make_store(workshop), at)) as rig:
        assert f"{at}/1.zip: " in rig.order(remote.INSTALL, url=f"{at}/1.zip", sha256="0" * 64)


@pytest.mark.parametrize("action", remote.ACTIONS)
def test_a_rig_without_a_source_takes_no_orders(workshop: Workshop, action: str) -> None:
    keys = {"url": "http://fleet/b.zip", "sha256": "0" * 64, "version": "1.0"}
    with closing(OrderedRig(make_store(workshop, "1.0"), "")) as rig:
        assert "bundle.source is empty" in rig.order(action, **keys)
        assert rig.store.roles().shadow == "1.0"


@pytest.mark.parametrize(
    "url",
    [
        "http://fleet.example/b",
        "http://fleet.example/b/",
        "http://fleet.example/b/../x.zip",
        "http://fleet.example/b/more/x.zip",
        "http://fleet.example/b/x.zip?to=1",
        "http://fleet.example/b/%2e%2e",
        "http://fleet.example/bx.zip",
        "https://fleet.example/b/x.zip",
        "http://fleet.example.evil/b/x.zip",
        "http://fleet.example@evil/b/x.zip",
        "",
        None,
    ],
)
def test_an_address_elsewhere_is_refused_before_anything_is_fetched(url: str | None) -> None:
    with pytest.raises(RequestError, match=r"no file directly under bundle\.source"):
        remote.install_order(remote.BundleSource("http://fleet.example/b"), url, "0" * 64)
