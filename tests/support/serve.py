"""Run the service on a free port of this machine; its settings are in TENSORMAP_*.

Says its port and the id of its process.
"""

import os
import signal
import socket
import sys

if __name__ == "__main__":  # the processes of builds import this file too, and need nothing of it
    import uvicorn

    from app.http.connections import BoundedServer, connection_options, within_descriptors
    from app.main import create_app
    from app.settings import Settings

    signal.signal(signal.SIGTERM, lambda _number, _frame: sys.exit(0))  # as `tensormap serve`
    listener = socket.create_server(("127.0.0.1", 0))
    sys.stdout.write(f"{listener.getsockname()[1]} {os.getpid()}\n")
    sys.stdout.flush()  # whoever started it waits for it
    settings = within_descriptors(Settings())
    # Uvicorn's own log of requests goes to standard output, of which one line is read: as soon as
    # that pipe is full the service would wait for ever.
    config = uvicorn.Config(
        create_app(settings),
        access_log=False,
        timeout_graceful_shutdown=int(os.environ.get("TENSORMAP_TEST_GRACE_S", "10")),
        **connection_options(settings),
    )
    BoundedServer(config).run(sockets=[listener])
