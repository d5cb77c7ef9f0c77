"""TensorMap's method: numpy and scipy only, no files, no HTTP, no HDF5.

These names are its public face. Each is loaded when it is first used, so that importing one module
of `core` loads no other.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from core.encodings.base import Encoding
    from core.encodings.signature import Signature, pack_signatures, unpack_signatures
    from core.errors import TensorMapError
    from core.evaluation.condition import Condition
    from core.evaluation.evaluate import EvaluationProtocol, evaluate
    from core.evaluation.result import Evaluation
    from core.localization.localizer import Localization, Localizer
    from core.localization.match import Match
    from core.mapping.merge import merge_maps, without_drives
    from core.mapping.pipeline import build_map
    from core.mapping.tensormap import TensorMap
    from core.parameters import MapParameters
    from core.scans.drive import Drive, MemoryDrive
    from core.scans.pose import Pose
    from core.scans.scan import Scan
    from core.tracking.track import Observation, Track, Tracker

__all__ = [
    "Condition",
    "Drive",
    "Encoding",
    "Evaluation",
    "EvaluationProtocol",
    "Localization",
    "Localizer",
    "MapParameters",
    "Match",
    "MemoryDrive",
    "Observation",
    "Pose",
    "Scan",
    "Signature",
    "TensorMap",
    "TensorMapError",
    "Track",
    "Tracker",
    "build_map",
    "evaluate",
    "merge_maps",
    "pack_signatures",
    "unpack_signatures",
    "without_drives",
]

_MODULE_OF = {
    name: module
    for module, names in (
        ("core.encodings.base", "Encoding"),
        ("core.encodings.signature", "Signature pack_signatures unpack_signatures"),
        ("core.errors", "TensorMapError"),
        ("core.evaluation.condition", "Condition"),
        ("core.evaluation.evaluate", "EvaluationProtocol evaluate"),
        ("core.evaluation.result", "Evaluation"),
        ("core.localization.localizer", "Localization Localizer"),
        ("core.localization.match", "Match"),
        ("core.mapping.merge", "merge_maps without_drives"),
        ("core.mapping.pipeline", "build_map"),
        ("core.mapping.tensormap", "TensorMap"),
        ("core.parameters", "MapParameters"),
        ("core.scans.drive", "Drive MemoryDrive"),
        ("core.scans.pose", "Pose"),
        ("core.scans.scan", "Scan"),
        ("core.tracking.track", "Observation Track Tracker"),
    )
    for name in names.split()
}


def __getattr__(name: str) -> Any:  # noqa: ANN401 - PEP 562: mypy reads the imports above
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'core' has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
