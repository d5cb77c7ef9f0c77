"""The least that FastAPI and Uvicorn need for an answer: a server that only reads bodies.

    python -m benchmarks.http_floor

The settings are those of `serve`, without our middlewares.
"""

import socket
import sys

import uvicorn
from fastapi import FastAPI, Request, WebSocket
from starlette.responses import Response

app = FastAPI()


@app.get("/readyz")
async def ready() -> dict[str, str]:
    """Answer."""
    return {"status": "ok"}


@app.post("/floor")
async def floor(request: Request) -> Response:
    """Read the body."""
    await request.body()
    return Response(b"{}", media_type="application/json")


@app.websocket("/echo")
async def echo(websocket: WebSocket) -> None:
    """Send each message back."""
    await websocket.accept()
    while True:
        await websocket.send_bytes(await websocket.receive_bytes())


def main() -> None:
    """Serve on a free port until the process is ended."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listening.bind(("127.0.0.1", 0))
    config = uvicorn.Config(
        app,
        loop="uvloop",
        http="httptools",
        server_header=False,
        ws="websockets-sansio",
        log_config=None,
        access_log=False,
    )
    print(f"http://127.0.0.1:{listening.getsockname()[1]}", file=sys.stderr, flush=True)
    uvicorn.Server(config).run(sockets=[listening])


if __name__ == "__main__":
    main()
