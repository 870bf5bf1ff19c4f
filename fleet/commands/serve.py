"""`greenhouse fleet serve`: the page of all rigs and its API."""

import argparse
import asyncio
import contextlib

import uvicorn

from edge.config.settings import PageSettings
from edge.page.server import config_of, listen, prepare
from fleet.page.app import make_fleet_app
from fleet.settings import FleetSettings


def serve_fleet(settings: FleetSettings) -> None:
    """Serve until SIGTERM or SIGINT. Errors: ConfigError where the address is taken; DataError"""
    prepare()
    place = PageSettings(host=settings.page.host, port=settings.page.port)
    server = uvicorn.Server(config_of(make_fleet_app(settings), place))
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(each) for each in listen(place, opened=False)]
        asyncio.run(server.serve(sockets=sockets))


def run_serve(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C. Errors: ConfigError, DataError"""
    serve_fleet(settings)
    return 0
