"""Stands in for a program of ours: `commands.py` tells what for. Starts fast.

`python command_client.py SOCKET MODULE WORD...`
"""

import json
import os
import signal
import socket
import sys


def main() -> None:
    """Have a command run on this process's files, pass signals on to it, and end as it does."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as commands:
        commands.connect(sys.argv[1])
        folder = os.open(".", os.O_RDONLY)
        request = {
            "words": sys.argv[2:],
            "environment": dict(os.environ),
        }
        socket.send_fds(commands, [json.dumps(request).encode()], [0, 1, 2, folder])
        command = int(commands.recv(100))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda sent, _: os.kill(command, sent))
        status = int(commands.recv(100))
    if status < 0:  # a signal ended it
        signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    sys.exit(status)


if __name__ == "__main__":
    main()
