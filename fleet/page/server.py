"""Serves the fleet's page at the address of its settings, by the server of a rig's page."""

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
