"""Types of the catalog's columns, the same on every database."""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import JSON, DateTime, Dialect, String, Text, TypeDecorator


def plain(text: str) -> str:
    """Return a text as it is stored: U+FFFD for NUL, which PostgreSQL does not have."""
    return text.replace("\0", "\N{REPLACEMENT CHARACTER}")


class PlainString(TypeDecorator[str]):
    """A string; a query for a name with a NUL finds nothing, on any database."""

    impl = String
    cache_ok = True

    def process_bind_param(  # dialect: SQLAlchemy's signature
        self,
        value: str | None,
        dialect: Dialect,  # noqa: ARG002
    ) -> str | None:
        """Replace NUL."""
        return None if value is None else plain(value)


class PlainText(PlainString):
    """As `PlainString`, of any length."""

    impl = Text
    cache_ok = True


Id = PlainString(32)
# In the order of its bytes, whatever the database's collation is.
Slug = PlainString(64).with_variant(PlainString(64, collation="C"), "postgresql")
Digest = PlainString(64)


class UtcDateTime(TypeDecorator[datetime]):
    """A time in UTC; SQLite does not store the zone and would return a naive one."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(  # dialect: SQLAlchemy's signature
        self,
        value: datetime | None,
        dialect: Dialect,  # noqa: ARG002
    ) -> datetime | None:
        """Reject a naive time, store an aware one in UTC."""
        if value is not None and value.tzinfo is None:
            raise ValueError(f"{value} has no time zone")
        return None if value is None else value.astimezone(UTC)

    def process_result_value(
        self,
        value: datetime | None,
        dialect: Dialect,  # noqa: ARG002
    ) -> datetime | None:
        """Return an aware time in UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class JsonOrNull(TypeDecorator[Any]):
    """JSON of a list or an object; NULL when it is empty, as in rows of earlier versions."""

    impl = JSON
    cache_ok = True

    def __init__(self, empty: type) -> None:
        self.empty = empty
        super().__init__(none_as_null=True)

    def process_bind_param(self, value: Any, dialect: Dialect) -> Any:  # noqa: ANN401, ARG002
        """Store nothing for an empty value."""
        return value or None

    def process_result_value(self, value: Any, dialect: Dialect) -> Any:  # noqa: ANN401, ARG002
        """Return an empty value for nothing."""
        return self.empty() if value is None else value


Values = JsonOrNull(dict)
