"""LAZ, unpacked in a process of its own.

lazrs 0.8.2 trusts the sizes inside compressed points: files damaged at random soon make it
allocate 4 GB at once, which ends the process, or panic. So that process is not the service. It has
limits on memory and time, and what it writes is checked.
"""

import io
import os
import resource
import signal
import subprocess
import sys

import numpy as np

from core.arrays import Float32Array
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan

_CHUNK_BYTES = 4 * 2**20
_MEMORY_BYTES, _WALL_S = 2**30, 60
_READ_BYTES = 12
_PASSED_ON = ("PYTHON", "LD_", "LANG", "LC_")  # what Python itself needs, and no key or password


def unpack(body: bytes, points: int) -> Float32Array:
    """Return the `(points, 3)` metres of a LAZ file whose header is checked.

    Raises:
        MalformedScan: If they cannot be unpacked within the limits.
    """
    with _started() as process:
        try:
            written, said = process.communicate(body, _WALL_S)
        except subprocess.TimeoutExpired as error:
            process.kill()
            raise MalformedScan(f"the points took more than {_WALL_S} s to unpack") from error
        except BaseException:
            process.kill()
            raise
    expected = points * _READ_BYTES
    if process.returncode or len(written) != expected:
        reason = said.decode("utf-8", "replace").strip().rpartition("\n")[2][:200]
        raise MalformedScan(
            f"the compressed points cannot be unpacked: {reason or 'the unpacker ended'};"
            f" it wrote {len(written)} of {expected} bytes"
        )
    return np.frombuffer(written, dtype="<f4").reshape(-1, 3)


def _started() -> subprocess.Popen[bytes]:
    """Start the process, which ignores what stops a service: a scan would count as malformed.

    Ctrl-C is for the whole group of processes. A service that stops still answers what it has
    begun; a process inherits the signals that the starting thread blocks.
    """
    # -P: no module is imported from the current folder.
    command = [sys.executable, "-P", "-m", "storage.formats.scans.laz"]
    # Each thread of OpenBLAS takes 40 MB of the memory that the process may have.
    environment = {k: v for k, v in os.environ.items() if k.startswith(_PASSED_ON)}
    environment["OPENBLAS_NUM_THREADS"] = "1"
    pipe = subprocess.PIPE
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        return subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
            command, stdin=pipe, stdout=pipe, stderr=pipe, env=environment
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def read_points(body: bytes, points: int) -> Float32Array:
    """Read the points of a LAS or LAZ file, at most as many as its header claims."""
    import laspy  # takes as long to import as NumPy: only for such a file

    returns_m = np.empty((points, 3), np.float32)
    at = 0
    backend = laspy.LazBackend.Lazrs
    with laspy.open(io.BytesIO(body), read_evlrs=False, laz_backend=backend) as reader:
        scales, offsets = reader.header.scales, reader.header.offsets
        if not (np.isfinite(scales).all() and np.isfinite(offsets).all()):
            raise MalformedScan(f"scales are {scales} and offsets {offsets}, wanted numbers")
        chunk_points = max(1, _CHUNK_BYTES // reader.header.point_format.size)
        for chunk in reader.chunk_iterator(chunk_points):
            with np.errstate(over="ignore", invalid="ignore"):  # infinite is no return
                steps = np.stack([chunk["X"], chunk["Y"], chunk["Z"]], axis=1)
                returns_m[at : at + len(steps)] = steps * scales + offsets
            at += len(steps)
    return returns_m[:at]


def _main() -> None:
    import laspy

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (BUDGET.laz_cpu_s, BUDGET.laz_cpu_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    body = sys.stdin.buffer.read()
    with laspy.open(io.BytesIO(body), read_evlrs=False) as reader:
        points = reader.header.point_count
    sys.stdout.buffer.write(read_points(body, points).astype("<f4").tobytes())


if __name__ == "__main__":
    _main()
