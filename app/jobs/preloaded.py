"""What jobs need: the process that forks them imports this module, and nothing else before."""

from contextlib import suppress
from importlib import import_module

from app.process import loading

_NEEDED = (
    "app.jobs.worker",
    # Imported by what uses them only when it does; KISS-ICP where it is installed.
    "core.encodings.harmonic.encoding",
    "h5py",
    "kiss_icp.config.parser",
    "kiss_icp.registration",
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.sparse.csgraph",
    "scipy.spatial.transform",
    "scipy.special",
    "sqlalchemy.dialects.sqlite",
)

with loading():
    for _name in _NEEDED:
        with suppress(ImportError):
            import_module(_name)
