"""Pages of other sites: which may ask, none unless the operator names it."""

from collections.abc import Sequence

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware

_METHODS = ("DELETE", "GET", "PATCH", "POST", "PUT")
_ASKED_WITH = (
    "Authorization",
    "Content-Digest",
    "Content-Type",
    "Idempotency-Key",
    "If-Match",
    "If-None-Match",
    "Last-Event-ID",
)
_TOLD = ("ETag", "Location", "RateLimit", "RateLimit-Policy", "Retry-After")
_REMEMBERED_S = 600


def allow_origins(app: FastAPI, origins: Sequence[str]) -> None:
    """Let the pages of these sites ask and read the answers, with a key that they hold.

    Never with what a browser would send by itself: the service has no cookies, and is told none.
    Without origins nothing is added, and a browser keeps every answer from pages elsewhere.
    """
    if not origins:
        return
    app.add_middleware(
        CORSMiddleware,
        allow_origins=list(origins),
        allow_methods=_METHODS,
        allow_headers=_ASKED_WITH,
        expose_headers=_TOLD,
        allow_credentials=False,
        max_age=_REMEMBERED_S,
    )
