"""Options of the commands that read run files: which columns a run may lack."""

import argparse

from edge.formats.run_file import OPTION_WITHOUT


def add_absent_columns(parser: argparse.ArgumentParser, *columns: str) -> None:
    """Add the options for `columns`, keys of OPTION_WITHOUT; `arguments.without` lists what may be absent."""
    parser.set_defaults(without=[])
    for column in columns:
        parser.add_argument(
            OPTION_WITHOUT[column],
            action="append_const",
            const=column,
            dest="without",
            help=f"accept run files without the column {column}, which was not recorded",
        )
