"""The Python client's calls of a service in this process."""

HERE = "http://127.0.0.1"


def watched(client, note):
    """Return a client's connections; each request is passed to `note`, with its answer."""
    send = client._transport.handle_request

    class Watched:
        def handle_request(self, request):
            answer = send(request)
            note(request, answer)
            return answer

        def close(self):
            pass

    return Watched()


def counted(client):
    """Return a client's connections, and what is requested of them from now on.

    Each request is the last word of its path, with the status of its answer.
    """
    requested = []

    def note(request, answer):
        requested.append((request.url.path.rpartition("/")[2], answer.status_code))

    return watched(client, note), requested
