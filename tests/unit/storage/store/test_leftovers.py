"""What a start reads to find what no row names."""

from sqlalchemy import event

from storage.store import Store


def queries_of_a_start(store: Store) -> int:
    queries = []
    engine = store.catalog._database.engine

    def collect(_connection, _cursor, statement, *_):
        if statement.startswith("SELECT"):
            queries.append(statement)

    event.listen(engine, "before_cursor_execute", collect)
    store.recover()
    event.remove(engine, "before_cursor_execute", collect)
    return len(queries)


def test_a_start_makes_one_query_for_each_map_without_a_drive(store):
    before = queries_of_a_start(store)
    for index in range(10):
        store.maps.create(f"yard-{index}")
    assert queries_of_a_start(store) - before == 10  # of its revisions
