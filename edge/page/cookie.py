"""The secret of a session: in a cookie that no script reads, or in the header that a program sends."""

from starlette.requests import Request
from starlette.responses import Response

COOKIE = "greenhouse_session"
COOKIE_S = 365 * 86_400  # the session ends before, on this side


def secret_of(request: Request) -> str:
    """Return the secret that a request carries, "" without one."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    return token if scheme == "Bearer" else request.cookies.get(COOKIE, "")


def set_cookie(request: Request, response: Response, secret: str) -> None:
    """Have the browser keep the secret."""
    secure = request.url.scheme == "https" or request.headers.get("x-forwarded-proto") == "https"
    response.set_cookie(COOKIE, secret, max_age=COOKIE_S, httponly=True, samesite="strict", secure=secure)


def delete_cookie(response: Response) -> None:
    """Have the browser forget it."""
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
