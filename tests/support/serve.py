"""Run the service on a free port of this machine; its settings are in TENSORMAP_*.

Says its port and the id of its process.
"""

import os
import socket
import sys

import uvicorn

from app.main import create_app

if __name__ == "__main__":
    listener = socket.create_server(("127.0.0.1", 0))
    sys.stdout.write(f"{listener.getsockname()[1]} {os.getpid()}\n")
    sys.stdout.flush()  # whoever started it waits for it
    uvicorn.Server(uvicorn.Config(create_app())).run(sockets=[listener])
