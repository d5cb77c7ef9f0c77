"""Queries by signature that are as quick as those like them were."""

from collections.abc import Hashable
from contextlib import AbstractContextManager
from weakref import WeakKeyDictionary

from app.localization.query_schemas import LocalizeQuery
from app.quick_work import LastTimes
from core.localization.localizer import Localizer

_times: WeakKeyDictionary[Localizer, LastTimes] = WeakKeyDictionary()


def measured_query(
    localizer: Localizer, body: bytes, query: LocalizeQuery
) -> AbstractContextManager[None]:
    """Return the block of a query's localization; see `LastTimes.measured`.

    Those of equally long bodies, for as many matches and with the same options, are alike: partial
    views and limits of reach make a packed signature longer.
    """
    kind: Hashable = len(body), query.k, frozenset(query.model_fields_set)
    return _times.setdefault(localizer, LastTimes()).measured(kind)
