"""The page `/docs`: its language, and what a browser without JavaScript shows."""

from fastapi import FastAPI, Request
from fastapi.routing import APIRoute
from starlette.responses import HTMLResponse

_PATH = "/docs"
_WITHOUT_SCRIPT = (
    "<noscript><p>This page needs JavaScript. What it shows is the OpenAPI document of this"
    ' service, <a href="{document}">{document}</a>.</p></noscript>'
)


def serve_docs_page(app: FastAPI) -> None:
    """Replace the route of the page, whose text the library gives no other way to change."""
    [place] = [
        number
        for number, route in enumerate(app.router.routes)
        if isinstance(route, APIRoute) and route.path == _PATH
    ]
    written = app.router.routes[place].endpoint  # type: ignore[attr-defined]

    async def page(request: Request) -> HTMLResponse:
        text = bytes((await written(request)).body).decode()
        document = f"{request.scope.get('root_path', '')}{app.openapi_url}"
        text = text.replace("<html>", '<html lang="en">', 1)
        text = text.replace("<body>", f"<body>{_WITHOUT_SCRIPT.format(document=document)}", 1)
        return HTMLResponse(text)

    app.router.routes[place] = APIRoute(_PATH, page, include_in_schema=False)
