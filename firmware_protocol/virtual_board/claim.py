"""One process per path: what a killed board left behind is taken away, what a live one owns is refused."""

import socket
from pathlib import Path


class PathInUse(Exception):
    """The path belongs to a living board, or is none of ours."""


def claim(path: Path) -> socket.socket:
    """Own `path` for as long as the socket returned lives, and clear it of a dead board's rest.

    The kernel frees an abstract socket name when its process ends, however that was; a lock file would stay.
    Errors: PathInUse.
    """
    owner = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        owner.bind(f"\0virtual_board:{path.absolute()}")
    except OSError as error:
        owner.close()
        raise PathInUse(f"{path}: in use by a running board") from error
    if path.is_symlink() or path.is_socket():
        path.unlink()
    elif path.exists():
        owner.close()
        raise PathInUse(f"{path}: there is a file that no board has made")
    return owner
