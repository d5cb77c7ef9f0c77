"""Which tests share a worker: those that would otherwise make the same thing in each."""

from xdist.scheduler import LoadScopeScheduling

__all__ = ["ByModule"]

_ALONE = ("tests/docs/", "tests/api/test_schemathesis.py", "tests/torture/")
_POSTGRESQL = "postgresql"


class ByModule(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
    """A module's tests run where its fixtures are, all on PostgreSQL where the cluster is.

    Documents, operations and attacks take longest and share little: each goes where there is room.
    A mark on tests would say the same, but xdist 3.8 reads marks through a field that pytest 9.2 no
    longer looks at.
    """

    def _split_scope(self, nodeid: str) -> str:
        module, _, test = nodeid.partition("::")
        if _POSTGRESQL in module or f"[{_POSTGRESQL}" in test or f"{_POSTGRESQL}]" in test:
            return _POSTGRESQL
        return nodeid if module.startswith(_ALONE) else module
