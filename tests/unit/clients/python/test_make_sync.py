from make_sync import sync_files


def test_the_synchronous_client_is_made_of_the_asynchronous_one():
    for path, text in sync_files():
        assert path.read_text() == text, "run `python clients/python/make_sync.py`"
