"""python -m edge.page FILE: serve the page with the settings of a file, "" for every default.

The process of `greenhouse page` becomes this one, without all that a command line imports: 30 MB less.
"""

import sys

from edge.config import loading as config
from edge.core.errors import ConfigError
from edge.page.server import serve


def main(file: str) -> int:
    """Serve until SIGTERM or SIGINT."""
    try:
        serve(config.load(file) if file else config.default(), file)
    except ConfigError as error:
        print(f"greenhouse page: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
