"""The asking side of the control socket, which imports little: a stop has to start fast."""

import json
import socket
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edge.core.errors import RequestError
from edge.formats.reader import parse_json

ANSWER_MAX = 16 << 20  # longest answer [bytes]


class NobodyListens(RequestError):
    """There is no daemon to ask."""


def request(path: Path, message: Mapping[str, Any], timeout_s: float = 15.0) -> dict[str, Any]:
    """Client side: send one request, wait for its answer. Errors: RequestError, of it NobodyListens."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            # With a full queue a socket with a time-out would fail at once, a blocking one waits its turn.
            whole_s = int(timeout_s)
            limit = struct.pack("@ll", whole_s, int(1e6 * (timeout_s - whole_s)) or 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
            connection.connect(str(path))
            connection.settimeout(timeout_s)
            connection.sendall(encode_line(message))
            with connection.makefile("rb") as answers:
                answer = answers.readline()
    except (FileNotFoundError, ConnectionRefusedError):
        raise NobodyListens(f"no daemon listens at {path}") from None
    except (TimeoutError, BlockingIOError):
        raise RequestError(f"the daemon at {path} did not answer within {timeout_s:g} s") from None
    except OSError as error:
        raise RequestError(f"{path}: {error.strerror or error}") from None
    if not answer.endswith(b"\n"):
        raise RequestError(f"the daemon at {path} went away before it answered")
    return parse_json(answer, str(path), ANSWER_MAX)


def listens(path: Path) -> bool:
    """Return at once whether a process has the socket open, also one that hangs or that refuses this user."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except (FileNotFoundError, NotADirectoryError, ConnectionRefusedError, ValueError):
            return False
        except OSError:
            return True
    return True


def encode_line(message: Mapping[str, Any]) -> bytes:
    """Return a request or an answer as it goes over the socket."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode() + b"\n"
