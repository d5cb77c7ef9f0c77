"""What a connection does while others need its place or its client leaves."""

import asyncio
import socket

import uvicorn

from app.http.server import BoundedServer, connection_options, within_descriptors
from app.settings import Settings


def test_a_request_notices_that_its_client_left_though_another_one_waits_behind_it():
    async def left_after(sent):
        left = asyncio.Event()

        async def app(scope, receive, send):
            assert scope["path"] == "/first"
            await send({"type": "http.response.start", "status": 200, "headers": []})
            while (await receive())["type"] != "http.disconnect":
                pass
            left.set()

        options = connection_options(within_descriptors(Settings()))
        server = BoundedServer(uvicorn.Config(app, log_config=None, lifespan="off", **options))
        with socket.create_server(("127.0.0.1", 0)) as listening:
            serving = asyncio.create_task(server.serve([listening]))
            reader, writer = await asyncio.open_connection(*listening.getsockname())
            writer.write(sent)
            assert await reader.readline() == b"HTTP/1.1 200 OK\r\n"
            writer.close()
            await asyncio.wait_for(left.wait(), 20)
            server.should_exit = True
            await serving

    first, second = (
        b"GET /%b HTTP/1.1\r\nHost: a\r\n\r\n" % path for path in (b"first", b"second")
    )
    asyncio.run(left_after(first))
    asyncio.run(left_after(first + second))


def test_a_client_that_still_reads_its_answer_keeps_its_connection_where_all_are_in_use():
    answer, connections = b"a" * 2**24, 8

    async def app(scope, receive, send):
        head = [(b"content-length", b"%d" % len(answer))]
        await send({"type": "http.response.start", "status": 200, "headers": head})
        await send({"type": "http.response.body", "body": answer})

    async def main():
        options = connection_options(within_descriptors(Settings(max_connections=connections)))
        server = BoundedServer(uvicorn.Config(app, log_config=None, lifespan="off", **options))
        with socket.create_server(("127.0.0.1", 0)) as listening:
            serving = asyncio.create_task(server.serve([listening]))
            opened, heads = [], []
            for _ in range(connections + 1):
                reader, writer = await asyncio.open_connection(*listening.getsockname())
                opened.append((reader, writer))
                writer.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
                heads.append((await reader.readuntil(b"\r\n\r\n"))[:12])
            assert heads == [b"HTTP/1.1 200"] * connections + [b"HTTP/1.1 503"]
            for reader, _ in opened[:connections]:
                assert await reader.readexactly(len(answer)) == answer
            for _, writer in opened:
                writer.close()
            server.should_exit = True
            await serving

    asyncio.run(main())
