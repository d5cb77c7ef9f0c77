"""`tensormap serve`: the service in the foreground."""

import logging
import os
import signal
import socket
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from app.cli.chosen_settings import chosen_settings
from app.cli.errors import CommandFailed
from app.cli.stop_signals import hangup_as_termination
from app.ending import ANSWERS_S, end_hung_threads
from app.settings import LogFormat, unknown_variables

_log = logging.getLogger("tensormap")

_PING_S = 20.0  # of WebSockets; docs/reference/http-api.md#streams


def serve(
    host: Annotated[
        str | None,
        typer.Option(help="Address to listen on; all but loopback need a key. [127.0.0.1]"),
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port; 0 takes a free one. [8000]")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of all data. [data]")
    ] = None,
) -> None:
    """Start the service; `TENSORMAP_*` variables have the other settings."""
    # Here, not above: other commands must not wait for the whole service.
    from app.http import server
    from app.http.logs import configure_logging
    from app.process import (
        answer_beside_large_work,
        collect_garbage_of_work,
        private_files,
    )

    private_files()
    settings = chosen_settings(host=host, port=port, data_dir=data)
    configure_logging(settings.log_format, settings.log_level)
    for name in unknown_variables(os.environ):
        _log.warning("%s is set and is no setting of TensorMap: is it misspelt?", name)
    settings = server.within_descriptors(settings)
    with _listen(settings.host, settings.port) as listening:
        # Nor must an error of the address wait for it.
        import uvicorn

        from app.http.peers import with_both_forms
        from app.main import create_app
        from storage.files.forking import forkserver
        from storage.store import Store

        server.close_unread(listening)
        # An error at start is one line here; from inside Uvicorn it would be a traceback.
        forkserver()
        store = Store.serving(settings.data_dir, settings.catalog_url)
        app = create_app(settings, store)
        config = uvicorn.Config(
            app,
            host=settings.host,
            port=settings.port,
            server_header=False,
            log_config=None,
            access_log=False,  # the application has its own, without queries
            # Otherwise Uvicorn trusts the headers of everybody on this machine.
            proxy_headers=bool(settings.trusted_proxies),
            forwarded_allow_ips=with_both_forms(settings.trusted_proxies),
            ws_max_size=settings.max_json_bytes,
            # A signature has 60 bytes; a compressed message of 4 kB could be one of 4 MB.
            ws_per_message_deflate=False,
            ws_ping_interval=_PING_S,
            ws_ping_timeout=_PING_S,
            timeout_graceful_shutdown=ANSWERS_S,
            **server.connection_options(settings),
        )
        collect_garbage_of_work()
        answer_beside_large_work()
        # After its shutdown Uvicorn raises the signal that stopped it again: by default the process
        # would end at once, and leave the files of multiprocessing in /tmp.
        signal.signal(signal.SIGTERM, lambda _number, _frame: sys.exit(0))
        hangup_as_termination()
        # Uvicorn, given a socket, names no URL.
        began = f"TensorMap at {_url(listening)}"
        if settings.log_format is LogFormat.JSON:  # each line of the log is an object
            _log.info(began)
        else:
            typer.echo(began, err=True)
        # Started in another folder, `--data data` is another, empty directory.
        _log.info("the data directory is %s", store.layout.data_dir.resolve())
        try:
            bounded = server.BoundedServer(config, lambda: app.state.service.begin_stop())
            bounded.run(sockets=[listening])
        finally:
            end_hung_threads()


def _url(listening: socket.socket) -> str:
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _listen(host: str, port: int) -> socket.socket:
    """Bind the port before anything is opened or printed.

    The protocol is given because asyncio switches Nagle's algorithm off only for sockets with TCP:
    with the default, 0, every answer is 40 ms late.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with ExitStack() as closed_on_error:
        try:
            listening = closed_on_error.enter_context(
                socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
            )
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((host, port))
            listening.listen()  # reserves the port; the server sets how many connections may wait
        except (OSError, UnicodeError) as error:  # the latter: no name that could be looked up
            reason = getattr(error, "strerror", None) or error
            raise CommandFailed(f"cannot listen on {host}:{port}: {reason}") from None
        closed_on_error.pop_all()
    return listening
