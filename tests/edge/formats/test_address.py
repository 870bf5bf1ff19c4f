"""edge/formats/address.py: which hosts and http addresses a setting may hold."""

import pytest

from edge.formats.address import host_problem, url_problem

HOSTS = (
    "localhost",
    "broker.lan",
    "broker.lan.",
    "mqtt_broker",
    "10.0.0.7",
    "::1",
    "fe80::1%eth0",
    "bücher.example",
    "",
)
NO_HOSTS = (
    *("mqtt://broker:1883", "broker:1883", "http://broker", "broker/", "a@broker", "[::1]", "10.0.0.300"),
    *("a b", "a..b", "x" * 64, "ü" * 63, "1883", "#", "?", "a\\b", " broker"),
)
URLS = (
    *("http://localhost:11434/v1", "https://ntfy.sh/topic", "http://10.0.0.7", "https://host/hook?token=a"),
    *("http://[::1]:8420/", "HTTPS://host/", ""),
)
NO_URLS = (
    *("http://a@b:c/", "http://a:b@host/", "http://host:port/", "http://host:0/", "http://host:99999/"),
    *(
        "host",
        "//host/",
        "ftp://host/",
        "mqtt://host",
        "http://",
        "http:///path",
        "http://[::1/",
        "http://10.0.0.300/",
    ),
    *("http://ho st/", "https://host/#part", "http://host/a b"),
)


@pytest.mark.parametrize("text", HOSTS)
def test_a_host_is_a_name_or_an_address(text: str) -> None:
    assert host_problem(text) == ""


@pytest.mark.parametrize("text", NO_HOSTS)
def test_what_is_more_or_less_than_a_host_is_refused(text: str) -> None:
    assert "is not a host name or an IP address alone" in host_problem(text)


@pytest.mark.parametrize("text", URLS)
def test_an_http_address_has_a_host_and_may_have_port_path_and_query(text: str) -> None:
    assert url_problem(text) == ""


@pytest.mark.parametrize("text", NO_URLS)
def test_what_cannot_be_asked_by_http_is_refused_without_a_quote(text: str) -> None:
    assert url_problem(text).startswith("is not https://HOST/PATH")
