"""The address at which a browser finds the page."""

import ipaddress
import socket

from edge.config.settings import Settings


def address(settings: Settings, opened: bool) -> str:
    """Return where a browser finds the page. opened : to the network, see `greenhouse page pair`"""
    page = settings.page
    name = next(iter(page.names), "")
    if name and _is_loopback(page.host):
        return f"https://{name}/"  # no name but a proxy's leads to a page that listens to this machine alone
    scheme = "https" if page.certificate else "http"
    name = name or (page.host.strip("0:.") and page.host)
    host = name or (f"{socket.gethostname().partition('.')[0]}.local" if opened else "127.0.0.1")
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{page.port}/"


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
