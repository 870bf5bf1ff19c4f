"""page_check.py LINK PATH [KEY...]: ask the page of the machine that this runs in, as a browser does.

Enters by the link that `greenhouse page pair` printed, sends a POST to PATH of the API where that is "stop",
else a GET, and prints what the answer has below the keys.
"""

import json
import sys
import urllib.request
from typing import Any

JSON = {"content-type": "application/json", "sec-fetch-site": "same-origin"}


def ask(base: str, path: str, values: dict[str, Any] | None, cookie: str) -> tuple[Any, str]:
    """Return an answer and the cookie that it sets. values : None for a GET"""
    data = None if values is None else json.dumps(values).encode()
    request = urllib.request.Request(f"{base}/api/{path}", data, {**JSON, "origin": base, "cookie": cookie})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.load(answer), str(answer.headers.get("set-cookie", "")).partition(";")[0]


def main(link: str, path: str, *keys: str) -> None:
    """Enter, ask, print."""
    port = link.partition("/#")[0].rpartition(":")[2]
    base = f"http://127.0.0.1:{port}"
    _, cookie = ask(base, "session", {"link": link.partition("#link=")[2]}, "")
    found, _ = ask(base, path, {} if path == "stop" else None, cookie)
    for key in keys:
        found = found[key]
    print(found)


if __name__ == "__main__":
    main(*sys.argv[1:])
