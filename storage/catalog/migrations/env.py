"""What Alembic runs: on the connection it is given, without touching anybody's logging."""

from alembic import context

from storage.catalog.models import Base

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    transactional_ddl=True,  # SQLite has it too, once its driver leaves BEGIN to us
    render_as_batch=True,  # how SQLite alters a table
)
context.run_migrations()
