"""Signatures that have or see less than a map's own: what their distances mean is measured once."""

from collections.abc import Sequence
from functools import partial

from app.loading import Loading
from core.confidence.rescaling import Rescaling
from core.encodings.search import QueryLimits
from core.encodings.signature import Signature
from core.localization.localizer import Localizer
from core.mapping.tensormap import TensorMap


def _measured(of: tuple[TensorMap, QueryLimits]) -> Rescaling | None:
    tensor_map, limits = of
    return tensor_map.rescalings.known(limits)


_measuring = Loading(_measured)


def require_measured(localizer: Localizer, signatures: Sequence[Signature]) -> None:
    """Measure what distances of such signatures mean in a map, if that was not done yet.

    Args:
        localizer: The localizer of the map's revision.
        signatures: One query's signatures.

    Raises:
        NotLoaded: If it was not, and this thread must not wait for it.
    """
    tensor_map = localizer.map
    for signature in signatures:
        limits = tensor_map.model.limits_of(signature.values.shape, signature.view)
        if limits is not None:
            _measuring.get((tensor_map, limits), partial(tensor_map.rescalings, limits))
