"""TensorMap's method: numpy, scipy and threadpoolctl only, no files, no HTTP, no HDF5.

These names are its public API. Each is loaded when it is first used, so that importing one module
of `core` loads no other. SciPy is imported where it is used, since answers do without: it takes
45 MB and 0.3 s (docs/decisions/0033-hot-path.md).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from core.encodings.base import Encoding as Encoding
    from core.encodings.signature import Signature as Signature
    from core.encodings.signature import pack_signatures as pack_signatures
    from core.encodings.signature import unpack_signatures as unpack_signatures
    from core.errors import TensorMapError as TensorMapError
    from core.evaluation.condition import Condition as Condition
    from core.evaluation.evaluate import Evaluation as Evaluation
    from core.evaluation.evaluate import EvaluationProtocol as EvaluationProtocol
    from core.evaluation.evaluate import evaluate as evaluate
    from core.localization.localizer import Localization as Localization
    from core.localization.localizer import Localizer as Localizer
    from core.localization.match import Match as Match
    from core.mapping.merge import merge_maps as merge_maps
    from core.mapping.merge import without_drives as without_drives
    from core.mapping.pipeline import build_map as build_map
    from core.mapping.tensormap import TensorMap as TensorMap
    from core.parameters import MapParameters as MapParameters
    from core.scans.accumulation import accumulate as accumulate
    from core.scans.drive import Drive as Drive
    from core.scans.drive import MemoryDrive as MemoryDrive
    from core.scans.mounting import Mounting as Mounting
    from core.scans.mounting import vehicle_drive as vehicle_drive
    from core.scans.pose import Pose as Pose
    from core.scans.scan import Scan as Scan
    from core.scans.tilt import Tilt as Tilt
    from core.tracking.track import Observation as Observation
    from core.tracking.track import Track as Track
    from core.tracking.track import Tracker as Tracker

_MODULE_OF = {
    name: module
    for module, names in (
        ("core.encodings.base", "Encoding"),
        ("core.encodings.signature", "Signature pack_signatures unpack_signatures"),
        ("core.errors", "TensorMapError"),
        ("core.evaluation.condition", "Condition"),
        ("core.evaluation.evaluate", "Evaluation EvaluationProtocol evaluate"),
        ("core.localization.localizer", "Localization Localizer"),
        ("core.localization.match", "Match"),
        ("core.mapping.merge", "merge_maps without_drives"),
        ("core.mapping.pipeline", "build_map"),
        ("core.mapping.tensormap", "TensorMap"),
        ("core.parameters", "MapParameters"),
        ("core.scans.accumulation", "accumulate"),
        ("core.scans.drive", "Drive MemoryDrive"),
        ("core.scans.mounting", "Mounting vehicle_drive"),
        ("core.scans.pose", "Pose"),
        ("core.scans.scan", "Scan"),
        ("core.scans.tilt", "Tilt"),
        ("core.tracking.track", "Observation Track Tracker"),
    )
    for name in names.split()
}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - PEP 562: mypy reads the imports above
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'core' has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
